"""Evaluation of policies whose behaviour is known, and videos of it."""

# pyright: reportAttributeAccessIssue=false

import dataclasses
import json
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import mujoco
import numpy as np
import pytest
from PIL import Image
from scipy.stats import binomtest

from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import Group, run_of
from cgm_jax.config.settings import Settings
from cgm_jax.envs.fetch import FetchEnvironment
from cgm_jax.evaluate import _report, main
from cgm_jax.loop.environment import make_environment
from cgm_jax.pretrained import NAMES, RECORD, pretrained_policy
from cgm_jax.results import policies
from cgm_jax.results.chosen import chosen_policies
from cgm_jax.results.plan import Plan
from cgm_jax.results.policies import Outcome, Recording, evaluate_policies, evaluate_random
from cgm_jax.results.video import write_video
from cgm_jax.storage.run_directory import RunDirectory
from tests.cgm_jax import own_environments
from tests.envs.surface import can_render

EXAMPLES = Path(__file__).parents[1] / "examples"
REACH = Settings(env="reach", engine="native")


def reaching_policy(gain: float) -> dict[str, np.ndarray]:
    """One layer that moves the grip by tanh(gain * (goal - grip))."""
    kernel = np.zeros((13, 4))
    kernel[:3, :3], kernel[10:, :3] = -gain * np.eye(3), gain * np.eye(3)
    arrays = {"layer_0_kernel": kernel, "layer_0_bias": np.zeros(4)}
    for name, size in (("observation", 10), ("goal", 3)):
        arrays |= {f"{name}_mean": np.zeros(size), f"{name}_std": np.ones(size)}
    arrays |= {"normalised_limit": np.array(5.0)}
    return {name: array.astype(np.float32) for name, array in arrays.items()}


@pytest.fixture(scope="module")
def directory(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunDirectory]:
    """Two runs on reach: one policy stands still, the other goes straight to the goal."""
    values = dataclasses.asdict(REACH)
    runs = tuple(run_of(name, values)[1] for name in ("still", "straight"))
    with RunDirectory.claimed(tmp_path_factory.mktemp("known") / "out", fresh=True) as directory:
        directory.config.write([Group(REACH, runs)], "smoke", "cpu")
        for run, gain in zip(runs, (0.0, 15.0), strict=True):
            directory.write_policy(run, reaching_policy(gain))
        yield directory


def evaluate(
    directory: RunDirectory, plan: Plan, run: str | None = None, progress: Any = lambda *_: None
) -> dict[str, Outcome]:
    return evaluate_policies(chosen_policies(directory.path, None, run, {}), plan, progress)


def grips(recording: Recording) -> np.ndarray:
    """Positions [T + 1, K, 3] of the grip, by MuJoCo itself from the recorded states."""
    env = make_environment(REACH)
    assert isinstance(env, FetchEnvironment)
    data = mujoco.MjData(env.scene.model)
    positions = env.physics.positions(recording.states)
    grips = []
    for row in positions.reshape(-1, positions.shape[-1]):
        data.qpos[:] = row
        mujoco.mj_kinematics(env.scene.model, data)
        grips.append(data.site("grip").xpos.copy())
    return np.reshape(grips, (*positions.shape[:-1], 3))


def test_success_is_that_of_the_policies_and_recordings_show_their_states(
    directory: RunDirectory,
) -> None:
    outcomes = evaluate(directory, Plan(episodes=40, seed=3, recorded=25))
    assert list(outcomes) == ["still", "straight"]
    straight, still = outcomes["straight"], outcomes["still"]
    assert (straight.valid, straight.successes) == (40, 40)
    assert still.successes < 15
    assert straight.recording is not None
    goals = np.asarray(straight.recording.desired_goal)
    distance = np.linalg.norm(grips(straight.recording) - goals, axis=-1)
    assert distance.shape == (51, 25)
    np.testing.assert_array_equal(straight.recording.achieved, distance.T < 0.05)


