"""`python -m cgm_jax.evaluate DIR`: success of trained policies, with a confidence interval.

DIR/policies/NAME.npz, or any other policy file, serves as well, and so does `--pretrained TASK`,
which comes with the package. `--video` also writes a video of the best one, `--view` shows it in
MuJoCo's viewer; `--random` evaluates random actions, not policies.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from cgm_jax.config.components import ROOMS
from cgm_jax.config.fields import SettingError
from cgm_jax.config.settings import Settings
from cgm_jax.host.command_line import (
    owns_process,
    parse,
    print_error,
    print_restored,
    run_program,
)
from cgm_jax.host.exit_codes import ExitCode
from cgm_jax.host.interruption import Interruption
from cgm_jax.host.startup import prepare_jax
from cgm_jax.host.training_options import name_own_code
from cgm_jax.machine.device_errors import DeviceError
from cgm_jax.pretrained import NAMES as PRETRAINED
from cgm_jax.pretrained import pretrained_policy
from cgm_jax.results.chosen import chosen_policies, named_code
from cgm_jax.results.plan import Plan, goal_mask, mask_words
from cgm_jax.results.statistics import wilson_interval
from cgm_jax.storage.looking import is_directory

if TYPE_CHECKING:
    from cgm_jax.host.progress import CountProgress
    from cgm_jax.results.episodes import Outcome

GIF = ".gif"
VIDEO_FORMATS = (".mp4", GIF)
MAX_VIDEO_EPISODES = 1000
WIDTH_STEP, MAX_WIDTH = 64, 1280
"""Encoders want both sides to be multiples of 16, and the height is three quarters."""


@dataclass(kw_only=True)
class EvaluateOptions:
    """Run trained policies without noise, and report their success."""

    source: Annotated[Path | None, tyro.conf.Positional] = None
    """Directory that a sweep or a training run has written, or one policy file (.npz)."""

    run: str | None = None
    """Evaluate only the run of this name (default: all)."""

    pretrained: Annotated[
        str | None, tyro.conf.arg(metavar=f"{{{','.join(PRETRAINED)}}}", help_behavior_hint="")
    ] = None
    """Evaluate the policy of this task that comes with the package."""

    random: bool = False
    """Take uniformly random actions in --env instead of a policy's."""

    env: tuple[str, ...] | None = None
    """For --random, and for a policy file that lies in no run directory: reach, push,
    pick_and_place, FILE.py:NAME of your own, or gymnasium:MODULE:ID. With a directory: a file
    that its policies were trained on, if it has moved, was edited, or was never named on this
    machine; so --curriculum, --agent and --relabelling."""

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
    """Goal dimensions that count as achieved, such as z, xy, or numbers from 0: 2 or 0,4 (default:
    none, the full goal)."""

    video: Path | None = None
    """Video of the best policy's first episodes, an .mp4 or .gif file: of the Fetch tasks, or of an
    environment of your own with render_frame(state, width, height)."""

    view: bool = False
    """Show them in MuJoCo's viewer instead, until its window is closed (Fetch tasks; needs a
    display)."""

    video_episodes: int = 5
    """Episodes in the video or the viewer."""

    video_width: int = 640
    """Width of the video in pixels, a multiple of 64."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program on command-line arguments; return its exit code.

    Raises:
        SettingError: input is refused, or the video cannot be written.
        SystemExit: an argument is no option, or asks for help.
    """
    options = parse(EvaluateOptions, arguments, "python -m cgm_jax.evaluate")
    _check(options)
    plan = _plan(options)
    name_own_code(named_code(options))
    with Interruption(
        ends_process=owns_process(), first_words="stopping", last_words="stopped"
    ) as interruption:
        prepare_jax()
        try:
            outcomes = _evaluate(options, plan)
        except DeviceError as error:
            print_error(error)
            return ExitCode.FAILED
        for line in _report(outcomes, options.mask):
            print(line, flush=True)
        best = max(outcomes, key=lambda name: outcomes[name].success_rate)
        if options.video is not None:
            interruption.expendable = False  # there are a file and an encoder to clear away
            print(_write_video(best, outcomes[best], len(outcomes), options, interruption))
        if options.view:
            interruption.expendable = False
            _view(outcomes[best], options.mask, interruption)
    return 0


def _check(options: EvaluateOptions) -> None:
    """Check what can be checked without JAX.

    Raises:
        SettingError: an option is out of its range, or does not go with another.
    """
    if not 1 <= options.video_episodes <= MAX_VIDEO_EPISODES:
        bounds = f"[1, {MAX_VIDEO_EPISODES}]"
        raise SettingError(f"video_episodes: {options.video_episodes} is not within {bounds}")
    chosen = {
        "random": options.random,
        "pretrained": options.pretrained is not None,
        "a directory or a file": options.source is not None,
    }
    if sum(chosen.values()) > 1:
        given = " and ".join(name for name, is_chosen in chosen.items() if is_chosen)
        raise SettingError(f"source: {given} do not go together")
    if not any(chosen.values()):
        raise SettingError(
            "source: name a run directory or a policy file, or give --pretrained TASK, "
            "or --random --env TASK"
        )
    for name in ("run", *ROOMS):
        if getattr(options, name) is not None and options.source is None:
            raise SettingError(f"{name}: goes with a run directory")
    if options.random and len(options.env or ()) != 1:
        raise SettingError("env: --random needs one task, --env TASK")
    if options.pretrained is not None:
        pretrained_policy(options.pretrained)
        if options.env:
            raise SettingError("env: --pretrained names its task itself")
    if options.view and options.video is not None:
        raise SettingError("view: shows what --video writes; give one of them")
    if options.video is None:
        _check_no_video(options)
    else:
        _check_video(options.video, options.video_width)


