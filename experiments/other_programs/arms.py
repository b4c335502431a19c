"""Who learns, on what, and with which settings. Needs no packages.

Usual settings are those that Stable-Baselines3's documentation gives for hindsight (for a parking
task; nothing was tuned for Fetch): networks of 3 x 256, batches of 256, a learning rate of 0.001, a
discount of 0.95, an update for every environment step, four hindsight goals of the future for each
real one. Only the first update comes later, after 1,000 steps, when all environments have whole
episodes.
"""

from dataclasses import dataclass
from typing import Any

TASKS = {"push": "FetchPush-v4", "pick_and_place": "FetchPickAndPlace-v4"}
"""Names here and in Gymnasium-Robotics, which puts half of the goals of the latter in the air."""

OURS = {
    "cgm_jax": ("this program, preset cpu (HER, stages, CGM)", ()),
    "cgm_jax_plain": (
        "the same without stages and masks",
        ("--relabelling", "future", "--curriculum", "full"),
    ),
}
"""This program's arms: a label for the figure, and options beside the preset."""

EVALUATION_EPISODES = 50
STEPS_PER_EVALUATION = 20_000
EPISODE_LENGTH = 50


@dataclass(frozen=True)
class Arm:
    """A way in which Stable-Baselines3 learns.

    Attributes:
        label: for the figure.
        algorithm: the name of its class.
        environments: side by side, in one process.
        noise: standard deviation of Gaussian noise on actions; None for an agent with its own.
        settings: what its class is given.
    """

    label: str
    algorithm: str
    environments: int = 1
    noise: float | None = None
    settings: tuple[tuple[str, Any], ...] = ()


_USUAL = {
    "buffer_size": 1_000_000,
    "learning_rate": 1e-3,
    "gamma": 0.95,
    "batch_size": 256,
    "learning_starts": 1000,
    "policy_kwargs": {"net_arch": [256, 256, 256]},
}

# As many updates for so many environment steps as the preset `cpu` here, and as many episodes.
_OUR_RATIO = {**_USUAL, "train_freq": (EPISODE_LENGTH, "step"), "gradient_steps": 40}

ARMS = {
    "sb3_sac": Arm("Stable-Baselines3, SAC + HER", "SAC", settings=tuple(_USUAL.items())),
    "sb3_ddpg": Arm(
        "Stable-Baselines3, DDPG + HER", "DDPG", noise=0.2, settings=tuple(_USUAL.items())
    ),
    "sb3_ddpg_our_ratio": Arm(
        "the same, with 40 updates for 16 episodes",
        "DDPG",
        environments=16,
        noise=0.2,
        settings=tuple(_OUR_RATIO.items()),
    ),
}


NAMES = (*OURS, *ARMS)


def label(arm: str) -> str:
    """What an arm is called in the figure."""
    return OURS[arm][0] if arm in OURS else ARMS[arm].label
