"""A user's own curriculum, agent and relabelling, from the command line to checkpoints."""

import functools
import itertools
import json
import os
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cgm_jax import sweep
from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import build_groups
from cgm_jax.host import jobs, recorder, session
from cgm_jax.results import figures
from cgm_jax.storage.policies import load_policy
from tests.cgm_jax.shared_programs import shared_programs
from tests.cgm_jax.sweeps import POINT_MASS

GROWING = f"{Path(__file__).with_name('my_curriculum.py')}:Growing"
AGENT = f"{Path(__file__).with_name('my_agent.py')}:MyAgent"
RELABELLING = f"{Path(__file__).with_name('my_relabelling.py')}:Final"
OPTIONS = ["--preset", "smoke", "--env", POINT_MASS, "--curriculum", GROWING, "--agent", AGENT]
OPTIONS += ["--relabelling", RELABELLING, "--epochs", "2", "--cycles-per-epoch", "1"]


def test_its_own_setting_is_swept_in_one_program() -> None:
    options = {"env": [POINT_MASS], "curriculum": [GROWING], "gain": [0.5, 0.7]}
    (group,) = build_groups("smoke", options)
    assert [run.hyper.curriculum.gain for run in group.runs] == [0.5, 0.7]
    names = [run.name for run in group.runs]
    assert names == [
        f"point_mass-PointMass_ddpg-her_my_curriculum-Growing_gain{gain}_seed0"
        for gain in ("0.5", "0.7")
    ]


def test_its_file_is_found_again_from_any_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(Path(__file__).parent)
    options = {"env": [POINT_MASS], "curriculum": ["my_curriculum.py:Growing"]}
    ((run,),) = (group.runs for group in build_groups("smoke", options))
    assert run.values["curriculum"] == GROWING


def test_a_wrong_value_and_another_curriculums_setting_are_refused() -> None:
    chosen = {"env": [POINT_MASS], "curriculum": [GROWING]}
    with pytest.raises(SettingError, match=r"gain: 1\.5 is not within \[0, 1\]"):
        build_groups("smoke", {**chosen, "gain": [1.5]})
    with pytest.raises(SettingError, match="c_g: is no setting of curriculum"):
        build_groups("smoke", {**chosen, "c_g": [0.1]})


def test_it_trains_stops_and_resumes_by_the_command_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    patient = functools.partial(session.Interruption, patience=300.0)
    monkeypatch.setattr(session, "Interruption", patient)
    monkeypatch.setattr(figures, "draw_figures", lambda _: None)
    monkeypatch.setattr(jobs, "make_environment", functools.cache(jobs.make_environment))
    record = recorder.Recorder.record_epoch

    def stop(self: Any, training: Any, metrics: Any) -> Any:
        os.kill(os.getpid(), signal.SIGTERM)
        return record(self, training, metrics)

    out = tmp_path / "out"
    swept = ["gain=0.5,0.7", "step_size=0.0,0.01", "width=16"]
    arguments = [*OPTIONS, "--set", *swept, "--out", str(out)]
    with shared_programs():
        with monkeypatch.context() as patch:
            patch.setattr(recorder.Recorder, "record_epoch", stop)
            assert sweep.main(arguments) == 75
        checkpoints = {path.name for path in (out / "checkpoints").glob("*.npz")}
        assert "group0_epoch000001_cycle000000.npz" in checkpoints
        assert sweep.main(arguments) == 0
    rows = [json.loads(line) for line in (out / "metrics.jsonl").read_text().splitlines()]
    assert [row["epoch"] for row in rows] == [1] * 4 + [2] * 4
    assert {(row["curriculum"], row["agent"]) for row in rows} == {(GROWING, AGENT)}
    assert {row["failure"] for row in rows} == {None}
    assert not any("critic_loss" in row for row in rows)
    assert len(list((out / "policies").glob("*.npz"))) == 4
    networks = {}
    for run, (gain, step_size) in enumerate(itertools.product((0.5, 0.7), (0.0, 0.01))):
        components = "my_agent-MyAgent-her_my_curriculum-Growing"
        name = f"point_mass-PointMass_{components}_gain{gain}_stepsize{step_size:g}_seed0"
        policy = load_policy(out / "policies" / f"{name}.npz")
        networks[gain, step_size] = [policy[key] for key in policy if key.startswith("layer")]
        assert policy["layer_2_kernel"].shape == (16, 2)
        kept = 0.5
        for row in rows[run::4]:
            assert row["run"] == name
            shares = zip(row["mask_rate_training"], row["mask_share"], strict=True)
            success = sum(rate * share for rate, share in shares if share)
            kept += gain * (success - kept)
            assert row["keep_probability"] == pytest.approx(kept, abs=1e-6)
            assert row["mask_probability"] is None
    # In their first cycle all saw the same transitions; only some learned from them.
    assert rows[0]["actor_loss"] == rows[2]["actor_loss"] > rows[1]["actor_loss"]
    still = networks[0.5, 0.0]
    for one, other in zip(still, networks[0.7, 0.0], strict=True):
        np.testing.assert_array_equal(one, other)
    for gain in (0.5, 0.7):
        for one, other in zip(still, networks[gain, 0.01], strict=True):
            assert (one != other).any()
