"""Gymnasium's own wrappers around the environments, each against the bare environment."""

# Gymnasium leaves its spaces and environments untyped.
# pyright: reportAttributeAccessIssue=false, reportOptionalMemberAccess=false
# pyright: reportOperatorIssue=false, reportArgumentType=false, reportCallIssue=false

import sys
import types
from pathlib import Path
from typing import Any, ClassVar

import gymnasium
import numpy as np
import pytest
from gymnasium import wrappers
from gymnasium.wrappers import vector as vector_wrappers

from tests.envs.gymnasium.helpers import assert_same_observations, make, make_vec
from tests.envs.surface import can_render

needs_rendering = pytest.mark.skipif(
    not can_render(), reason="this machine has no off-screen rendering"
)
ACTIONS = np.random.default_rng(4).uniform(-1, 1, (6, 4)).astype(np.float32)
BATCHES = np.random.default_rng(5).uniform(-1, 1, (6, 2, 4)).astype(np.float32)


def play(env: Any, actions: Any = ACTIONS) -> list[Any]:
    """Observations of an episode."""
    return [env.reset(seed=1)[0], *(env.step(action)[0] for action in actions)]


def bare() -> list[dict[str, np.ndarray]]:
    return play(make("FetchPush"))


def test_actions_are_rescaled_clipped_and_transformed() -> None:
    expected = bare()
    rescaled = wrappers.RescaleAction(make("FetchPush"), np.float32(-2), np.float32(2))
    assert_same_observations(play(rescaled, 2 * ACTIONS), expected)
    mirrored = wrappers.TransformAction(make("FetchPush"), lambda action: -action, None)
    assert_same_observations(play(mirrored, -ACTIONS), expected)
    clipped = wrappers.ClipAction(make("FetchPush"))
    assert clipped.action_space.high.min() == np.inf
    at_the_bounds = play(make("FetchPush"), np.sign(ACTIONS))
    assert_same_observations(play(clipped, 5 * np.sign(ACTIONS)), at_the_bounds)
    discrete = wrappers.DiscretizeAction(make("FetchPush"), bins=3)
    corner = play(make("FetchPush"), [discrete.action(0)] * 2)
    assert_same_observations(play(discrete, [0, 0]), corner)


def test_actions_are_repeated() -> None:
    expected = play(make("FetchPush"), np.repeat(ACTIONS, 2, axis=0))
    repeated = wrappers.RepeatAction(make("FetchPush"), num_repeats=2)
    assert_same_observations(play(repeated), expected[::2])
    sticky = wrappers.StickyAction(make("FetchPush"), repeat_action_probability=0.0)
    assert_same_observations(play(sticky), bare())


def test_observations_are_filtered_flattened_and_converted() -> None:
    env, expected = make("FetchPush"), bare()
    filtered = wrappers.FilterObservation(make("FetchPush"), ["observation", "desired_goal"])
    for one, other in zip(play(filtered), expected, strict=True):
        assert set(one) == {"observation", "desired_goal"}
        np.testing.assert_array_equal(one["observation"], other["observation"])
    flat = wrappers.FlattenObservation(make("FetchPush"))
    assert flat.observation_space.shape == (31,)
    order = list(env.observation_space)
    for one, other in zip(play(flat), expected, strict=True):
        np.testing.assert_array_equal(one, np.concatenate([other[name] for name in order]))
    with pytest.warns(UserWarning, match="precision lowered"):
        single = wrappers.DtypeObservation(flat, np.float32)
    for one, other in zip(play(single), play(flat), strict=True):
        np.testing.assert_array_equal(one, other.astype(np.float32))
    small = wrappers.RescaleObservation(flat, np.float64(-1), np.float64(1))
    for one, other in zip(play(small), play(flat), strict=True):
        np.testing.assert_allclose(one, other / 1000, atol=1e-12)


def test_observations_are_delayed_stacked_timed_and_normalised() -> None:
    expected = bare()
    delayed = wrappers.DelayObservation(make("FetchPush"), delay=2)
    assert_same_observations(play(delayed)[2:], expected[:-2])
    stacked = play(wrappers.FrameStackObservation(make("FetchPush"), stack_size=2))
    for i in range(1, len(expected)):
        pair = np.stack([expected[i - 1]["observation"], expected[i]["observation"]])
        np.testing.assert_array_equal(stacked[i]["observation"], pair)
    timed = wrappers.TimeAwareObservation(make("FetchPush"), flatten=False, normalize_time=False)
    assert [int(one["time"].item()) for one in play(timed)] == list(range(7))
    flat = wrappers.FlattenObservation(make("FetchPush"))
    normalised = wrappers.NormalizeObservation(flat)
    seen = np.array(play(wrappers.FlattenObservation(make("FetchPush"))))
    play(normalised)
    np.testing.assert_allclose(normalised.obs_rms.mean, seen.mean(axis=0), atol=1e-4)


