"""Exported models in ONNX's own runtime: `make test-onnx`, which installs it."""

# onnx and onnxruntime are not installed where the type checker runs.
# pyright: reportMissingImports=false

from pathlib import Path

import numpy as np
import pytest

from cgm_jax.config.fields import SettingError
from cgm_jax.export import main
from cgm_jax.pretrained import NAMES, pretrained_policy
from cgm_jax.storage.policies import load_policy
from tests.cgm_jax.storage.test_policies import readme_policy

onnxruntime = pytest.importorskip("onnxruntime")


def action_of(model: Path, observation: np.ndarray, goal: np.ndarray) -> np.ndarray:
    session = onnxruntime.InferenceSession(str(model), providers=["CPUExecutionProvider"])
    (action,) = session.run(["action"], {"observation": observation, "goal": goal})
    return action


def inputs(path: Path, count: int) -> tuple[np.ndarray, np.ndarray]:
    """What the policy sees in its task, and, in the last row, what is clipped."""
    arrays, generator = load_policy(path), np.random.default_rng(0)
    observation, goal = (
        generator.normal(arrays[f"{kind}_mean"], arrays[f"{kind}_std"], (count, size))
        for kind, size in (("observation", arrays["observation_mean"].size), ("goal", 3))
    )
    observation[-1], goal[-1] = 1e4, -1e4
    return observation.astype(np.float32), goal.astype(np.float32)


@pytest.mark.parametrize("name", NAMES)
def test_models_act_as_the_readmes_numpy_does_for_any_batch(name: str, tmp_path: Path) -> None:
    assert main(["--pretrained", name, "--onnx", "--out", str(tmp_path)]) == 0
    path, model = pretrained_policy(name), tmp_path / f"{name}.onnx"
    for count in (1, 50):
        observation, goal = inputs(path, count)
        rows = zip(observation, goal, strict=True)
        expected = np.stack([readme_policy(path, *row) for row in rows])
        np.testing.assert_allclose(action_of(model, observation, goal), expected, atol=1e-5)
    assert np.abs(np.diff(expected, axis=0)).max() > 0.1


def test_a_run_directory_is_exported_and_policies_of_the_first_format_clip_raw_values(
    tmp_path: Path,
) -> None:
    (tmp_path / "policies").mkdir()
    arrays = load_policy(pretrained_policy("reach"))
    old = {**arrays, "raw_limit": np.float32(0.5)}
    for name, content in {"new": arrays, "old": old}.items():
        np.savez(tmp_path / "policies" / f"{name}.npz", **content)
    assert main([str(tmp_path), "--onnx"]) == 0
    observation, goal = inputs(pretrained_policy("reach"), 8)
    new, clipped = (
        action_of(tmp_path / "policies" / f"{name}.onnx", np.clip(observation, *limits), goal)
        for name, limits in (("new", (-0.5, 0.5)), ("old", (-2.0, 2.0)))
    )
    expected = action_of(
        tmp_path / "policies/new.onnx", np.clip(observation, -0.5, 0.5), np.clip(goal, -0.5, 0.5)
    )
    np.testing.assert_allclose(clipped, expected, atol=1e-6)
    assert np.abs(new - expected).max() > 1e-3


def test_what_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "reach.onnx").mkdir()
    with pytest.raises(SettingError, match=r"^out: cannot write .*reach\.onnx: "):
        main(["--pretrained", "reach", "--onnx", "--out", str(tmp_path)])
