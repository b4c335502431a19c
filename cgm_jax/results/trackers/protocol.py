"""What a tracker offers."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Protocol


@dataclass
class Tracker(Protocol):
    """Shows the runs of one sweep; one instance per process.

    Anything it raises is reported once, and training continues without it. It imports what it
    needs when it is made, not with its module.

    Attributes:
        folder: the tracker's own in the run directory, which exists.
        sweep: a label of the sweep that no other has and that stays when it is resumed.
    """

    PACKAGE: ClassVar[str] = ""
    """The package that it needs, as it is imported."""

    folder: Path
    sweep: str

    def begin(self, run: str, settings: Mapping[str, Any], sent: int) -> int:
        """Open a run, or continue it in the same place.

        Args:
            run: its name.
            settings: all of them, by name.
            sent: epochs that it was given until now, 0 for a new run. A process that was killed
                may have sent one more, or sent some that never arrived.

        Returns:
            Epochs that it holds; the next one comes next, and is not to count twice.
        """
        ...

    def metrics(self, run: str, epoch: int, values: Mapping[str, float]) -> None:
        """Add an epoch, counted from 1; each comes once and in order."""
        ...

    def files(self, run: str, epoch: int, paths: Mapping[str, Path]) -> None:
        """Show PNG and GIF files by name, as of an epoch."""
        ...

    def end(self, run: str) -> None:
        """Close a run; return when all of it is on the disk, or sent."""
        ...


PROTOCOL = Tracker
