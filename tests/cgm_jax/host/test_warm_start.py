"""What a run takes over from another one, and what it does not."""

# Brax types the parts of its statistics as unknown.
# pyright: reportAttributeAccessIssue=false, reportArgumentType=false, reportCallIssue=false

import dataclasses
import errno
import functools
import hashlib
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cgm_jax.config.components import builtin
from cgm_jax.config.fields import SettingError, stack
from cgm_jax.config.grid import build_groups
from cgm_jax.host.checkpoint import TrainingProgress, save_checkpoint
from cgm_jax.host.warm_start import check_start, read_source, start_from
from cgm_jax.loop.normaliser import observe
from cgm_jax.loop.training import Programs, make_programs, make_trainer
from cgm_jax.replay.ring import Episodes
from cgm_jax.storage.arrays import write_arrays
from cgm_jax.storage.checkpoints import write_manifest
from cgm_jax.storage.files import ReadError
from cgm_jax.storage.policies import policy_arrays
from cgm_jax.storage.run_directory import RunDirectory
from tests.cgm_jax.archives import spoil
from tests.cgm_jax.probe import TINY, tiny
from tests.cgm_jax.refusing import refusing
from tests.examples.point_mass import PointMass

AGENTS = sorted(builtin("agent"))
TAKEN = ("agent", "normaliser.observation", "normaliser.goal")


def programs_of(**settings: Any) -> Programs:
    return make_programs(make_trainer(PointMass(), dataclasses.replace(TINY, **settings)))


PROGRAMS = programs_of()


def leaves(tree: Any) -> dict[str, np.ndarray]:
    named, _ = jax.tree_util.tree_flatten_with_path(tree)
    keys = [jax.random.key_data(x) if x.dtype.name.startswith("key") else x for _, x in named]
    names = [jax.tree_util.keystr(path).lstrip(".") for path, _ in named]
    return dict(zip(names, map(np.asarray, keys), strict=True))


def changed(state: Any) -> Any:
    """A state in which every number is another one, in every run, as if after training."""

    def change(leaf: Any) -> Any:
        runs = np.arange(1, len(leaf) + 1).reshape(-1, *(1,) * (leaf.ndim - 1))
        return leaf if leaf.dtype == bool else jnp.asarray(leaf + runs, leaf.dtype)

    return jax.tree.map(
        lambda leaf: leaf if leaf.dtype.name.startswith("key") else change(leaf), state
    )


@pytest.fixture
def directory(tmp_path: Path) -> tuple[Path, Any]:
    """A run directory of two runs, and the state of its last checkpoint."""
    with RunDirectory.claimed(tmp_path / "source", fresh=True) as found:
        groups = build_groups("smoke", {"kappa": [4.0, 32.0]})
        found.config.write(groups, "smoke", "cpu")
    hyper = stack([tiny(seed=0), tiny(seed=1)])
    state = changed(PROGRAMS.start(hyper))
    save_checkpoint(found.path / "checkpoints", 0, TrainingProgress(state, epoch=3))
    return found.path, state


SECOND = "reach_ddpg-her_cgm-cg0.1-kappa32_seed0"


def test_a_run_directory_gives_the_whole_agent_and_statistics_and_nothing_else(
    directory: tuple[Path, Any],
) -> None:
    path, state = directory
    hyper = stack([tiny(seed=seed) for seed in (5, 6)])
    fresh = PROGRAMS.start(hyper)
    source = read_source(path, SECOND)
    check_start(source, PROGRAMS, hyper)
    started = leaves(start_from(source, PROGRAMS, hyper, fresh))
    fresh, there = leaves(fresh), leaves(state)
    assert set(started) == set(fresh)
    count = 0
    for name, leaf in started.items():
        assert leaf.dtype == fresh[name].dtype
        if name.startswith(TAKEN):
            count += 1
            assert leaf.tobytes() == np.stack([there[name][1]] * 2).tobytes(), name
            assert leaf.tobytes() != fresh[name].tobytes(), name
        else:
            assert leaf.tobytes() == fresh[name].tobytes(), name
    assert count > 30  # actor, critic, their targets, two optimisers, statistics
    assert "normaliser.limit" in started
    assert "replay.inserted" in started


