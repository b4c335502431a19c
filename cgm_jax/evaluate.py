"""`python -m cgm_jax.evaluate DIR`: success of trained policies, with a confidence interval.

`--video` also writes a video of the best run; `--random` evaluates random actions, not policies.
"""

import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from cgm_jax.config.components import NAMES
from cgm_jax.config.fields import SettingError
from cgm_jax.config.settings import Settings
from cgm_jax.host.command_line import name_own_code, owns_process, parse, run_program
from cgm_jax.host.interruption import Interruption
from cgm_jax.host.startup import prepare_jax
from cgm_jax.results.plan import Plan
from cgm_jax.results.statistics import wilson_interval

if TYPE_CHECKING:
    from cgm_jax.host.progress import CountProgress
    from cgm_jax.results.policies import Outcome

VIDEO_FORMATS = (".mp4", ".gif")
MAX_VIDEO_EPISODES = 1000
WIDTH_STEP, MAX_WIDTH = 64, 1280
"""Encoders want both sides to be multiples of 16, and the height is three quarters."""


@dataclass(kw_only=True)
class EvaluateOptions:
    """Run the policies of a sweep without noise, and report their success."""

    directory: Annotated[Path | None, tyro.conf.Positional] = None
    """Directory that a sweep or a training run has written."""

    run: str | None = None
    """Evaluate only the run of this name (default: all)."""

    random: bool = False
    """Take uniformly random actions in --env instead of a directory's policies."""

    env: tuple[str, ...] | None = None
    """For --random: reach, push, pick_and_place, or FILE.py:FACTORY of your own. With a directory:
    a file that its policies were trained on, if it has moved, was edited, or was never named on
    this machine; so --curriculum, --agent and --relabelling."""

    curriculum: tuple[str, ...] | None = None
    """See --env."""

    agent: tuple[str, ...] | None = None
    """See --env."""

    relabelling: tuple[str, ...] | None = None
    """See --env."""

    engine: str | None = None
    """auto, native, mjx or warp (default: what the run was trained on; auto for --random)."""

    episodes: int = 200
    """Episodes per policy."""

    seed: int = 1000
    """Random seed of starts and goals, the same for every policy."""

    mask: str = ""
    """Goal axes that count as achieved, such as z or xy (default: none, the full goal)."""

    video: Path | None = None
    """Video of the best run's first episodes, an .mp4 or .gif file (Fetch only)."""

    video_episodes: int = 5
    """Episodes in the video."""

    video_width: int = 640
    """Width of the video in pixels, a multiple of 64."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program on command-line arguments; return its exit code."""
    options = parse(EvaluateOptions, arguments, "python -m cgm_jax.evaluate")
    _check(options)
    plan = _plan(options)
    name_own_code(_named(options))
    with Interruption(
        ends_process=owns_process(), first_words="stopping", last_words="stopped"
    ) as interruption:
        prepare_jax()
        outcomes = _evaluate(options, plan)
        for line in _report(outcomes, options.mask):
            print(line)
        if options.video is not None:
            interruption.expendable = False  # there are a file and an encoder to clear away
            best = max(outcomes, key=lambda name: outcomes[name].success_rate)
            print(_write_video(best, outcomes[best], len(outcomes), options, interruption))
    return 0


def _check(options: EvaluateOptions) -> None:
    """Check what can be checked without JAX.

    Raises:
        SettingError: an option is out of its range, or does not go with another.
    """
    if not 1 <= options.video_episodes <= MAX_VIDEO_EPISODES:
        bounds = f"[1, {MAX_VIDEO_EPISODES}]"
        raise SettingError(f"video_episodes: {options.video_episodes} is not within {bounds}")
    if options.random and (options.directory is not None or options.run is not None):
        raise SettingError("random: goes with --env, not with a directory or a run")
    if options.random and len(options.env or ()) != 1:
        raise SettingError("env: --random needs one")
    if not options.random and options.directory is None:
        raise SettingError("directory: name one to evaluate its policies, or give --random --env")
    if options.video is not None:
        _check_video(options.video, options.video_width)


