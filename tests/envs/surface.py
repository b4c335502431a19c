"""Whether this machine can draw."""

import functools

from envs.rendering import RenderingError, open_surface


@functools.cache
def can_render() -> bool:
    """Whether a drawing surface can be had; tests of pictures are skipped where it cannot."""
    try:
        open_surface(64, 64).free()
    except RenderingError:
        return False
    return True