def test_which_run_is_meant_must_be_clear(directory: tuple[Path, Any], tmp_path: Path) -> None:
    path, _ = directory
    with pytest.raises(SettingError, match=r"^from: .* has 2 runs; choose --from-run of reach_"):
        read_source(path)
    with pytest.raises(SettingError, match=r"^from_run: .* has no run 'x'$"):
        read_source(path, "x")
    with pytest.raises(SettingError, match=r"^from_run: .* is no run directory$"):
        read_source(tmp_path / "policy.npz", "x")
    with pytest.raises(SettingError, match=r"^from: .*nowhere"):
        read_source(tmp_path / "nowhere.npz")
    with pytest.raises(SettingError, match=r"holds no sweep: config.json is missing$"):
        read_source(tmp_path)
    for checkpoint in (path / "checkpoints").glob("*.npz"):
        checkpoint.write_bytes(checkpoint.read_bytes()[:-1])
    with pytest.raises(SettingError, match=rf"no whole checkpoint .*policies/{SECOND}.npz$"):
        read_source(path, SECOND)


def policy_of(name: str) -> dict[str, np.ndarray]:
    """The policy file of a run whose networks and statistics are not the initial ones."""
    one = tiny(agent=name, seed=3)
    state = changed(PROGRAMS.start(stack([one, one])))
    agent, normaliser = jax.tree.map(lambda leaf: leaf[0], (state.agent, state.normaliser))
    return policy_arrays(one.agent.actor(agent), normaliser)


@pytest.mark.parametrize("name", AGENTS)
def test_a_policy_file_gives_the_actor_and_statistics_and_leaves_the_rest_fresh(name: str) -> None:
    policy = policy_of(name)
    runs = [tiny(agent=name, seed=seed) for seed in (5, 6)]
    hyper = stack(runs)
    fresh = PROGRAMS.start(hyper)
    check_start(policy, PROGRAMS, hyper)
    started = start_from(policy, PROGRAMS, hyper, fresh)
    for i, run in enumerate(runs):
        agent, normaliser = jax.tree.map(
            lambda leaf, i=i: leaf[i], (started.agent, started.normaliser)
        )
        again = policy_arrays(run.agent.actor(agent), normaliser)
        for key in (key for key in policy if key != "normalised_limit"):  # a setting
            np.testing.assert_array_equal(again[key], policy[key], err_msg=key)
    rest, before = leaves(started), leaves(fresh)
    same = {key for key in rest if rest[key].tobytes() == before[key].tobytes()}
    assert {key for key in rest if "critic" in key or "optimiser" in key} <= same
    assert {key for key in rest if not key.startswith(TAKEN)} <= same
    if name != "sac":
        target = rest["agent.target_actor['params']['layer_0']['kernel']"]
        np.testing.assert_array_equal(target, rest["agent.actor['params']['layer_0']['kernel']"])


def test_a_policys_statistics_count_like_one_epoch_of_the_new_run() -> None:
    policy, hyper = policy_of("ddpg"), stack([tiny(seed=5), tiny(seed=6)])
    started = start_from(policy, PROGRAMS, hyper, PROGRAMS.start(hyper))
    normaliser = jax.tree.map(lambda leaf: leaf[0], started.normaliser)
    rows = np.random.default_rng(0).normal(3.0, 2.0, (7, 11, 4)).astype(np.float32)
    goals = jnp.zeros((7, 11, 2))
    episodes = Episodes(
        jnp.asarray(rows), goals, jnp.zeros((7, 10, 2)), goals[:, 0], goals[:, 0], jnp.ones(7)
    )
    valid = jnp.ones(7, bool)
    update = jax.jit(functools.partial(observe, floor=0.0, distance_threshold=0.05))
    after = update(normaliser, episodes, valid, episodes.desired_goal)
    seen = TINY.cycles_per_epoch * TINY.environments * PointMass().episode_length
    flat = rows.reshape(-1, 4)
    total = seen + len(flat)
    mean = (seen * policy["observation_mean"] + flat.sum(axis=0)) / total
    squares = seen * (policy["observation_std"] ** 2 + (policy["observation_mean"] - mean) ** 2)
    squares += ((flat - mean) ** 2).sum(axis=0)
    np.testing.assert_allclose(after.observation.mean, mean, rtol=1e-4)
    np.testing.assert_allclose(after.observation.std, np.sqrt(squares / total), rtol=1e-3)


