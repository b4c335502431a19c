"""Names of runs, which are names of files."""

import os
from collections.abc import Mapping, Sequence
from typing import Any

from cgm_jax.config.components import ROOMS
from cgm_jax.config.fields import SettingError
from cgm_jax.config.named import label
from cgm_jax.config.spelling import spelled

MAX_NAME = 200
"""Bytes of a run's name; files may have 255, of which their endings take some."""


def run_name(values: Mapping[str, Any], swept: Sequence[str], idle: frozenset[str]) -> str:
    """A file name that tells runs of a sweep apart.

    Args:
        values: of all settings of the run, by name.
        swept: settings that take several values in the sweep.
        idle: settings without effect, which stay out of the name.

    Raises:
        SettingError: it would be too long for a file.
    """
    agent = label(values["agent"])
    parts = [label(values["env"]), f"{agent}-her" if values.get("her") else agent]
    parts.append(label(values["curriculum"]))
    told = {"seed", "her", "env", *ROOMS}
    if values["curriculum"] == "cgm":
        parts[-1] += f"-cg{spelled(values['c_g'])}-kappa{spelled(values['kappa'])}"
        told |= {"c_g", "kappa"}
    if "relabelling" in swept:
        parts.append(label(values["relabelling"]))
    told |= idle
    parts += [f"{n.replace('_', '')}{spelled(values[n])}" for n in swept if n not in told]
    name = "_".join([*parts, f"seed{values['seed']}"])
    if len(os.fsencode(name)) > MAX_NAME:
        raise SettingError(f"env: a run's file would have too long a name, {name[:60]}...")
    return name
