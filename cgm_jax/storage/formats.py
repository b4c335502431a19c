"""Formats of config.json: older ones are read, newer ones are refused by name."""

from typing import Any

from cgm_jax.config.fields import SettingError

FORMAT = 2
"""1: a group had `settings` besides its runs, and `cgm` was a switch. 2: a run has all values."""


def upgraded(config: Any) -> Any:
    """A config as the present format has it.

    Raises:
        SettingError: its format is newer than this program.
    """
    number = config.get("format", 1)
    if number == FORMAT:
        return config
    if number != 1:
        raise SettingError(f"format: {number!r} is none that this version of cgm_jax reads")
    groups = [part for group in config["groups"] for part in _groups_of_format_1(group)]
    return {**config, "format": FORMAT, "groups": groups}


def _groups_of_format_1(group: dict[str, Any]) -> list[dict[str, Any]]:
    """The runs of an old group, in groups with one curriculum each; they trained `together`."""
    parts: dict[str, list[dict[str, Any]]] = {}
    for run in group["runs"]:
        values = _run_of_format_1(group["settings"], run)
        parts.setdefault(values["curriculum"], []).append(values)
    return [{"runs": runs, "together": len(group["runs"])} for runs in parts.values()]


CURRICULUM_ONLY = (
    "c_g",
    "kappa",
    "factorised",
    "success_history",
    "masked_evaluation_episodes",
)


def _run_of_format_1(settings: dict[str, Any], run: dict[str, Any]) -> dict[str, Any]:
    values = {**settings, **run}
    cgm = values.pop("cgm")
    if cgm and values["kappa"]:
        return {**values, "curriculum": "cgm"}
    values = {name: value for name, value in values.items() if name not in CURRICULUM_ONLY}
    return {**values, "curriculum": "uniform" if cgm else "full"}
