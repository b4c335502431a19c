"""Whether this machine can draw."""

import functools

from cgm_jax.envs.rendering import RenderingError, check_rendering


@functools.cache
def can_render() -> bool:
    """Whether a drawing surface can be had; rendering tests are skipped where it cannot."""
    try:
        check_rendering()
    except RenderingError:
        return False
    return True
