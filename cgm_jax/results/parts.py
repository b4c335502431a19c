"""The parts of a sweep, read and checked before they are put together.

What counts are the last checkpoints, since only what they hold is safe.
"""

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from cgm_jax.config.components import NAMES
from cgm_jax.config.fields import SettingError
from cgm_jax.config.shards import Shard
from cgm_jax.machine.commands import shell_command
from cgm_jax.results.same_names import same_names
from cgm_jax.results.statistics import have_finished
from cgm_jax.storage.arrays import open_arrays
from cgm_jax.storage.checkpoints import damage, finished_checkpoints, format_of, position_of
from cgm_jax.storage.config_file import renamed, start_beside
from cgm_jax.storage.files import ABSENT, reading
from cgm_jax.storage.layout import CONFIG
from cgm_jax.storage.metrics import Row, check_rows, from_lines
from cgm_jax.storage.run_directory import RunDirectory
from cgm_jax.storage.untrusted import UNREADABLE


@dataclass(frozen=True)
class Piece:
    """A group of runs that has finished: its last checkpoint and its rows."""

    checkpoint: Path
    rows: list[Row]


@dataclass(frozen=True)
class Part:
    """A finished part of a sweep.

    Attributes:
        path: its run directory.
        config: what its config.json says.
        shard: which part it is.
        pieces: its groups of runs, in order.
        start: SHA-256 of start.npz, from which it began; None for from scratch.
    """

    path: Path
    config: dict[str, Any]
    shard: Shard
    pieces: list[Piece]
    start: str | None


def read_parts(paths: Sequence[Path]) -> list[Part]:
    """The parts of a sweep, in order.

    Raises:
        SettingError: what lies there are not all parts of one sweep, each once and finished.
        ReadError: a file of theirs cannot be read just now.
    """
    opened = [(path, RunDirectory.open(path)) for path in paths]
    shards: dict[Path, Shard] = {}
    for path, directory in opened:
        shard = directory.config.shard()
        if shard is None:
            raise SettingError(f"{path} is no part of a sweep: it was trained without --shard")
        first, other = next(iter(shards.items()), (path, shard))
        if shard.sweep != other.sweep:
            raise SettingError(
                f"{path} is part of another sweep than {first}; if another version trained it, "
                "give its command again"
            )
        if shard.parts != other.parts:
            raise SettingError(
                f"{path} is a part of {shard.parts}, but {first} is a part of {other.parts}"
            )
        same = [before for before, known in shards.items() if known.part == shard.part]
        if same or path in shards:
            raise SettingError(f"part {shard.part} is given twice: {[*same, path][0]} and {path}")
        shards[path] = shard
    _check_complete(list(shards.values()))
    parts = []
    for path, directory in opened:
        with reading(path):
            parts.append(_read_part(path, directory, shards[path]))
    _check_same_start(parts)
    _check_same_settings(parts)
    parts = sorted(parts, key=lambda part: part.shard.part)
    names = same_names([part.config for part in parts])
    return [_renamed(part, its) for part, its in zip(parts, names, strict=True)]


def policies_of(part: Part) -> Iterator[Path]:
    """The policies of a part's runs, as paths in its folder of policies."""
    names = [run["name"] for group in part.config["groups"] for run in group["runs"]]
    yield from (Path(f"{name}.npz") for name in names)
    known = set(names)
    for path in sorted((part.path / "policies/improvements").glob("*_epoch*.npz")):
        if path.stem.rpartition("_epoch")[0] in known:
            yield Path("improvements") / path.name


def _check_complete(shards: Sequence[Shard]) -> None:
    if not shards:
        raise SettingError("directories: name those of all parts of a sweep")
    there, parts = {shard.part for shard in shards}, shards[0].parts
    missing = [str(part) for part in range(1, parts + 1) if part not in there]
    if missing:
        more = f", ... ({len(missing)} in all)" if len(missing) > 8 else ""
        are = "part" if len(missing) == 1 else "parts"
        raise SettingError(
            f"{are} {', '.join(missing[:8])}{more} of {parts} missing: train with "
            f"--shard {missing[0]}/{parts}"
        )


