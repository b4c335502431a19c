"""The Fetch tasks for other libraries, with the conventions of Gymnasium-Robotics.

fetch.py         one environment: `gymnasium.make("cgm_jax/FetchPush-v0")`
vector.py        a batch of them: `gymnasium.make_vec("cgm_jax/FetchPush-v0", num_envs=64)`
arguments.py     what either may be made with; resets.py, actions.py what resets and steps take
spaces.py        spaces of observations and actions; from states to observations
goals.py         rewards and ends of episodes, from goals
programs.py      the compiled functions that both call, once per process
frames.py        rendered frames
mujoco_copy.py   the simulation as MuJoCo's own model and data
"""

from cgm_jax.envs import quiet_import as _quiet_import  # noqa: F401 -- before anything of brax
