"""Settings that curricula and agents have in common, which know each other by protocol alone."""

from cgm_jax.config.fields import settings, traced


@settings
class Common:
    """Taken over, each by itself, with `fields.shared`."""

    discount: float = traced(0.98, "discount factor gamma", 0, 0.9999)
