"""The process around training: signals, memory, progress.

    command_line.py     options to settings; exit_codes.py what a program ends with
    session.py          from groups of runs to an exit code
    runner.py           the loop over chunks of training; pace.py how long a chunk may be
    recorder.py         what is written after an epoch; progress.py what is shown
    startup.py          JAX's own settings, before it starts
    memory.py           what a sweep will take, and how many runs fit
    streams.py          standard output and error that never fail

What keeps a sweep from losing anything:

    checkpoint.py       how far a group of runs has trained, as checked files
    interruption.py     Ctrl-C and SIGTERM; watchdog.py where a program hangs
    device_errors.py    errors from below JAX, in one line
"""
