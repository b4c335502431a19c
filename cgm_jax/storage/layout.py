"""The parts of a run directory, by name; that none leads elsewhere; what it lacks."""

import os
import stat
from pathlib import Path

from cgm_jax.config.fields import SettingError
from cgm_jax.machine.commands import shell_command
from cgm_jax.storage.lock import HOLDER, LOCK

START = "start.npz"
METRICS, TABLE = "metrics.jsonl", "metrics.csv"
CONFIG, LAUNCH = "config.json", "launch.json"
PARTS = (
    *(CONFIG, START, METRICS, TABLE, LOCK, HOLDER),
    *("policies", "figures", "checkpoints", "tracking"),
    *(LAUNCH, "parts", "attempts", "logs"),
)

SLURM = "slurm"
"""Folder of submitit's, which makes links in it: each launcher has a new folder there, so that
nothing that lay in it before is ever opened."""

HELD = {CONFIG: "sweep", LAUNCH: "launch"}
"""What a directory holds in which there is one of these files."""

WANDB_LOG = "debug-core.log"


def check_parts(path: Path) -> None:
    """Check that all parts of a run directory are ordinary files and directories.

    A symbolic link in a directory from elsewhere would have a sweep write wherever it leads to. One
    that wandb makes beside its log is left alone, since nothing here opens it; so is what lies in
    submitit's folder.

    Raises:
        SettingError: one is not.
    """
    for part in (*PARTS, SLURM):
        within = [] if part == SLURM else os.walk(path / part)
        for folder, folders, files in [(path, [part], []), *within]:
            for name in (*folders, *files):
                found = Path(folder) / name
                kept = found.relative_to(path).parts
                if name == WANDB_LOG and Path(folder).name == "logs" and "tracking" in kept:
                    continue
                try:
                    mode = found.lstat().st_mode
                except OSError:  # there is none
                    continue
                if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
                    kind = "a symbolic link" if stat.S_ISLNK(mode) else "no ordinary file"
                    raise SettingError(f"{found} is {kind}, which a run directory may not hold")


def why_it_holds_none(path: Path, missing: str) -> str:
    """One line on a path where a sweep or a launch should be and is not.

    Args:
        path: what the user has named.
        missing: the file that the directory lacks, `CONFIG` or `LAUNCH`.
    """
    (other,) = HELD.keys() - {missing}
    kind, found = HELD[missing], HELD[other]
    try:
        if not stat.S_ISDIR(path.stat().st_mode):
            return f"{path} is no directory"
        if not (path / other).exists():
            return f"{path} holds no {kind}: {missing} is missing"
    except (FileNotFoundError, NotADirectoryError):
        return f"there is no directory {path}"
    except OSError as error:
        return f"cannot look at {path}: {error.strerror}"
    parts = f", whose parts are in {path / 'parts'}" if found == "launch" else ""
    how = shell_command(f"cgm_jax.{found}", "--resume", path)
    return f"{path} holds no {kind}, but a {found}{parts}; to resume it: {how}"
