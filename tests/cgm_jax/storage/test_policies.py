import zipfile
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax.config.components import builtin
from cgm_jax.config.grid import build_groups
from cgm_jax.loop.normaliser import init_normaliser, network_input, with_statistics
from cgm_jax.storage.policies import act, load_policy, policy_arrays
from tests.cgm_jax.agents.oracle import SIZES
from tests.cgm_jax.probe import tiny


def readme_policy(path: Path, observation: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """The README's own lines, run on a policy file."""
    readme = (Path(__file__).parents[3] / "README.md").read_text()
    code = readme.split("<!-- policy -->\n```python\n")[1].split("```")[0]
    (group,) = build_groups("cpu", {"env": ["push"], "seed": [0]})  # what the README trains
    of_readme = f"runs/push/policies/{group.runs[0].name}.npz"
    assert of_readme in code
    namespace: dict[str, object] = {}
    exec(code.replace(of_readme, str(path)), namespace)
    return namespace["act"](observation, goal)  # pyright: ignore[reportCallIssue]


@pytest.mark.parametrize("name", sorted(builtin("agent")))
def test_a_policy_file_acts_as_the_actor_does_in_jax_and_in_ten_lines_of_numpy(
    name: str, tmp_path: Path
) -> None:
    generator = np.random.default_rng(0)

    def learned(leaf: jax.Array) -> jax.Array:
        return leaf + generator.normal(0.0, 0.3, leaf.shape).astype(leaf.dtype)

    agent, sizes = tiny(agent=name).agent, SIZES._replace(observation=4, goal=2, inputs=6)
    state = jax.tree.map(learned, agent.init(jax.random.key(0), sizes))  # targets differ, too
    seen = {
        f"{kind}_mean": generator.normal(size=n) for kind, n in (("observation", 4), ("goal", 2))
    }
    seen |= {name.replace("mean", "std"): 0.5 + mean**2 for name, mean in seen.items()}
    statistics = init_normaliser(4, 2, limit=5.0, distance_threshold=0.1)
    statistics = with_statistics(statistics, seen, rows=100)
    path = tmp_path / "policy.npz"
    np.savez(path, **policy_arrays(agent.actor(state), statistics))  # pyright: ignore

    observation = generator.uniform(-2, 2, (20, 4)).astype(np.float32)
    observation[0] = 1e4  # the limit is at work
    goal = generator.uniform(-1, 1, (20, 2)).astype(np.float32)
    inputs = network_input(statistics, jnp.asarray(observation), jnp.asarray(goal))
    expected = np.asarray(agent.act(state, inputs))
    assert np.abs(expected).max() > 0.01

    arrays = load_policy(path)
    loaded = act(arrays, jnp.asarray(observation), jnp.asarray(goal))
    np.testing.assert_allclose(loaded, expected, atol=1e-6)
    for i in range(20):
        actual = readme_policy(path, observation[i], goal[i])
        np.testing.assert_allclose(actual, expected[i], atol=1e-5)


def test_the_readmes_library_example_trains() -> None:
    readme = (Path(__file__).parents[3] / "README.md").read_text()
    namespace: dict[str, Any] = {}
    code = readme.split("<!-- library -->\n```python\n")[1].split("```")[0]
    cycles = "cycles_per_epoch=10"  # which `make test-wheel` trains
    assert cycles in code
    exec(code.replace(cycles, "cycles_per_epoch=1"), namespace)
    assert namespace["metrics"]["mask_probability"].shape == (8,)
    assert int(namespace["state"].env_steps) == 16 * 50


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
    "normalised_limit": np.array(5.0),
}
BAD = {
    "lacks layer_1_bias": {"layer_1_bias": None},
    "lacks goal_std": {"goal_std": None},
    "layer 1 has shape": {"layer_1_kernel": np.zeros((5, 2))},
    "layer 0 has shape": {"layer_0_kernel": np.zeros((7, 4))},
    "goal_mean holds no real numbers": {"goal_mean": np.array(["a"])},
    "goal_std holds numbers that are not above 0": {"goal_std": np.zeros(1)},
    "goal_std has shape": {"goal_std": np.ones(2)},
    "observation_std has shape": {"observation_mean": np.ones((1, 2))},
    "layer_1_kernel holds numbers that are not finite": {"layer_1_kernel": np.full((4, 2), np.nan)},
    "layer_0_bias holds numbers that are not finite": {"layer_0_bias": np.full(4, 1e300)},
    "goal_mean holds numbers that are not finite": {"goal_mean": np.array([np.inf])},
    "normalised_limit is not one number above 0": {"normalised_limit": np.array(-1.0)},
    "raw_limit is not one number above 0": {"raw_limit": np.ones(2)},
    "mask_weights do not have shape": {"mask_weights": np.ones((2, 4))},
    "a newer format, 'of several numbers'": {"format": np.ones(2)},
    "a newer format, 'two'": {"format": np.array("two")},
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
    with pytest.raises(ValueError, match=f"^{path}: .*{complaint}"):
        load_policy(path)


@pytest.mark.parametrize(
    ("sizes", "complaint"),
    [
        ((3, 1, 2), "made for observations of size 2, not 3"),
        ((2, 3, 2), "made for goals of size 1, not 3"),
        ((2, 1, 4), "made for actions of size 2, not 4"),
    ],
)
def test_a_policy_of_another_environment_is_refused(
    sizes: tuple[int, int, int], complaint: str, tmp_path: Path
) -> None:
    path = tmp_path / "policy.npz"
    np.savez(path, **GOOD)  # pyright: ignore
    assert set(load_policy(path, 2, 1, 2)) == set(GOOD)
    with pytest.raises(ValueError, match=f"^{path}: {complaint}"):
        load_policy(path, *sizes)


def test_a_policy_of_the_first_format_is_read_and_its_raw_values_clipped(tmp_path: Path) -> None:
    path = tmp_path / "policy.npz"
    kernel = np.array([[0.001], [0.0], [0.0]])
    old = {**GOOD, "layer_0_kernel": kernel, "layer_0_bias": np.zeros(1)}
    old = {name: value for name, value in old.items() if not name.startswith("layer_1")}
    np.savez(path, **old, raw_limit=np.array(3.0))  # pyright: ignore
    action = act(load_policy(path), jnp.array([[9.0, 0.0]]), jnp.zeros((1, 1)))
    np.testing.assert_allclose(action, np.tanh([[0.001 * (3.0 - 1.0)]]), rtol=1e-5)


def test_a_policy_of_a_newer_format_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "policy.npz"
    np.savez(path, **GOOD, format=np.array(99))  # pyright: ignore
    with pytest.raises(ValueError, match="newer format, 99"):
        load_policy(path)


def header(shape: tuple[int, ...], kind: str) -> bytes:
    text = repr({"descr": kind, "fortran_order": False, "shape": shape}).encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text


MALFORMED: dict[str, dict[str, bytes]] = {
    "holds pickled objects": {"goal_std.npy": header((), "|O") + b"cos\nsystem\n(S'false'\ntR."},
    "has not the size": {"goal_std.npy": header((10**12,), "<f4")},
    "is no array": {"goal_std": b"import os"},
    "magic string": {"goal_std.npy": b"nonsense"},
    "array format": {"goal_std.npy": b"\x93NUMPY\x09\x00" + bytes(8)},
}


@pytest.mark.parametrize("complaint", MALFORMED)
def test_a_hostile_file_is_refused_and_runs_no_code(complaint: str, tmp_path: Path) -> None:
    path = tmp_path / "policy.npz"
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in MALFORMED[complaint].items():
            archive.writestr(name, data)
    with pytest.raises(ValueError, match=f"not a readable policy file: .*{complaint}"):
        load_policy(path)


def test_a_small_file_that_unpacks_to_gigabytes_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "policy.npz"
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
        archive.open("goal_std.npy", "w", force_zip64=True) as member,
    ):
        member.write(header((2**28 + 1,), "<f4"))
        for _ in range(2**10):
            member.write(bytes(2**20))
        member.write(bytes(4))
    assert path.stat().st_size < 2**24
    with pytest.raises(ValueError, match="holds 1,073,741,828 bytes of arrays, more than"):
        load_policy(path)


@pytest.mark.parametrize("length", [0, 10, 300, -1])
def test_a_truncated_file_is_refused(length: int, tmp_path: Path) -> None:
    path = tmp_path / "policy.npz"
    np.savez(path, **GOOD)  # pyright: ignore
    path.write_bytes(path.read_bytes()[:length])
    with pytest.raises(ValueError, match="not a readable policy file"):
        load_policy(path)


def test_a_flipped_byte_in_a_policy_is_noticed(tmp_path: Path) -> None:
    path = tmp_path / "policy.npz"
    np.savez(path, **GOOD)  # pyright: ignore
    data = bytearray(path.read_bytes())
    data[200] ^= 1  # a weight
    path.write_bytes(data)
    with pytest.raises(ValueError, match=r"not a readable policy file: .*CRC"):
        load_policy(path)