def _check_video(path: Path, width: int) -> None:
    if path.suffix not in VIDEO_FORMATS:
        raise SettingError(f"video: {path} ends neither in .mp4 nor in .gif")
    if not path.parent.is_dir():
        raise SettingError(f"video: {path.parent} is no directory")
    if width % WIDTH_STEP or not WIDTH_STEP <= width <= MAX_WIDTH:
        bounds = f"a multiple of {WIDTH_STEP} within [{WIDTH_STEP}, {MAX_WIDTH}]"
        raise SettingError(f"video_width: {width} is not {bounds}")


def _plan(options: EvaluateOptions) -> Plan:
    return Plan(
        episodes=options.episodes,
        seed=options.seed,
        mask=options.mask,
        recorded=0 if options.video is None else min(options.video_episodes, options.episodes),
        engine=options.engine,
    )


def _evaluate(options: EvaluateOptions, plan: Plan) -> "dict[str, Outcome]":
    from cgm_jax.host.progress import CountProgress
    from cgm_jax.results.policies import evaluate_directory, evaluate_random
    from cgm_jax.storage.run_directory import RunDirectory

    if options.video is not None:
        from cgm_jax.envs.rendering import RenderingError, check_rendering

        try:  # now, and not after the evaluation
            check_rendering()
        except RenderingError as error:
            raise SettingError(f"video: {error}") from None
    named = _named(options)
    with CountProgress("episodes") as progress:
        if options.directory is None:
            settings = Settings(env=named["env"][0])
            return {"random": evaluate_random(settings, plan, progress.show)}
        if (restored := RunDirectory(options.directory).restore_config()) is not None:
            print(restored, file=sys.stderr)
        directory = RunDirectory.open(options.directory)
        moved = directory.moved(named)
        return evaluate_directory(directory, plan, options.run, moved, progress.show)


def _named(options: EvaluateOptions) -> dict[str, list[str]]:
    return {setting: list(getattr(options, setting) or ()) for setting in NAMES}


def _report(outcomes: "Mapping[str, Outcome]", mask: str) -> list[str]:
    """One line per policy."""
    width = max(len(name) for name in outcomes)
    goals = f", goals with {' and '.join(mask)} masked" if mask else ""
    lines = []
    for name, outcome in outcomes.items():
        dropped = outcome.episodes - outcome.valid
        note = f", {dropped} dropped for physics_warnings" if dropped else ""
        if not outcome.valid:
            lines.append(f"{name:{width}}  no valid episode{note}")
            continue
        low, high = wilson_interval(outcome.successes, outcome.valid)
        lines.append(
            f"{name:{width}}  {100 * outcome.success_rate:5.1f} %  "
            f"(95 %: {100 * low:.1f} to {100 * high:.1f}, {outcome.valid} episodes{goals}{note})"
        )
    return lines


def _write_video(
    name: str,
    outcome: "Outcome",
    runs: int,
    options: EvaluateOptions,
    interruption: Interruption,
) -> str:
    """Write the video, and say what is in it."""
    from cgm_jax.envs.fetch import FetchEnvironment
    from cgm_jax.host.progress import CountProgress
    from cgm_jax.results.video import count_frames, video_frames, write_video

    recording, path = outcome.recording, options.video
    if recording is None or path is None or not isinstance(outcome.env, FetchEnvironment):
        raise SettingError("video: nothing was recorded")
    shown = int(recording.valid.sum())
    if not shown:
        return f"{path} is not written: no valid episode among the first {options.video_episodes}"
    solved = int((recording.achieved[:, -1] & recording.valid).sum())
    frames = video_frames(outcome.env, recording, options.mask, options.video_width)
    try:
        with CountProgress("frames") as progress:
            write_video(path, _watched(frames, count_frames(recording), progress, interruption))
    except OSError as error:
        raise SettingError(f"video: cannot write {path}: {error}") from None
    episodes = f"{shown} episode{'s' if shown > 1 else ''}"
    which = f"{name}, the best of {runs}" if runs > 1 else name
    return f"{path}: {episodes} of {which}; the goal is achieved in {solved}"


def _watched(
    frames: Iterable[Any], total: int, progress: "CountProgress", interruption: Interruption
) -> Iterator[Any]:
    """Pass frames on until a signal comes."""
    for number, frame in enumerate(frames):
        if interruption.requested:
            raise KeyboardInterrupt
        progress.show(number, total)
        yield frame


if __name__ == "__main__":
    run_program(main)
