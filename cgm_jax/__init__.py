"""Curriculum goal masking (CGM) for goal-conditioned reinforcement learning, in JAX.

Programs, one file a command: `python -m cgm_jax.sweep`, `.train` (a sweep of one), `.evaluate`,
`.benchmark`. Behind them, in rooms:

    config/      what is asked for: settings, presets, the grid of a sweep
    curricula/   what to practise: the mask sampler of Eppe, Magg and Wermter (2019)
    agents/      who learns, and what the networks see
    replay/      what is replayed: the ring of episodes, hindsight
    loop/        what turns: rollout, cycle, epoch, evaluation, as pure functions over one state
    envs/        what is acted in: the Fetch tasks (in a checkout a link to the folder `envs`)

    storage/     what lies on the disk: run directories, files of arrays
    host/        the process around training: signals, memory, progress
    results/     what is made of runs: figures, measured policies, videos
    measuring/   how fast it is: what the benchmark measures

The loop knows environments only through `envs.GoalEnvironment`. Importing the package registers
the Fetch tasks with Gymnasium (gymnasium_names.py).
"""

from cgm_jax.gymnasium_names import register_fetch as _register_fetch

_register_fetch()

__version__ = "0.1.0"
