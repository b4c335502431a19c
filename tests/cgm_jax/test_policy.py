from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax.normaliser import network_input
from cgm_jax.policy import act, load_policy, policy_arrays
from cgm_jax.settings import Hyperparameters
from cgm_jax.training import Trainer
from tests.cgm_jax.probe import TINY
from tests.examples.point_mass import PointMass


def readme_policy(path: Path, observation: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """The README's own lines, run on a policy file."""
    readme = (Path(__file__).parents[2] / "README.md").read_text()
    code = readme.split("<!-- policy -->\n```python\n")[1].split("```")[0]
    namespace: dict[str, object] = {"path": path}
    exec(code, namespace)
    return namespace["act"](observation, goal)  # pyright: ignore[reportCallIssue]


def test_a_policy_file_acts_as_the_trained_actor_does_in_jax_and_in_ten_lines_of_numpy(
    tmp_path: Path,
) -> None:
    trainer, hyper = Trainer(PointMass(), TINY), Hyperparameters()
    state = jax.jit(trainer.train_cycles)(trainer.initial_state(hyper), hyper, 3)
    path = tmp_path / "policy.npz"
    np.savez(path, **policy_arrays(state.agent.actor, state.normaliser))  # pyright: ignore

    generator = np.random.default_rng(0)
    observation = generator.uniform(-2, 2, (20, 4)).astype(np.float32)
    observation[0] = 1e4  # both limits are at work
    goal = generator.uniform(-1, 1, (20, 2)).astype(np.float32)
    inputs = network_input(state.normaliser, jnp.asarray(observation), jnp.asarray(goal))
    expected = np.asarray(trainer.ddpg.act(state.agent.actor, inputs))
    assert np.abs(expected).max() > 0.01

    arrays = load_policy(path)
    loaded = act(arrays, jnp.asarray(observation), jnp.asarray(goal))
    np.testing.assert_allclose(loaded, expected, atol=1e-6)
    for i in range(20):
        actual = readme_policy(path, observation[i], goal[i])
        np.testing.assert_allclose(actual, expected[i], atol=1e-5)


def test_the_readmes_library_example_trains() -> None:
    readme = (Path(__file__).parents[2] / "README.md").read_text()
    namespace: dict[str, Any] = {}
    exec(readme.split("<!-- library -->\n```python\n")[1].split("```")[0], namespace)
    assert namespace["metrics"]["mask_probability"].shape == (4,)
    assert int(namespace["state"].env_steps) == 10 * 16 * 25


GOOD = {
    "layer_0_kernel": np.zeros((3, 4)),
    "layer_0_bias": np.zeros(4),
    "layer_1_kernel": np.zeros((4, 2)),
    "layer_1_bias": np.zeros(2),
    **{
        f"{kind}_{part}": np.ones(n)
        for kind, n in (("observation", 2), ("goal", 1))
        for part in ("mean", "std")
    },
    "raw_limit": np.array(200.0),
    "normalised_limit": np.array(5.0),
}
BAD = {
    "lacks layer_1_bias": {"layer_1_bias": None},
    "lacks goal_std": {"goal_std": None},
    "layer 1 has shape": {"layer_1_kernel": np.zeros((5, 2))},
    "layer 0 has shape": {"observation_mean": np.ones(7)},
    "goal_mean holds no real numbers": {"goal_mean": np.array(["a"])},
}


@pytest.mark.parametrize("complaint", BAD)
def test_a_malformed_policy_is_refused_with_its_reason(complaint: str, tmp_path: Path) -> None:
    path = tmp_path / "policy.npz"
    np.savez(path, **GOOD)  # pyright: ignore
    assert set(load_policy(path)) == set(GOOD)
    arrays = {
        name: array for name, array in {**GOOD, **BAD[complaint]}.items() if array is not None
    }
    np.savez(path, **arrays)  # pyright: ignore
    with pytest.raises(ValueError, match=complaint):
        load_policy(path)


def test_a_file_with_a_pickle_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "policy.npz"
    np.savez(path, layer_0_kernel=np.array([{"a": 1}], dtype=object))
    with pytest.raises(ValueError, match="not a readable policy file"):
        load_policy(path)
