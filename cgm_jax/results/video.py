"""Videos of episodes, as MP4 or GIF."""

import contextlib
import errno
import itertools
import os
import subprocess
from collections.abc import Generator, Iterable, Iterator
from pathlib import Path

import imageio_ffmpeg
import jax
import numpy as np
from PIL import Image

from cgm_jax.envs import RenderableEnvironment
from cgm_jax.envs.fetch import FetchEnvironment
from cgm_jax.envs.rendering import FRAMES_PER_SECOND, Renderer
from cgm_jax.results.episodes import Recording
from cgm_jax.results.plan import goal_mask
from cgm_jax.storage.files import remove_abandoned, replacing

HELD_FRAMES = 12
"""The last frame of an episode is held for half a second, so that its outcome can be seen."""

GIF_COLOURS = 256


def video_frames(
    env: FetchEnvironment | RenderableEnvironment, recording: Recording, mask: str, width: int
) -> Iterator[np.ndarray]:
    """Frames [height, width, 3] of the valid episodes of a recording, one after another.

    Args:
        env: what was recorded: a Fetch environment, or a `RenderableEnvironment`.
        recording: whole episodes of it.
        mask: masked axes, as `results.plan.Plan` has them; only Fetch environments draw it.
        width: of a frame, pixels; the height is three quarters of it.

    Raises:
        RenderingError: this machine cannot render.
        SettingError: the user's environment fails to, or returns no frame of that size.
    """
    if isinstance(env, FetchEnvironment):
        frames = _fetch_frames(env, recording, mask, width)
    else:
        frames = _own_frames(env, recording, width)
    with contextlib.closing(frames):
        for frame, last in frames:
            yield from [frame] * (HELD_FRAMES if last else 1)


def _fetch_frames(
    env: FetchEnvironment, recording: Recording, mask: str, width: int
) -> Generator[tuple[np.ndarray, bool], None, None]:
    """Frames, and whether they are the last of their episode."""
    positions = env.physics.positions(recording.states)
    goals, achieved = np.asarray(recording.desired_goal), np.asarray(recording.achieved)
    kept = goal_mask(mask, goals.shape[-1]).tolist()
    with Renderer(env.scene, env.distance_threshold, width, width * 3 // 4) as renderer:
        for episode in np.flatnonzero(recording.valid):
            for step, row in enumerate(positions[:, episode]):
                reached = bool(achieved[episode, step])
                frame = renderer.frame(row, goals[episode], achieved=reached, mask=kept)
                yield frame, step == len(positions) - 1


def _own_frames(
    env: RenderableEnvironment, recording: Recording, width: int
) -> Generator[tuple[np.ndarray, bool], None, None]:
    steps = recording.achieved.shape[1]
    for episode in np.flatnonzero(recording.valid):
        for step in range(steps):
            state = jax.tree.map(lambda rows, at=(step, episode): rows[at], recording.states)
            yield env.render_frame(state, width, width * 3 // 4), step == steps - 1


def count_frames(recording: Recording) -> int:
    """How many frames `video_frames` makes of a recording."""
    return int(np.sum(recording.valid)) * (recording.achieved.shape[1] - 1 + HELD_FRAMES)


def write_video(path: Path, frames: Iterable[np.ndarray]) -> None:
    """Write frames as a video in real time. It is whole or not there.

    Args:
        path: where to; the suffix .mp4 or .gif decides the format. Is replaced if it exists.
        frames: at least one [height, width, 3] uint8, all of one size; for MP4 both
            sides multiples of 16.

    Raises:
        OSError: the file cannot be written.
    """
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    write = _write_gif if path.suffix == ".gif" else _write_mp4
    remove_abandoned(path)
    with replacing(path) as file:
        write(Path(file.name), frames)


def _write_mp4(path: Path, frames: Iterable[np.ndarray]) -> None:
    rest = iter(frames)
    first = next(rest)
    height, width, _ = first.shape
    source = f"-f rawvideo -pix_fmt rgb24 -s {width}x{height} -r {FRAMES_PER_SECOND} -i -"
    encoding = "-an -c:v libx264 -crf 20 -pix_fmt yuv420p -movflags +faststart -f mp4"
    options = ["-y", "-loglevel", "error", *source.split(), *encoding.split(), str(path)]
    # Not by imageio_ffmpeg's own writer: it forks, which JAX's threads do not bear.
    with subprocess.Popen(
        [imageio_ffmpeg.get_ffmpeg_exe(), *options],
        stdin=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,  # Ctrl-C is for this process, which then ends the other
    ) as encoder:
        if encoder.stdin is None:
            raise OSError("the encoder takes no input")
        with contextlib.suppress(BrokenPipeError):  # the encoder says why
            for frame in itertools.chain([first], rest):
                encoder.stdin.write(frame.tobytes())
        _, complaint = encoder.communicate()
    if encoder.returncode:
        raise OSError(complaint.decode(errors="replace").strip().rpartition("\n")[2])


def _write_gif(path: Path, frames: Iterable[np.ndarray]) -> None:
    """One palette for all frames, undithered: what does not move then costs nothing."""
    images = [Image.fromarray(frame) for frame in frames]
    palette = _palette(images)
    first, *rest = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    first.save(
        path,
        format="GIF",
        save_all=True,
        append_images=rest,
        duration=1000 // FRAMES_PER_SECOND,
        loop=0,
    )


def _palette(images: list[Image.Image]) -> Image.Image:
    """A palette that serves the first frame, the last, and some between."""
    chosen = images[:: max(1, len(images) // 8)] + images[-1:]
    together = Image.fromarray(np.concatenate([np.asarray(image) for image in chosen]))
    return together.quantize(GIF_COLOURS, method=Image.Quantize.MAXCOVERAGE, kmeans=1)
