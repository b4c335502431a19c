"""A video of a sweep's best policy."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from cgm_jax.results.chosen import chosen_policies
from cgm_jax.results.plan import Plan
from cgm_jax.results.policies import evaluate_policies
from cgm_jax.results.video import video_frames, write_video
from cgm_jax.storage.metrics import Row
from cgm_jax.storage.run_directory import RunDirectory

EPISODES = 5
SEED = 1000
"""Of starts and goals; that of `evaluate`."""

WIDTH = 320


def video_of_best_policy(directory: RunDirectory, rows: Sequence[Row]) -> Path:
    """Write figures/best_policy.gif, the first episodes of the run that succeeds most often.

    Args:
        directory: of a sweep.
        rows: the last row of each of its runs.

    Raises:
        SettingError: its environment cannot be rendered, or not here, or there is no policy.
        ValueError: no episode is valid.
        OSError: the file cannot be written.
    """
    best = max(rows, key=lambda row: row["success_rate"] or 0.0)["run"]
    plan = Plan(episodes=EPISODES, seed=SEED, recorded=EPISODES, gif_width=WIDTH)
    outcome = evaluate_policies(chosen_policies(directory.path, None, best, {}), plan)[best]
    env: Any = outcome.env  # of which it is known that it can be rendered
    recording = outcome.recording
    if recording is None or not recording.valid.any():
        raise ValueError("it has no valid episode")
    path = directory.path / "figures" / "best_policy.gif"
    write_video(path, video_frames(env, recording, plan.mask, WIDTH))
    return path
