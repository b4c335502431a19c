"""Settings for all tests; imported by pytest before anything of JAX."""

import os

# Tests compile many small programs and run them briefly.
os.environ.setdefault("XLA_FLAGS", "--xla_backend_optimization_level=0")
os.environ.setdefault("JAX_PLATFORMS", "cpu")

import cgm_jax.envs  # noqa: F401 -- imports MJX without its remarks, ahead of Brax
