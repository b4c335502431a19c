"""What turns: training as pure functions over one state, jitted and vmapped over runs.

state.py        everything that training carries from step to step
environment.py  the environment that a setting names
rollout.py      episodes of many environments in one scan; exploration.py action noise
training.py     a cycle, an epoch, evaluation
programs.py     the compiled programs; divergence.py freezes a run that diverges
"""

from cgm_jax.envs import quiet_import as _quiet_import  # noqa: F401 -- before anything of brax
