"""Curriculum goal masking (CGM) for goal-conditioned reinforcement learning, in JAX.

Programs, one file a command: `python -m cgm_jax.sweep`, `.train` (a sweep of one), `.evaluate`,
`.benchmark`. Behind them, in rooms:

    config/      what is asked for: settings, presets, the grid of a sweep
    curricula/   what to practise: CGM of Eppe, Magg and Wermter (2019), and others
    agents/      who learns: DDPG, ...
    replay/      what is replayed: the ring of episodes, hindsight
    loop/        what turns: rollout, cycle, epoch, evaluation, as pure functions over one state
    envs/        what is acted in: the Fetch tasks (in a checkout a link to the folder `envs`)

    storage/     what lies on the disk: run directories, files of arrays
    host/        the process around training: signals, memory, progress
    results/     what is made of runs: figures, measured policies, videos
    measuring/   how fast it is: what the benchmark measures
    gymnasium/   for other libraries, without JAX: CGM as a wrapper, names of the Fetch tasks

The loop knows environments only through `envs.GoalEnvironment`. Importing the package registers
the Fetch tasks with Gymnasium (gymnasium/registration.py).
"""

from cgm_jax.gymnasium.registration import register_fetch as _register_fetch

_register_fetch()

__version__ = "0.1.0"
