"""Curriculum goal masking (CGM) for goal-conditioned reinforcement learning, in JAX.

The method (Eppe, Magg, Wermter 2019), one file each:

    masking.py          the mask sampler: which goal dimensions to keep, by estimated success
    relabelling.py      HER: replayed transitions with goals that were reached later
    replay.py           the ring buffer of whole episodes that HER draws from
    ddpg.py             actor and critic updates; networks.py their shape
    normaliser.py       running mean and standard deviation of observations and goals
    exploration.py      action noise

The loop that puts them together, as pure functions over one state:

    training_state.py   everything that training carries from step to step
    rollout.py          episodes of many environments in one scan
    training.py         a cycle, an epoch, evaluation: what is jitted and vmapped over runs
    programs.py         the compiled programs; divergence.py freezes a run that diverges
    policy.py           trained policies as plain arrays; arrays.py reads files from strangers
    statistics.py       when a run reaches or holds a success

What is asked for:

    settings.py         every setting, its default, and whether a sweep may vary it
    presets.py          smoke, quick, cpu, paper
    grid.py             from lists of values to runs, and from runs to groups that fit in memory
    environments.py     the environment that a setting names

Programs: `python -m cgm_jax.sweep`, `.train` (a sweep of one), `.evaluate` and `.benchmark`. What
they do around training is in host/, what they make of results in report/.

Environments live in the package `envs`; this one knows them only through
`envs.GoalEnvironment`. Importing the package registers the Fetch tasks with Gymnasium; what other
libraries use is in gymnasium/.
"""

from cgm_jax.gymnasium.registration import register_fetch as _register_fetch

_register_fetch()

__version__ = "0.1.0"
