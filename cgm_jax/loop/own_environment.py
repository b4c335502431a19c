"""An environment of the user's own, checked for all that training relies on.

What training does not read may be of any type and change it from step to step; the scan over an
episode gets it in the form that `reset` gave it. Reward, done and metrics are mere outputs, and may
even change their shape. The environment may keep something for itself in info, in further entries
of the observation, and in pipeline_state; of those shapes must last.
"""

import operator
from collections.abc import Sequence
from numbers import Real
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jax.extend.core import Jaxpr, jaxprs_in_params

from cgm_jax.config.fields import SettingError
from cgm_jax.config.user_code import user_code
from cgm_jax.envs import GoalEnvironment, Stage

PROTOCOL = ("reset", "step", "action_size", "episode_length", "distance_threshold")
ENTRIES = ("observation", "achieved_goal", "desired_goal")
OUTPUTS = ("reward", "done", "metrics")
WARNINGS = "physics_warnings"

MAX_ACTION_SIZE = 10_000
MAX_STAGE_SIZE = 10_000
MAX_EPISODE_LENGTH = 1_000_000
THRESHOLDS = (1e-15, 1e15)
"""Squares of distances must be numbers of float32."""

FEW_OPERATIONS = 2_000
"""A reset and a step of up to so many compile in seconds: they are run to look at their values."""


class OwnState(struct.PyTreeNode):
    """What the trainer carries and reads of an environment's state.

    Attributes:
        state: the environment's own, always of the structure, shapes and types of its `reset`.
        warnings: above 0 if its physics broke in the last step, float32 scalar.
    """

    state: Any
    warnings: jax.Array

    @property
    def obs(self) -> dict[str, Any]:
        """Observation, achieved and desired goal: arrays, or their shapes."""
        return {name: self.state.obs[name] for name in ENTRIES}

    @property
    def metrics(self) -> dict[str, jax.Array]:
        """Whether the physics held."""
        return {WARNINGS: self.warnings}


class OwnEnvironment:
    """A `GoalEnvironment` around one of the user's; make it by `checked`.

    Attributes:
        action_size, episode_length, distance_threshold: see `GoalEnvironment`.
        stages: see `StagedEnvironment`; empty where there are none.
        remarks: lines about what is allowed but hardly meant.
        is_large: whether compiling it is a matter of minutes and of much memory.
    """

    def __init__(self, env: Any, name: str) -> None:
        self._env = env
        self.action_size = _whole_number(env, name, "action_size", MAX_ACTION_SIZE)
        self.episode_length = _whole_number(env, name, "episode_length", MAX_EPISODE_LENGTH)
        self.distance_threshold = _distance_threshold(env, name)
        self.remarks: list[str] = []
        self.is_large = False
        if hasattr(env, "restart"):  # optional in the protocol
            self.restart = self._restart
        self.stages = _stages(env, name)
        if hasattr(env, "render_frame"):
            self.render_frame = self._render_frame
        self._name = name
        self._take_rules(env, name)

    def _take_rules(self, env: Any, name: str) -> None:
        """What the environment has of a `JudgingEnvironment`."""
        if hasattr(env, "goal_tolerance"):
            self._tolerance = _tolerance(env, name)
            self.goal_success = self._within_tolerance
        if hasattr(env, "goal_success"):
            self.goal_success = lambda achieved, desired: jnp.asarray(
                env.goal_success(achieved, desired), bool
            )
        if hasattr(env, "goal_reward"):
            self.reward_range = _reward_range(env, name)
            self.goal_reward = lambda achieved, desired: jnp.clip(
                jnp.asarray(env.goal_reward(achieved, desired), jnp.float32), *self.reward_range
            )
        if hasattr(env, "is_terminal"):
            self.is_terminal = lambda state: jnp.asarray(env.is_terminal(state.state), bool)

    def _within_tolerance(self, achieved_goal: jax.Array, desired_goal: jax.Array) -> jax.Array:
        return jnp.linalg.norm((achieved_goal - desired_goal) / self._tolerance) < 1.0

    def reset(self, rng: jax.Array) -> OwnState:
        """Start an episode."""
        state = self._env.reset(rng)
        return OwnState(jax.tree.map(_retyped, state, state), jnp.zeros(()))

    def _restart(self, state: OwnState) -> OwnState:
        """Start an episode in a state that another one has visited."""
        after = self._env.restart(state.state)
        return OwnState(_as_before(state.state, after), jnp.zeros(()))

    def _render_frame(self, state: Any, width: int, height: int) -> np.ndarray:
        """A frame of a state of the user's environment, concrete.

        Raises:
            SettingError: it fails, or is no frame of that size.
        """
        with user_code("video", f"render_frame of {self._name}"):
            frame = np.asarray(self._env.render_frame(state, width, height))
        if frame.shape != (height, width, 3) or frame.dtype != np.uint8:
            raise SettingError(
                f"video: render_frame of {self._name} returns {_described(frame)}, "
                f"not uint8[{height},{width},3]"
            )
        return frame

    def step(self, state: OwnState, action: jax.Array) -> OwnState:
        """Advance by one control step."""
        after = self._env.step(state.state, action)
        return OwnState(_as_before(state.state, after), _warnings(after))