@pytest.mark.parametrize(
    ("source", "changes", "settings", "message"),
    [
        ("policy", {"hidden_layers": (8, 8)}, {}, "its layers.* in the source and 6x8x8x2 here"),
        ("directory", {"hidden_layers": (8, 8)}, {}, r"agent.actor.layer_0.bias is float32\[.*\] "),
        ("directory", {"agent": "sac"}, {}, "the agents differ: agent.* is only "),
        ("directory", {"critics": 2}, {}, "the agents differ: agent.critic"),
    ],
)
def test_what_does_not_fit_is_named(
    source: str,
    changes: dict[str, Any],
    settings: dict[str, Any],
    message: str,
    directory: tuple[Path, Any],
) -> None:
    arrays = policy_of("ddpg") if source == "policy" else read_source(directory[0], SECOND)
    with pytest.raises(SettingError, match=f"^from: {message}"):
        check_start(arrays, programs_of(**settings), stack([tiny(**changes)]))


def test_a_policy_for_other_observations_is_named() -> None:
    policy = policy_of("ddpg") | {"observation_mean": np.zeros(3, np.float32)}
    with pytest.raises(SettingError, match=r"^from: it was made for observations of size 3, not 4"):
        check_start(policy, PROGRAMS, stack([tiny()]))


def test_masks_that_a_policy_sees_are_taken_over() -> None:
    programs, hyper = programs_of(mask_input=True), stack([tiny(seed=5)])
    policy = policy_of("ddpg")
    width = policy["layer_0_bias"].size
    policy["mask_weights"] = np.full((2, width), 0.5, np.float32)
    fresh = programs.start(hyper)
    kernel = start_from(policy, programs, hyper, fresh).agent.actor["params"]["layer_0"]["kernel"]
    np.testing.assert_array_equal(kernel[0, :6], policy["layer_0_kernel"])
    np.testing.assert_array_equal(kernel[0, 6:], policy["mask_weights"])


def test_a_checkpoint_that_cannot_be_read_just_now_is_not_passed_over(
    directory: tuple[Path, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    path, _ = directory

    stale = refusing(errno.ESTALE)

    monkeypatch.setattr(hashlib, "file_digest", stale)
    (checkpoint,) = (path / "checkpoints").glob("*.npz")
    with pytest.raises(ReadError) as caught:
        read_source(path, SECOND)
    assert caught.value.filename == str(checkpoint)


def test_a_checkpoint_with_damaged_bytes_under_the_right_checksum_is_refused(
    directory: tuple[Path, Any],
) -> None:
    path, _ = directory
    (checkpoint,) = (path / "checkpoints").glob("*.npz")
    with checkpoint.open("wb") as file:
        write_arrays(file, [(".agent.actor", np.ones((2, 5000)))])
    data = checkpoint.read_bytes()
    write_manifest(checkpoint, hashlib.sha256(data).hexdigest(), len(data), b"{}")
    assert read_source(path, SECOND)[".agent.actor"].shape == (5000,)
    spoil(checkpoint)
    with pytest.raises(SettingError, match=rf"^from: {checkpoint} cannot be read: .*Bad CRC-32"):
        read_source(path, SECOND)


def test_what_a_policy_file_leaves_out_begins_without_weight() -> None:
    """Networks that see more than the file's, such as stages, act for the full goal as it does."""
    programs, hyper = programs_of(mask_input=True), stack([tiny(seed=5)])
    policy = policy_of("ddpg")
    check_start(policy, programs, hyper)
    started = start_from(policy, programs, hyper, programs.start(hyper))
    kernel = started.agent.actor["params"]["layer_0"]["kernel"]
    np.testing.assert_array_equal(kernel[0, :6], policy["layer_0_kernel"])
    np.testing.assert_array_equal(kernel[0, 6:], np.zeros_like(kernel[0, 6:]))
