"""Who learns, and what the networks see.

ddpg.py        actor and critic updates; networks.py their shape
normaliser.py  running mean and standard deviation of observations and goals
policy.py      trained policies as plain arrays
"""

from cgm_jax.envs import quiet_import as _quiet_import  # noqa: F401 -- before anything of brax
