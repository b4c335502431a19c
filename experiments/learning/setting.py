"""The setting of a run: what the seeds of a line, or of a row of a table, have in common."""

from collections.abc import Mapping
from typing import Any, NamedTuple

NO_MASKS = "no masks"
UNIFORM = "uniform masks"
CGM = "CGM"


class Setting(NamedTuple):
    """What tells runs apart in a comparison, besides their seeds.

    Attributes:
        env: the task.
        her: whether hindsight is replayed.
        her_filter: whether only from episodes that moved the achieved goal.
        random_action_steps: how many steps a random action lasts.
        masks: where masks come from: `NO_MASKS`, `UNIFORM`, `CGM`, or CGM that knows the success of
            masks otherwise than as a product of sub-goal rates.
        c_g: success rate aimed at; None where nothing is aimed at.
        kappa: sharpness; None likewise.
    """

    env: str
    her: bool
    her_filter: bool
    random_action_steps: int
    masks: str
    c_g: float | None = None
    kappa: float | None = None

    @property
    def algorithm(self) -> str:
        """What learns, in words."""
        if not self.her:
            return "DDPG"
        return "DDPG + HER" if self.her_filter else "DDPG + HER (from all episodes)"

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


def setting_of(settings: Mapping[str, Any]) -> Setting:
    """The setting of a run, from all its settings by name. Nothing else decides it."""
    curriculum = _curriculum(settings)
    return Setting(
        settings["env"],
        settings["her"],
        settings["her"] and settings["her_filter"],
        settings["random_action_steps"],
        *curriculum,
    )


def _curriculum(settings: Mapping[str, Any]) -> tuple[str, float | None, float | None]:
    """Where masks come from, c_g and kappa."""
    if not settings["cgm"]:
        return NO_MASKS, None, None
    if settings["kappa"] == 0:
        return UNIFORM, None, None
    masks = CGM
    if settings["masked_evaluation_episodes"]:
        masks = "CGM, masks measured"
    elif not settings["factorised"]:
        masks = "CGM, joint rates"
    return masks, settings["c_g"], settings["kappa"]
