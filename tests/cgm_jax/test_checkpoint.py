from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax.checkpoint import load_checkpoint, save_checkpoint
from cgm_jax.settings import Hyperparameters
from cgm_jax.training import Trainer
from cgm_jax.training_state import TrainingState
from tests.cgm_jax.probe import TINY
from tests.examples.point_mass import PointMass

TRAINER = Trainer(PointMass(), TINY)


def trained() -> TrainingState:
    hyper = Hyperparameters()
    return jax.jit(TRAINER.train_cycles)(TRAINER.initial_state(hyper), hyper, 1)


def test_a_checkpoint_holds_every_bit_of_the_state(tmp_path: Path) -> None:
    state = trained()
    path = save_checkpoint(tmp_path, group=0, epoch=1, state=state)
    like = jax.eval_shape(TRAINER.initial_state, Hyperparameters())
    restored = load_checkpoint(path, like)
    assert jax.tree.structure(restored) == jax.tree.structure(state)
    for leaf, other in zip(jax.tree.leaves(restored), jax.tree.leaves(state), strict=True):
        assert leaf.dtype == other.dtype
        assert bool(jnp.all(leaf == other))


def test_only_the_last_two_checkpoints_of_a_group_are_kept(tmp_path: Path) -> None:
    state = trained()
    for epoch in (1, 2, 10):
        save_checkpoint(tmp_path, group=0, epoch=epoch, state=state)
    save_checkpoint(tmp_path, group=1, epoch=1, state=state)
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["group0_epoch000002.npz", "group0_epoch000010.npz", "group1_epoch000001.npz"]


def test_the_state_of_another_program_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "other.npz"
    np.savez(path, something=np.zeros(3))
    like = jax.eval_shape(TRAINER.initial_state, Hyperparameters())
    with pytest.raises(ValueError, match="another program"):
        load_checkpoint(path, like)
