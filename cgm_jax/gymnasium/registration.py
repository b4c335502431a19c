"""Registers the Fetch tasks with Gymnasium, by name only: nothing of JAX is imported here."""

import gymnasium

from cgm_jax.envs.tasks import STEPS_PER_EPISODE

FETCH = {
    "FetchReach": {"task": "reach"},
    "FetchPush": {"task": "push"},
    # As in Gymnasium-Robotics; the paper's, and this project's trainer's, is 1.
    "FetchPickAndPlace": {"task": "pick_and_place", "air_probability": 0.5},
}


def register_fetch() -> None:
    """Make `gymnasium.make("cgm_jax/FetchPush-v0")` and the others work. Any number of times."""
    for name, arguments in FETCH.items():
        identifier = f"cgm_jax/{name}-v0"
        if identifier in gymnasium.registry:
            continue
        gymnasium.register(
            id=identifier,
            entry_point="cgm_jax.envs.gymnasium.fetch:FetchGymnasium",
            vector_entry_point="cgm_jax.envs.gymnasium.vector:FetchVector",
            max_episode_steps=STEPS_PER_EPISODE,
            kwargs=dict(arguments),
        )
