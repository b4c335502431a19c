"""Settings for all tests; imported by pytest before anything of JAX."""

import os

# Tests compile many small programs and run them briefly.
os.environ.setdefault("XLA_FLAGS", "--xla_backend_optimization_level=0")
os.environ.setdefault("JAX_PLATFORMS", "cpu")

from jaxtyping import install_import_hook

# Shapes and types that annotations of these modules tell are checked at every call in tests.
CHECKED = ("cgm_jax.agents.networks", "cgm_jax.curricula.goals")
install_import_hook(CHECKED, "beartype.beartype")

import cgm_jax.envs  # noqa: E402, F401 -- imports MJX without its remarks, ahead of Brax
