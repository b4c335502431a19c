import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cgm_jax.results.figures.runs import TrainedRun
from cgm_jax.results.page.data import page_data
from cgm_jax.results.page.series import arrays_of
from cgm_jax.results.page.success import final_success
from cgm_jax.results.page.sweeps import labels_of, read_sweep
from cgm_jax.results.statistics import quartiles, wilson_interval
from tests.cgm_jax.results.page.made import (
    EPISODES,
    STEPS,
    directory,
    grid,
    masks,
    timed_run,
    troubled,
)


def data_of(*paths: Path) -> dict[str, Any]:
    """As the page gets it: through JSON."""
    return json.loads(json.dumps(page_data([read_sweep(path) for path in paths]), allow_nan=False))


def texts(data: dict[str, Any], group: dict[str, Any]) -> dict[str, str | None]:
    """A group's values of all settings, as the page shows them."""
    return {
        setting["name"]: None if index is None else setting["values"][index]["text"]
        for setting, index in zip(data["settings"], group["values"], strict=True)
    }


def test_every_number_of_metrics_is_in_the_data(tmp_path: Path) -> None:
    path = grid(tmp_path / "run")
    data = data_of(path)
    rows: dict[str, list[Any]] = {}
    for line in (path / "metrics.jsonl").read_text().splitlines():
        row = json.loads(line)
        rows.setdefault(row["run"], []).append(row)
    assert {run["name"] for run in data["runs"]} == rows.keys()
    for run in data["runs"]:
        own = rows[run["name"]]
        for name in ("epoch", "env_steps", "wall_s", "success_rate", "critic_loss"):
            assert run["columns"][name] == [row[name] for row in own], name
        for name in ("mask_probability", "mask_rate_estimated", "mask_rate_training"):
            if own[0].get(name) is None:
                assert name not in run["arrays"]
            else:
                array = run["arrays"][name]
                assert array["values"] == np.array([row[name] for row in own]).T.tolist()
                assert array["labels"] == ["none", "z", "y", "y z", "x", "x z", "x y", "x y z"]
        last = [row["success_rate"] for row in own[-3:]]
        assert run["final"]["rate"] == pytest.approx(sum(last) / 3)
        successes = round(sum(last) * EPISODES)
        interval = run["final"]["low"], run["final"]["high"]
        assert interval == wilson_interval(successes, 3 * EPISODES)


def test_runs_that_differ_in_the_seed_only_are_one_group(tmp_path: Path) -> None:
    data = data_of(grid(tmp_path / "run", seeds=2))
    names = [setting["name"] for setting in data["settings"]]
    assert names == ["curriculum", "c_g", "kappa"]
    assert len(data["groups"]) == 7
    for group in data["groups"]:
        assert [data["runs"][i]["seed"] for i in group["runs"]] == [0, 1]
        rates = [data["runs"][i]["final"]["rate"] for i in group["runs"]]
        assert group["final"] == {"median": quartiles(rates)[1]}
    shown = [texts(data, group) for group in data["groups"]]
    assert {"curriculum": "CGM", "c_g": "10 %", "kappa": "32"} in shown
    assert {"curriculum": "full goals", "c_g": None, "kappa": None} in shown


def test_six_seeds_give_an_interval_of_the_median(tmp_path: Path) -> None:
    rows = [row for seed in range(6) for row in timed_run([seed / 10] * 3, seed)]
    (group,) = data_of(directory(tmp_path / "run", rows))["groups"]
    assert group["final"] == pytest.approx({"median": 0.25, "low": 0.0, "high": 0.5})


def test_same_names_in_two_directories_stay_apart(tmp_path: Path) -> None:
    rows = timed_run([0.0, 0.5, 1.0])
    one = directory(tmp_path / "a/run", rows, batch_size=16)
    other = directory(tmp_path / "b/run", timed_run([0.0] * 3), batch_size=32)
    data = data_of(one, other)
    assert [sweep["label"] for sweep in data["sweeps"]] == ["a/run", "b/run"]
    assert [group["runs"] for group in data["groups"]] == [[0], [1]]
    assert [texts(data, group) for group in data["groups"]] == [
        {"sweep": "a/run", "batch_size": "16"},
        {"sweep": "b/run", "batch_size": "32"},
    ]
    assert [setting["between"] for setting in data["settings"]] == [False, True]
    assert {"title": "batch size", "values": ["16", "32"]} in data["differences"]
    assert ["evaluation episodes", str(EPISODES)] in data["common"]


