"""How good is the independence assumption?

`python -m experiments.learning.calibration RUN_DIR OUT` writes OUT/calibration.csv and
OUT/calibration.png.

The curriculum estimates the success of a masked goal as the product of the success rates of its
kept sub-goals, measured with the full goal and without noise. The paper's Fig. 5 compares that with
success in training, which mixes two things: whether the estimate is right, and what exploration
noise costs. Here every policy that a run of the directory kept along the way, each of them better
than all before, plays each mask without and with noise.
"""

import functools
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from cgm_jax.config.grid import Run
from cgm_jax.config.settings import Hyperparameters
from cgm_jax.curricula.parts.masks import goal_masks, mask_success_rates
from cgm_jax.curricula.protocol import Outcomes
from cgm_jax.envs import GoalEnvironment
from cgm_jax.loop.environment import make_environment
from cgm_jax.loop.exploration import Exploration, draw_exploration, explore
from cgm_jax.loop.rollout import drawn_goals, reset, roll_out
from cgm_jax.results.figures import mask_label
from cgm_jax.storage.policies import act, load_policy
from cgm_jax.storage.run_directory import RunDirectory
from experiments.command_line import paths
from experiments.learning.calibration_errors import ESTIMATES, MEASURED, calibration_errors
from experiments.table import write_table

EPISODES = 100
"""Per policy, mask and kind of noise."""

Rates = dict[str, jax.Array]


def success_per_mask(
    env: GoalEnvironment, arrays: dict[str, jax.Array], hyper: Hyperparameters, key: jax.Array
) -> Rates:
    """Estimated and measured success rates [2^n] of one policy, by name.

    Both estimates come from the noise-free episodes with the full goal.
    """
    size = arrays["goal_mean"].shape[-1]
    masks = goal_masks(size)
    each = jnp.repeat(masks, EPISODES, axis=0)

    def policy(observation: jax.Array, goal: jax.Array, noise: Exploration | None) -> jax.Array:
        action = act(arrays, observation, goal, each)
        return action if noise is None else explore(noise, action)

    def play(key: jax.Array, noise: Exploration | None = None) -> Outcomes:
        first = reset(env, key, len(each))
        goals = drawn_goals(env, first).replace(mask=each)
        return roll_out(env, policy, first, goals, noise).outcomes

    start_key, noisy_start_key, noise_key = jax.random.split(key, 3)
    noise = draw_exploration(noise_key, (env.episode_length, len(each), env.action_size), hyper)
    clean, noisy = play(start_key), play(noisy_start_key, noise)
    full = clean.subgoal_success[-EPISODES:]
    kept_achieved = jnp.all((masks[:, None] == 0) | full, axis=-1)
    return {
        "product": mask_success_rates(masks, full.mean(axis=0)),
        "joint": kept_achieved.mean(axis=-1),
        "without_noise": clean.success.reshape(len(masks), EPISODES).mean(axis=-1),
        "with_noise": noisy.success.reshape(len(masks), EPISODES).mean(axis=-1),
    }


def calibrate(directory: RunDirectory) -> list[dict[str, Any]]:
    """One row per kept policy and mask, of all runs of a directory.

    Raises:
        ValueError: its runs differ in their settings or environments.
    """
    groups = directory.config.groups()
    (settings,) = {group.settings for group in groups}
    env = make_environment(settings)
    measure = jax.jit(functools.partial(success_per_mask, env))
    rows = []
    for run in (run for group in groups for run in group.runs):
        for epoch, path in kept_policies(directory, run):
            key = jax.random.fold_in(jax.random.key(run.hyper.seed), epoch)
            rates = measure(load_policy(path), run.hyper, key)
            columns = {column: np.asarray(values, float) for column, values in rates.items()}
            count = len(columns["product"])
            for mask in range(1, count):  # the empty mask succeeds by definition
                entry = {"run": run.name, "epoch": epoch}
                entry |= {"kept": mask_label(mask, count.bit_length() - 1)}
                rows.append(entry | {key: round(float(v[mask]), 4) for key, v in columns.items()})
    return rows


def kept_policies(directory: RunDirectory, run: Run) -> list[tuple[int, Path]]:
    """The policies with which a run became better than ever, by epoch."""
    paths = (directory.path / "policies" / "improvements").glob(f"{run.name}_epoch*.npz")
    return sorted((int(path.stem.rpartition("_epoch")[2]), path) for path in paths)


def draw(rows: list[dict[str, Any]]) -> Figure:
    """Estimated over measured success, a point per policy and mask."""
    figure, panels = plt.subplots(
        1, len(MEASURED), figsize=(10, 4.6), layout="constrained", sharey=True
    )
    kept = list(dict.fromkeys(row["kept"] for row in rows))
    colours = plt.get_cmap("turbo")(np.linspace(0.05, 0.95, len(kept)))
    for panel, (measured, title) in zip(panels, MEASURED.items(), strict=True):
        panel.plot([0, 1], [0, 1], color="grey", linewidth=0.8)
        for label, colour in zip(kept, colours, strict=True):
            same = [row for row in rows if row["kept"] == label]
            panel.scatter(
                [row[measured] for row in same],
                [row["product"] for row in same],
                s=14,
                alpha=0.6,
                linewidths=0,
                color=colour,
                label=label,
            )
        mean, bias = calibration_errors(rows)["product", measured]
        panel.set_title(f"{title}: off by {100 * mean:.1f} points, bias {100 * bias:+.1f}")
        panel.set_xlabel("measured success of the masked goal")
        panel.grid(alpha=0.25)
    panels[0].set_ylabel("estimated: product of sub-goal rates")
    panels[-1].legend(title="kept axes", fontsize=8, title_fontsize=8)
    return figure


def main(directory: Path, out: Path) -> None:
    """Write the table and the figure, and print the errors."""
    rows = calibrate(RunDirectory.open(directory))
    out.mkdir(parents=True, exist_ok=True)
    write_table(out / "calibration.csv", rows)
    figure = draw(rows)
    figure.savefig(out / "calibration.png", dpi=130)
    plt.close(figure)
    for (estimate, measured), (mean, bias) in calibration_errors(rows).items():
        print(f"{ESTIMATES[estimate]}, {MEASURED[measured]}: {mean:.3f} off, bias {bias:+.3f}")


if __name__ == "__main__":
    main(*paths("experiments.learning.calibration", __doc__, "run_dir", "out"))
