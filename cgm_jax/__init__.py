"""Curriculum goal masking (CGM) for goal-conditioned reinforcement learning, in JAX.

The method (Eppe, Magg, Wermter 2019), one file each:

    masking.py          the mask sampler: which goal dimensions to keep, by estimated success
    relabelling.py      HER: replayed transitions with goals that were reached later
    replay.py           the ring buffer of whole episodes that HER draws from
    ddpg.py             actor and critic updates; networks.py their shape
    normaliser.py       running mean and standard deviation of observations and goals

The loop that puts them together, as pure functions over one state:

    training_state.py   everything that training carries from step to step
    rollout.py          episodes of many environments in one scan
    training.py         a cycle, an epoch, evaluation: what is jitted and vmapped over runs

Around it, on the host:

    settings.py         every setting, its default, and whether a sweep may vary it
    presets.py          smoke, quick, cpu, paper
    grid.py             from lists of values to runs, and from runs to groups that fit in memory
    sweep.py            `python -m cgm_jax.sweep`; train.py: a sweep of one; evaluate.py
    session.py          from groups of runs to an exit code; runner.py the loop over chunks
    run_directory.py    config.json, metrics.jsonl, policies, figures, checkpoints
    evaluation.py       success of exported policies; video.py films of their episodes

What keeps a sweep from losing anything:

    checkpoint.py       where a group of runs stands, as checked files; recorder.py writes them
    interruption.py     Ctrl-C and SIGTERM; lock.py: one sweep per directory
    divergence.py       a run that diverges is frozen, the others keep their bits
    memory.py           what a sweep will take; watchdog.py: where it stands if it hangs
    arrays.py, files.py files of arrays from strangers; files that are whole or not there
    device_errors.py    errors from below JAX, in one line; exit_codes.py

Environments live in the package `envs`; this one knows them only through
`envs.GoalEnvironment`. Importing the package registers the Fetch tasks with Gymnasium
(gymnasium_names.py).
"""

from cgm_jax.gymnasium_names import register_fetch as _register_fetch

_register_fetch()

__version__ = "0.1.0"
