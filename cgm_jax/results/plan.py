"""What policies are evaluated on. Needs no device, so that bad plans are refused early."""

from dataclasses import dataclass

from cgm_jax.config.fields import SettingError

AXES = "xyz"
"""Letters of the first goal dimensions, as `--mask` names them."""

RANGES = {"episodes": (1, 10**6), "seed": (0, 2**31 - 1), "recorded": (0, 1000)}


@dataclass(frozen=True)
class Plan:
    """What to evaluate on.

    Attributes:
        episodes: how many per policy. The first ones are the same for any number.
        seed: of starts and goals, the same for every policy.
        mask: goal axes that count as achieved, letters of `AXES`; "" is the full goal.
        recorded: of how many episodes, the first ones, to keep every state.
        view: whether they are for MuJoCo's viewer, and not for a video.
        engine: physics engine to use instead of the one in the settings, or None.

    Raises:
        SettingError: a number out of its range, or a mask of other letters.
    """

    episodes: int
    seed: int
    mask: str = ""
    recorded: int = 0
    view: bool = False
    engine: str | None = None

    def __post_init__(self) -> None:
        for name, (low, high) in RANGES.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise SettingError(f"{name}: {value} is not within [{low}, {high}]")
        letters = set(self.mask)
        if letters - set(AXES) or len(letters) < len(self.mask):
            raise SettingError(f"mask: {self.mask!r} is not made of x, y and z, each at most once")
