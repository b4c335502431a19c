"""What the suites over everything discovered have in common."""

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax.config.components import builtin
from cgm_jax.config.fields import Field, SettingError, declared
from cgm_jax.config.grid import hyperparameters
from cgm_jax.config.settings import Hyperparameters
from cgm_jax.host.checkpoint import TrainingProgress, load_checkpoint, save_checkpoint
from cgm_jax.loop.state import TrainingState
from cgm_jax.loop.training import Programs, Trainer
from cgm_jax.measuring.compilations import programs_compiled

KEY = jax.random.key(0).dtype


def other_value(item: "Field[Any]") -> Any:
    """A value of a traced setting that is not its default."""
    default: Any = item.default
    if isinstance(default, bool):
        return not default
    if isinstance(default, int):
        return default + 1
    low = max(item.metadata["low"], default - 1.0)
    return low + 0.3 * (min(item.metadata["high"], low + 2.0 * abs(default) + 1.0) - low)


def other_values(kind: str, name: str) -> dict[str, Any]:
    """For every traced setting of a component a value that is not its default."""
    return {
        item.name: other_value(item)
        for item in declared(builtin(kind)[name])
        if item.metadata["traced"]
    }


def assert_same(one: Any, other: Any) -> None:
    """Two pytrees of arrays have the same structure and the same bits."""

    def words(leaf: jax.Array) -> np.ndarray:
        is_key = jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)
        return np.asarray(jax.random.key_data(leaf) if is_key else leaf)

    assert jax.tree.structure(one) == jax.tree.structure(other)
    jax.tree.map(lambda x, y: np.testing.assert_array_equal(words(x), words(y)), one, other)


def assert_training_resumes(
    programs: Programs, hyper: Hyperparameters, state: TrainingState, start: Any, folder: Path
) -> None:
    """A state from a checkpoint has the bits of the one that was saved, and trains on with them.

    Args:
        programs: that have trained it, and have compiled all that they need.
        hyper: of its runs, stacked.
        state: after two epochs.
        start: shapes of a state.
        folder: for the checkpoint.
    """
    save_checkpoint(folder, 0, TrainingProgress(state, epoch=2))
    training, notes = load_checkpoint(folder, 0, start)
    assert training is not None
    assert not notes
    assert_same(training.state, state)
    copy, restored = jax.tree.map(jnp.copy, state), programs.spread(training.state)
    before = programs_compiled()
    resumed = programs.train(restored, hyper, 1)
    assert programs_compiled() == before > 0
    assert_same(resumed, programs.train(copy, hyper, 1))


def assert_no_type_is_promoted(trainer: Trainer, hyper: Hyperparameters) -> None:
    """Of what trains and evaluates, no type becomes another unless the code says so.

    Args:
        trainer: of the runs; nothing is compiled.
        hyper: of its runs, stacked.
    """
    first = jax.tree.map(lambda leaf: jnp.asarray(leaf[0]), hyper)
    with jax.numpy_dtype_promotion("strict"):
        state = jax.eval_shape(trainer.init, first)
        jax.eval_shape(trainer.epoch, state, first)
    assert not any(leaf.weak_type for leaf in jax.tree.leaves(state) if leaf.dtype != KEY)


def assert_wrong_settings_are_refused_by_name(kind: str, name: str) -> None:
    """Values of another type or out of range, for each setting of a component."""
    for item in declared(builtin(kind)[name]):
        low, high = item.metadata["low"], item.metadata["high"]
        outside = [bound for bound in (low - 1, 2 * high + 1) if np.isfinite(bound)]
        wrong = ["much", *(outside if not isinstance(item.default, bool) else [0.5])]
        for bad in wrong:
            with pytest.raises(SettingError, match=f"^{item.name}: "):
                hyperparameters(**{kind: name, item.name: bad})
