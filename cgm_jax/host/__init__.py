"""The process around training: signals, memory, progress.

    command_line.py     arguments of all programs; exit_codes.py what a program ends with
    training_options.py what sweep and train are asked for; setting_options.py an option per setting
    help_texts.py       what --help says
    devices.py          --devices: how many share the runs
    asked.py            what is to be trained: options, over a settings_file.py, over a preset
    to_train.py         the same, as jobs, beside what the directory holds
    session.py          from what is asked for to an exit code; dry_run.py what it would be
    conclusion.py       what a finished sweep has come to
    differences.py      why what is asked for is not what a directory holds
    extension.py        more epochs; warm_start.py what another run has learned
    jobs.py             what is trained side by side, as memory allows
    beginning.py        where a job begins: at a checkpoint, at what it starts from, from scratch
    runner.py           the loop over chunks of training; pace.py how long a chunk may be
    recorder.py         what is written after an epoch; progress.py what is shown
    startup.py          JAX's own settings, before it starts
    memory.py           what a sweep will take, and how many runs fit
    streams.py          standard output and error that never fail

What keeps a sweep from losing anything:

    checkpoint.py       how far a group of runs has trained, as checked files
    interruption.py     Ctrl-C and SIGTERM; early_signals.py the same before anything is imported
    watchdog.py         where a program hangs
"""