def test_success_under_a_mask_is_that_of_the_kept_axes(directory: RunDirectory) -> None:
    plan = Plan(episodes=60, seed=3, mask="xz", recorded=60)
    still = evaluate(directory, plan, "still")["still"]
    assert still.recording is not None
    offset = grips(still.recording)[-1] - np.asarray(still.recording.desired_goal)
    achieved = np.abs(offset[:, 1]) < 0.05
    assert still.successes == achieved.sum()
    assert 5 < achieved.sum() < 40
    np.testing.assert_array_equal(still.recording.achieved[:, -1], achieved)
    everything = evaluate(directory, Plan(episodes=9, seed=3, mask="yxz"), "still")
    assert everything["still"].successes == 9
    numbered = evaluate(directory, Plan(episodes=60, seed=3, mask="2,0"), "still")
    assert numbered["still"].successes == still.successes


def test_any_dimension_of_a_goal_is_masked_by_its_number() -> None:
    far = Settings(env=f"{own_environments.__file__}:FarInTheFourth")
    successes = {
        mask: evaluate_random(far, Plan(episodes=5, seed=0, mask=mask)).successes
        for mask in ("", "3", "0,1,2,4", "x,3")
    }
    assert successes == {"": 0, "3": 5, "0,1,2,4": 0, "x,3": 5}


def test_random_actions_are_uniform_and_follow_the_seed() -> None:
    first = evaluate_random(REACH, Plan(episodes=30, seed=0, recorded=30)).recording
    again = evaluate_random(REACH, Plan(episodes=30, seed=0, recorded=30)).recording
    other = evaluate_random(REACH, Plan(episodes=30, seed=1, recorded=30)).recording
    assert first is not None
    assert again is not None
    assert other is not None
    np.testing.assert_array_equal(first.states.sensors, again.states.sensors)
    assert np.abs(first.desired_goal - other.desired_goal).max() > 0.01
    steps = np.diff(grips(first), axis=0)[:, :, :2]
    # A full action moves the grip by about 3.2 cm; uniform ones have 1 / sqrt(3) of that.
    assert np.std(steps) == pytest.approx(0.032 / np.sqrt(3), rel=0.15)
    assert np.abs(steps.mean()) < 0.002


