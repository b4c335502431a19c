import json
from pathlib import Path

import pytest

from cgm_jax.config.fields import SettingError
from cgm_jax.config.named import absolute, name_now
from cgm_jax.storage.formats import FORMAT, upgraded
from cgm_jax.storage.run_directory import RunDirectory
from tests.cgm_jax.sweeps import ROOT

RECORDS = sorted((ROOT / "experiments/results/sweeps").glob("*/config.json"))


def first(settings: dict[str, object], **run: object) -> dict[str, object]:
    """The only run of an old config, in today's format."""
    values = {"name": "a", "c_g": 0.1, "kappa": 32.0, "cgm": True, "factorised": True, **run}
    old = {"groups": [{"settings": settings, "runs": [values]}]}
    return upgraded(old)["groups"][0]["runs"][0]


def test_the_curriculum_of_the_first_format_was_a_switch_and_a_kappa() -> None:
    assert first({"success_history": 10}) == {
        "name": "a",
        "curriculum": "cgm",
        "c_g": 0.1,
        "kappa": 32.0,
        "factorised": True,
        "success_history": 10,
    }
    assert first({"success_history": 10}, cgm=False) == {"name": "a", "curriculum": "full"}
    assert first({"epochs": 3}, kappa=0.0) == {"name": "a", "curriculum": "uniform", "epochs": 3}


def test_the_present_format_stays_as_it_is_and_a_newer_one_is_refused_by_name() -> None:
    config = {"format": FORMAT, "groups": []}
    assert upgraded(config) is config
    with pytest.raises(SettingError, match="format: 3 is none that this version"):
        upgraded({"format": FORMAT + 1, "groups": []})


@pytest.mark.parametrize("path", RECORDS, ids=lambda path: path.parent.name)
def test_every_committed_sweep_is_read(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)  # the sliders are named from there
    written = json.loads(path.read_text())["groups"]
    for env in {run["env"] for group in written for run in group["runs"] if "env" in run}:
        name_now(absolute(env))
    groups = RunDirectory(path.parent).config.groups()
    names = [run["name"] for group in written for run in group["runs"]]
    assert sorted(run.name for group in groups for run in group.runs) == sorted(names)
