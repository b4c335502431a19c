"""Run directories, made up: what a sweep would leave, without training."""

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from tests.cgm_jax.results.figures.made import STEPS, Rates, run

SECONDS = 1.5
"""Of an epoch."""

EPISODES = 20
"""Of an evaluation."""

TROUBLE = "</script><img src=x onerror='document.title=1'>&amp;$title é"
"""What no name in a run directory may do to a page."""


def timed_run(rates: Rates, seed: int = 0, swept: Sequence[str] = (), **values: Any) -> list[Any]:
    """The rows of a run, with seconds."""
    metrics = {"wall_s": lambda epoch: SECONDS * epoch, "physics_warnings": 0}
    return run(rates, seed, swept, **metrics, **values)


def directory(
    path: Path,
    rows: Iterable[Mapping[str, Any]],
    epochs: int | None = None,
    **settings: Any,
) -> Path:
    """A run directory with these rows; its config has what they say of settings, and `settings`.

    Args:
        path: the directory to make.
        rows: of metrics.jsonl.
        epochs: how many were planned (default: the most that there are).
        settings: of all runs.
    """
    path.mkdir(parents=True)
    lines = list(rows)
    planned = {}
    for row in lines:
        names = ("env", "seed", "curriculum", "agent", "c_g", "kappa", "her", *row["swept"])
        planned[row["run"]] = {
            "name": row["run"],
            **{name: row[name] for name in names if row[name] is not None},
            "epochs": epochs or max(row["epoch"] for row in lines),
            "evaluation_episodes": EPISODES,
            "leave_at": None,
            **settings,
        }
    config = {
        "format": 2,
        "command": ["python", "-m", "cgm_jax.sweep"],
        "preset": "smoke",
        "started": "2026-11-25T12:00:00+00:00",
        "commit": "0123456789ab",
        "groups": [{"runs": [values]} for values in planned.values()],
    }
    (path / "config.json").write_text(json.dumps(config))
    (path / "metrics.jsonl").write_text("".join(json.dumps(row) + "\n" for row in lines))
    return path


def grid(path: Path, seeds: int = 3, epochs: int = 12) -> Path:
    """A directory of c_g x kappa and a baseline without CGM, with masks; seeds differ a little."""
    rows: list[Any] = []
    swept = ("curriculum", "c_g", "kappa")
    for seed in range(seeds):
        for c_g in (0.0, 0.1, 0.4):
            for kappa in (1.0, 32.0):
                half = 3 + abs(c_g - 0.1) * 12 + seed + (4 if kappa == 32.0 and c_g == 0.4 else 0)
                rows += timed_run(
                    rates(half, epochs),
                    seed,
                    swept,
                    c_g=c_g,
                    kappa=kappa,
                    critic_loss=lambda epoch: 1.0 / epoch,
                    **masks(half),
                )
        rows += timed_run(
            rates(9 + seed, epochs), seed, swept, curriculum="full", critic_loss=lambda e: 2.0 / e
        )
    return directory(path, sorted(rows, key=lambda row: row["epoch"]))


def rates(half: float, epochs: int) -> list[float]:
    """Success of whole evaluations that reaches a half in epoch `half`."""
    return [
        round(EPISODES / (1 + 2.718281828 ** (half - epoch))) / EPISODES
        for epoch in range(1, epochs + 1)
    ]


def masks(half: float, size: int = 3) -> dict[str, Any]:
    """Metrics per mask of so many goal dimensions, null for one that is never drawn."""
    count = 2**size

    def estimated(epoch: int) -> list[float]:
        share = 1 / (1 + 2.718281828 ** (half - epoch))
        return [share ** mask.bit_count() for mask in range(count)]

    def training(epoch: int) -> list[float | None]:
        return [None if mask == 1 else 0.8 * rate for mask, rate in enumerate(estimated(epoch))]

    return {
        "mask_rate_estimated": estimated,
        "mask_rate_training": training,
        "mask_probability": lambda _: [1 / count] * count,
    }


def troubled(path: Path) -> Path:
    """A directory of all that has ever misled: see the rows."""
    swept = ("batch_size", "env")
    rows: list[Any] = []
    for batch_size in range(20):  # twenty labels, a diverged one, single points and gaps among them
        values: dict[str, Any] = {"batch_size": 2**batch_size, "env": "reach"}
        values["run"] = f"<b>batch{batch_size}</b>".replace("/", "|")
        own = rates(3 + batch_size / 3, 10)
        if batch_size == 4:
            values |= {"failed_epoch": 5, "failure": f"critic is not finite {TROUBLE}"}
            own[5:] = [own[4]] * 5
        if batch_size == 5:
            own = [0.35]
        if batch_size == 6:
            own = [None, 0.5, None, None, 0.7, 0.7, None]
        rows += timed_run(own, 0, swept, **values)
    for seed in range(2):  # five goal dimensions, and what a curriculum of one's own reports
        rows += timed_run(
            rates(4, 10),
            seed,
            swept,
            run=f"five_seed{seed}",
            env=f"/tmp/{TROUBLE}/mine.py:Five",
            batch_size=1,
            curriculum="/tmp/mine.py:Windows",
            window=[0.1, 0.2, 0.3],
            window_rate=lambda epoch: [epoch / 10, None, 0.5],
            surprise=lambda epoch: None if epoch < 3 else 1e-4 / epoch,
            reported=["surprise", "window", "window_rate"],
            **masks(4, size=5),
        )
    return directory(path, sorted(rows, key=lambda row: row["epoch"]), epochs=11)


def follow_on(path: Path, more: int) -> None:
    """Append so many epochs of no success to all runs of a directory."""
    rows = [json.loads(line) for line in (path / "metrics.jsonl").read_text().splitlines()]
    last = {row["run"]: row for row in rows}
    with (path / "metrics.jsonl").open("a") as file:
        for row in last.values():
            for epoch in range(row["epoch"] + 1, row["epoch"] + 1 + more):
                new = row | {"epoch": epoch, "env_steps": STEPS * epoch, "success_rate": 0.0}
                file.write(json.dumps(new) + "\n")
