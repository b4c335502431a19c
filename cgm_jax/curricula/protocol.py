"""What a curriculum offers to the loop, and what it is told.

A curriculum is a class of settings (see `config/fields.py`) with pure functions over a state of its
own, any pytree of arrays. All are written for one run; the loop maps them over runs, the settings
included, so that a sweep varies every traced setting in one program. In order of a cycle:

    goals = curriculum.sample(state, key, drawn, view)    # before E training episodes
    state = curriculum.after_training(state, outcomes)    # after them
    state = curriculum.after_evaluation(state, outcomes, examined)  # at the end of an epoch

A new curriculum is one new file with one class derived from `Curriculum`; what it does not define
is inherited. It must define `sample`.
"""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple, Protocol, TypeVar, runtime_checkable

import jax
from flax import struct
from jaxtyping import Array, Float

from cgm_jax.config.sizes import Sizes

State = TypeVar("State")


class Goals(struct.PyTreeNode):
    """What E episodes are to achieve.

    Attributes:
        desired: [E, n].
        mask: 1 counts, 0 counts as achieved, and nothing else, [E, n].
        threshold: achieved closer than this, [E].
        start: states of the environment in which the episodes begin, leading axis [E]; None for
            those of a reset. See `View.first`.
        memo: what the curriculum wants back with the outcomes, any pytree of arrays.
    """

    desired: jax.Array
    mask: jax.Array
    threshold: jax.Array
    start: Any = None
    memo: Any = None


class Outcomes(struct.PyTreeNode):
    """What became of E episodes.

    Attributes:
        goals: what they were to achieve.
        success: whether the masked goal was achieved at the last step, [E] bool.
        subgoal_success: whether each dimension of the whole goal was, [E, n] bool.
        valid: whether the physics held, and the episode did not end before its first step;
            episodes that are not valid must not count, [E] bool.
        observation: at the first step, [E, o].
        visited: a state of the environment after a random step of each episode, leading axis [E],
            for a curriculum that `wants_visited`; else None. It does not end the episode; where the
            first step did, it is the one before.
    """

    goals: Goals
    success: jax.Array
    subgoal_success: jax.Array
    valid: jax.Array
    observation: jax.Array
    visited: Any = None


class View(NamedTuple):
    """What a curriculum may look at, read only.

    Attributes:
        first: states of the E environments after their reset, which hold what they observe. Those
            of an environment of the user's own are wrapped: its own are their `state`.
        achieved: goals achieved in replay, [C, T + 1, n].
        filled: how many of the C episodes are real, the first ones; int32 scalar.
        value: from observations [..., o] and goals [..., n] to the return that each of the
            agent's critics expects under its actor, [critics, ...].
        draw: further goals of the environment, from a key and their number: [number, n].
        steps: after how many steps each episode in replay was over, int32 [C], or None where all
            took T; what it achieved then is repeated up to T.
    """

    first: Any
    achieved: jax.Array
    filled: jax.Array
    value: Callable[[jax.Array, jax.Array], jax.Array]
    draw: Callable[[jax.Array, int], jax.Array]
    steps: jax.Array | None = None


@runtime_checkable
class Curriculum(Protocol[State]):
    """Pure functions of one run over a state; derive from it and override what differs.

    Attributes:
        wants_visited: whether `Outcomes.visited` is needed, which costs memory.
        shows_threshold: whether the networks must see an episode's threshold, since it varies.
        wants_critics: how many critics an agent gets that can have several, unless a run says.
        needs_critics: how many it must have at least, or is refused.
        needs_sparse_rewards: whether values must be returns of rewards of -1 or 0; an environment
            with rewards of its own is refused.
    """

    wants_visited: ClassVar[bool] = False
    shows_threshold: ClassVar[bool] = False
    wants_critics: ClassVar[int] = 1
    needs_critics: ClassVar[int] = 0
    needs_sparse_rewards: ClassVar[bool] = False

    def init(self, sizes: Sizes) -> State:
        """The state before any training.

        Raises:
            SettingError: the environment or the agent cannot serve this curriculum.
        """
        del sizes
        return ()  # pyright: ignore[reportReturnType]

    @abstractmethod
    def sample(self, state: State, key: jax.Array, drawn: Goals, view: View) -> Goals:
        """What the next E training episodes are to achieve.

        Args:
            state: of the curriculum.
            key: consumed.
            drawn: what the environment drew: its own goals, whole, at its own threshold.
            view: replay and critics.

        Returns:
            `drawn`, with other values of the same shapes and types: `drawn.replace(mask=...)`.
        """
        ...

    def after_training(self, state: State, outcomes: Outcomes) -> State:
        """Learn from the E training episodes of a cycle."""
        del outcomes
        return state

    def after_evaluation(
        self, state: State, outcomes: Outcomes, examined: Outcomes | None = None
    ) -> State:
        """Learn from the noise-free episodes at the end of an epoch.

        Args:
            state: before.
            outcomes: of `evaluation_episodes` episodes with the full goal.
            examined: of the episodes that `examination` asked for, in its order.
        """
        del outcomes, examined
        return state

    def examination(self, sizes: Sizes) -> Float[Array, "P n"] | None:
        """Masks [P, n] of further noise-free episodes to run at each evaluation; None for none."""
        del sizes
        return None

    def report(self, state: State) -> dict[str, jax.Array]:
        """What metrics.jsonl is to hold: the state that an epoch was trained with, by name.

        The figure curriculum.png draws scalars as lines and arrays [k] as heat maps over training;
        values of an array `a` [k] name the rows of an array `a_b` [k]. Names of settings, and those
        that metrics.jsonl has already (`loop/own_components.py`), are taken.
        """
        del state
        return {}

    def idle(self) -> frozenset[str]:
        """Names of settings that have no effect, given the others; for concrete values only."""
        return frozenset()


PROTOCOL = Curriculum


def with_mask(drawn: Goals, mask: Float[Array, "E n"]) -> Goals:
    """The goals that the environment drew, under other masks [E, n]."""
    return drawn.replace(mask=mask)
