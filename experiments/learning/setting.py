"""The setting of a run: what the seeds of a line, or of a row of a table, have in common."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import PurePath
from typing import Any, NamedTuple

from cgm_jax.config.components import builtin
from cgm_jax.config.fields import declared
from experiments.markdown import counted, percent

NO_MASKS = "no masks"
UNIFORM = "uniform masks"
CGM = "CGM"
CURRICULA = {
    "full": NO_MASKS,
    "uniform": UNIFORM,
    "cgm": CGM,
    "goid": "GOID",
    "mega": "MEGA",
    "vds": "VDS",
}
"""What curricula are called, where that is not the option's value."""

VARIANTS: Mapping[str, Callable[[Any], str]] = {
    "factorised": lambda _: "joint rates",
    "masked_evaluation_episodes": lambda _: "masks measured",
    "success_history": lambda h: f"h = {h}",
    "full_share": lambda share: f"{percent(share, 1)} full goals",
    "mask_levels": lambda _: "difficulty first",
    "critics": lambda number: counted(number, "critic"),
}
"""How settings of a curriculum are told that are not at their defaults."""

USUAL_LAYERS = [128, 128, 128]


class Setting(NamedTuple):
    """What tells runs apart in a comparison, besides their seeds.

    Attributes:
        env: the environment.
        air_probability: chance of a goal in the air, where that is not the environment's own.
        agent: what learns.
        her: whether hindsight is replayed.
        her_filter: whether only from episodes that moved the achieved goal.
        her_masks: whether under the masks of its episodes.
        mask_input: whether the networks see which dimensions are masked.
        random_action_steps: how many steps a random action lasts.
        masks: where masks come from: `NO_MASKS`, `UNIFORM`, `CGM`, or another curriculum; with what
            is not at its default.
        c_g: success rate aimed at; None where nothing is aimed at.
        kappa: sharpness; None likewise.
        stages: how stages before the goal are pursued and replayed; empty where they are not.
        hidden_layers: their widths; empty where they are those of most plans, `USUAL_LAYERS`.
        engine: of physics; empty where that is C MuJoCo, or the environment's own.
    """

    env: str
    air_probability: float | None
    agent: str
    her: bool
    her_filter: bool
    her_masks: bool
    mask_input: bool
    random_action_steps: int
    masks: str
    c_g: float | None = None
    kappa: float | None = None
    stages: str = ""
    hidden_layers: str = ""
    engine: str = ""

    @property
    def task(self) -> str:
        """What is to be learned, in words."""
        name = self.env.replace("_", "-")
        if self.air_probability is None:
            return name
        return f"{name}, {percent(self.air_probability)} in the air"

    @property
    def algorithm(self) -> str:
        """What learns, in words."""
        details = {
            "from all episodes": self.her and not self.her_filter,
            "masked hindsight": self.her_masks,
            "mask as input": self.mask_input,
            self.stages: bool(self.stages),
            self.hidden_layers: bool(self.hidden_layers),
            f"on {self.engine}": bool(self.engine),
        }
        told = ", ".join(detail for detail, holds in details.items() if holds)
        name = f"{self.agent.upper()} + HER" if self.her else self.agent.upper()
        return f"{name} ({told})" if told else name

    @property
    def curriculum(self) -> str:
        """What is practised, in words."""
        if self.c_g is None:
            return self.masks
        return f"{self.masks} ({100 * self.c_g:g} %, {self.kappa:g})"

    def differs_in_masks_alone(self, other: "Setting") -> bool:
        """Whether nothing but the curriculum tells two settings apart."""
        apart = {"masks": "", "c_g": None, "kappa": None}
        return self != other and self._replace(**apart) == other._replace(**apart)

    def differs_in_learning_alone(self, other: "Setting") -> bool:
        """Whether nothing but the agent and what its networks see tells two settings apart."""
        apart = {"agent": "", "her_masks": False, "mask_input": False, "stages": ""}
        return self != other and self._replace(**apart) == other._replace(**apart)


def setting_of(settings: Mapping[str, Any]) -> Setting:
    """The setting of a run, from all its settings by name. Nothing else decides it."""
    her, air = settings["her"], settings["air_probability"]
    return Setting(
        PurePath(settings["env"].partition(".py:")[0]).name,
        None if air == 1.0 else air,
        settings["agent"],
        her,
        her and settings["her_filter"],
        her and settings["her_masks"],
        settings["mask_input"],
        settings["random_action_steps"],
        _masks(settings),
        settings.get("c_g"),
        settings.get("kappa"),
        _stages(settings) if settings["relabelling"] == "relay" else "",
        _widths(settings["hidden_layers"]),
        settings["engine"] if settings["engine"] in ("mjx", "warp") else "",
    )


def _stages(settings: Mapping[str, Any]) -> str:
    """By which chance stages are pursued before the goal, and which share of hindsight they get."""
    chance, share = percent(settings["relay_chance"]), percent(settings["relay_share"])
    return f"stages by {chance}, {share} of hindsight" if settings["her"] else f"stages by {chance}"


def _widths(hidden_layers: Sequence[int]) -> str:
    return "" if [*hidden_layers] == USUAL_LAYERS else " x ".join(map(str, hidden_layers))


def _masks(settings: Mapping[str, Any]) -> str:
    """The curriculum's name, and what is not at its default."""
    name: str = settings["curriculum"]
    fields = declared(builtin("curriculum")[name]) if name in builtin("curriculum") else []
    told = [item for item in fields if item.name not in ("c_g", "kappa", "discount")]
    variants = [
        _variant(item.name, value)
        for item in told
        if (value := settings.get(item.name, item.default)) != item.default
    ]
    if settings["agent"] == "ddpg" and settings["critics"] > 1:
        variants.append(_variant("critics", settings["critics"]))
    return ", ".join([CURRICULA.get(name, name), *variants])


def _variant(name: str, value: Any) -> str:
    return VARIANTS[name](value) if name in VARIANTS else f"{name} = {value}"