def checked(env: Any, name: str) -> GoalEnvironment:
    """Make an environment of the user's fit to be trained on.

    Shapes and types are found without running it; if it is small, values as well, by a reset and
    a step.

    Args:
        env: what the user's factory returned.
        name: what the user calls it, for messages.

    Raises:
        SettingError: it lacks something that training relies on; one line says what.
    """
    with user_code("env", name):
        missing = [attribute for attribute in PROTOCOL if not hasattr(env, attribute)]
    if missing:
        raise SettingError(f"env: {name} lacks {', '.join(missing)}; see envs.GoalEnvironment")
    with user_code("env", name):  # whatever it says of names that it need not have
        own = OwnEnvironment(env, name)
    _check_shapes(own, env, name)
    own.is_large = _operations(own) > FEW_OPERATIONS
    if not own.is_large:
        _check_values(own, name)
    return own  # pyright: ignore[reportReturnType] -- its State is not brax's


def _whole_number(env: Any, name: str, attribute: str, most: int) -> int:
    with user_code("env", f"{attribute} of {name}"):
        value = getattr(env, attribute)
        try:
            number = None if isinstance(value, bool | np.bool_) else operator.index(value)
        except TypeError:  # jax.Array says so, too, of what is no integer scalar
            number = None
        shown = _shown(value)
    if number is None:
        raise SettingError(f"env: {attribute} of {name} is {shown}, not a whole number")
    if not 1 <= number <= most:
        raise SettingError(f"env: {attribute} of {name} is {shown}, not within [1, {most:,}]")
    return number


def _stages(env: Any, name: str) -> tuple[Stage, ...]:
    with user_code("env", f"stages of {name}"):
        stages = tuple(getattr(env, "stages", ()))
    for stage in stages:
        if not isinstance(stage, Stage):
            kind = type(stage).__name__
            raise SettingError(f"env: stages of {name} hold {kind}, not an envs.Stage")
        _whole_number(stage, f"a stage of {name}", "size", MAX_STAGE_SIZE)
        _distance_threshold(stage, f"a stage of {name}")
    return stages


def _distance_threshold(env: Any, name: str) -> float:
    with user_code("env", f"distance_threshold of {name}"):
        value = env.distance_threshold
        shown = _shown(value)
        is_array = np.ndim(value) == 0 and getattr(value, "dtype", None) is not None
        is_number = isinstance(value, Real) or (is_array and np.asarray(value).dtype.kind in "fiu")
        if not is_number or isinstance(value, bool | np.bool_):
            raise SettingError(f"env: distance_threshold of {name} is {shown}, not a number")
        number, (low, high) = float(value), THRESHOLDS
        if not low <= number <= high:  # NaN is not
            raise SettingError(
                f"env: distance_threshold of {name} is {shown}, not within [{low:g}, {high:g}]"
            )
        return number


