"""Brax's states and MJX, imported without MJX's remark about Warp.

`mujoco.mjx` prints to standard output when the optional Warp engine is not installed, which is
the normal case; Brax imports it. What needs either imports this module first.
"""

import contextlib
import io

with contextlib.redirect_stdout(io.StringIO()):
    import mujoco.mjx  # noqa: F401

from brax.envs.base import Env, State

__all__ = ["Env", "State"]