def test_runs_that_nothing_tells_apart_are_not_pooled(tmp_path: Path) -> None:
    rows = timed_run([0.0] * 3, run="one") + timed_run([1.0] * 3, run="two")
    assert [group["runs"] for group in data_of(directory(tmp_path / "run", rows))["groups"]] == [
        [0],
        [1],
    ]


def test_rows_that_do_not_say_what_was_swept_are_told_by_the_config(tmp_path: Path) -> None:
    rows = [*timed_run([0.0] * 3, run="one"), *timed_run([1.0] * 3, run="two")]
    path = directory(tmp_path / "run", rows)
    config = json.loads((path / "config.json").read_text())
    for group, size in zip(config["groups"], (16, 32), strict=True):
        group["runs"][0]["batch_size"] = size
    (path / "config.json").write_text(json.dumps(config))
    for row in rows:
        del row["swept"]
    (path / "metrics.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    data = data_of(path)
    assert [texts(data, group) for group in data["groups"]] == [
        {"batch_size": "16"},
        {"batch_size": "32"},
    ]


def test_the_first_format_is_read(tmp_path: Path) -> None:
    rows = timed_run([0.0, 0.5, 1.0])
    path = directory(tmp_path / "run", rows)
    settings = {"env": "reach", "epochs": 3, "evaluation_episodes": 7}
    own = {"seed": 0, "c_g": 0.1, "kappa": 32.0, "cgm": True, "her": True}
    group = {"settings": settings, "runs": [{"name": rows[0]["run"], **own}]}
    (path / "config.json").write_text(json.dumps({"preset": "quick", "groups": [group]}))
    for row in rows:
        for name in ("swept", "curriculum", "agent"):
            del row[name]
    (path / "metrics.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    data = data_of(path)
    assert data["runs"][0]["final"]["episodes"] == 21
    assert ["curriculum", "CGM"] in data["common"]
    assert data["sweeps"][0]["finished"]


@pytest.mark.parametrize(
    ("entries", "episodes"),
    [
        ({"physics_warnings": 0}, 60),
        ({"physics_warnings": 2}, None),  # whose episodes is not known
        ({"physics_warnings": 2, "evaluated_episodes": 20}, 60),  # training's
        ({"physics_warnings": 0, "evaluated_episodes": 19}, None),  # one was over at its start
    ],
)
def test_final_success_has_an_interval_where_all_episodes_were_valid(
    entries: dict[str, int], episodes: int | None
) -> None:
    rows = [{"success_rate": rate, **entries} for rate in (0.0, 0.8, 0.9, 1.0)]
    final = final_success(TrainedRun("run", 0, {}, rows), {"evaluation_episodes": 20})
    assert final["rate"] == pytest.approx(0.9)
    assert final.get("episodes") == episodes
    assert ("low" in final) == (episodes is not None)


@pytest.mark.parametrize("episodes", [10**6 + 1, 10**19, 10**400, 0, 20.0, "20"], ids=range(6))
def test_final_success_has_no_interval_where_episodes_are_no_number_of_any(episodes: Any) -> None:
    rows = [{"success_rate": 0.5, "physics_warnings": 0}] * 3
    final = final_success(TrainedRun("run", 0, {}, rows), {"evaluation_episodes": episodes})
    assert final == {"rate": 0.5, "evaluations": 3, "never_valid": False}


def test_a_run_without_a_valid_episode_is_told_from_one_without_success() -> None:
    for rates, never in (
        ([None, None], True),
        ([0.0, 0.0], False),
        ([0.5, None, None, None], False),
    ):
        rows = [{"success_rate": rate} for rate in rates]
        final = final_success(TrainedRun("run", 0, {}, rows), {})
        assert (final["rate"], final["never_valid"]) == (0.0, never)


@pytest.mark.parametrize(
    ("c_g", "text"),
    [(1e308, "1e+308"), (10**308, "1e+308"), (0.4, "40 %")],
    ids=["real", "whole", "share"],
)
def test_a_share_beyond_all_numbers_is_shown_as_it_is(
    c_g: float, text: str, tmp_path: Path
) -> None:
    rows = timed_run([0.5], 0, ("c_g",), c_g=0.1) + timed_run(
        [0.5], 0, ("c_g",), c_g=c_g, run="other"
    )
    (setting,) = data_of(directory(tmp_path / "run", rows))["settings"]
    assert [value["text"] for value in setting["values"]] == ["10 %", text]
    numbers = [value["number"] for value in setting["values"]]
    assert numbers == ([10.0, 40.0] if c_g == 0.4 else [None, None])


def test_what_has_misled_before(tmp_path: Path) -> None:
    data = data_of(troubled(tmp_path / "run"))
    runs = {run["name"]: run for run in data["runs"]}
    assert runs["<b>batch4<|b>"]["failed"]["epoch"] == 5
    assert runs["<b>batch5<|b>"]["columns"]["success_rate"] == [0.35]
    gaps = runs["<b>batch6<|b>"]
    assert gaps["columns"]["success_rate"] == [None, 0.5, None, None, 0.7, 0.7, None]
    assert "episodes" not in gaps["final"]  # episodes were dropped, and no row says how many
    five = runs["five_seed0"]["arrays"]
    assert five["mask_rate_estimated"]["labels"] == ["0", "1", "2", "3", "4", "0 1 2 3 4"]
    assert five["mask_rate_estimated"]["total"] == 32
    whole = masks(4, size=5)["mask_rate_estimated"](10)
    shown = [column[-1] for column in five["mask_rate_estimated"]["values"]]
    assert shown == [whole[i] for i in (16, 8, 4, 2, 1, 31)]
    assert five["window_rate"]["labels"] == ["0.1", "0.2", "0.3"]
    assert five["window_rate"]["values"][1] == [None] * 10
    assert runs["five_seed0"]["columns"]["surprise"][:3] == [None, None, pytest.approx(1e-4 / 3)]
    (sweep,) = data["sweeps"]
    assert (sweep["runs"], sweep["failed"], sweep["finished"]) == (22, 1, False)
    assert sweep["env_steps"] == STEPS * (18 * 10 + 1 + 7 + 2 * 10)


def test_a_sweep_is_finished_once_all_runs_of_a_group_may_leave(tmp_path: Path) -> None:
    rows = timed_run([0.5] * 3, 0) + timed_run([0.4] * 3, 1)
    held = directory(tmp_path / "held", rows[:3], epochs=9, leave_at=0.5)
    one_of_two = directory(tmp_path / "one", rows, epochs=9, leave_at=0.5)
    assert read_sweep(held).finished
    assert not read_sweep(one_of_two).finished


def test_rows_of_an_array_whose_names_are_alike_are_told_apart_by_number() -> None:
    for second, labels in (
        (0.0501, ["0.05", "0.0501", "1"]),
        (0.05001, ["0: 0.05", "1: 0.05", "2: 1"]),
    ):
        row = {"threshold": [0.05, second, 1.0], "threshold_rate": [0.1, 0.2, 0.3]}
        run = TrainedRun("run", 0, {}, [{"epoch": 1, "success_rate": 0.5, **row}])
        assert arrays_of(run)["threshold_rate"]["labels"] == labels


def test_labels_of_directories_are_as_short_as_tells_them_apart() -> None:
    assert labels_of([Path("/x/a"), Path("/x/b")]) == ["a", "b"]
    assert labels_of([Path("/x/a/r"), Path("/x/b/r"), Path("/c")]) == ["a/r", "b/r", "c"]
    assert labels_of([Path("/1/a/r"), Path("/2/a/r")]) == ["1/a/r", "2/a/r"]
