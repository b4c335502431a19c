"""The training loop: pure functions over one state, jitted and vmapped over runs.

training.py     `make_trainer`, and the compiled programs: start here; compiler.py compiles them
cycle.py        choose goals, roll out, store, learn
rollout.py      episodes of many environments in one scan; exploration.py action noise
parts.py        cycles so long that they are taken in parts; cutting.py which, and where
learning.py     minibatches and updates; divergence.py freezes a run that diverges
evaluation.py   the end of an epoch: noise-free episodes, and the epoch's metrics

setup.py        the environment and static settings, and the state before any training
state.py        everything that training carries from step to step
inputs.py       what the networks see; normaliser.py its running mean and standard deviation
environment.py  the environment that a setting names
own_*.py        what is the user's own: own_checks.py checks an environment before anything is made,
                own_components.py all else, with what it returns (own_returns.py);
                own_environment.py is what training makes of an environment, with what it
                declares (own_declarations.py), its states in lasting form (own_states.py)
judging.py      an environment's own success, reward and ends of episodes
devices.py      the axis of runs over devices; in_turn.py runs of one device, one after another
"""

from cgm_jax.envs import quiet_import as _quiet_import  # noqa: F401 -- before anything of brax
