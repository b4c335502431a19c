"""What the programs' exit codes mean."""

from enum import IntEnum


class ExitCode(IntEnum):
    """An exit code; after those from 74 on the same command, given again, resumes."""

    DONE = 0
    FAILED = 1
    """Something below went wrong, such as the physics or the memory; one line says what."""
    BAD_INPUT = 2
    """Input was refused; one line names the field."""
    DIVERGED = 3
    """Done, but some runs diverged, or had no valid episode in the end; they are named."""
    CANNOT_WRITE = 74
    """A full disk, or a directory that cannot be written to, or read just now (EX_IOERR)."""
    STOPPED = 75
    """Stopped by a signal (EX_TEMPFAIL)."""
    IN_USE = 75
    """Another process trains in the directory: try again later. Nothing was begun."""


FINISHED = (ExitCode.DONE, ExitCode.DIVERGED)
"""Of a sweep all of whose epochs are done."""