def test_rewards_are_recorded_and_changed() -> None:
    recorded = wrappers.RecordEpisodeStatistics(make("FetchReach"))
    recorded.reset(seed=0)
    results = [recorded.step(np.zeros(4, np.float32)) for _ in range(50)]
    assert "episode" not in results[-2][4]
    assert results[-1][4]["episode"]["l"] == 50
    assert results[-1][4]["episode"]["r"] == sum(result[1] for result in results) == -50.0
    shifted = wrappers.TransformReward(make("FetchReach"), lambda reward: reward + 1)
    shifted.reset(seed=0)
    assert shifted.step(np.zeros(4, np.float32))[1] == 0.0
    clipped = wrappers.ClipReward(make("FetchReach"), min_reward=-0.25)
    clipped.reset(seed=0)
    assert clipped.step(np.zeros(4, np.float32))[1] == -0.25


def test_episodes_follow_each_other_by_themselves() -> None:
    env = wrappers.Autoreset(make("FetchReach", max_episode_steps=2))
    first, _ = env.reset(seed=0)
    ends, goals = [], []
    for _ in range(4):
        observation, _, _, truncated, _ = env.step(np.zeros(4, np.float32))
        ends.append(truncated)
        goals.append(observation["desired_goal"])
    assert ends == [False, True, False, False]
    np.testing.assert_array_equal(goals[1], first["desired_goal"])
    assert np.abs(goals[2] - first["desired_goal"]).max() > 1e-3


def test_wrappers_reach_through_to_the_goals_functions() -> None:
    env = wrappers.FilterObservation(make("FetchPush"), ["observation"])
    reward = env.get_wrapper_attr("compute_reward")(np.zeros(3), np.zeros(3), {})
    assert reward == 0.0


@needs_rendering
def test_frames_are_collected_and_observed() -> None:
    size = {"width": 64, "height": 48}
    env = make("FetchPush", render_mode="rgb_array", **size)
    env.reset(seed=1)
    first = env.render()
    env.step(ACTIONS[0])
    second = env.render()
    collected = make("FetchPush", render_mode="rgb_array_list", **size)
    collected.reset(seed=1)
    collected.step(ACTIONS[0])
    np.testing.assert_array_equal(collected.render(), [first, second])
    observed = wrappers.AddRenderObservation(make("FetchPush", render_mode="rgb_array", **size))
    assert observed.observation_space.shape == (48, 64, 3)
    np.testing.assert_array_equal(play(observed)[1], second)
    for one in (env, collected, observed):
        one.close()


class Recorder:
    """Takes the part of moviepy's clip, whose codecs are not what is tested here."""

    clips: ClassVar[list["Recorder"]] = []

    def __init__(self, frames: list[np.ndarray], fps: int) -> None:
        self.frames, self.fps = frames, fps

    def write_videofile(self, path: str, **_: Any) -> None:
        self.path = Path(path)
        Recorder.clips.append(self)


@pytest.fixture
def clips(monkeypatch: pytest.MonkeyPatch) -> list[Recorder]:
    """What RecordVideo has written, without moviepy, which wants an older Pillow than this."""
    clip = types.ModuleType("moviepy.video.io.ImageSequenceClip")
    vars(clip)["ImageSequenceClip"] = Recorder
    for name in ("moviepy", "moviepy.video", "moviepy.video.io"):
        monkeypatch.setitem(sys.modules, name, types.ModuleType(name))
    monkeypatch.setitem(sys.modules, clip.__name__, clip)
    Recorder.clips.clear()
    return Recorder.clips


@needs_rendering
def test_videos_are_recorded_in_real_time(tmp_path: Path, clips: list[Recorder]) -> None:
    arguments: dict[str, Any] = {"render_mode": "rgb_array", "width": 64, "height": 48}
    inner = make("FetchPush", max_episode_steps=3, **arguments)
    env = wrappers.RecordVideo(
        inner, str(tmp_path / "videos"), episode_trigger=lambda episode: True
    )
    frames = []
    for seed in (0, 1):
        env.reset(seed=seed)
        frames.append([inner.render()])
        for action in ACTIONS[:3]:
            env.step(action)
            frames[-1].append(inner.render())
    env.close()
    assert [clip.path.name for clip in clips] == [f"rl-video-episode-{i}.mp4" for i in (0, 1)]
    assert [clip.fps for clip in clips] == [25, 25]
    np.testing.assert_array_equal([clip.frames for clip in clips], frames)


