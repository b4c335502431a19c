import json
from pathlib import Path
from typing import Any

import pytest

from cgm_jax.config.grid import build_groups, split
from cgm_jax.results.page.sweeps import read_sweep
from cgm_jax.storage.layout import CONFIG, METRICS
from cgm_jax.storage.run_directory import RunDirectory
from experiments.learning import records

RATES: list[float | None] = [1.0, 0.12345, None]


def trained(
    path: Path, options: dict[str, list[Any]], rates: list[list[float | None]], **metrics: Any
) -> None:
    """A directory of two seeds, each of which got as far as its success rates go."""
    (group,) = build_groups("smoke", {"kappa": [4.0], "seed": [0, 1], "epochs": [5], **options})
    with RunDirectory.claimed(path, fresh=True) as directory:
        directory.config.write(split(group, 1), "smoke", "cpu")
    fixed = {"env": "reach", "c_g": 0.1, "kappa": 4.0, "her": True, "cgm": True, "wall_s": 1.5}
    fixed |= {"curriculum": "cgm", "agent": "ddpg"}
    fixed |= {"physics_warnings": 0.0, "failed_epoch": None, **metrics}
    fixed |= dict.fromkeys(("mask_rate_estimated", "mask_rate_training", "mask_probability"), RATES)
    rows = [
        {
            **fixed,
            **{"run": run.name, "seed": run.hyper.seed, "success_rate": rate},
            **{"epoch": epoch, "env_steps": 100 * epoch, "updates": epoch},
        }
        for run, curve in zip(group.runs, rates, strict=True)
        for epoch, rate in enumerate(curve, start=1)
    ]
    (path / METRICS).write_text("".join(json.dumps(row) + "\n" for row in rows))


def record(path: Path, name: str) -> None:
    """Record a directory, as one that was planned."""
    config = json.loads((path / CONFIG).read_text())
    planned = [settings for _, settings in records.settings_by_run(config)]
    records.record(RunDirectory(path), name, planned)


@pytest.fixture(autouse=True)
def _apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(records, "SWEEPS", tmp_path / "sweeps")


def test_rows_of_runs_that_are_done_come_back_as_they_were(tmp_path: Path) -> None:
    trained(tmp_path / "run", {}, [[0.0, 0.25, None, 0.5, 1.0], [0.0, 0.1]])
    record(tmp_path / "run", "mine")
    (run,) = records.recorded_runs("mine")  # seed 1 is not done
    assert (run.sweep, run.seed, run.alone, run.budget) == ("mine", 0, True, 500)
    assert [row["success_rate"] for row in run.rows] == [0.0, 0.25, None, 0.5, 1.0]
    originals = RunDirectory(tmp_path / "run").metrics()[:5]
    rounded = [1.0, 0.123, None]
    for row, original in zip(run.rows, originals, strict=True):
        rates = {name: rounded for name, value in original.items() if isinstance(value, list)}
        assert row == {**original, **rates}
        assert {name: type(value) for name, value in row.items()} == {
            name: type(value) for name, value in original.items()
        }


def test_a_run_that_left_early_is_done(tmp_path: Path) -> None:
    trained(tmp_path / "run", {"leave_at": [0.5]}, [[0.0, 0.4, 0.6, 0.5], [0.0, 0.4, 0.6, 0.4]])
    record(tmp_path / "run", "mine")
    (run,) = records.recorded_runs("mine")
    assert (run.seed, len(run.rows), run.settings["leave_at"], run.budget) == (0, 4, 0.5, 500)


def test_a_column_that_a_version_wrote_is_kept_and_one_that_it_did_not_is_absent(
    tmp_path: Path,
) -> None:
    trained(tmp_path / "run", {}, [[1.0] * 5] * 2, moved_share=0.4375)
    record(tmp_path / "run", "new")
    trained(tmp_path / "older", {}, [[1.0] * 5] * 2)
    record(tmp_path / "older", "old")
    assert [row["moved_share"] for row in records.recorded_runs("new")[1].rows] == [0.4375] * 5
    assert "moved_share" not in records.recorded_runs("old")[0].rows[0]


def test_settings_that_an_older_version_had_not_are_at_their_defaults(tmp_path: Path) -> None:
    trained(tmp_path / "run", {"leave_at": [0.5]}, [[1.0] * 5] * 2)
    record(tmp_path / "run", "mine")
    path = tmp_path / "sweeps" / "mine" / CONFIG
    config = json.loads(path.read_text())
    before = [settings for _, settings in records.recorded_settings("mine")]
    for group in config["groups"]:
        for run in group["runs"]:
            del run["leave_at"], run["her_filter"]
    path.write_text(json.dumps(config))
    after = [settings for _, settings in records.recorded_settings("mine")]
    assert [run["leave_at"] for run in before] == [0.5, 0.5]
    assert after == [{**run, "leave_at": None, "her_filter": False} for run in before]


