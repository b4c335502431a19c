import json
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest

from cgm_jax.loop.devices import Share, share, spread, team_of
from tests.cgm_jax.sweeps import (
    POINT_MASS,
    ROOT,
    assert_same_results,
    command,
    finish,
    rows,
)


@pytest.mark.parametrize(
    ("runs", "devices", "expected"),
    [
        (8, 2, Share(2, 4)),
        (3, 2, Share(2, 2)),  # and one row left over
        (3, 8, Share(3, 1)),  # no device without a run
        (9, 8, Share(5, 2)),  # as long as on eight devices, and one row left over in place of seven
        (1, 4, Share(1, 1)),
        (5, 1, Share(1, 5)),
    ],
)
def test_runs_are_shared_out(runs: int, devices: int, expected: Share) -> None:
    assert share(runs, devices) == expected


def test_what_is_spread_keeps_its_bits() -> None:
    key = jax.random.split(jax.random.key(0), 3)
    numbers, keys = spread(team_of(jax.devices()[:1]), (np.arange(3.0), key))
    np.testing.assert_array_equal(numbers[:3], [0.0, 1.0, 2.0])
    np.testing.assert_array_equal(jax.random.key_data(keys)[:3], jax.random.key_data(key))


def on_devices(directory: Path, *arguments: str) -> list[list[str]]:
    """Digests of runs, for each argument; see `tests.cgm_jax.loop.on_devices`."""
    words = [sys.executable, "-m", "tests.cgm_jax.loop.on_devices", str(directory), *arguments]
    result = subprocess.run(words, cwd=ROOT, check=True, capture_output=True, text=True)
    return json.loads(result.stdout)


@pytest.mark.slow
def test_a_run_has_the_same_bits_among_any_number_of_runs_and_devices(tmp_path: Path) -> None:
    # Alone; in turn; on as many devices; with rows left over; and resumed on others.
    cases = ("1:1", "5:1", "5:2", "5:3", "5:4", "5:3:2", "5:1:4")
    (alone,), *others = on_devices(tmp_path, *cases)
    assert len(set(others[0])) == 5
    assert others[0][0] == alone
    for case, digests in zip(cases[1:], others, strict=True):
        assert digests == others[0], case


@pytest.mark.slow
def test_a_sweep_has_the_same_bits_on_any_number_of_devices_and_in_unequal_parts(
    tmp_path: Path,
) -> None:
    outs = {name: tmp_path / name.replace(" ", "") for name in ("1", "2", "3", "4", "2 4")}
    for name, out in outs.items():
        devices, *side_by_side = name.split()
        options = ["--kappa", "4", "--seeds", "7", "--epochs", "2", "--devices", devices]
        options += ["--side-by-side", *side_by_side] if side_by_side else []
        finish(command(*options, "--out", str(out)))
    for name in ("2", "3", "4"):
        assert_same_results(outs["1"], outs[name])
    # Four runs, then three: on two devices as many rows, but programs of their own.
    parts = {(row["run"], row["epoch"]): row for row in rows(outs["2 4"])}
    assert parts == {(row["run"], row["epoch"]): row for row in rows(outs["1"])}


@pytest.mark.slow
def test_curricula_and_agents_of_one_sweep_train_as_they_do_alone(tmp_path: Path) -> None:
    options = ["--env", POINT_MASS, "--seed", "0", "--epochs", "2", "--devices", "1"]
    sweeps = {
        "curriculum": ["full", "uniform", "progress", "vds"],
        "agent": ["ddpg", "sac"],
    }
    for kind, names in sweeps.items():
        together = tmp_path / kind
        chosen = [*options, f"--{kind}"]
        finish(command(*chosen, *names, "--out", str(together)))
        found = rows(together)
        for name in names:
            finish(command(*chosen, name, "--out", str(tmp_path / name)))
            alone = rows(tmp_path / name)
            mine = [row for row in found if row[kind] == name]
            assert len(alone) == len(mine) >= 2
            # Which settings a sweep compares, and so what its rows tell, is not the runs' affair.
            for one, other in zip(alone, mine, strict=True):
                both = set(one) & set(other) - {"run", "swept"}
                assert {key: one[key] for key in both} == {key: other[key] for key in both}
        assert len({row["value"] for row in found if row["epoch"] == 2}) == len(found) // 2
