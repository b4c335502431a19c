"""Imports MJX without its remark about Warp.

`mujoco.mjx` prints to standard output when the optional Warp engine is not installed, which is
the normal case. Importing this module first keeps that out of the output of every program.
"""

import contextlib
import io

with contextlib.redirect_stdout(io.StringIO()):
    import mujoco.mjx  # noqa: F401