def _tolerance(env: Any, name: str) -> np.ndarray:
    """The tolerance per goal dimension [n], float32."""
    low, high = THRESHOLDS
    with user_code("env", f"goal_tolerance of {name}"):
        value, shown = np.asarray(env.goal_tolerance), _shown(env.goal_tolerance)
    if (
        value.ndim != 1
        or value.dtype.kind not in "fiu"
        or not ((low <= value) & (value <= high)).all()
    ):
        raise SettingError(
            f"env: goal_tolerance of {name} is {shown}, not one number per dimension, "
            f"each within [{low:g}, {high:g}]"
        )
    if hasattr(env, "goal_success"):
        raise SettingError(f"env: {name} has both goal_tolerance and goal_success")
    return value.astype(np.float32)


def _reward_range(env: Any, name: str) -> tuple[float, float]:
    """Least and greatest of the environment's own rewards."""
    with user_code("env", f"reward_range of {name}"):
        value = getattr(env, "reward_range", None)
        numbers = np.asarray(value, float) if value is not None else np.zeros(0)
    fits = numbers.shape == (2,) and np.isfinite(numbers).all() and numbers[0] < numbers[1]
    if not fits:
        raise SettingError(
            f"env: {name} has goal_reward, so it needs reward_range, (least, greatest); "
            f"it is {_shown(value)}"
        )
    return float(numbers[0]), float(numbers[1])


def _check_rules(own: OwnEnvironment, name: str, first: Any) -> None:
    """Trace the environment's own rules, without running them."""
    goal = jax.ShapeDtypeStruct(first.state.obs["desired_goal"].shape, np.float32)
    tolerance = getattr(own, "_tolerance", None)
    if tolerance is not None and tolerance.shape != goal.shape:
        raise SettingError(
            f"env: goal_tolerance of {name} has shape {tolerance.shape}, goals have {goal.shape}"
        )
    for rule in ("goal_success", "goal_reward", "is_terminal"):
        if not hasattr(own, rule):
            continue
        with user_code("env", f"{rule} of {name}"):
            inputs = (first,) if rule == "is_terminal" else (goal, goal)
            shape = jax.eval_shape(getattr(own, rule), *inputs).shape
        if shape != ():
            raise SettingError(f"env: {rule} of {name} returns shape {shape}, not a scalar")


def _check_shapes(own: OwnEnvironment, env: Any, name: str) -> None:
    """Trace reset and step without running them, alone and as training maps them.

    Raises:
        SettingError: see `checked`.
    """
    key = jax.random.key(0)
    with user_code("env", f"reset of {name}"):
        first = jax.eval_shape(env.reset, key)
    _check_entries(first, f"reset of {name}")
    _check_stages(own.stages, first.obs, name)
    action = jax.ShapeDtypeStruct((own.action_size,), np.float32)
    first = jax.eval_shape(own.reset, key)
    with user_code("env", f"step of {name}"):
        second = jax.eval_shape(env.step, first.state, action)
    _check_entries(second, f"step of {name}")
    _check_alike(first.state, _with_unread_of(first.state, second), name, "step")
    _check_rules(own, name, first)
    if hasattr(own, "restart"):
        with user_code("env", f"restart of {name}"):
            again = jax.eval_shape(env.restart, first.state)
        _check_entries(again, f"restart of {name}")
        _check_alike(first.state, _with_unread_of(first.state, again), name, "restart")
    with user_code("env", f"jax.vmap over reset and step of {name}"):
        keys = jax.eval_shape(lambda: jax.random.split(key, (2, 3)))
        actions = jax.ShapeDtypeStruct((2, 3, own.action_size), np.float32)
        many = jax.eval_shape(jax.vmap(jax.vmap(own.reset)), keys)
        jax.eval_shape(jax.vmap(jax.vmap(own.step)), many, actions)


