"""The training programs as a GPU would get them, on a machine without one."""

import re

import jax
import pytest

from cgm_jax.config.grid import build_groups
from cgm_jax.envs.physics.mjx import CPU_FLAG
from cgm_jax.loop.environment import make_environment
from cgm_jax.loop.training import make_programs, make_trainer

RUNS = 4
CUSTOM_CALLS = {"cusolver_potrf_ffi"}
"""What XLA is to call on a GPU: cuSOLVER's Cholesky, in the solver of MJX. None calls back."""


def _lowered(
    engine: str, platform: str, lowered_for: str, names: tuple[str, ...]
) -> dict[str, str]:
    """The text of programs of four runs."""
    grid = {"env": ["reach"], "engine": [engine], "seed": list(range(RUNS))}
    group = build_groups("cpu", {**grid, "replay_transitions": [100_000]})[0]
    trainer = make_trainer(make_environment(group.settings), group.settings, platform)
    programs, hyper = make_programs(trainer), group.hyper()
    state = jax.eval_shape(programs.start, hyper)
    arguments = {"start": (hyper,), "train": (state, hyper, 1), "evaluate": (state, hyper)}
    return {
        name: getattr(programs, name)
        .trace(*arguments[name])
        .lower(lowering_platforms=(lowered_for,))
        .as_text()
        for name in names
    }


def _products_of_all_runs(text: str) -> int:
    """How many matrix products take a batch of 512 of all runs at once."""
    return len(re.findall(rf"dot_general .*tensor<{RUNS}x512x\d+xf32>", text))


@pytest.mark.slow
def test_training_on_mjx_lowers_for_cuda(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XLA_FLAGS", CPU_FLAG)  # so that the engine sets nothing for good
    texts = _lowered("mjx", "gpu", "cuda", ("start", "train", "evaluate"))
    calls = {name: set(re.findall(r"custom_call @([\w.$]+)", text)) for name, text in texts.items()}
    assert calls == {"start": set(), "train": CUSTOM_CALLS, "evaluate": CUSTOM_CALLS}
    assert _products_of_all_runs(texts["train"]) > 20


def test_updates_of_runs_are_batched_on_a_gpu_only() -> None:
    # Native physics lowers for a CPU alone, and the choice does not depend on it.
    counts = {
        platform: _products_of_all_runs(_lowered("native", platform, "cpu", ("train",))["train"])
        for platform in ("cpu", "gpu")
    }
    assert counts["cpu"] == 0
    assert counts["gpu"] > 20
