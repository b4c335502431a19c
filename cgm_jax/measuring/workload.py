"""What is measured: runs of the cpu preset."""

from cgm_jax.config.grid import Group, build_groups


def cpu_group(env: str, runs: int = 1) -> Group:
    """Runs of the cpu preset, which differ in their seed."""
    grid = {"env": [env], "seed": list(range(runs))}
    return build_groups("cpu", {**grid, "replay_transitions": [100_000]})[0]