def test_runs_of_the_first_format_have_the_settings_and_rows_of_today(tmp_path: Path) -> None:
    shared = {"env": "push", "epochs": 1, "hidden_layers": [8, 8], "leave_at": None}
    run = {"seed": 0, "cgm": True, "c_g": 0.2, "kappa": 4.0, "her": False, "her_k": 6.0}
    runs = [
        {**run, "name": "cgm"},
        {**run, "name": "full", "cgm": False, "c_g": 0.1},
        {**run, "name": "uniform", "kappa": 0.0},
    ]
    folder = tmp_path / "sweeps" / "old"
    folder.mkdir(parents=True)
    config = {"groups": [{"settings": shared, "runs": runs}]}
    (folder / CONFIG).write_text(json.dumps(config))
    columns = "run,env,seed,epoch,env_steps,her,cgm,c_g,kappa,success_rate\n"
    lines = [f"{r['name']},push,0,1,100,False,True,0.1,0.0,0.5\n" for r in runs]
    (folder / records.LEARNING).write_text(columns + "".join(lines))
    cgm, full, uniform = records.recorded_runs("old")
    assert [one.settings["curriculum"] for one in (cgm, full, uniform)] == [
        "cgm",
        "full",
        "uniform",
    ]
    assert (cgm.settings["c_g"], cgm.settings["kappa"], cgm.settings["agent"]) == (0.2, 4.0, "ddpg")
    assert (cgm.settings["hidden_layers"], cgm.alone) == ([8, 8], False)
    assert {"c_g", "kappa"}.isdisjoint({*full.settings, *uniform.settings})
    assert "her_k" not in cgm.settings  # without effect, as HER is off
    (row,) = uniform.rows
    assert (row["cgm"], row["curriculum"], row["c_g"], row["success_rate"]) == (
        *(False, "uniform", None, 0.5),
    )


def test_runs_are_the_same_whatever_their_order_and_what_has_no_effect() -> None:
    one, other = ({"env": "push", "her": False, "seed": seed} for seed in (0, 1))
    planned = [records.settings_from(one), records.settings_from({**other, "her_k": 3.0})]
    assert records.same_runs(planned, [records.settings_from(run) for run in (other, one)])
    assert not records.same_runs(planned, planned[:1])
    assert not records.same_runs(planned, [planned[0], {**planned[1], "discount": 0.9}])


def test_an_environment_of_these_experiments_is_the_same_in_every_checkout(tmp_path: Path) -> None:
    name = "experiments/learning/sliders.py:Sliders"
    checkout = str(Path(records.__file__).parents[2])
    trained(tmp_path / "run", {"env": [f"{checkout}/{name}"]}, [[1.0] * 5] * 2)
    assert checkout in (tmp_path / "run" / CONFIG).read_text()
    record(tmp_path / "run", "mine")
    assert checkout not in (tmp_path / "sweeps" / "mine" / CONFIG).read_text()
    assert {settings["env"] for _, settings in records.recorded_settings("mine")} == {name}
    here = records.settings_from({"env": f"/else/where/{name}"})
    assert here["env"] == name


def test_where_runs_lay_is_not_recorded(tmp_path: Path) -> None:
    trained(tmp_path / "run", {}, [[0.0] * 5, [0.0] * 5], env="/home/me/experiments/a.py:A")
    config = json.loads((tmp_path / "run" / CONFIG).read_text())
    words = ["python", "-m", "cgm_jax.sweep", "--epochs", "5", "--out", "/home/me/a/run", "--csv"]
    (tmp_path / "run" / CONFIG).write_text(json.dumps({**config, "command": words}, indent=2))
    record(tmp_path / "run", "mine")
    recorded = json.loads((tmp_path / "sweeps" / "mine" / CONFIG).read_text())
    assert recorded["command"] == [*words[:6], "runs/run", "--csv"]
    table = (tmp_path / "sweeps" / "mine" / records.LEARNING).read_text()
    assert ",experiments/a.py:A," in table
    assert "/home/me" not in table


def test_a_setting_that_no_version_had_is_named() -> None:
    with pytest.raises(ValueError, match="warp_drive"):
        records.settings_from({"seed": 0, "warp_drive": True})


