"""JAX's own means of finding faults, and values that are wrong where a library is called."""

import jax
import numpy as np
import pytest

from cgm_jax.config.fields import SettingError, stack
from cgm_jax.config.settings import Hyperparameters
from cgm_jax.loop.training import make_trainer
from cgm_jax.storage.metrics import plain_row
from tests.cgm_jax.probe import TINY, AlwaysFaultyProbe, OneStepProbe, tiny


def test_a_search_for_nan_does_not_find_what_merely_does_not_exist() -> None:
    trainer, hyper = make_trainer(AlwaysFaultyProbe(goals=(1.0,)), TINY), tiny()
    with jax.debug_nans(True):
        _, metrics = jax.jit(trainer.epoch)(trainer.init(hyper), hyper)
    row = plain_row({name: np.asarray(value) for name, value in metrics.items()})
    assert row["success_rate"] is None  # of no valid episode
    assert row["mask_rate_training"] == [None, None]
    assert row["physics_warnings"] == 2 * TINY.environments + TINY.evaluation_episodes


def test_the_values_of_hyperparameters_are_checked_where_they_are_used() -> None:
    trainer = make_trainer(OneStepProbe(goals=(1.0,)), TINY)
    with pytest.raises(SettingError, match=r"^seed: -1 is not within"):
        trainer.init(Hyperparameters(seed=-1))
    with pytest.raises(SettingError, match=r"^action_noise: nan is not a finite number"):
        stack([Hyperparameters(), Hyperparameters(action_noise=float("nan"))])
