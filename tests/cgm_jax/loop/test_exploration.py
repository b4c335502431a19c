import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax.config.grid import hyperparameters
from cgm_jax.loop.exploration import Exploration, draw_exploration, explore

STEPS, EPISODES, SIZE = 50, 2000, 3


def draw(random_action_steps: int = 1) -> dict[str, np.ndarray]:
    noise = draw_exploration(
        jax.random.key(0),
        (STEPS, EPISODES, SIZE),
        hyperparameters(random_action_steps=random_action_steps),
    )
    return {name: np.asarray(getattr(noise, name)) for name in Exploration.__dataclass_fields__}


@pytest.mark.parametrize("random_action_steps", [1, 5])
def test_noise_has_the_distribution_that_the_settings_name(random_action_steps: int) -> None:
    noise = draw(random_action_steps=random_action_steps)
    assert noise["perturbation"].std() == pytest.approx(0.2, abs=0.002)
    assert noise["replaced"].mean() == pytest.approx(0.3, abs=0.01)
    # Uniform in [-1, 1]: quartiles at -0.5, 0 and 0.5, in every dimension.
    quartiles = np.percentile(noise["random_action"], (25, 50, 75), axis=(0, 1))
    np.testing.assert_allclose(quartiles, np.array([[-0.5, 0, 0.5]] * SIZE).T, atol=0.02)


def test_random_actions_are_drawn_anew_at_every_step_unless_they_are_to_last() -> None:
    noise = draw()
    action, replaced = noise["random_action"], noise["replaced"][..., 0]
    assert (action[1:] != action[:-1]).any(axis=-1).all()
    # Neighbours that are both replaced: 0.3 of 0.3.
    assert (replaced[1:] & replaced[:-1]).mean() == pytest.approx(0.09, abs=0.01)


def test_random_actions_last_and_episodes_do_not_keep_step() -> None:
    noise = draw(random_action_steps=5)
    changes = (noise["random_action"][1:] != noise["random_action"][:-1]).any(axis=-1)
    # Every episode changes its random action at one of the first five steps, then every fifth.
    for offset in range(5):
        same = changes[:, changes[offset]]
        due = np.arange(STEPS - 1) % 5 == offset
        np.testing.assert_array_equal(same, np.broadcast_to(due[:, None], same.shape))
        assert changes[offset].mean() == pytest.approx(0.2, abs=0.05)
    flips = noise["replaced"][1:] != noise["replaced"][:-1]
    assert not (flips[..., 0] & ~changes).any()  # whether it replaces lasts as long
    gaussian = noise["perturbation"]
    assert (gaussian[1:] != gaussian[:-1]).all()


def test_a_random_action_replaces_and_gaussian_noise_is_clipped() -> None:
    noise = Exploration(
        perturbation=jnp.array([[0.5], [0.5], [-3.0]]),
        random_action=jnp.array([[-0.7]] * 3),
        replaced=jnp.array([[True], [False], [False]]),
    )
    action = explore(noise, jnp.array([[0.1], [0.8], [0.0]]))
    np.testing.assert_allclose(action, [[-0.7], [1.0], [-1.0]])
