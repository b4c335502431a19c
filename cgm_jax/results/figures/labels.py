"""How figures name settings and their values."""

from collections.abc import Hashable, Mapping, Sequence
from pathlib import Path
from typing import Any

from cgm_jax.config.named import is_own
from cgm_jax.results.figures.runs import TrainedRun

MAX_CHARACTERS = 44
"""Characters of one value; the middle of a longer one is left out."""

TITLE_WIDTH = 54
"""Characters of a line of a title."""


def setting_text(name: str, value: Any) -> str:
    """A setting and its value, as labels and titles have them."""
    if name == "c_g" and isinstance(value, int | float):
        return f"$c_g$ = {100 * value:.10g} %"
    if name == "kappa" and isinstance(value, int | float):
        return f"$\\kappa$ = {value:.10g}"
    if name == "her" and isinstance(value, bool):
        return "HER" if value else "no HER"
    if name == "curriculum":
        return {"cgm": "CGM", "full": "no CGM (full)"}.get(value) or _named(name, value)
    if name == "agent":
        return _named(name, value) if is_own(value) else value.upper()
    if name == "env":
        return _named(name, value) if is_own(value) else value.replace("_", "-")
    return f"{name.replace('_', ' ')} {value_text(value)}"


def naming_array(key: str, size: int, row: Mapping[str, Any]) -> str | None:
    """The array of a row whose values name those of another one: `a` of `a_b`.

    Args:
        key: the other array's name.
        size: how many values that has; `a` has as many.
        row: of metrics.jsonl.

    Returns:
        The longest such name, or None.
    """
    words = key.split("_")
    for count in range(len(words) - 1, 0, -1):
        name = "_".join(words[:count])
        if isinstance(row.get(name), list) and len(row[name]) == size:
            return name
    return None


def value_text(value: Any) -> str:
    """A setting's value alone, as tick labels have it."""
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, tuple):
        return "x".join(value_text(item) for item in value)
    if isinstance(value, int | float):
        return f"{value:.12g}"
    return _plain(_short(str(value)))


def line_text(settings: Mapping[str, Any], names: Sequence[str]) -> str:
    """The settings of these names that a run has, for a legend."""
    return ", ".join(
        setting_text(name, settings[name]) for name in names if settings.get(name) is not None
    )


def title_text(
    runs: Sequence[TrainedRun], names: Sequence[str], further: Sequence[str] = ()
) -> str:
    """The settings of these names that all of the runs which have them share, for a title."""
    shared = {name: value for name in names if (value := shared_value(runs, name)) is not None}
    parts = [] if "env" not in shared else [setting_text("env", shared.pop("env"))]
    if "agent" in shared:
        agent = setting_text("agent", shared.pop("agent"))
        parts.append(f"{agent} + HER" if shared.get("her") is True else agent)
        if isinstance(shared.get("her"), bool):
            del shared["her"]
    parts += [setting_text(name, value) for name, value in shared.items()]
    return wrapped([*parts, *further])


def shared_value(runs: Sequence[TrainedRun], name: str) -> Hashable:
    """The one value that runs have of a setting; None if there are several, or none."""
    values = {run.settings.get(name) for run in runs} - {None}
    return values.pop() if len(values) == 1 else None


def wrapped(parts: Sequence[str]) -> str:
    """Parts with commas in between, in lines that fit over a panel."""
    lines = [""]
    for part in parts:
        joined = f"{lines[-1]}, {part}" if lines[-1] else part
        if len(joined) > TITLE_WIDTH and lines[-1]:
            lines[-1] += ","
            lines.append(part)
        else:
            lines[-1] = joined
    return "\n".join(lines)


def counted_runs(runs: Sequence[TrainedRun]) -> str:
    """How many they are."""
    return "1 run" if len(runs) == 1 else f"median of {len(runs)} runs"


def remarks(runs: Sequence[TrainedRun]) -> str:
    """What a label must add, in brackets."""
    parts = remark_parts(runs)
    return f" ({', '.join(parts)})" if parts else ""


def remark_parts(runs: Sequence[TrainedRun]) -> list[str]:
    """How many runs diverged, or had no valid episode, where there are such."""
    parts = []
    if never := sum(run.never_valid for run in runs):
        all_of_them = never == len(runs)
        parts.append("no valid episode" if all_of_them else f"{never} without valid episode")
    if diverged := sum(run.failed_row is not None for run in runs):
        parts.append(f"{diverged} diverged")
    return parts


def _named(kind: str, value: Any) -> str:
    text = value_text(value)
    return f"{kind} {text}" if text.startswith("_") else text  # matplotlib hides such labels


def _short(value: str) -> str:
    """Without its folders, and without its middle if it is long."""
    if ".py" in value:
        value = Path(value).name
    if len(value) <= MAX_CHARACTERS:
        return value
    half = (MAX_CHARACTERS - 3) // 2
    return f"{value[:half]}...{value[-half:]}"


def _plain(text: str) -> str:
    """Text that matplotlib does not take for a formula."""
    return text.replace("$", r"\$")
