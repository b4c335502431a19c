"""How many cycles to give the device at once."""

CHUNK_SECONDS = 2.0
"""Long enough to hide the hand-over to the host, short enough for progress and signals."""


class Pace:
    """Learns the time of a cycle, and sizes chunks to about two seconds."""

    def __init__(self) -> None:
        self._seconds_per_cycle: float | None = None
        self._compiled = False

    def next_chunk(self, remaining: int) -> int:
        """Cycles for the next chunk: one until a cycle has been timed."""
        if self._seconds_per_cycle is None:
            return 1
        fitting = int(CHUNK_SECONDS / max(self._seconds_per_cycle, 1e-6))
        return max(1, min(remaining, fitting))

    def record(self, cycles: int, seconds: float) -> None:
        """Take in how long a chunk took. The first includes compilation and is too slow."""
        self._compiled = self._seconds_per_cycle is not None
        self._seconds_per_cycle = seconds / cycles

    def outlasts(self, seconds: float) -> bool:
        """Whether even a chunk of one cycle takes longer than that, as far as is known."""
        return self._compiled and (self._seconds_per_cycle or 0.0) > seconds
