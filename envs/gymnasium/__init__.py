"""The Fetch tasks for other libraries, with the conventions of Gymnasium-Robotics.

fetch.py    one environment: `gymnasium.make("cgm_jax/FetchPush-v0")`
vector.py   a batch of them: `gymnasium.make_vec("cgm_jax/FetchPush-v0", num_envs=64)`
"""
