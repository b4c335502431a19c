"""One physics protocol, several engines.

protocol.py  what an engine offers: start, advance, positions, a copy for MuJoCo
native.py    C MuJoCo, all environments of a run in one Batch call per control step (CPU)
mjx.py       MJX, MuJoCo as a JAX program (GPU, TPU, and the check of the others)
warp.py      MuJoCo Warp (NVIDIA GPU)
weld.py      the term of welds that MJX lacks
choose.py    "auto" and the engines' names
deferred.py  an engine that starts at its first use
"""

from cgm_jax.envs import quiet_import as _quiet_import  # noqa: F401 -- before anything of brax
