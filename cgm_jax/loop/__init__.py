"""What turns: training as pure functions over one state, jitted and vmapped over runs.

training.py     `make_trainer`, and the compiled programs: start here
cycle.py        choose goals, roll out, store, learn
rollout.py      episodes of many environments in one scan; exploration.py action noise
learning.py     minibatches and updates; divergence.py freezes a run that diverges
evaluation.py   the end of an epoch: noise-free episodes, and the epoch's metrics

setup.py        the environment and static settings, and the state before any training
state.py        everything that training carries from step to step
inputs.py       what the networks see; normaliser.py its running mean and standard deviation
environment.py  the environment that a setting names
own_environment.py, own_components.py   what is the user's own, checked before anything is made
"""

from cgm_jax.envs import quiet_import as _quiet_import  # noqa: F401 -- before anything of brax