def test_nothing_done_leaves_the_record_of_before(tmp_path: Path) -> None:
    trained(tmp_path / "first", {}, [[1.0] * 5] * 2)
    trained(tmp_path / "second", {}, [[1.0], []])
    for name in ("first", "second"):
        record(tmp_path / name, "mine")
    assert [len(run.rows) for run in records.recorded_runs("mine")] == [5, 5]
    assert records.recorded_runs("another") == []
    assert (tmp_path / "sweeps" / "mine" / CONFIG).is_file()


def test_a_run_that_is_on_record_is_not_lost_to_a_directory_without_it(tmp_path: Path) -> None:
    trained(tmp_path / "whole", {}, [[0.5] * 5] * 2)
    trained(tmp_path / "part", {}, [[1.0] * 5, [1.0] * 4])
    trained(tmp_path / "more", {}, [[1.0] * 5] * 2)
    record(tmp_path / "whole", "mine")
    assert records.is_whole("mine")
    with pytest.raises(ValueError, match="seed1 is on record and not done here"):
        record(tmp_path / "part", "mine")
    assert [run.rows[-1]["success_rate"] for run in records.recorded_runs("mine")] == [0.5, 0.5]
    record(tmp_path / "part", "new")
    assert not records.is_whole("new")
    assert not records.is_whole("none")
    for name in ("mine", "new"):  # trained again, and further
        record(tmp_path / "more", name)
        assert [run.rows[-1]["success_rate"] for run in records.recorded_runs(name)] == [1.0, 1.0]


def test_a_run_that_is_now_planned_for_longer_is_not_lost_either(tmp_path: Path) -> None:
    trained(tmp_path / "before", {}, [[0.5] * 5] * 2)
    trained(tmp_path / "now", {"epochs": [6]}, [[1.0] * 6, [1.0] * 5])
    record(tmp_path / "before", "mine")
    with pytest.raises(ValueError, match="seed1 is on record and not done here"):
        record(tmp_path / "now", "mine")
    assert [len(run.rows) for run in records.recorded_runs("mine")] == [5, 5]


def test_a_run_that_is_planned_no_more_may_go(tmp_path: Path) -> None:
    trained(tmp_path / "before", {}, [[0.5] * 5] * 2)
    trained(tmp_path / "now", {"discount": [0.9]}, [[1.0] * 5, []])
    for name in ("before", "now"):
        record(tmp_path / name, "mine")
    (run,) = records.recorded_runs("mine")
    assert (run.settings["discount"], run.rows[-1]["success_rate"]) == (0.9, 1.0)


def test_other_runs_than_are_planned_are_not_recorded(tmp_path: Path) -> None:
    trained(tmp_path / "run", {}, [[1.0] * 5] * 2)
    planned = [records.settings_from({"env": "reach", "seed": 0})]
    with pytest.raises(ValueError, match="other runs than are planned for mine"):
        records.record(RunDirectory(tmp_path / "run"), "mine", planned)
    assert records.recorded_runs("mine") == []


def test_a_sweep_that_was_stopped_before_its_first_evaluation_has_nothing_done(
    tmp_path: Path,
) -> None:
    trained(tmp_path / "run", {}, [[1.0] * 5] * 2)
    (tmp_path / "run" / METRICS).unlink()
    record(tmp_path / "run", "mine")
    assert records.recorded_runs("mine") == []


def test_an_engine_that_was_chosen_by_itself_was_the_one_for_the_cpu(tmp_path: Path) -> None:
    for env, engine, recorded in (
        *(("push", "auto", "native"), ("push", "mjx", "mjx")),
        (f"{Path(records.__file__).parent / 'sliders.py'}:Sliders", "auto", "auto"),
    ):
        name = f"{Path(env).stem}-{engine}"
        trained(tmp_path / name, {"env": [env], "engine": [engine]}, [[1.0] * 5] * 2)
        record(tmp_path / name, name)
        assert {s["engine"] for _, s in records.recorded_settings(name)} == {recorded}


def test_a_record_becomes_a_run_directory_again(tmp_path: Path) -> None:
    trained(tmp_path / "run", {}, [[0.0, 0.2, None, 0.6, 0.8], [0.0, 0.0, 0.4, 0.5, 1.0]])
    record(tmp_path / "run", "kept")
    records.restore("kept", tmp_path / "again")
    before, again = read_sweep(tmp_path / "run"), read_sweep(tmp_path / "again")
    assert again.finished
    assert again.planned == before.planned
    for name in ("run", "epoch", "env_steps", "success_rate", "wall_s"):
        columns = [
            [row[name] for run in sweep.runs for row in run.rows] for sweep in (before, again)
        ]
        assert columns[0] == columns[1], name
