"""What the loop works with, and the state of a run before any training."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from cgm_jax.config.fields import SettingError, check_concrete
from cgm_jax.config.settings import Hyperparameters, Settings
from cgm_jax.config.sizes import Sizes
from cgm_jax.curricula.parts.masks import MAX_TABULATED
from cgm_jax.envs import GoalEnvironment, Stage
from cgm_jax.loop.cutting import is_cut, updates_at_once
from cgm_jax.loop.judging import has_own_rules, may_end, reward_range
from cgm_jax.loop.normaliser import init_normaliser
from cgm_jax.loop.state import TrainingState, init_statistics
from cgm_jax.replay.ring import init_replay


class Setup(NamedTuple):
    """An environment and the static settings of the loop.

    Attributes:
        env: what to train on.
        settings: `settings.env` and `settings.engine` are not read.
        like: shapes of a state of the environment.
        platform: what the programs are for, as JAX names it: "cpu", "gpu", "tpu".
        is_cut: whether cycles are cut into parts.
    """

    env: GoalEnvironment
    settings: Settings
    like: Any
    platform: str
    is_cut: bool

    @property
    def goal_size(self) -> int:
        """Dimensions of a goal, n."""
        return self.like.obs["desired_goal"].shape[-1]

    @property
    def stages(self) -> tuple[Stage, ...]:
        """Sub-goals on the way to the environment's goal; empty where it declares none."""
        return tuple(getattr(self.env, "stages", ()))

    @property
    def masks(self) -> int:
        """How many masks metrics tell apart: 2^n, or 0 where that is too many."""
        return 2**self.goal_size if self.goal_size <= MAX_TABULATED else 0


def make_setup(env: GoalEnvironment, settings: Settings, platform: str | None = None) -> Setup:
    """Look at an environment without running it.

    Args:
        env: what to train on.
        settings: of the loop.
        platform: what the programs are for; None for the one that JAX computes on.
    """
    like = jax.eval_shape(env.reset, jax.random.key(0))
    platform = platform or jax.default_backend()
    return Setup(env, settings, like, platform, is_cut(env, settings, platform))


def sizes(setup: Setup, hyper: Hyperparameters) -> Sizes:
    """What the curriculum and the agent of a run may know of the task and the loop."""
    settings, env = setup.settings, setup.env
    observation, goal = setup.like.obs["observation"].shape[-1], setup.goal_size
    shown = goal * settings.mask_input + hyper.curriculum.shows_threshold
    shown += hyper.relabelling.shows(setup.stages)
    whole = Sizes(
        observation=observation,
        goal=goal,
        action=env.action_size,
        inputs=observation + goal + shown,
        episode_length=env.episode_length,
        distance_threshold=env.distance_threshold,
        environments=settings.environments,
        evaluation_episodes=settings.evaluation_episodes,
        updates_at_once=settings.updates_per_cycle,
        critics=hyper.agent.critics,
        starts=setup.like if hasattr(env, "restart") else None,
    )
    if not setup.is_cut:
        return whole

    def check(count: int) -> None:
        fewer = whole._replace(updates_at_once=count)
        jax.eval_shape(lambda: hyper.agent.init(jax.random.key(0), fewer))

    return whole._replace(updates_at_once=updates_at_once(settings, check))


def init_state(setup: Setup, hyper: Hyperparameters) -> TrainingState:
    """The state of a run before any training; of its randomness, `hyper.seed` is all.

    Raises:
        SettingError: the environment, the loop, the agent and the curriculum do not go together,
            or a value that is not traced is out of its range.
    """
    check_concrete(hyper)
    known, settings = sizes(setup, hyper), setup.settings
    _check_together(setup, hyper, known.critics)
    key, agent_key = jax.random.split(jax.random.key(hyper.seed))
    length = known.episode_length
    return TrainingState(
        key=key,
        agent=hyper.agent.init(agent_key, known),
        curriculum=hyper.curriculum.init(known),
        normaliser=init_normaliser(
            known.observation,
            known.goal,
            limit=settings.normaliser_limit,
            distance_threshold=known.distance_threshold,
        ),
        replay=init_replay(
            max(settings.replay_transitions // length, settings.environments),
            length,
            known.observation,
            known.goal,
            known.action,
            may_end=may_end(setup.env),
        ),
        statistics=init_statistics(setup.masks, hyper.agent.logged),
        env_steps=jnp.zeros((), jnp.int32),
        updates=jnp.zeros((), jnp.int32),
        failure=jnp.zeros((), jnp.int32),
    )


def _check_together(setup: Setup, hyper: Hyperparameters, critics: int) -> None:
    """Check that environment, agent with so many critics, curriculum and relabelling go together.

    Raises:
        SettingError: they do not.
    """
    env, curriculum, relabelling = setup.env, hyper.curriculum, hyper.relabelling
    name, relabels = _called(curriculum), _called(relabelling)
    has_own_rewards = hasattr(env, "goal_reward")
    reward_range(env)  # which it has to say, if so
    if critics < curriculum.needs_critics:
        least = curriculum.needs_critics
        raise SettingError(f"critics: {critics}, but curriculum {name} needs {least} or more")
    if relabelling.needs_stages and not setup.stages:
        raise SettingError(
            f"relabelling: {relabels} needs stages, and {setup.settings.env} declares none"
        )
    if relabelling.needs_stages and has_own_rewards:
        raise SettingError("relabelling: stages have rewards of -1 or 0, and env has its own")
    if curriculum.needs_sparse_rewards and has_own_rewards:
        raise SettingError(f"curriculum: {name} needs rewards of -1 or 0, and env has its own")
    if curriculum.shows_threshold and has_own_rewards:
        raise SettingError(
            f"curriculum: {name} varies the distance threshold, which env's rewards do not follow"
        )
    if curriculum.shows_threshold and has_own_rules(env):
        raise SettingError(
            f"curriculum: {name} varies the distance threshold, but env has a rule of success "
            "of its own"
        )


def _called(part: object) -> str:
    """A component's name: that of its option, or that of its class where it is the user's own."""
    module = type(part).__module__
    return module.rpartition(".")[2] if module.startswith("cgm_jax.") else type(part).__name__
