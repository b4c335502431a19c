"""Relay hindsight experience replay: first what comes before the goal, then the goal.

An environment may declare stages, sub-goals in an order: for an arm and a block, to be at the
block. While the block is untouched nothing is learned about moving it; but being at the block is
soon learned, and exploration that begins there moves it in most episodes. So

    exploration  pursues the first stage that is not achieved, by chance or else the goal, and once
                 all are achieved always the goal;
    hindsight    of the relabelled transitions `relay_share` serve a stage, uniformly drawn: their
                 goal is what that stage achieved at a later step of the episode.

One network serves all, as Luo et al. have it (2023, "Relay Hindsight Experience Replay", arXiv
2208.00843): it sees the goals of all stages, of which all but the pursued one are 0. Here the goal
of a stage is shown as what remains of it, with a flag per stage. For the environment's own goal all
these inputs are 0, so that evaluation and an exported policy know nothing of stages. The chance is
theirs, too: a policy for the goal that has never acted on the way to the block throws it off the
table there.

Where it deviates: there each stage has a minibatch of its own in every update, and actions that
pursue a stage are not random. There a stage is at the object itself; here the environment says
where, such as behind what it is to push. Without HER stages are neither served nor pursued.

    python -m cgm_jax.train --preset cpu --env pick_and_place --relabelling relay
"""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp

from cgm_jax.config.fields import settings, traced
from cgm_jax.replay.future import Future, integer_below
from cgm_jax.replay.protocol import Transitions
from cgm_jax.replay.ring import Replay

if TYPE_CHECKING:  # importing environments takes long, and starts JAX
    from cgm_jax.envs import Stage

UNIT = 2.0
"""What remains of a stage is shown in so many of its thresholds."""

PRECISION = 0.5
"""Hindsight counts as achieved what is closer than this share of a stage's threshold; a policy that
were content at the threshold itself would stay there, in and out of the stage."""

LIMIT = 5.0
"""And clipped to +-this, as normalised inputs are by default."""


@settings
class Relay(Future):
    """HER's strategy "future" for every stage. Its settings, with the names of the options."""

    needs_stages = True

    relay_share: float = traced(0.2, "share of hindsight for the stages before the goal", 0, 1)
    relay_chance: float = traced(
        0.5, "chance that an action pursues a stage not yet achieved", 0, 1
    )

    def sample(
        self,
        key: jax.Array,
        replay: Replay,
        count: int,
        distance_threshold: float,
        stages: "Sequence[Stage]" = (),
    ) -> Transitions:
        """Draw transitions as `Future` does, some of the relabelled ones for a stage.

        Those come from all episodes, whether or not they moved the achieved goal.
        """
        uniform = jax.random.uniform(key, (5, count))
        for_places, for_stage = uniform[:4], uniform[4]
        anywhere = for_stage < self.relay_share
        drawn = self.draw(replay, for_places, distance_threshold, anywhere)
        place = for_stage / jnp.maximum(self.relay_share, jnp.finfo(jnp.float32).tiny)
        staged = drawn.relabelled & anywhere
        stage = jnp.where(staged, integer_below(len(stages), place), len(stages))
        own = self.transitions(replay, drawn)

        later = replay.episodes.observation[drawn.episode, drawn.future]
        targets = [_each(one.achieved, later) for one in stages]
        reward = own.reward
        for number, (one, target) in enumerate(zip(stages, targets, strict=True)):
            reached = _is_achieved(one, target, own.next_observation, PRECISION)
            reward = jnp.where(stage == number, jnp.where(reached, 0.0, -1.0), reward)
        return own.replace(
            reward=reward,
            subgoal=_shown(stages, stage, targets, own.observation),
            next_subgoal=_shown(stages, stage, targets, own.next_observation),
        )

    def shows(self, stages: "Sequence[Stage]") -> int:
        """A flag per stage, and what remains of each."""
        return len(stages) + sum(one.size for one in stages)

    def pursued(
        self,
        stages: "Sequence[Stage]",
        observation: jax.Array,
        goal: jax.Array,
        uniform: jax.Array,
    ) -> jax.Array:
        """The first stage that is not achieved, [E, `shows`]; 0 where all are.

        By chance the goal is pursued instead, so that its policy is corrected on the way, too.
        """
        targets = [_each(one.desired, observation, goal) for one in stages]
        stage = jnp.full(observation.shape[:-1], len(stages))
        for number, one in reversed(list(enumerate(stages))):
            reached = _is_achieved(one, targets[number], observation)
            stage = jnp.where(reached, stage, number)
        chance = jnp.where(self.her, self.relay_chance, 0.0)
        stage = jnp.where(uniform < chance, stage, len(stages))
        return _shown(stages, stage, targets, observation)

    def idle(self) -> frozenset[str]:
        """Without HER, what is about stages, too."""
        return super().idle() | (frozenset() if self.her else {"relay_share", "relay_chance"})


def _each(
    function: Callable[..., jax.Array], observation: jax.Array, *goal: jax.Array
) -> jax.Array:
    """A stage's function of one observation, and of one goal, over all leading axes."""
    signature = "(o),(n)->(m)" if goal else "(o)->(m)"
    return jnp.vectorize(function, signature=signature)(observation, *goal)


def _is_achieved(
    stage: "Stage", target: jax.Array, observation: jax.Array, precision: float = 1.0
) -> jax.Array:
    """Whether observations [..., o] achieve a stage's goal [..., m]; [...] bool."""
    remaining = target - _each(stage.achieved, observation)
    return jnp.linalg.norm(remaining, axis=-1) < precision * stage.distance_threshold


def _shown(
    stages: "Sequence[Stage]",
    pursued: jax.Array,
    targets: Sequence[jax.Array],
    observation: jax.Array,
) -> jax.Array:
    """What the networks see of the pursued stage, [..., `Relay.shows`].

    Args:
        stages: of the environment, K.
        pursued: number of the stage, K for the environment's own goal, int32 [...].
        targets: what each stage is to achieve, [..., m].
        observation: [..., o].
    """
    flags = jnp.stack([pursued == number for number in range(len(stages))], axis=-1)
    flags = flags.astype(jnp.float32)
    parts = [flags]
    for number, (stage, target) in enumerate(zip(stages, targets, strict=True)):
        remaining = (target - _each(stage.achieved, observation)) / (
            UNIT * stage.distance_threshold
        )
        parts.append(flags[..., number, None] * jnp.clip(remaining, -LIMIT, LIMIT))
    return jnp.concatenate(parts, axis=-1)
