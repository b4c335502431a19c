"""How long the device takes, and how much to give it at once."""

CHUNK_SECONDS = 2.0
"""Long enough to hide the hand-over to the host, short enough for progress and signals."""


class Pace:
    """Learns how long training and evaluations take, and sizes chunks to about two seconds.

    What is trained comes in units of some kind that take equally long: cycles, or parts of cycles.

    Attributes:
        evaluation: seconds of the last evaluation; None until one is timed.
        at_risk: seconds of training and evaluations since the last checkpoint of this process.
    """

    def __init__(self) -> None:
        self.evaluation: float | None = None
        self.at_risk = 0.0
        self._units: dict[str, float] = {}

    def unit(self, kind: str) -> float | None:
        """Seconds of each unit of the last chunk of this kind; None until one is timed."""
        return self._units.get(kind)

    def next_chunk(self, kind: str, remaining: int) -> int:
        """Units for the next chunk: one until one has been timed."""
        seconds = self.unit(kind)
        if seconds is None:
            return 1
        fitting = int(CHUNK_SECONDS / max(seconds, 1e-6))
        return max(1, min(remaining, fitting))

    def record(self, kind: str, units: int, seconds: float) -> None:
        """Take in how long a chunk took."""
        self._units[kind] = seconds / units
        self.at_risk += seconds

    def record_evaluation(self, seconds: float) -> None:
        """Take in how long an evaluation took."""
        self.evaluation = seconds
        self.at_risk += seconds

    def record_checkpoint(self) -> None:
        """Take in that all until now is safe."""
        self.at_risk = 0.0
