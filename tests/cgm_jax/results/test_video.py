"""Videos: their frames, and what is left of one that was not finished."""

import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image

from cgm_jax.results.page.videos import video_figures
from cgm_jax.results.video import write_video
from cgm_jax.storage.run_directory import RunDirectory
from tests.cgm_jax.sweeps import ROOT

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
    command += ["--video", str(tmp_path / f"video.{suffix}"), "--video-episodes", "60"]
    with subprocess.Popen(
        command,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        cwd=ROOT,
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


def test_a_video_that_a_killed_process_was_writing_is_not_shown_and_goes(tmp_path: Path) -> None:
    seen = []

    def frames() -> Iterator[np.ndarray]:
        yield np.zeros((48, 64, 3), np.uint8)
        seen.extend(path for path in (tmp_path / "figures").iterdir())
        assert video_figures(tmp_path, "a") == ""

    with RunDirectory.claimed(tmp_path, fresh=True):
        write_video(tmp_path / "figures/best_policy.gif", frames())
    (partial,) = seen
    assert "best_policy.gif" in video_figures(tmp_path, "a")
    partial.touch()
    with RunDirectory.claimed(tmp_path, fresh=False):
        assert not partial.exists()
