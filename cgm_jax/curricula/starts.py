"""Starts of intermediate difficulty (reverse curriculum; Florensa, Held, Wulfmeier et al. 2017).

    s_0 ~ uniform over { s visited : R_min <= R(s, g) <= R_max },   R = success of today's policy

A start is a state of the environment with the goal that was pursued there; a share of the episodes
begins at a reset. Goals are the environment's. What differs from the paper: it spreads starts by
random actions from starts that were good, beginning at a state in which the only goal is achieved;
here they are states that training episodes visit (a random step of each), since goals differ and
no such state is given. And where it tries every start several times, R(s, g) is the mean success of
the training episodes that began where the critics expected most nearly the same return,
Q(s, pi(s, g), g); so starts are chosen as well as the critics tell near from far. The authors also
mix in starts from all that were good in earlier iterations; here there are none but the states
visited recently. While none of these is of intermediate difficulty, any of them is a start.

    python -m cgm_jax.train --curriculum starts --reset-share 0.5

Needs an environment in which an episode can begin in a given state (`StartableEnvironment`).
"""

from typing import ClassVar

import jax
import jax.numpy as jnp
from flax import struct
from jaxtyping import Array, Float

from cgm_jax.config.fields import SettingError, settings, shared, static, traced
from cgm_jax.config.missing import missing
from cgm_jax.config.sizes import Sizes
from cgm_jax.curricula.goid import GOID
from cgm_jax.curricula.parts.candidates import (
    between,
    check_neighbours,
    draw_eligible,
    nearest_success,
)
from cgm_jax.curricula.parts.recent import Recent, init_recent, mean_of, record
from cgm_jax.curricula.parts.rows import where_rows
from cgm_jax.curricula.protocol import Curriculum, Goals, Outcomes, View


class Begun(struct.PyTreeNode):
    """Where training episodes began and what they were after: [N, o], [N, n]; success [N]."""

    observation: jax.Array
    goal: jax.Array
    success: jax.Array


class StartsState(struct.PyTreeNode):
    """Where episodes may begin, and what is known of it.

    Attributes:
        visited: whole states of the environment.
        begun: recent training episodes.
        share: of the visited states those of intermediate difficulty; NaN while there were none.
    """

    visited: Recent
    begun: Recent
    share: jax.Array


@settings
class Starts(Curriculum[StartsState]):
    """Starts between too hard and too easy. Its settings, with the names of the options."""

    wants_visited: ClassVar[bool] = True
    needs_critics: ClassVar[int] = 1

    least_success: float = shared(GOID, "least_success")
    most_success: float = shared(GOID, "most_success")
    reset_share: float = traced(0.5, "share of episodes that begin at a reset", 0, 1)
    neighbours: int = shared(GOID, "neighbours")
    practised_episodes: int = shared(GOID, "practised_episodes")
    visited_states: int = static(500, "recently visited states that may be starts", 1, 10**6)

    def init(self, sizes: Sizes) -> StartsState:
        """Nowhere been yet.

        Raises:
            SettingError: episodes of the environment cannot begin in a given state, or a single
                one is to tell how often a start succeeds.
        """
        check_neighbours(self.neighbours, self.practised_episodes)
        if sizes.starts is None:
            raise SettingError(
                "curriculum: starts needs an environment with restart(state); "
                "see envs.StartableEnvironment"
            )
        like = Begun(jnp.zeros(sizes.observation), jnp.zeros(sizes.goal), jnp.zeros((), bool))
        return StartsState(
            visited=init_recent(sizes.starts, self.visited_states),
            begun=init_recent(like, self.practised_episodes),
            share=jnp.full((), missing(), jnp.float32),
        )

    def sample(self, state: StartsState, key: jax.Array, drawn: Goals, view: View) -> Goals:
        """Visited states of intermediate difficulty with their goals, and resets."""
        choice_key, reset_key = jax.random.split(key)
        count = len(drawn.desired)
        filled = state.visited.filled
        medium = between(self.rates(state, view), self.least_success, self.most_success) & filled
        chosen = draw_eligible(choice_key, jnp.where(medium.any(), medium, filled), count)
        visited = jax.tree.map(lambda rows: rows[chosen], state.visited.rows)
        kept = jax.random.bernoulli(reset_key, self.reset_share, (count,)) | ~filled.any()
        share = medium.sum(dtype=jnp.float32) / jnp.maximum(filled.sum(dtype=jnp.float32), 1.0)
        return drawn.replace(
            start=where_rows(kept, view.first, visited),
            desired=jnp.where(kept[:, None], drawn.desired, visited.obs["desired_goal"]),
            memo=jnp.where(filled.any(), share, missing()),
        )

    def after_training(self, state: StartsState, outcomes: Outcomes) -> StartsState:
        """Remember where episodes began, what became of them, and a state that each visited."""
        begun = Begun(outcomes.observation, outcomes.goals.desired, outcomes.success)
        return StartsState(
            visited=record(state.visited, outcomes.visited, outcomes.valid),
            begun=record(state.begun, begun, outcomes.valid),
            share=jnp.where(outcomes.valid.any(), outcomes.goals.memo, state.share),
        )

    def report(self, state: StartsState) -> dict[str, jax.Array]:
        """Share of visited states of intermediate difficulty, and success of all starts."""
        return {
            "start_share": state.share,
            "start_success": mean_of(state.begun, state.begun.rows.success),
        }

    def rates(self, state: StartsState, view: View) -> Float[Array, " N"]:
        """Estimated success rate [N] of every visited state; NaN before any training episode."""
        visited, begun = state.visited.rows, state.begun.rows
        values = view.value(visited.obs["observation"], visited.obs["desired_goal"]).mean(axis=0)
        known = view.value(begun.observation, begun.goal).mean(axis=0)
        return nearest_success(
            values[:, None], known[:, None], begun.success, state.begun.filled, self.neighbours
        )
