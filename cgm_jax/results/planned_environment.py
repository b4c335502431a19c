"""The environment that policies are evaluated in, if what was asked for fits it."""

from dataclasses import replace

import jax

from cgm_jax.config.fields import SettingError
from cgm_jax.config.settings import Settings
from cgm_jax.envs import GoalEnvironment
from cgm_jax.envs.fetch import FetchEnvironment
from cgm_jax.envs.rendering import RenderingError, check_rendering
from cgm_jax.envs.viewer import check_display
from cgm_jax.loop.environment import make_environment
from cgm_jax.results.plan import Plan, mask_words, masked_axes

MAX_GIF_BYTES = 4 * 2**30
"""What the frames of a .gif may take: some 69 episodes of a Fetch task, 640 pixels wide."""


def planned_environment(settings: Settings, plan: Plan) -> GoalEnvironment:
    """Make the environment that `settings` names, if the plan fits it.

    Raises:
        SettingError: it does not: a mask with more dimensions than the goal, a video of what
            cannot be rendered, or here.
    """
    if plan.engine is not None:
        settings = replace(settings, engine=plan.engine)
    env = make_environment(settings)
    if plan.recorded:
        _check_shown(env, settings.env, plan)
    size = environment_sizes(env)[1]
    for word, axis in zip(mask_words(plan.mask), masked_axes(plan.mask), strict=True):
        if axis >= size:
            raise SettingError(
                f"mask: goals of {settings.env} have no {word}, but dimensions 0 to {size - 1}"
            )
    return env


def _check_shown(env: GoalEnvironment, name: str, plan: Plan) -> None:
    """Check that episodes can be shown: now, and not after the evaluation."""
    shown_as = "view" if plan.view else "video"
    if plan.view and not isinstance(env, FetchEnvironment):
        raise SettingError(f"view: only the Fetch tasks have a scene of MuJoCo's, not {name}")
    if not isinstance(env, FetchEnvironment) and not hasattr(env, "render_frame"):
        raise SettingError(
            f"video: {name} has no render_frame(state, width, height); "
            "see envs.RenderableEnvironment"
        )
    if plan.gif_width is not None:
        _check_memory_of_gif(plan.recorded, env.episode_length, plan.gif_width)
    try:
        if plan.view:
            check_display()
        elif isinstance(env, FetchEnvironment):
            check_rendering()
    except RenderingError as error:
        raise SettingError(f"{shown_as}: {error}") from None


def _check_memory_of_gif(episodes: int, length: int, width: int) -> None:
    """Check that frames of a .gif fit: they share a palette, so that all are held till the end."""
    frame = width * (width * 3 // 4) * 4  # bytes; RGB, and then a number in the palette as well
    needed = episodes * length * frame
    if needed > MAX_GIF_BYTES:
        raise SettingError(
            f"video_episodes: a .gif of {episodes} takes {needed / 2**30:.1f} GiB of memory, and "
            f"{MAX_GIF_BYTES / 2**30:.0f} is the most; take fewer, a smaller width, or an .mp4"
        )


def environment_sizes(env: GoalEnvironment) -> tuple[int, int, int]:
    """Sizes of the observation, of the goal and of the action."""
    obs = jax.eval_shape(env.reset, jax.random.key(0)).obs
    return obs["observation"].shape[-1], obs["desired_goal"].shape[-1], env.action_size
