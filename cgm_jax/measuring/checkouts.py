"""This checkout and a worktree of another commit, ready to run."""

import compileall
import contextlib
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from cgm_jax.config.fields import SettingError

HERE = Path(__file__).resolve().parents[2]
"""Where this code runs from."""

PACKAGES = ("cgm_jax", "envs")
PROGRAM = "cgm_jax/sweep.py"
LIBRARIES = ("jax", "mujoco.mjx")
"""What takes longest to read from the disk when a sweep starts."""


@dataclass(frozen=True)
class Checkout:
    """A directory that holds the files of a commit, named by its short hash."""

    root: Path
    commit: str

    def environment(self) -> dict[str, str]:
        """Variables under which Python imports this checkout's packages."""
        theirs = os.environ.get("PYTHONPATH")
        paths = [str(self.root), *([theirs] if theirs else [])]
        return {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}


def this_checkout() -> Checkout:
    """The checkout that this code runs from.

    Raises:
        SettingError: it is none, such as an installed wheel; git is missing; or files differ
            from the commit.
    """
    if not (HERE / ".git").exists():
        raise SettingError(f"against: {HERE} is not a git checkout")
    changed = [line[3:] for line in _ask(HERE, "status", "--porcelain", "-uno").splitlines()]
    if changed:
        more = f" and {len(changed) - 1} more" if len(changed) > 1 else ""
        raise SettingError(f"against: {HERE} has uncommitted changes: {changed[0]}{more}")
    return Checkout(HERE, find_commit(HERE, "HEAD"))


def find_commit(root: Path, name: str) -> str:
    """The short hash of a commit.

    Raises:
        SettingError: there is no such commit, or it has no sweeps.
    """
    revision = f"{name}^{{commit}}"
    verify = ("rev-parse", "--verify", "--quiet", "--short=8", "--end-of-options", revision)
    found = _git(root, *verify)
    if found.returncode:
        raise SettingError(f"against: there is no commit {name!r} in {root}")
    commit = found.stdout.strip()
    if not _ask(root, "ls-tree", "--name-only", commit, PROGRAM):
        raise SettingError(f"against: commit {name} has no {PROGRAM}")
    return commit


@contextlib.contextmanager
def worktree(root: Path, commit: str, path: Path) -> Iterator[Checkout]:
    """A worktree of a commit at `path`, removed at the end of the block.

    Raises:
        SettingError: git cannot make it.
    """
    try:
        _ask(root, "worktree", "add", "--detach", str(path), commit)
        yield Checkout(path, commit)
    finally:
        _git(root, "worktree", "remove", "--force", "--force", str(path))


def prepare(checkout: Checkout) -> None:
    """Make starts of a checkout comparable: its bytecode compiled, libraries read from disk.

    Raises:
        SettingError: Python cannot import the checkout's package, or imports another one.
    """
    for package in PACKAGES:
        compileall.compile_dir(checkout.root / package, quiet=2)
    program = f"import {', '.join([*LIBRARIES, 'cgm_jax'])}; print(cgm_jax.__file__)"
    result = subprocess.run(
        [sys.executable, "-c", program],
        cwd=checkout.root,
        env=checkout.environment(),
        capture_output=True,
        text=True,
        check=False,
        process_group=0,
    )
    if result.returncode:
        said = "".join(result.stderr.strip().splitlines()[-1:])
        raise SettingError(f"against: {checkout.commit} cannot be imported: {said}")
    imported = Path(result.stdout.splitlines()[-1]).resolve()
    if not imported.is_relative_to(checkout.root.resolve()):
        raise SettingError(f"against: Python imports {imported} in place of {checkout.root}")


def _ask(root: Path, *arguments: str) -> str:
    """What git answers.

    Raises:
        SettingError: git is missing or fails.
    """
    result = _git(root, *arguments)
    if result.returncode:
        raise SettingError(f"against: git {arguments[0]}: {result.stderr.strip()}")
    return result.stdout


def _git(root: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    try:
        return subprocess.run(
            ["git", "-C", str(root), "-c", "core.hooksPath=/dev/null", *arguments],
            capture_output=True,
            text=True,
            check=False,
            process_group=0,  # Ctrl-C is for us, and does not leave half a worktree
        )
    except OSError as error:
        raise SettingError(f"against: cannot run git: {error.strerror}") from None
