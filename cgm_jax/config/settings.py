"""What the loop itself is asked for. Curricula, agents and relabelling declare their own settings.

`Settings` shape a program: one value per program. `Hyperparameters` are of one run: numbers that a
sweep varies within a program, and the curriculum, the agent and the relabelling with theirs.
Defaults are the paper's; see presets.py for others.
"""

import dataclasses
from dataclasses import dataclass
from typing import Any

from cgm_jax.config.components import DEFAULTS, NAMES, component
from cgm_jax.config.fields import check, nested, settings, static, traced


@dataclass(frozen=True)
class Settings:
    """Static settings of the loop, shared by all runs of one compiled program.

    Raises:
        SettingError: a value out of its range.
    """

    env: str = static(
        "push", "reach, push, pick_and_place, FILE.py:NAME of your own, or gymnasium:MODULE:ID"
    )
    engine: str = static("auto", "auto, native, mjx or warp")
    air_probability: float | None = static(
        None, "chance of a pick-and-place goal in the air (default: 1)", 0, 1
    )
    epochs: int = static(100, "epochs, each ending with an evaluation", 1, 10**9)
    cycles_per_epoch: int = static(64, "cycles of rollouts and updates per epoch", 1, 10**9)
    environments: int = static(16, "parallel environments; an episode each per cycle", 1, 10**6)
    updates_per_cycle: int = static(40, "updates of the critics per cycle", 1, 10**6)
    batch_size: int = static(1024, "transitions per update", 1, 10**7)
    replay_transitions: int = static(
        1_000_000, "capacity of the replay buffer; at least those of a cycle", 1, 10**10
    )
    normaliser_floor: float = static(
        0.2, "least standard deviation of inputs, in distance thresholds", 0, 1e6
    )
    normaliser_limit: float = static(5.0, "normalised inputs are clipped to +-this", 1e-3, 1e6)
    mask_input: bool = static(False, "show the networks which goal dimensions are masked")
    evaluation_episodes: int = static(20, "noise-free full-goal episodes per epoch", 1, 10**6)
    leave_at: float | None = static(
        None,
        "end runs early once all side by side hold this success, in the mean of three "
        "evaluations (default: never)",
        0,
        1,
    )
    side_by_side: int = static(1_000_000, "runs that train side by side, at most", 1, 10**6)

    def __post_init__(self) -> None:
        check(self)


def _default(kind: str) -> Any:
    return nested(lambda: component(kind, DEFAULTS[kind])())


@settings
class Hyperparameters:
    """Settings of one run.

    Also the pytree of arrays that the compiled program takes (see `fields.stack`), so that
    construction checks nothing: call `fields.check`.

    Attributes:
        curriculum: what to practise, see `curricula/protocol.py`.
        agent: who learns, see `agents/protocol.py`.
        relabelling: what is replayed, see `replay/protocol.py`.
    """

    seed: int = traced(0, "random seed", 0, 2**31 - 1)
    action_noise: float = traced(0.2, "standard deviation of exploration noise", 0)
    random_action_probability: float = traced(0.3, "chance of a uniform action", 0, 1)
    random_action_steps: int = traced(1, "steps that a uniform action lasts", 1, 10**6)
    curriculum: Any = _default("curriculum")
    agent: Any = _default("agent")
    relabelling: Any = _default("relabelling")


LOOP_FIELDS = {
    item.name: item
    for kind in (Settings, Hyperparameters)
    for item in dataclasses.fields(kind)
    if "help" in item.metadata
}
"""The loop's own settings by name."""

RESERVED = {
    *("name", "run", "seed", "cgm", "epoch", "wall_s", "env_steps", "updates", "success_rate"),
    *("subgoal_success", "moved_share", "mask_rate_training", "mask_share", "physics_warnings"),
    *("evaluated_episodes", "failed_epoch", "failure", "swept", "reported"),
    *(*NAMES, *LOOP_FIELDS),
}
"""Names in config.json and metrics.jsonl that are not for a component's own settings, for what a
curriculum reports, nor for what an agent logs."""
