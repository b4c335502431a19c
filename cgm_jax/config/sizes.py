"""What a curriculum and an agent may know of the task and the loop."""

from typing import NamedTuple


class Sizes(NamedTuple):
    """What a curriculum and an agent may know of the task and the loop when they are made.

    Attributes:
        observation: entries of an observation.
        goal: dimensions of a goal, n.
        action: dimensions of an action.
        inputs: entries of what a network sees: observation, goal, and what else is shown.
        episode_length: steps of an episode, T.
        distance_threshold: a goal is achieved closer than this.
        environments: training episodes per cycle, E.
        evaluation_episodes: noise-free episodes with the full goal per epoch.
        updates_at_once: minibatches that `Agent.train` gets, those of a cycle or of a part of it.
        critics: estimates of the return that the agent's `value` gives.
        starts: a state of the environment without axes as shapes, where an episode can begin in
            one; else None.
    """

    observation: int
    goal: int
    action: int
    inputs: int
    episode_length: int
    distance_threshold: float
    environments: int
    evaluation_episodes: int
    updates_at_once: int
    critics: int
    starts: object | None