def _check_stages(stages: Sequence[Stage], obs: dict[str, Any], name: str) -> None:
    """Check shapes of what stages achieve and desire.

    Raises:
        SettingError: they are not what the stage says.
    """
    for number, stage in enumerate(stages, start=1):
        with user_code("env", f"stage {number} of {name}"):
            results = {
                "achieved": jax.eval_shape(stage.achieved, obs["observation"]),
                "desired": jax.eval_shape(stage.desired, obs["observation"], obs["desired_goal"]),
            }
        for function, result in results.items():
            is_array = isinstance(result, jax.ShapeDtypeStruct)
            shown = _described(result) if is_array else type(result).__name__
            is_real = is_array and jnp.issubdtype(result.dtype, jnp.floating)
            if not is_real or result.shape != (stage.size,):
                raise SettingError(
                    f"env: {function} of stage {number} of {name} returns {shown}, "
                    f"not float32[{stage.size}]"
                )


def _check_entries(state: Any, function: str) -> None:
    """Check shapes and types of what the trainer reads of a state's observation."""
    obs = getattr(state, "obs", None)
    if not hasattr(state, "replace"):
        raise SettingError(f"env: {function} returns {type(state).__name__}, not a brax State")
    if not isinstance(obs, dict) or not set(obs) >= set(ENTRIES):
        raise SettingError(f"env: {function}: State.obs is no dict with {', '.join(ENTRIES)}")
    for entry in ENTRIES:
        value = obs[entry]
        if not isinstance(value, jax.ShapeDtypeStruct):
            raise SettingError(f"env: {function}: {entry} is {type(value).__name__}, not an array")
        if not jnp.issubdtype(value.dtype, jnp.floating):
            raise SettingError(f"env: {function}: {entry} is {value.dtype}, not float32")
        if len(value.shape) != 1 or not value.shape[0]:
            raise SettingError(f"env: {function}: {entry} has shape {value.shape}, not [n]")
    achieved, desired = (obs[entry].shape for entry in ENTRIES[1:])
    if achieved != desired:
        raise SettingError(
            f"env: {function}: achieved_goal has shape {achieved} and desired_goal {desired}"
        )


def _check_alike(first: Any, second: Any, name: str, function: str) -> None:
    """Check that states after reset and after another function can take each other's place."""
    leaves = [jax.tree_util.tree_flatten_with_path(state)[0] for state in (first, second)]
    after_reset, after_step = ({_path(path): leaf for path, leaf in part} for part in leaves)
    for path in sorted(set(after_reset) | set(after_step)):
        here, there = after_reset.get(path), after_step.get(path)
        if here is None or there is None or not _convertible(there, here):
            raise SettingError(
                f"env: {path} of {name} is {_described(here)} after reset "
                f"and {_described(there)} after {function}"
            )
    if jax.tree.structure(first) != jax.tree.structure(second):
        raise SettingError(
            f"env: reset and {function} of {name} return states of different structure"
        )


def _check_values(own: OwnEnvironment, name: str) -> None:
    """Run a reset and a step.

    Raises:
        SettingError: they fail, or the goal does not stay, or is too large for its threshold.
    """

    def run() -> Any:
        @jax.jit  # anew, so that the user's functions are called again
        def first_two(key: jax.Array) -> Any:
            first = own.reset(key)
            return first.obs, own.step(first, jnp.zeros(own.action_size)).obs

        with user_code("env", f"running reset and step of {name}"):
            return jax.tree.map(np.asarray, jax.block_until_ready(first_two(jax.random.key(0))))

    states = run()
    for function, obs in zip(("reset", "step"), states, strict=True):
        for entry in ENTRIES:
            if not np.isfinite(obs[entry]).all():
                own.remarks.append(
                    f"{entry} is not finite after {function} of {name}; "
                    "episodes in which that happens are dropped"
                )
                return
    first, second = states
    if not np.array_equal(first["desired_goal"], second["desired_goal"]):
        raise SettingError(f"env: step of {name} changes desired_goal, which holds for an episode")
    largest = np.abs(first["desired_goal"].astype(np.float32)).max()
    if np.spacing(largest) > own.distance_threshold:
        raise SettingError(
            f"env: distance_threshold of {name}, {own.distance_threshold:g}, is less than float32 "
            f"can tell apart at a desired_goal of {largest:g}"
        )
    again = jax.tree.map(np.array_equal, states, run())
    if not all(jax.tree.leaves(again)):
        own.remarks.append(
            f"reset and step of {name} give other values for the same key and action; "
            "what is trained with them cannot be repeated, nor resumed to the same bits"
        )


