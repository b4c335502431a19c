"""What other libraries use, through Gymnasium's interface: nothing here imports JAX.

registration.py         names of the Fetch tasks for `gymnasium.make`
goal_masking.py         curriculum goal masking for any goal environment; vector_goal_masking.py
                        for a batch of them
goals.py                goal spaces, masked goals, and when one is achieved
mask_sampler.py         which goal dimensions to keep, by estimated success: from a table of all
                        masks (mask_table.py), or for many dimensions mask_lookahead.py and
                        mask_levels.py
stable_baselines3.py    evaluations of Stable-Baselines3 that feed the curriculum
"""

from cgm_jax.gymnasium.goal_masking import GoalMasking
from cgm_jax.gymnasium.vector_goal_masking import VectorGoalMasking

__all__ = ["GoalMasking", "VectorGoalMasking"]
