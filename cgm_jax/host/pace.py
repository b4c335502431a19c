"""How long the device takes, and how many cycles to give it at once."""

CHUNK_SECONDS = 2.0
"""Long enough to hide the hand-over to the host, short enough for progress and signals."""


class Pace:
    """Learns the times of a cycle and of an evaluation, and sizes chunks to about two seconds.

    Attributes:
        cycle: seconds of the last chunk's cycles, each; None until one is timed.
        evaluation: seconds of the last evaluation; None until one is timed.
    """

    def __init__(self) -> None:
        self.cycle: float | None = None
        self.evaluation: float | None = None

    def next_chunk(self, remaining: int) -> int:
        """Cycles for the next chunk: one until a cycle has been timed."""
        if self.cycle is None:
            return 1
        fitting = int(CHUNK_SECONDS / max(self.cycle, 1e-6))
        return max(1, min(remaining, fitting))

    def record(self, cycles: int, seconds: float) -> None:
        """Take in how long a chunk took."""
        self.cycle = seconds / cycles
