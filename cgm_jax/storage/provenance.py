"""What results depend on besides the settings: versions, machine, code, flags."""

import functools
import importlib.metadata
import os
import platform
import subprocess
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from cgm_jax.config.named import files_of, folder_of, hosted_versions
from cgm_jax.config.user_code import digest_of
from cgm_jax.machine.allotment import available_cores
from cgm_jax.storage.untrusted import printable

PACKAGES = (
    *("cgm_jax", "jax", "jaxlib", "mujoco", "mujoco-mjx", "warp-lang"),
    *("flax", "optax", "brax", "numpy", "gymnasium"),
)
TITLES = {
    "python": "Python",
    "commit": "commit",
    "device": "device",
    "flags": "XLA_FLAGS",
    "machine": "",
}
"""Entries that are one text each, and what to call them."""

HOSTING = "CGM_JAX_GYMNASIUM_"
"""Prefix of environment variables on which results of hosted tasks depend."""

MAX_SHOWN = 100


def provenance(device: str, own_names: Iterable[str]) -> dict[str, Any]:
    """What this process computes with.

    Args:
        device: what JAX computes on.
        own_names: of the user's own code, which has been loaded.
    """
    files: dict[str, str] = {}
    hosted: dict[str, str] = {}
    for name in own_names:
        files |= files_of(name)
        versions = hosted_versions(name)
        hosted |= {f"{package} of {name}": version for package, version in versions.items()}
    return {
        "versions": {name: _version(name) for name in PACKAGES},
        "python": platform.python_version(),
        "commit": _commit(),
        "device": device,
        "flags": os.environ.get("XLA_FLAGS", ""),
        "variables": _variables("JAX_", *([HOSTING] if hosted else [])),
        "machine": f"{platform.platform()}, {cores()}",
        "files": files,
        "hosted": hosted,
    }


def changes(
    before: Mapping[str, Any], now: Mapping[str, Any], moved: Mapping[str, str]
) -> list[str]:
    """What differs now from then; what was not recorded then is left out.

    Args:
        before: as `provenance` returned it, though it may come from anybody.
        now: as it returns it now.
        moved: names of the user's own code then, and what they are called now.

    Raises:
        TypeError, AttributeError: `before` is something else.
    """
    found = [f"{_shown(old)} (now {_shown(new)})" for old, new in moved.items()]
    found += _changed_files(before.get("files", {}), moved)
    for kind in ("versions", "variables", "hosted"):
        old, new = before.get(kind, {}), now[kind]
        if kind == "hosted":
            old = moved_hosts(old, moved)
        known = PACKAGES if kind == "versions" else old
        names = [name for name in old if name in known and old[name] is not None]
        if kind == "variables":
            names = sorted({*old, *new}) if kind in before else []
        for name in names:
            if old.get(name) != new.get(name):
                found.append(_change(_shown(name), old.get(name), new.get(name)))
    for kind, title in TITLES.items():
        if kind in before and _decisive(kind, before[kind]) != _decisive(kind, now[kind]):
            found.append(_change(title, before[kind], now[kind]))
    return found


def _decisive(kind: str, entry: Any) -> Any:
    """What bits depend on of an entry: not on the number of cores, which ends that of a machine."""
    return str(entry).rpartition(", ")[0] if kind == "machine" else entry


def _change(title: str, before: Any, now: Any) -> str:
    return f"{title} {_shown(before)} (now {_shown(now)})".lstrip()


def _changed_files(before: Mapping[str, str], moved: Mapping[str, str]) -> Iterator[str]:
    for name, digest in before.items():
        path = moved_path(name, moved)
        now = digest_of(path)
        if now != digest:
            then = f"SHA-256 {_shown(digest)[:12]}"
            yield f"{_shown(str(path))} with {then} (now {now[:12] if now else 'gone'})"


def moved_path(name: str, moved: Mapping[str, str]) -> Path:
    """Where a file is now, if it was, or was beside, what the user has named again elsewhere."""
    for old, new in moved.items():
        folder, file = os.path.split(old.rpartition(":")[0])
        if name == os.path.join(folder, file):  # noqa: PTH118
            return Path(new.rpartition(":")[0])
        if folder and Path(name).is_relative_to(folder):
            return folder_of(new) / Path(name).relative_to(folder)
    return Path(name)


def moved_hosts(hosted: Mapping[str, str], moved: Mapping[str, str]) -> dict[str, str]:
    """Versions by package and task, where tasks have been named again."""
    apart = {name: name.partition(" of ") for name in hosted}
    return {
        f"{package}{of}{moved.get(task, task)}": hosted[name]
        for name, (package, of, task) in apart.items()
    }


def _variables(*prefixes: str) -> dict[str, str]:
    """Environment variables, less those of a cache, which change no result."""
    return {
        name: value
        for name, value in sorted(os.environ.items())
        if name.startswith(prefixes) and "CACHE" not in name
    }


def _version(package: str) -> str | None:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


@functools.cache
def _commit() -> str | None:
    """The commit of this checkout, marked if it has changes; None in an installed wheel.

    Asked for once, since a process does not follow when the checkout moves on, but for what it has
    not imported yet.
    """
    checkout = Path(__file__).parents[2]
    if not (checkout / ".git").exists():
        return None
    describe = ["describe", "--always", "--exclude=*", "--abbrev=12", "--dirty"]
    git = ["git", "-C", str(checkout), *describe]
    try:
        result = subprocess.run(git, capture_output=True, text=True, check=False)
    except OSError:
        return None
    return result.stdout.strip() or None


def cores() -> str:
    """How many of the machine's cores this process may use, on which its time depends."""
    usable, there = available_cores(), os.cpu_count()
    return f"{there} cores" if usable == there else f"{usable} of {there} cores"


def _shown(value: Any) -> str:
    """A value from a config, which may come from anybody: one short line, fit for a terminal."""
    text = "none" if value is None else str(value)
    text = printable(text) or "none"
    return text if len(text) <= MAX_SHOWN else f"{text[:MAX_SHOWN]}..."