def _check_no_video(options: EvaluateOptions) -> None:
    if options.video_width != EvaluateOptions.video_width:
        raise SettingError("video_width: goes with --video")
    if options.video_episodes != EvaluateOptions.video_episodes and not options.view:
        raise SettingError("video_episodes: goes with --video or --view")


def _check_video(path: Path, width: int) -> None:
    if path.suffix not in VIDEO_FORMATS:
        raise SettingError(f"video: {path} ends neither in .mp4 nor in .gif")
    if not is_directory("video", path.parent):
        raise SettingError(f"video: {path.parent} is no directory")
    if width % WIDTH_STEP or not WIDTH_STEP <= width <= MAX_WIDTH:
        bounds = f"a multiple of {WIDTH_STEP} within [{WIDTH_STEP}, {MAX_WIDTH}]"
        raise SettingError(f"video_width: {width} is not {bounds}")


def _plan(options: EvaluateOptions) -> Plan:
    shown = options.view or options.video is not None
    is_gif = options.video is not None and options.video.suffix == GIF
    return Plan(
        episodes=options.episodes,
        seed=options.seed,
        mask=options.mask,
        recorded=min(options.video_episodes, options.episodes) if shown else 0,
        view=options.view,
        gif_width=options.video_width if is_gif else None,
        engine=options.engine,
    )


def _evaluate(options: EvaluateOptions, plan: Plan) -> "dict[str, Outcome]":
    from cgm_jax.host.progress import CountProgress
    from cgm_jax.results.policies import evaluate_policies, evaluate_random

    named = named_code(options)
    if options.random:
        with CountProgress("episodes") as progress:
            settings = Settings(env=named["env"][0])
            return {"random": evaluate_random(settings, plan, progress.show)}
    source = options.source
    if source is not None and is_directory("source", source):
        print_restored(source)
    policies = chosen_policies(source, options.pretrained, options.run, named)
    with CountProgress("episodes") as progress:
        return evaluate_policies(policies, plan, progress.show)


def _report(outcomes: "Mapping[str, Outcome]", mask: str) -> list[str]:
    """One line per policy."""
    width = max(len(name) for name in outcomes)
    goals = f", goals with {' and '.join(mask_words(mask))} masked" if mask else ""
    lines = []
    for name, outcome in outcomes.items():
        dropped = outcome.episodes - outcome.valid
        note = f", {dropped} dropped: physics broke, or over at the start" if dropped else ""
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
    """Write the video, and say what is in it.

    Raises:
        SettingError: no episode is valid, or the file cannot be written.
    """
    from cgm_jax.host.progress import CountProgress
    from cgm_jax.results.video import count_frames, video_frames, write_video

    recording, path = outcome.recording, options.video
    if recording is None or path is None:
        raise SettingError("video: nothing was recorded")
    shown = int(recording.valid.sum())
    if not shown:
        first = min(options.video_episodes, options.episodes)
        raise SettingError(
            f"video: {path} is not written: no valid episode among the first {first}"
        )
    solved = int((recording.achieved[:, -1] & recording.valid).sum())
    env: Any = outcome.env  # of which the plan knows that it can be rendered
    frames = video_frames(env, recording, options.mask, options.video_width)
    try:
        with CountProgress("frames") as progress:
            write_video(path, _watched(frames, count_frames(recording), progress, interruption))
    except OSError as error:
        raise SettingError(f"video: cannot write {path}: {error}") from None
    episodes = f"{shown} episode{'s' if shown > 1 else ''}"
    which = f"{name}, the best of {runs}" if runs > 1 else name
    return f"{path}: {episodes} of {which}; the goal is achieved in {solved}"


def _view(outcome: "Outcome", mask: str, interruption: Interruption) -> None:
    """Show the recorded episodes until the window is closed or a signal comes."""
    import numpy as np

    from cgm_jax.envs.fetch import FetchEnvironment
    from cgm_jax.envs.viewer import play

    recording, env = outcome.recording, outcome.env
    if recording is None or not isinstance(env, FetchEnvironment):
        raise SettingError("view: nothing was recorded")
    valid, goals = np.asarray(recording.valid), np.asarray(recording.desired_goal)
    if not valid.any():
        print("no valid episode to show")
        return
    play(
        env.scene,
        env.physics.positions(recording.states)[:, valid],
        goals[valid],
        np.asarray(recording.achieved)[valid],
        goal_radius=env.distance_threshold,
        mask=goal_mask(mask, goals.shape[-1]).tolist(),
        stopped=lambda: interruption.requested,
    )


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
