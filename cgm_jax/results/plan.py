"""What policies are evaluated on. Needs no device, so that bad plans are refused early."""

import re
from dataclasses import dataclass

import numpy as np

from cgm_jax.config.fields import SettingError

AXES = "xyz"
"""Letters of the first goal dimensions, as `--mask` names them; it numbers any from 0."""

RANGES = {"episodes": (1, 10**6), "seed": (0, 2**31 - 1), "recorded": (0, 1000)}


@dataclass(frozen=True)
class Plan:
    """What to evaluate on.

    Attributes:
        episodes: how many per policy. The first ones are the same for any number.
        seed: of starts and goals, the same for every policy.
        mask: goal dimensions that count as achieved, such as "xz" or "0,4"; "" is the full goal.
        recorded: of how many episodes, the first ones, to keep every state.
        view: whether they are for MuJoCo's viewer, and not for a video.
        gif_width: of the .gif that they are for, pixels; None where they are for something else.
        engine: physics engine to use instead of the one in the settings, or None.

    Raises:
        SettingError: a number out of its range, or a mask of other letters or twice the same.
    """

    episodes: int
    seed: int
    mask: str = ""
    recorded: int = 0
    view: bool = False
    gif_width: int | None = None
    engine: str | None = None

    def __post_init__(self) -> None:
        for name, (low, high) in RANGES.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise SettingError(f"{name}: {value} is not within [{low}, {high}]")
        axes = masked_axes(self.mask)
        if len(set(axes)) < len(axes):
            raise _bad_mask(self.mask)


def mask_words(mask: str) -> list[str]:
    """What a mask names, one by one: letters without commas, else letters or numbers."""
    return mask.split(",") if re.search(r"[\d,]", mask) else list(mask)


def masked_axes(mask: str) -> list[int]:
    """Numbers of the goal dimensions that a mask names.

    Raises:
        SettingError: it is made of something else.
    """
    axes = []
    for word in mask_words(mask):
        if not re.fullmatch(rf"[{AXES}]|[0-9]{{1,6}}", word):
            raise _bad_mask(mask)
        axes.append(AXES.index(word) if word in AXES else int(word))
    return axes


def goal_mask(mask: str, goal_size: int) -> np.ndarray:
    """From names of masked dimensions to 1 = keep, 0 = masked, [goal_size] float32."""
    kept = np.ones(goal_size, np.float32)
    kept[masked_axes(mask)] = 0.0
    return kept


def _bad_mask(mask: str) -> SettingError:
    return SettingError(
        f"mask: {mask!r} is not made of x, y and z, or of numbers from 0 with commas, "
        "each at most once"
    )
