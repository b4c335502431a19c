"""Every setting of a run: its default, its range, and whether a sweep may vary it.

*Traced* settings (`Hyperparameters`) enter the compiled program as numbers: one value per run,
any number of runs in one process. *Static* settings (`Settings`) decide shapes and structure:
one value per program. Defaults are the paper's; see presets.py for others.

This module imports no JAX, so that bad input is refused before anything is loaded.
"""

import dataclasses
import math
from dataclasses import dataclass, field
from numbers import Integral, Real
from typing import Any


class SettingError(ValueError):
    """A setting out of its range; the message starts with its name."""


def _setting(default: Any, help: str, low: float = -math.inf, high: float = math.inf) -> Any:
    return field(default=default, metadata={"help": help, "low": low, "high": high})


@dataclass(frozen=True)
class Hyperparameters:
    """Traced settings of one run; a sweep may vary all of them.

    Also the pytree of arrays that the compiled program takes (see `training_state.stack`), so
    that construction checks nothing: call `check`.
    """

    seed: int = _setting(0, "random seed", 0, 2**31 - 1)
    c_g: float = _setting(0.1, "success rate aimed at by the mask sampler", 0, 1)
    kappa: float = _setting(32.0, "sharpness of the mask sampler; 0 is uniform", 0, 1e6)
    cgm: bool = _setting(True, "curriculum goal masking; off: always the full goal")
    factorised: bool = _setting(True, "estimate masks as if sub-goals succeeded independently")
    her: bool = _setting(True, "hindsight experience replay; off: only original goals")
    her_k: float = _setting(6.0, "relabelled transitions for each original one", 0, 1e6)
    her_filter: bool = _setting(False, "relabel only episodes that moved the achieved goal")
    actor_learning_rate: float = _setting(1e-3, "Adam step size of the actor", 0)
    critic_learning_rate: float = _setting(1e-3, "Adam step size of the critic", 0)
    discount: float = _setting(0.98, "discount factor gamma", 0, 0.9999)
    target_rate: float = _setting(0.05, "how far targets move towards the networks", 0, 1)
    action_penalty: float = _setting(1.0, "weight of mean squared action in the actor loss", 0)
    action_noise: float = _setting(0.2, "standard deviation of exploration noise", 0)
    random_action_probability: float = _setting(0.3, "chance of a uniform action", 0, 1)
    random_action_steps: int = _setting(1, "steps that a uniform action lasts", 1, 10**6)


@dataclass(frozen=True)
class Settings:
    """Static settings, shared by all runs of one compiled program.

    Raises:
        SettingError: a value out of its range, or actor_update_every does not divide
            updates_per_cycle.
    """

    env: str = _setting("push", "reach, push, pick_and_place, or FILE.py:FACTORY of your own")
    engine: str = _setting("auto", "auto, native, mjx or warp")
    air_probability: float | None = _setting(
        None, "chance of a pick-and-place goal in the air (default: 1)", 0, 1
    )
    epochs: int = _setting(100, "epochs, each ending with an evaluation", 1, 10**9)
    cycles_per_epoch: int = _setting(64, "cycles of rollouts and updates per epoch", 1, 10**9)
    environments: int = _setting(16, "parallel environments; an episode each per cycle", 1, 10**6)
    updates_per_cycle: int = _setting(40, "updates of the critic per cycle", 1, 10**6)
    actor_update_every: int = _setting(1, "updates of the critic for each of the actor", 1, 10**6)
    batch_size: int = _setting(1024, "transitions per update", 1, 10**7)
    target_update_every: int = _setting(40, "updates between moves of the targets", 1, 10**9)
    hidden_layers: tuple[int, ...] = _setting((256, 256, 256), "widths of hidden layers", 1, 10**5)
    normaliser_floor: float = _setting(
        0.2, "least standard deviation of inputs, in distance thresholds", 0, 1e6
    )
    normaliser_limit: float = _setting(5.0, "normalised inputs are clipped to +-this", 0, 1e6)
    replay_transitions: int = _setting(1_000_000, "capacity of the replay buffer", 1, 10**10)
    evaluate_target: bool = _setting(False, "evaluate and export the target actor")
    evaluation_episodes: int = _setting(20, "noise-free full-goal episodes per epoch", 1, 10**6)
    masked_evaluation_episodes: int = _setting(
        0,
        "noise-free episodes per mask and epoch, to measure its success; 0: estimate it",
        0,
        10**6,
    )
    success_history: int = _setting(10, "evaluation episodes behind success rates, h", 1, 10**6)

    leave_at: float | None = _setting(
        None, "end runs early once all side by side hold this success (default: never)", 0, 1
    )
    side_by_side: int = _setting(1_000_000, "runs that train side by side, at most", 1, 10**6)

    def __post_init__(self) -> None:
        check(self)
        if self.updates_per_cycle % self.actor_update_every:
            raise SettingError(
                f"actor_update_every: {self.actor_update_every} does not divide "
                f"updates_per_cycle, {self.updates_per_cycle}"
            )


def check(settings: Settings | Hyperparameters) -> None:
    """Check every value against its type and range.

    Raises:
        SettingError: a value of another type, not finite, or out of its range.
    """
    for item in dataclasses.fields(settings):
        check_value(item.name, getattr(settings, item.name))


def check_concrete(hyper: Hyperparameters) -> None:
    """Check those values that are Python's or numpy's, and not JAX's, which may be traced.

    Raises:
        SettingError: as `check`.
    """
    for item in dataclasses.fields(hyper):
        value = getattr(hyper, item.name)
        if isinstance(value, str | Real | None):
            check_value(item.name, value)


def check_value(name: str, value: Any) -> None:
    """Check one value of the setting `name`.

    Raises:
        SettingError: there is no such setting, or its value is of another type, not finite, or
            out of its range.
    """
    if name not in FIELDS:
        raise SettingError(f"{name}: there is no such setting")
    item = FIELDS[name]
    if value is None and item.default is None:
        return
    kind = float if item.default is None else type(item.default)
    if not isinstance(value, ACCEPTED[kind]) or isinstance(value, bool) != (kind is bool):
        raise SettingError(f"{name}: {value!r} is not of type {kind.__name__}")
    if kind is tuple:
        if not value:
            raise SettingError(f"{name}: needs at least one value")
        if not all(isinstance(width, Integral) and not isinstance(width, bool) for width in value):
            raise SettingError(f"{name}: {value!r} holds something else than whole numbers")
    if kind not in (str, bool):
        for number in value if isinstance(value, tuple) else (value,):
            _check_range(item, number)


def _check_range(item: "dataclasses.Field[Any]", number: Any) -> None:
    low, high = item.metadata["low"], item.metadata["high"]
    if not -math.inf < number < math.inf:  # also of integers beyond any float
        raise SettingError(f"{item.name}: {number} is not a finite number")
    if not low <= number <= high:
        upper = "" if high == math.inf else f", {high:.10g}]"
        bounds = f"within [{low:.10g}{upper}" if upper else f"at least {low:.10g}"
        raise SettingError(f"{item.name}: {number} is not {bounds}")


FIELDS = {
    item.name: item for kind in (Settings, Hyperparameters) for item in dataclasses.fields(kind)
}
ACCEPTED = {str: str, bool: bool, int: Integral, float: Real, tuple: tuple}
"""What counts as a value of a setting, by the type of its default; numpy's numbers do."""
