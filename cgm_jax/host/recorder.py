"""What a group of runs leaves on the disk while it trains."""

import sys
import time
from collections.abc import Iterator, Sequence
from typing import Any

import jax
import numpy as np

from cgm_jax.config.grid import Group, Run, idle_settings
from cgm_jax.host.checkpoint import TrainingProgress, save_checkpoint
from cgm_jax.loop.divergence import describe_failure
from cgm_jax.loop.evaluation import Metrics
from cgm_jax.loop.state import TrainingState
from cgm_jax.results.tracking import Tracking
from cgm_jax.storage.metrics import Row, plain_row
from cgm_jax.storage.policies import policy_arrays
from cgm_jax.storage.run_directory import RunDirectory


class Recorder:
    """Writes the metrics, policies and checkpoints of one group of runs.

    Attributes:
        save_seconds: what the last checkpoint took to write; before the first a guess.
    """

    def __init__(
        self,
        directory: RunDirectory,
        group: Group,
        index: int,
        rows: Sequence[Row],
        checkpoint_seconds: float,
        swept: Sequence[str],
        tracking: Tracking,
    ) -> None:
        """Record a group of runs.

        Args:
            directory: where to.
            group: the runs.
            index: number of the group in its sweep.
            rows: what it has written so far.
            checkpoint_seconds: least time between two checkpoints.
            swept: names of the settings in which runs of the whole sweep differ.
            tracking: is sent the rows, those written so far included.
        """
        self._directory = directory
        self._group = group
        self._index = index
        self._facts = [_facts(run, swept) for run in group.runs]
        self._interval = checkpoint_seconds
        self._saved = time.monotonic()
        self.save_seconds = 1.0
        self._config = directory.config.read_bytes()  # as it was when training began
        self._best = {run.name: 0.0 for run in group.runs}
        for row in rows:
            self._improves(row)
        self._tracking = tracking
        tracking.begin(group.runs, rows)

    def record_epoch(self, training: TrainingProgress, metrics: Metrics) -> list[Row]:
        """Add an epoch's rows, and keep the policies that are better than all before.

        Raises:
            OSError: the metrics cannot be written.
        """
        rows = _rows(self._group, self._facts, training, metrics)
        training.rows += rows
        self._directory.append_metrics(rows)
        self._tracking.send(rows)
        improved = [i for i, row in enumerate(rows) if self._improves(row)]
        if improved:
            policies = list(_policies(self._group, training.state))
            for i in improved:
                self._directory.write_improvement(self._group.runs[i], training.epoch, policies[i])
        for run, row in zip(self._group.runs, rows, strict=True):
            if row["failed_epoch"] == training.epoch:
                note = f"{run.name} diverged in epoch {training.epoch}: {row['failure']}"
                print(f"{note}; it learns no more, the others continue", file=sys.stderr)
        return rows

    def unsaved_seconds(self) -> float:
        """Since the last checkpoint, or since recording began."""
        return time.monotonic() - self._saved

    def save_if_due(self, training: TrainingProgress) -> bool:
        """Write a checkpoint if the last one is old; whether it has been written.

        If that fails, say so and continue.
        """
        return self.unsaved_seconds() >= self._interval and self.try_to_save(training)

    def try_to_save(self, training: TrainingProgress) -> bool:
        """Write policies and a checkpoint; if that fails, say so, continue, and return false."""
        try:
            self.save(training)
        except OSError as error:
            self._saved = time.monotonic()
            print(
                f"no checkpoint written ({error.strerror}); the one before stays, "
                "and training continues",
                file=sys.stderr,
            )
            return False
        return True

    def save(self, training: TrainingProgress) -> None:
        """Write policies and a checkpoint.

        Raises:
            OSError: they cannot be written.
        """
        began = time.monotonic()
        for run, policy in zip(
            self._group.runs, _policies(self._group, training.state), strict=True
        ):
            self._directory.write_policy(run, policy)
        checkpoints = self._directory.path / "checkpoints"
        save_checkpoint(checkpoints, self._index, training, self._config)
        self._saved = time.monotonic()
        self.save_seconds = self._saved - began

    def _improves(self, row: Row) -> bool:
        """Whether a row shows more success than all rows of its run before."""
        success = row["success_rate"] or 0.0
        better = success > self._best[row["run"]]
        if better:
            self._best[row["run"]] = success
        return better


def _policies(group: Group, state: TrainingState) -> Iterator[dict[str, np.ndarray]]:
    """The policy of every run, in order."""
    agent, normaliser = jax.tree.map(np.asarray, (state.agent, state.normaliser))
    for i, run in enumerate(group.runs):
        own, statistics = jax.tree.map(lambda leaf, i=i: leaf[i], (agent, normaliser))
        actor = run.hyper.agent.actor(own)
        yield policy_arrays(actor, statistics, mask_input=group.settings.mask_input)


def _rows(
    group: Group, facts: Sequence[dict[str, Any]], training: TrainingProgress, metrics: Metrics
) -> list[Row]:
    arrays = {name: np.asarray(value) for name, value in metrics.items()}
    failures = arrays.pop("failure")
    before = {row["run"]: row["failed_epoch"] for row in training.rows[-len(facts) :]}
    reported = _reported(group, training.state)
    rows = []
    for i, own in enumerate(facts):
        failed = bool(failures[i])
        values = {
            **own,
            "epoch": training.epoch,
            "wall_s": round(training.wall_s, 3),
            **dict.fromkeys(MASK_METRICS),
            # A setting is what it is, whatever a curriculum reports under its name.
            **{name: values[i] for name, values in arrays.items() if name not in own},
            "failed_epoch": (before.get(own["run"]) or training.epoch) if failed else None,
            "failure": describe_failure(int(failures[i]), training.state.agent) if failed else None,
            "reported": reported,
        }
        rows.append(plain_row(values))
    return rows


MASK_METRICS = ("mask_rate_estimated", "mask_rate_training", "mask_probability", "mask_share")
"""Per mask [2^n]; null where a curriculum has no such thing, or 2^n is too many."""


def _reported(group: Group, state: TrainingState) -> list[str]:
    """Names of what the curriculum's own report adds to a row."""
    settings = group.runs[0].hyper.curriculum
    own = jax.tree.map(
        lambda leaf: jax.ShapeDtypeStruct(leaf.shape[1:], leaf.dtype), state.curriculum
    )
    return sorted(jax.eval_shape(lambda one, state: one.report(state), settings, own))


ALWAYS = ("env", "seed", "curriculum", "agent", "c_g", "kappa", "her")
"""Settings that every row has."""


def _facts(run: Run, swept: Sequence[str]) -> dict[str, Any]:
    """What a row says of its run: null for a setting that the run does not have.

    Further settings that the sweep varies are null where they have no effect, too.
    """
    values = run.values
    idle = idle_settings(run.hyper)
    further = {
        name: None if name in idle else values.get(name) for name in swept if name not in ALWAYS
    }
    return {
        "run": run.name,
        **{name: values.get(name) for name in ALWAYS},
        "cgm": values["curriculum"] == "cgm",
        **further,
        "swept": list(swept),
    }