def _check_same_start(parts: Sequence[Part]) -> None:
    """Check that parts began from the same, which the merged directory can begin anew from.

    What it holds decides, since on another machine it may have lain elsewhere.

    Raises:
        SettingError: they did not.
    """
    first = parts[0]
    for part in parts[1:]:
        if part.start != first.start:
            then, there = (one.config.get("from") or "nothing" for one in (part, first))
            which = ", another one" if then == there else ""
            raise SettingError(
                f"from: {part.path} was begun from {then}{which}, but {first.path} from {there}"
            )


def _check_same_settings(parts: Sequence[Part]) -> None:
    """Check that parts differ in nothing but what the sweep varies.

    Settings at their default do not tell sweeps apart, and a default may have changed in between.

    Raises:
        SettingError: they do.
    """
    known: dict[str, tuple[Path, Any]] = {}
    for part in parts:
        varies = {*part.shard.swept, *NAMES, "name", "seed", "epochs"}  # one may train for longer
        for run in (run for group in part.config["groups"] for run in group["runs"]):
            for name in run.keys() - varies:
                there, value = known.setdefault(name, (part.path, run[name]))
                if run[name] != value:
                    raise SettingError(
                        f"{name}: {part.path} was trained with {run[name]!r:.60}, "
                        f"but {there} with {value!r:.60}"
                    )


def _read_part(path: Path, directory: RunDirectory, shard: Shard) -> Part:
    config = directory.config.read()
    try:
        pieces = [
            _read_piece(path, index, entry["runs"]) for index, entry in enumerate(config["groups"])
        ]
        start = start_beside(path / CONFIG)
        digest = None if start is None else _digest(start)
    except (*ABSENT, *UNREADABLE) as error:
        if isinstance(error, SettingError):
            raise
        text = str(error).partition("\n")[0]
        raise SettingError(f"{path} cannot be read: {type(error).__name__}: {text}") from None
    part = Part(path, config, shard, pieces, digest)
    for name in policies_of(part):
        if not (path / "policies" / name).is_file():
            raise SettingError(f"{path / 'policies' / name} is missing; {_resume(path)}")
    return part


def _renamed(part: Part, names: dict[str, str]) -> Part:
    groups = renamed(part.config["groups"], names)
    pieces = [replace(piece, rows=renamed(piece.rows, names)) for piece in part.pieces]
    return replace(part, config={**part.config, "groups": groups}, pieces=pieces)


def _read_piece(path: Path, index: int, runs: Sequence[dict[str, Any]]) -> Piece:
    """What a group has come to; whatever is wrong with it raises."""
    last = next(reversed(finished_checkpoints(path / "checkpoints", index)), None)
    epochs, leave_at = runs[0]["epochs"], runs[0]["leave_at"]
    if last is None:
        raise _unfinished(path, 0, epochs)
    format_of(last)
    if (complaint := damage(last)) is not None:
        raise SettingError(f"{last} is damaged ({complaint}); {_resume(path)}")
    try:
        with open_arrays(last) as arrays:
            epoch, cycle = (int(number) for number in arrays["position"])
            rows = from_lines(bytes(arrays["rows"]).decode().splitlines())
    except (*ABSENT, *UNREADABLE) as error:
        raise SettingError(f"{last} is no checkpoint: {error}") from None
    names = [run["name"] for run in runs]
    try:
        check_rows(rows, names, epoch)
    except (ValueError, KeyError) as error:
        raise SettingError(f"{last} holds rows of other runs: {error}") from None
    rates = [row["success_rate"] for row in rows]
    in_epoch = (cycle, position_of(last)[2]) > (0, 0)
    if in_epoch or not have_finished(rates, len(runs), epoch, epochs, leave_at):
        raise _unfinished(path, epoch, epochs)
    own = {run["name"]: {kind: run[kind] for kind in NAMES if kind in run} for run in runs}
    return Piece(last, [row | _among(own[row["run"]], row) for row in rows])


def _among(names: dict[str, str], row: Row) -> dict[str, str]:
    """Names of own code as the config has them now: its files may have moved since."""
    return {kind: name for kind, name in names.items() if kind in row}


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _unfinished(path: Path, epoch: int, epochs: int) -> SettingError:
    return SettingError(f"{path} is not finished (epoch {epoch} of {epochs}); {_resume(path)}")


def _resume(path: Path) -> str:
    return f"resume it: {shell_command('cgm_jax.sweep', '--resume', path)}"
