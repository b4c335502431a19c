"""What distinguishes the Fetch tasks from each other, as data."""

from dataclasses import dataclass

STEPS_PER_EPISODE = 50
"""Control steps of 0.04 s, in all tasks."""


@dataclass(frozen=True)
class Task:
    """One Fetch task.

    Attributes:
        scene: MJCF file in assets/fetch/.
        has_object: whether there is a box, whose position is then the achieved goal.
        fingers_blocked: whether the fingers are shut anew at every control step, whatever the
            action says.
        pose_lag: age in seconds of the gripper position that an action displaces. In
            pick-and-place Gymnasium-Robotics reads it one 2 ms substep late. What is observed has
            no such lag here; see `fetch_observation`.
        approach: how far behind the object, seen from the goal, the grip is before it moves the
            object, metres; 0 for at the object itself.
        approach_within: the grip is there closer than this, metres.
        air_probability: default chance that a goal lies above the table, where the object can be
            lifted. 1 for the paper's pick-and-place, whose DDPG+HER baseline never succeeds;
            Gymnasium-Robotics has 0.5.
    """

    scene: str
    has_object: bool
    fingers_blocked: bool
    air_probability: float
    pose_lag: float = 0.0
    approach: float = 0.0
    approach_within: float = 0.05


TASKS = {
    "reach": Task("reach.xml", has_object=False, fingers_blocked=True, air_probability=0.0),
    "push": Task(
        "push.xml",
        has_object=True,
        fingers_blocked=True,
        air_probability=0.0,
        approach=0.06,
        approach_within=0.04,
    ),
    "pick_and_place": Task(
        "pick_and_place.xml",
        has_object=True,
        fingers_blocked=False,
        air_probability=1.0,
        pose_lag=0.002,
    ),
}
