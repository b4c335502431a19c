"""What all engines share: attempts at every part until it is done or cannot be."""

import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from cgm_jax.host.exit_codes import FINISHED, ExitCode
from cgm_jax.host.interruption import Interruption
from cgm_jax.launching.attempts import POLL_SECONDS, Step, next_step, was_killed
from cgm_jax.launching.directory import Launch
from cgm_jax.launching.progress import JointProgress
from cgm_jax.launching.record import append_event, fruitless_attempts, position
from cgm_jax.storage.untrusted import printable

MAX_DELAY = 60.0
"""Seconds before an attempt that follows others without progress, at most."""

PATIENCE_SECONDS = 30.0
"""From a signal to the end of the launcher, at most: its children take ten to end."""


@dataclass(frozen=True)
class Ended:
    """An attempt's end: its exit code, None if it has none; `final` if somebody wanted it."""

    code: int | None
    final: bool = False


class Engine(Protocol):
    """What makes attempts: processes, jobs, tasks."""

    @property
    def detached(self) -> str:
        """What happens to attempts when the launcher is stopped; "" if they are, too."""
        ...

    def check(self) -> None:
        """Ask whoever is to start attempts whether they are there.

        Raises:
            SettingError: they do not answer.
        """
        ...

    def variables_here(self) -> dict[str, str] | None:
        """Variables of a part that trains on this machine; None if parts train on others."""
        ...

    def begin(self, launch: Launch) -> None:
        """The attempts to come are at the parts of this launch."""
        ...

    def room(self) -> int:
        """How many more attempts it takes now; what it cannot run at once it may queue."""
        ...

    def start(self, parts: Sequence[int]) -> Sequence[int]:
        """Make an attempt at each of these parts, at most `room()` of them.

        Returns:
            Those that were taken; the others are offered again later.

        Raises:
            SettingError: none can be, ever.
        """
        ...

    def ended(self) -> dict[int, Ended]:
        """Attempts that have ended since the last call, by part."""
        ...

    def stop(self) -> None:
        """Ask all attempts to end with a checkpoint; `ended` tells when they have."""
        ...


@dataclass
class Parts:
    """What has become of all parts.

    Attributes:
        waiting: parts to be attempted, and the time before which not.
        running: parts being attempted.
        codes: exit codes of parts that are done, or cannot be.
        logged: bytes in each part's log when its last attempt began.
        stands: where each part stood when its last attempt ended.
        stuck: how many attempts in a row have ended there. Unlike the part's own record this counts
            those that never began, as where a job's interpreter is not there.
    """

    waiting: dict[int, float]
    running: set[int] = field(default_factory=set)
    codes: dict[int, int] = field(default_factory=dict)
    logged: dict[int, int] = field(default_factory=dict)
    stands: dict[int, list[int]] = field(default_factory=dict)
    stuck: dict[int, int] = field(default_factory=dict)

    def done(self) -> list[int]:
        """Parts that are done."""
        return [part for part, code in self.codes.items() if code in FINISHED]

    def fruitless(self, part: int, here: list[int]) -> int:
        """How many attempts in a row came no further than here, one that ended now included."""
        self.stuck[part] = self.stuck.get(part, 0) + 1 if self.stands.get(part) == here else 0
        self.stands[part] = here
        return self.stuck[part]


def supervise(
    launch: Launch, engine: Engine, epochs: Mapping[int, int], interruption: Interruption
) -> dict[int, int] | None:
    """Attempt every part until it is done or cannot be.

    Args:
        launch: what is launched.
        engine: what makes attempts.
        epochs: of all runs of each part, added up.
        interruption: says when to stop.

    Returns:
        The exit code of each part; None if a signal came.
    """
    engine.begin(launch)
    for part in epochs:
        append_event(launch.record(part), "launched")
    parts = Parts(
        dict.fromkeys(epochs, 0.0), stands={part: position(launch.out(part)) for part in epochs}
    )
    metrics = {part: launch.out(part) / "metrics.jsonl" for part in epochs}
    with JointProgress(metrics, epochs) as progress:
        while parts.waiting or parts.running:
            if interruption.requested:
                _stop(engine, parts)
                return None
            _start(launch, engine, parts)
            for part, end in engine.ended().items():
                _follow_up(launch, parts, part, end)
            progress.show(parts.done(), len(parts.running))
            time.sleep(POLL_SECONDS)
    return parts.codes


def _start(launch: Launch, engine: Engine, parts: Parts) -> None:
    now = time.monotonic()
    due = [part for part, when in parts.waiting.items() if when <= now][: engine.room()]
    parts.logged |= {part: _size(launch.log(part)) for part in due}
    taken = engine.start(due) if due else []
    for part in due:
        if part in taken:
            del parts.waiting[part]
            parts.running.add(part)
        else:
            parts.waiting[part] = now + MAX_DELAY


def _follow_up(launch: Launch, parts: Parts, part: int, end: Ended) -> None:
    """Decide what becomes of a part whose attempt has ended."""
    parts.running.discard(part)
    out = launch.out(part)
    fruitless = max(
        fruitless_attempts(launch.record(part), out), parts.fruitless(part, position(out))
    )
    step = next_step(end.code, fruitless)
    if end.final and step is Step.AGAIN:
        step = Step.FAILED
    if step is Step.AGAIN:
        delay = min(MAX_DELAY, 2.0**fruitless) if fruitless > 1 else 0.0
        parts.waiting[part] = time.monotonic() + delay
        after = f" in {delay:.0f} s" if delay else ""
        _say(f"part {part}: {_reason(end.code)}; it is tried again{after}")
        return
    parts.codes[part] = ExitCode.FAILED if end.code is None else end.code
    if step is Step.FAILED:
        why = "it was cancelled" if end.final else _reason(end.code)
        if not end.final and next_step(end.code, 0) is Step.AGAIN:
            why += f", and {fruitless} attempts in a row have come no further"
        said = last_error(launch.log(part), since=parts.logged.get(part, 0))
        _say(f"part {part}: {why}; {said or f'see {launch.log(part)}'}")


def _stop(engine: Engine, parts: Parts) -> None:
    engine.stop()
    if engine.detached:
        _say(engine.detached)
        return
    deadline = time.monotonic() + PATIENCE_SECONDS
    while parts.running and time.monotonic() < deadline:
        parts.running -= set(engine.ended())
        time.sleep(POLL_SECONDS)


def verdict(codes: Mapping[int, int]) -> int:
    """The exit code of a launch that has come to its end, but not with all parts done."""
    found = {ExitCode.FAILED if was_killed(code) else code for code in codes.values()}
    for code in (ExitCode.BAD_INPUT, ExitCode.FAILED, ExitCode.CANNOT_WRITE, ExitCode.STOPPED):
        if code in found:
            return code
    return ExitCode.FAILED


def last_error(log: Path, since: int = 0) -> str | None:
    """The last line of a log that says what was wrong, after so many bytes of it."""
    try:
        with log.open("rb") as file:
            file.seek(max(since, log.stat().st_size - 20_000))
            lines = file.read().decode(errors="replace").splitlines()
    except OSError:
        return None
    found = [line for line in lines if line.startswith("error: ")]
    return printable(found[-1][:500]) if found else None


def _size(file: Path) -> int:
    try:
        return file.stat().st_size
    except OSError:
        return 0


def _reason(code: int | None) -> str:
    if code is None:
        return "it was lost"
    if was_killed(code):
        number = -code if code < 0 else code - 128
        return f"it was killed by signal {number}"
    return f"it ended with exit code {code}"


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)