@needs_rendering
def test_a_video_of_a_batch_tiles_its_rows(tmp_path: Path, clips: list[Recorder]) -> None:
    vector = make_vec("FetchPush", 2, render_mode="rgb_array", width=64, height=48)
    env = vector_wrappers.RecordVideo(vector, str(tmp_path / "videos"), video_length=2)
    env.reset(seed=0)
    rows = vector.render()
    for actions in BATCHES[:3]:
        env.step(actions)
    env.close()
    assert len(clips) == 1
    assert clips[0].fps == 25
    first = np.asarray(clips[0].frames[0])
    for row in rows:
        assert any(
            np.array_equal(first[y : y + 48, x : x + 64], row)
            for y in range(0, first.shape[0], 48)
            for x in range(0, first.shape[1], 64)
        )


def batch(**arguments: Any) -> Any:
    return make_vec("FetchPush", 2, **arguments)


def test_a_batchs_actions_are_rescaled_and_clipped() -> None:
    expected = play(batch(), BATCHES)
    rescaled = vector_wrappers.RescaleAction(batch(), np.float32(-2), np.float32(2))
    assert_same_observations(play(rescaled, 2 * BATCHES), expected)
    mirrored = vector_wrappers.TransformAction(batch(), lambda actions: -actions)
    assert_same_observations(play(mirrored, -BATCHES), expected)
    clipped = vector_wrappers.ClipAction(batch())
    at_the_bounds = play(batch(), np.sign(BATCHES))
    assert_same_observations(play(clipped, 5 * np.sign(BATCHES)), at_the_bounds)


def test_a_batchs_observations_are_filtered_flattened_and_normalised() -> None:
    expected = play(batch(), BATCHES)
    filtered = vector_wrappers.FilterObservation(batch(), ["observation"])
    for one, other in zip(play(filtered, BATCHES), expected, strict=True):
        assert list(one) == ["observation"]
        np.testing.assert_array_equal(one["observation"], other["observation"])
    order = list(batch().single_observation_space)
    flat = [np.concatenate([one[name] for name in order], axis=1) for one in expected]
    flattened = vector_wrappers.FlattenObservation(batch())
    np.testing.assert_array_equal(play(flattened, BATCHES), flat)
    normalised = vector_wrappers.NormalizeObservation(flattened)
    play(normalised, BATCHES)
    mean = np.mean(flat, axis=(0, 1))
    np.testing.assert_allclose(normalised.obs_rms.mean, mean, atol=1e-4)


def test_a_batchs_episodes_are_recorded_also_where_a_mask_resets_them() -> None:
    env = vector_wrappers.RecordEpisodeStatistics(batch(max_episode_steps=3))
    env.reset(seed=0)
    zeros, lengths = np.zeros((2, 4), np.float32), []
    env.step(zeros)
    env.reset(options={"reset_mask": np.array([True, False])})
    for _ in range(7):
        *_, infos = env.step(zeros)
        if "episode" in infos:
            assert infos["episode"]["r"].tolist() == (-infos["episode"]["l"]).tolist()
            lengths.append(infos["episode"]["l"].tolist())
        else:
            lengths.append([0, 0])
    # The second row's episode is a step older; the step that resets is none of an episode.
    assert lengths == [[0, 0], [0, 3], [3, 0], [0, 0], [0, 0], [0, 3], [3, 0]]


def test_a_batchs_rewards_and_information_change_their_form() -> None:
    shifted = vector_wrappers.TransformReward(batch(), lambda rewards: rewards + 1)
    shifted.reset(seed=0)
    assert shifted.step(np.zeros((2, 4)))[1].tolist() == [0.0, 0.0]
    listed = vector_wrappers.DictInfoToList(batch())
    listed.reset(seed=0)
    *_, infos = listed.step(np.zeros((2, 4)))
    assert [one["is_success"] for one in infos] == [False, False]
    assert [one["physics_warnings"] for one in infos] == [0, 0]


def test_wrappers_are_given_to_make_vec_where_environments_are_single() -> None:
    flat = make_vec(
        "FetchPush", 2, vectorization_mode="sync", wrappers=(wrappers.FlattenObservation,)
    )
    assert flat.reset(seed=0)[0].shape == (2, 31)
    with pytest.raises(gymnasium.error.Error, match="wrappers"):
        make_vec("FetchPush", 2, wrappers=(wrappers.FlattenObservation,))
