import jax
import pytest

from cgm_jax import runner
from cgm_jax.grid import build_groups
from cgm_jax.memory import bytes_per_run, free_bytes, runs_that_fit, tree_bytes
from cgm_jax.settings import Hyperparameters
from cgm_jax.training import Trainer
from tests.cgm_jax.probe import TINY
from tests.examples.point_mass import PointMass


def test_the_replay_buffer_is_counted_to_the_byte() -> None:
    state = jax.eval_shape(Trainer(PointMass(), TINY).initial_state, Hyperparameters())
    # 40 episodes of 25 steps: observation 4 and goal 2 at 26 steps, action 2, goal and mask.
    floats = 40 * (26 * (4 + 2) + 25 * 2 + 2 + 2)
    assert tree_bytes(state.replay) == 4 * (floats + 1)


def test_a_run_takes_its_state_and_a_cycles_minibatches() -> None:
    trainer = Trainer(PointMass(), TINY)
    state = jax.eval_shape(trainer.initial_state, Hyperparameters())
    minibatches = 4 * TINY.updates_per_cycle * TINY.batch_size * (2 * (4 + 2) + 2 + 1)
    assert bytes_per_run(trainer) == tree_bytes(state) + 2 * minibatches


def test_what_is_free_is_within_what_a_machine_has() -> None:
    assert 2**26 < free_bytes() < 2**50


@pytest.mark.parametrize(("free", "fit"), [(1000, 8), (124, 1), (10, 1)])
def test_runs_that_fit(monkeypatch: pytest.MonkeyPatch, free: int, fit: int) -> None:
    monkeypatch.setattr("cgm_jax.memory.free_bytes", lambda: free)
    assert runs_that_fit(100) == fit


def test_a_grid_that_does_not_fit_is_split_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    (group,) = build_groups("smoke", {"seed": list(range(5)), "kappa": [4.0], "engine": ["native"]})
    monkeypatch.setattr(runner, "runs_that_fit", lambda _: 2)
    jobs, (note,) = runner.plan_jobs([group])
    assert [len(job.group.runs) for job in jobs] == [2, 2, 1]
    assert note.startswith("reach: 5 runs, 2 at a time, take ")
    assert len({id(job.programs) for job in jobs}) == 1
