"""Runs on record, made up."""

from collections.abc import Sequence
from typing import Any

from experiments.learning.records import RecordedRun, settings_from
from experiments.learning.setting import USUAL_LAYERS

EVERY = 1000
"""Environment steps between evaluations."""


def run(
    rates: Sequence[float | None], seed: int = 0, sweep: str = "one", **settings: Any
) -> RecordedRun:
    """A run on push with HER that was evaluated every 1,000 environment steps and 2 seconds."""
    usual = {"env": "push", "her_filter": True, "hidden_layers": USUAL_LAYERS}
    shared = {**usual, "epochs": len(rates)}
    values = settings_from({**shared, **settings, "seed": seed})
    rows = [
        {
            "run": f"{sweep}_seed{seed}",
            "epoch": epoch,
            "env_steps": EVERY * epoch,
            "wall_s": 2.0 * epoch,
            "success_rate": rate,
        }
        for epoch, rate in enumerate(rates, start=1)
    ]
    return RecordedRun(sweep, f"{sweep}_seed{seed}", values, rows, alone=True)