def _operations(own: OwnEnvironment) -> int:
    """How many operations a reset and a step have."""

    def run(key: jax.Array) -> Any:
        return own.step(own.reset(key), jnp.zeros(own.action_size))

    return _count(jax.make_jaxpr(run)(jax.random.key(0)).jaxpr)


def _count(jaxpr: Jaxpr) -> int:
    inner = [sub for equation in jaxpr.eqns for sub in jaxprs_in_params(equation.params)]
    return len(jaxpr.eqns) + sum(map(_count, inner))


def _warnings(state: Any) -> jax.Array:
    """1 if a state tells of broken physics, else 0; NaN tells of it, too."""
    reported = (getattr(state, "metrics", None) or {}).get(WARNINGS, 0.0)
    return jnp.any(~(jnp.asarray(reported) <= 0)).astype(jnp.float32)


def _as_before(before: Any, after: Any) -> Any:
    """A state with the structure and types of the one before."""
    return jax.tree.map(_retyped, _with_unread_of(before, after), before)


def _with_unread_of(before: Any, after: Any) -> Any:
    """`after`, with what nothing reads in the structure and the types that it has in `before`."""
    fields = {
        name: _fitted(getattr(before, name), getattr(after, name), is_output=name in OUTPUTS)
        for name in (*OUTPUTS, "info")
        if hasattr(before, name) and hasattr(after, name)
    }
    others = {name: value for name, value in before.obs.items() if name not in ENTRIES}
    read = {entry: after.obs[entry] for entry in ENTRIES}
    kept = _fitted(others, after.obs, is_output=False)
    return after.replace(obs={**kept, **read}, **fields)


def _fitted(before: Any, after: Any, *, is_output: bool) -> Any:
    """`after` retyped, less new entries; an entry that is gone, or an unfit output, as before."""
    if isinstance(before, dict) and isinstance(after, dict):
        return {
            name: _fitted(value, after[name], is_output=is_output) if name in after else value
            for name, value in before.items()
        }
    fits = jax.tree.structure(before) == jax.tree.structure(after) and all(
        np.shape(old) == np.shape(new) and (_dtype(old) == _dtype(new) or not _is_key(old, new))
        for old, new in zip(jax.tree.leaves(before), jax.tree.leaves(after), strict=True)
    )
    if fits:
        return jax.tree.map(_retyped, after, before)
    return before if is_output else after


def _retyped(leaf: Any, like: Any) -> Any:
    """A leaf as the type of another, and without the weak type of Python's numbers."""
    if isinstance(leaf, jax.ShapeDtypeStruct):
        return jax.ShapeDtypeStruct(leaf.shape, like.dtype)
    return leaf if _is_key(leaf) else jax.lax.convert_element_type(leaf, _dtype(like))


def _dtype(leaf: Any) -> Any:
    return leaf.dtype if hasattr(leaf, "dtype") else jnp.result_type(leaf)


def _is_key(*leaves: Any) -> bool:
    return any(jnp.issubdtype(_dtype(leaf), jax.dtypes.prng_key) for leaf in leaves)


def _convertible(leaf: Any, like: Any) -> bool:
    if leaf.shape != like.shape:
        return False
    if leaf.dtype == like.dtype:
        return True
    return any(
        jnp.issubdtype(leaf.dtype, kind) and jnp.issubdtype(like.dtype, kind)
        for kind in (jnp.floating, jnp.integer)
    )


def _path(path: Any) -> str:
    return jax.tree_util.keystr(path).lstrip(".")


def _described(leaf: Any) -> str:
    if leaf is None:
        return "absent"
    return f"{leaf.dtype}[{','.join(map(str, leaf.shape))}]"


def _shown(value: Any) -> str:
    """A value of the user's, short and in one line."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else f"{text[:57]}..."
