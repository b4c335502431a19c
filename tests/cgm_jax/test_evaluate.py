"""The program that evaluates policies."""

import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest
from PIL import Image

from cgm_jax.config.fields import SettingError
from cgm_jax.config.settings import Settings
from cgm_jax.evaluate import _report, main
from cgm_jax.loop.environment import make_environment
from cgm_jax.machine.device_errors import DeviceError
from cgm_jax.results.episodes import Outcome
from cgm_jax.results.plan import Plan
from cgm_jax.results.policies import evaluate_random
from cgm_jax.storage.run_directory import RunDirectory
from tests.cgm_jax.host.in_process import outcome
from tests.cgm_jax.reaching import REACH, reaching_policy, reaching_runs
from tests.cgm_jax.sweeps import POINT_MASS, ROOT
from tests.envs.surface import can_render

EXAMPLES = Path(__file__).parents[1] / "examples"


@pytest.fixture(scope="module")
def directory(tmp_path_factory: pytest.TempPathFactory) -> RunDirectory:
    return reaching_runs(tmp_path_factory.mktemp("known") / "out")


def test_ctrl_c_ends_an_evaluation_that_shows_how_far_it_is() -> None:
    command = [sys.executable, "-m", "cgm_jax.evaluate", "--random", "--env", POINT_MASS]
    with subprocess.Popen(
        [*command, "--episodes", "1000000"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=ROOT,
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
        "2 dropped: physics broke, or over at the start)",
        "none  no valid episode, 10 dropped: physics broke, or over at the start",
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


BAD_INPUT = {
    "": "source: name a run directory or a policy file",
    "runs --random --env reach": "source: random and a directory or a file do not go together",
    "runs --pretrained reach": "source: pretrained and a directory or a file do not go together",
    "--pretrained slide": "pretrained: no policy 'slide'; choose from reach, push, pick_and_place",
    "--pretrained reach --env push": "env: --pretrained names its task itself",
    "--pretrained reach --run x": "run: goes with a run directory",
    "--pretrained reach --agent nonsense": "agent: goes with a run directory",
    "--pretrained reach --curriculum cgm": "curriculum: goes with a run directory",
    "--random --env reach --relabelling x": "relabelling: goes with a run directory",
    "nowhere.npz --env reach": "source: there is no file nowhere.npz",
    "nowhere.npz --run x": "run: goes with a run directory, not with a policy file",
    "README.md --env reach": "README.md is no directory",
    "--pretrained reach --view --video a.gif": "view: shows what --video writes",
    "--random": "env: --random needs one task, --env TASK",
    "--random --env reach push": "env: --random needs one task, --env TASK",
    "nowhere --env reach": "there is no directory nowhere",
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
    "--random --env reach --video-width 320": "video_width: goes with --video",
    "--random --env reach --video-episodes 7": "video_episodes: goes with --video or --view",
    "--random --env reach --view --video-width 320": "video_width: goes with --video",
    "--random --env reach --video a.gif --video-episodes 100": (
        "video_episodes: a .gif of 100 takes 5.7 GiB of memory, and 4 is the most; take fewer"
    ),
    "--random --env reach --video a.gif --video-width 1280 --video-episodes 18": "takes 4.1 GiB",
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
    with pytest.raises(SettingError, match=r"agent: .*mine\.npz lies in no run directory"):
        main([str(elsewhere), "--env", "reach", "--agent", "sac"])
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
        durations = 0
        for frame in range(video.n_frames):  # pyright: ignore[reportAttributeAccessIssue]
            video.seek(frame)
            durations += video.info["duration"]
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


@pytest.mark.skipif(not can_render(), reason="this machine has no off-screen rendering")
def test_a_video_without_a_valid_episode_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mine.py").write_text(
        "import numpy as np\nfrom tests.cgm_jax.own_environments import NeverValid\n\n"
        "class Shown(NeverValid):\n    def render_frame(self, state, width, height):\n"
        "        return np.zeros((height, width, 3), np.uint8)\n"
    )
    video = tmp_path / "out.gif"
    words = ["--random", "--env", f"{tmp_path / 'mine.py'}:Shown", "--episodes", "3"]
    line = f"^video: {video} is not written: no valid episode among the first 3$"
    with pytest.raises(SettingError, match=line):
        main([*words, "--video", str(video)])
    assert capsys.readouterr().out.startswith("random  no valid episode, 3 dropped")
    assert not video.exists()


def test_what_fails_below_ends_a_program_that_calls_main_with_code_1(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(*_: object) -> None:
        raise DeviceError("out of memory")

    monkeypatch.setattr("cgm_jax.results.policies.evaluate_random", fail)
    assert main(["--random", "--env", "reach"]) == 1
    assert capsys.readouterr().err == "error: out of memory\n"


def test_what_fails_below_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    env = "gymnasium:tests.envs.hosted.variants:tests/Failing-v0"
    code, out, text = outcome(main, ["--random", "--env", env, "--episodes", "2"], capsys)
    jax.effects_barrier()  # nothing is left to be raised at exit
    assert (code, out) == (1, "")
    error = [line for line in text.splitlines() if not line.endswith("episodes")]
    assert len(error) == 1, text
    assert error[0].startswith(f"error: ValueError: env: {env}: RuntimeError: the motor broke (")


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
        cwd=ROOT,
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
