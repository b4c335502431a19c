"""Names of runs, which are names of files."""

import hashlib
import os
from collections.abc import Mapping, Sequence
from typing import Any

from cgm_jax.config.components import ROOMS
from cgm_jax.config.named import label
from cgm_jax.config.spelling import spelled

MAX_NAME = 200
"""Bytes of a run's name; files may have 255, of which their endings take some."""


def run_name(values: Mapping[str, Any], swept: Sequence[str], idle: frozenset[str]) -> str:
    """A file name that tells runs of a sweep apart.

    One that would be too long for a file is cut, and has a digest of what it was instead.

    Args:
        values: of all settings of the run, by name.
        swept: settings that take several values in the sweep.
        idle: settings without effect, which stay out of the name.
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
    seed = f"_seed{values['seed']}"
    name = "_".join(parts)
    if len(os.fsencode(name + seed)) <= MAX_NAME:
        return name + seed
    digest = hashlib.sha256(os.fsencode(name)).hexdigest()[:12]
    kept = os.fsencode(name)[: MAX_NAME - len(f"_{digest}{seed}")]
    return f"{kept.decode(errors='ignore')}_{digest}{seed}"
