"""The record of a part's attempts: where each began, and its exit code; one line of JSON an event.

    launched     a launcher has begun; attempts before that no longer count
    submitted    to a scheduler, as `job`
    started      an attempt: at which checkpoint (`position`), and where
    ended        with an exit code; without this line an attempt was lost

Written on whichever machine the attempt is made, so that it tells what a scheduler may not.
"""

import contextlib
import json
import os
import re
import time
from pathlib import Path
from typing import Any

from cgm_jax.storage.untrusted import UNREADABLE, from_json

Event = dict[str, Any]

MANIFEST = re.compile(
    r"group([0-9]{1,9})_epoch([0-9]{1,10})_cycle([0-9]{1,10})(?:_part([0-9]{1,10}))?\.json"
)
"""Of a finished checkpoint, see storage/checkpoints.py, which would import JAX."""


def append_event(record: Path, event: str, **values: Any) -> None:
    """Add an event to a part's record of attempts; where that cannot be written, go without."""
    entry = {"event": event, "time": round(time.time(), 3), **values}
    with contextlib.suppress(OSError), record.open("a") as file:
        # On a line of its own, whatever a full disk has left of the one before.
        file.write(("" if _ends_a_line(record) else "\n") + json.dumps(entry) + "\n")


def _ends_a_line(record: Path) -> bool:
    with record.open("rb") as file:
        if file.seek(0, os.SEEK_END) == 0:
            return True
        file.seek(-1, os.SEEK_END)
        return file.read() == b"\n"


def events(record: Path) -> list[Event]:
    """A part's record of attempts, less lines that were torn."""
    try:
        lines = record.read_text(errors="replace").splitlines()
    except OSError:
        return []
    found = []
    for line in lines:
        with contextlib.suppress(*UNREADABLE):
            found.append(from_json(line))
    return [entry for entry in found if isinstance(entry, dict) and "event" in entry]


def last_code(record: Path) -> int | None:
    """The exit code of the last attempt; None if it has none, since it was killed or still runs."""
    for entry in reversed(events(record)):
        if entry["event"] == "ended":
            code = entry.get("code")
            return code if type(code) is int else None
        if entry["event"] in ("started", "submitted"):
            return None
    return None


def position(out: Path) -> list[int]:
    """Where a part's next attempt begins, at its last finished checkpoint.

    Returns:
        Its group, epoch, cycle, and parts of the next cycle where that is cut; nothing if there is
        no checkpoint, or none can be read just now.
    """
    found: list[re.Match[str] | None] = []
    with contextlib.suppress(OSError):
        found = [MANIFEST.fullmatch(path.name) for path in (out / "checkpoints").iterdir()]
    places = ([int(number) for number in match.groups("0")] for match in found if match)
    return max(places, default=[])


def fruitless_attempts(record: Path, out: Path) -> int:
    """How many attempts in a row, since the launch, began where training still stands."""
    here, count = position(out), 0
    for entry in reversed(events(record)):
        if entry["event"] == "launched":
            break
        if entry["event"] == "started":
            if entry.get("position") != here:
                break
            count += 1
    return count