def test_chunks_do_not_change_what_is_found(
    directory: RunDirectory, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = Plan(episodes=50, seed=3, recorded=45)
    whole = evaluate(directory, plan)
    told: list[tuple[int, int]] = []
    monkeypatch.setattr(policies, "CHUNK_EPISODES", 20)
    monkeypatch.setattr(policies, "CHUNK_ROWS", 20)  # one policy after the other
    cut = evaluate(directory, plan, progress=lambda *counts: told.append(counts))
    assert told == [(done, 100) for done in (20, 40, 50, 70, 90, 100)]
    assert list(whole) == list(cut)
    for name, outcome in whole.items():
        assert (outcome.valid, outcome.successes) == (cut[name].valid, cut[name].successes)
        recording, again = outcome.recording, cut[name].recording
        assert recording is not None
        assert again is not None
        np.testing.assert_array_equal(recording.desired_goal, again.desired_goal)
        np.testing.assert_array_equal(recording.achieved, again.achieved)
        assert recording.states.sensors.shape == again.states.sensors.shape


@pytest.mark.parametrize(("field", "value"), [("episodes", 0), ("seed", -1), ("mask", "xx")])
def test_plans_are_checked_where_they_are_made(field: str, value: object) -> None:
    with pytest.raises(SettingError, match=f"^{field}: "):
        Plan(**{"episodes": 1, "seed": 0, field: value})  # pyright: ignore[reportArgumentType]


def test_ctrl_c_ends_an_evaluation_that_shows_how_far_it_is() -> None:
    command = [sys.executable, "-m", "cgm_jax.evaluate", "--random", "--env", "reach"]
    with subprocess.Popen(
        [*command, "--episodes", "1000000"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=Path(__file__).parents[2],
    ) as process:
        assert process.stderr is not None
        line = process.stderr.readline()
        assert re.fullmatch(r"[\d,]+ of 1,000,000 episodes\n", line)
        process.send_signal(signal.SIGINT)
        out, error = process.communicate(timeout=60)
    assert (process.returncode, out) == (75, "")
    assert error.splitlines()[-1] == "stopped"


def test_dropped_episodes_and_masks_are_said() -> None:
    env = make_environment(REACH)
    outcomes = {
        "some": Outcome(env, episodes=10, valid=8, successes=4, recording=None),
        "none": Outcome(env, episodes=10, valid=0, successes=0, recording=None),
        "all": Outcome(env, episodes=10, valid=10, successes=10, recording=None),
    }
    assert "10 episodes, goals with 0 and 14 masked)" in _report(outcomes, "0,14")[2]
    assert _report(outcomes, "xz") == [
        "some   50.0 %  (95 %: 21.5 to 78.5, 8 episodes, goals with x and z masked, "
        "2 dropped for physics_warnings)",
        "none  no valid episode, 10 dropped for physics_warnings",
        "all   100.0 %  (95 %: 72.2 to 100.0, 10 episodes, goals with x and z masked)",
    ]
    assert _report({"all": outcomes["all"]}, "") == [
        "all  100.0 %  (95 %: 72.2 to 100.0, 10 episodes)"
    ]


@pytest.mark.skipif(not can_render(), reason="this machine has no off-screen rendering")
def test_the_program_records_the_best_run(
    directory: RunDirectory, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "out.gif"
    options = ["--episodes", "8", "--video", str(path), "--video-episodes", "1"]
    assert main([str(directory.path), *options, "--video-width", "64", "--mask", "y"]) == 0
    line = capsys.readouterr().out.splitlines()[-1]
    assert line == f"{path}: 1 episode of straight, the best of 2; the goal is achieved in 1"
    with Image.open(path) as video:
        assert video.size == (64, 48)
        durations = []
        for frame in range(video.n_frames):  # pyright: ignore[reportAttributeAccessIssue]
            video.seek(frame)
            durations.append(video.info["duration"])
    # 51 states, of which the last stands for 12 frames.
    assert sum(durations) == (51 + 11) * 40


COLOURS = np.array([[200, 30, 30], [30, 160, 30], [30, 30, 200]], np.uint8)


@pytest.mark.parametrize("suffix", ["gif", "mp4"])
def test_videos_hold_the_frames_in_real_time(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"video.{suffix}"
    frames = [np.broadcast_to(colour, (48, 64, 3)) for colour in COLOURS for _ in range(25)]
    write_video(path, iter(frames))
    if suffix == "gif":
        with Image.open(path) as video:
            shown = []
            for frame in range(video.n_frames):  # pyright: ignore[reportAttributeAccessIssue]
                video.seek(frame)
                colour = np.asarray(video.convert("RGB"))[20, 30]
                shown += [colour] * (video.info["duration"] // 40)
    else:
        decode = ["-i", str(path), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
        result = subprocess.run(
            [imageio_ffmpeg.get_ffmpeg_exe(), *decode], capture_output=True, check=True
        )
        assert b"64x48" in result.stderr
        assert b" 25 fps" in result.stderr
        shown = np.frombuffer(result.stdout, np.uint8).reshape(-1, 48, 64, 3)[:, 20, 30]
    assert len(shown) == 75
    expected = np.repeat(COLOURS, 25, axis=0).astype(int)
    assert np.abs(np.asarray(shown) - expected).max() < 12


@pytest.mark.parametrize("suffix", ["gif", "mp4"])
def test_a_video_stopped_midway_leaves_what_was_there_and_nothing_else(
    suffix: str, tmp_path: Path
) -> None:
    def frames() -> Iterator[np.ndarray]:
        yield from [np.zeros((48, 64, 3), np.uint8)] * 200
        raise KeyboardInterrupt

    for before in ({}, {f"video.{suffix}": b"an older one"}):
        for name, data in before.items():
            (tmp_path / name).write_bytes(data)
        with pytest.raises(KeyboardInterrupt):
            write_video(tmp_path / f"video.{suffix}", frames())
        assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["gif", "mp4"])
def test_ctrl_c_in_the_middle_of_a_video_is_one_line_and_leaves_no_file(
    suffix: str, tmp_path: Path
) -> None:
    command = [sys.executable, "-m", "cgm_jax.evaluate", "--random", "--env", "reach"]
    command += ["--video", str(tmp_path / f"video.{suffix}"), "--video-episodes", "100"]
    with subprocess.Popen(
        command,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        cwd=Path(__file__).parents[2],
    ) as process:
        assert process.stderr is not None
        for line in process.stderr:
            if line.endswith("frames\n"):
                break
        process.send_signal(signal.SIGINT)
        _, error = process.communicate(timeout=60)
    assert process.returncode == 75
    assert [line for line in error.splitlines() if not line.endswith("frames")] == ["stopping"]
    assert not list(tmp_path.iterdir())


def test_a_video_that_cannot_be_written_says_so(tmp_path: Path) -> None:
    (tmp_path / "taken.mp4").mkdir()
    with pytest.raises(OSError, match="Is a directory"):
        write_video(tmp_path / "taken.mp4", [np.zeros((48, 64, 3), np.uint8)] * 500)


BAD_INPUT = {
    "": "source: name a run directory or a policy file",
    "runs --random --env reach": "source: random and a directory or a file do not go together",
    "runs --pretrained reach": "source: pretrained and a directory or a file do not go together",
    "--pretrained slide": "pretrained: no policy 'slide'; choose from reach, push, pick_and_place",
    "--pretrained reach --env push": "env: --pretrained names its task itself",
    "--pretrained reach --run x": "run: goes with a run directory",
    "nowhere.npz --env reach": "source: there is no file nowhere.npz",
    "nowhere.npz --run x": "run: goes with a run directory, not with a policy file",
    "README.md --env reach": "README.md holds no sweep",
    "--pretrained reach --view --video a.gif": "view: shows what --video writes",
    "--random": "env: --random needs one",
    "--random --env reach push": "env: --random needs one",
    "nowhere --env reach": "nowhere holds no sweep",
    "--random --env slide": "env: unknown environment 'slide'",
    "--random --env reach --engine bullet": "engine: unknown engine 'bullet'",
    "--random --env reach --mask xq": "mask: 'xq' is not made of x, y and z",
    "--random --env reach --mask xx": "mask: 'xx' is not made of x, y and z",
    "--random --env reach --mask x,0": "mask: 'x,0' is not made of x, y and z, or of numbers",
    "--random --env reach --mask 0,": "mask: '0,' is not made of x, y and z, or of numbers",
    "--random --env reach --mask 3": "mask: goals of reach have no 3, but dimensions 0 to 2",
    "--random --env reach --episodes 0": "episodes: 0 is not within [1, 1000000]",
    "--random --env reach --video out.avi": "video: out.avi ends neither in .mp4 nor in .gif",
    "--random --env reach --video nowhere/out.gif": "video: nowhere is no directory",
    "--random --env reach --video a.gif --video-width 100": "video_width: 100 is not a multiple",
    "--random --env tests/examples/point_mass.py:PointMass --mask z": "have no z",
    "--random --env tests/cgm_jax/own_environments.py:Base --video a.gif": "has no render_frame",
    "--random --env tests/examples/point_mass.py:PointMass --view": "only the Fetch tasks have",
}


@pytest.mark.parametrize("arguments", BAD_INPUT)
def test_bad_input_is_refused_by_name(arguments: str) -> None:
    with pytest.raises(SettingError) as refusal:
        main(arguments.split())
    assert BAD_INPUT[arguments] in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_a_policy_file_is_evaluated_in_the_environment_of_its_run_or_in_a_named_one(
    directory: RunDirectory, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = directory.config.groups()[0].runs[1]
    directory.write_improvement(run, 7, reaching_policy(15.0))
    improvement = directory.path / "policies/improvements/straight_epoch7.npz"
    elsewhere = tmp_path / "mine.npz"
    shutil.copy(improvement, elsewhere)
    assert main([str(improvement), "--episodes", "20"]) == 0
    assert main([str(elsewhere), "--env", "reach", "--episodes", "20"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split("(")[0].split() for line in lines] == [
        ["straight_epoch7", "100.0", "%"],
        ["mine", "100.0", "%"],
    ]
    with pytest.raises(SettingError, match=r"env: name the environment of .*mine\.npz"):
        main([str(elsewhere)])
    with pytest.raises(SettingError, match="made for observations of size 10, not 25"):
        main([str(elsewhere), "--env", "push"])
    with pytest.raises(SettingError, match="was trained with reach, not push"):
        main([str(improvement), "--env", "push"])


def test_an_environment_of_ones_own_draws_its_own_video(tmp_path: Path) -> None:
    path = tmp_path / "out.gif"
    own = f"{EXAMPLES / 'point_mass.py'}:PointMass"
    options = ["--episodes", "3", "--video", str(path), "--video-episodes", "2"]
    assert main(["--random", "--env", own, *options, "--video-width", "64"]) == 0
    recording = evaluate_random(
        Settings(env=own), Plan(episodes=3, seed=1000, recorded=2)
    ).recording
    assert recording is not None
    goal = np.asarray(recording.desired_goal)[0]
    with Image.open(path) as video:
        first = np.asarray(video.convert("RGB"))
        durations = sum(
            (video.seek(frame), video.info["duration"])[1] for frame in range(video.n_frames)
        )
    assert durations == 2 * (26 + 11) * 40  # 26 states, the last stands for 12 frames
    rows, columns = np.nonzero((first[..., 1] > 100) & (first[..., 0] < 100))  # green
    drawn = np.array([columns.mean() / 64, 1 - rows.mean() / 48]) * 4 - 2
    np.testing.assert_allclose(drawn, goal, atol=0.15)


def test_a_frame_that_is_none_is_refused_in_one_line(tmp_path: Path) -> None:
    code = (EXAMPLES / "point_mass.py").read_text().replace("np.uint8)", "np.int32)")
    (tmp_path / "mine.py").write_text(code)
    own = f"{tmp_path / 'mine.py'}:PointMass"
    video = tmp_path / "out.gif"
    with pytest.raises(SettingError, match=r"returns int32\[48,64,3\], not uint8\[48,64,3\]"):
        main(["--random", "--env", own, "--video", str(video), "--video-width", "64"])
    assert not video.exists()


@pytest.mark.parametrize("name", NAMES)
def test_policies_that_come_with_the_package_are_as_good_as_their_record_says(name: str) -> None:
    recorded = json.loads(RECORD.read_text())[name]
    assert recorded["episodes"] == 1000
    assert recorded["success_rate"] >= 0.98
    outcome = evaluate_policies(
        chosen_policies(None, name, None, {}), Plan(episodes=60, seed=1000)
    )[name]
    chance = binomtest(outcome.successes, outcome.valid, recorded["success_rate"]).pvalue
    assert chance > 1e-3
    assert pretrained_policy(name).stat().st_size < 300_000


@pytest.mark.skipif(bool(os.environ.get("DISPLAY")), reason="there is a display here")
def test_without_a_display_the_viewer_is_refused_before_anything_is_evaluated(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SettingError, match=r"^view: there is no display here; --video FILE\.mp4"):
        main(["--pretrained", "reach", "--view"])
    assert capsys.readouterr().out == ""


def test_unknown_runs_are_refused(directory: RunDirectory) -> None:
    with pytest.raises(SettingError, match="holds no run 'fast'"):
        main([str(directory.path), "--run", "fast"])


def test_a_machine_that_cannot_render_says_what_to_install(tmp_path: Path) -> None:
    video = tmp_path / "out.mp4"
    result = subprocess.run(
        [sys.executable, "-m", "cgm_jax.evaluate", "--random", "--env", "reach", "--video", video],
        env={"PYOPENGL_PLATFORM": "none of them", "HOME": str(tmp_path), "JAX_PLATFORMS": "cpu"},
        cwd=Path(__file__).parents[2],
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 2
    assert result.stdout == ""
    (line,) = result.stderr.splitlines()
    assert line.startswith("error: video: no off-screen rendering here")
    assert line.endswith("apt-get install -y libegl1 libgl1-mesa-dri")
    assert not video.exists()
