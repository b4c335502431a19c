"""What a directory does not go on with: refused in one line, and left as it was."""

import hashlib
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cgm_jax import sweep
from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import build_groups
from cgm_jax.host import to_train
from cgm_jax.storage.lock import InUseError, locked
from cgm_jax.storage.run_directory import RunDirectory
from tests.cgm_jax.host.in_process import train

pytestmark = pytest.mark.usefixtures("in_process")


def test_a_directory_in_use_is_refused_and_left_alone(whole: Path) -> None:
    before = {
        path: path.stat().st_mtime_ns
        for path in whole.rglob("*")
        if path.name not in ("lock", "holder")
    }
    with locked(whole), pytest.raises(InUseError, match=f"{whole} is in use by .*process"):
        train(whole)
    assert before == {path: path.stat().st_mtime_ns for path in before}


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (["--epochs", "3"], "epochs 4, not 3$"),
        (["--epochs", "5"], "epochs 4, not 5; to train it for longer: .*--resume .* --epochs 5$"),
        (["--seed", "1"], "seed 0, not 1$"),
        (["--kappa", "32", "4"], "these values in another order$"),
        (["--kappa", "4", "--epochs", "5"], "epochs 4, not 5; kappa 4 32, not 4$"),
        (
            ["--agent", "sac", "--curriculum", "full"],
            "curriculum cgm, not full; agent ddpg, not sac; .*; and 1[0-9] more$",
        ),
        (["--hidden-layers", "32x32", "8"], "hidden_layers 32x32, not 32x32 8$"),
    ],
)
def test_another_sweep_in_the_same_directory_is_refused_with_what_differs(
    options: list[str], complaint: str, whole: Path
) -> None:
    with pytest.raises(SettingError, match=f"^out: {whole} already holds a sweep .*{complaint}"):
        train(whole, *options)


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (
            ["--kappa", "4"],
            "kappa: .* was begun with 4 32, not 4; a sweep resumes as it was begun$",
        ),
        (["--seeds", "2"], "seed: .* was begun with 0, not 0 1; "),
        (["--target-noise", "0.1"], "target_noise: .* was begun with none, not 0.1; "),
        (["--epochs", "3"], "epochs: 3 are fewer than the 4 that .* has begun$"),
        (["--epochs", "0"], "epochs: 0 are fewer than the 4 "),
        (["--epochs", "5", "6"], "epochs: takes one value with --resume$"),
        (["--epochs", "1000000000"], "epochs: .* env_steps in all are more than 2\\^31 - 1$"),
    ],
)
def test_resuming_with_other_settings_is_refused_with_both_values(
    options: list[str], complaint: str, whole: Path
) -> None:
    before = (whole / "config.json").read_bytes()
    with pytest.raises(SettingError, match=f"^{complaint}"):
        sweep.main(["--resume", str(whole), *options])
    assert (whole / "config.json").read_bytes() == before


@pytest.mark.parametrize("damage", ["array", "archive", "format"])
def test_a_checkpoint_that_is_refused_leaves_the_directory_as_it_is(
    damage: str, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    shutil.copytree(whole, out)
    path = max((out / "checkpoints").glob("*.npz"))
    manifest = path.with_suffix(".json")
    if damage == "array":
        with np.load(path) as file:
            arrays = {name: file[name] for name in file.files}
        del arrays[".env_steps"]
        with path.open("wb") as file:
            np.savez(file, **arrays)
    elif damage == "archive":
        path.write_bytes(b"whole, but no archive")
    digest, size = hashlib.sha256(path.read_bytes()).hexdigest(), path.stat().st_size
    entry = json.loads(manifest.read_text()) | {"sha256": digest, "bytes": size}
    manifest.write_text(json.dumps(entry | ({"format": 99} if damage == "format" else {})))
    before = {one: one.read_bytes() for one in out.rglob("*") if one.is_file()}
    monkeypatch.setenv("JAX_OF_ANOTHER_DAY", "1")  # which may be the reason
    line = r"^resume: .*npz (is|holds) .*; it was begun with .*JAX_OF_ANOTHER_DAY none \(now 1\)"
    with pytest.raises(SettingError, match=line):
        sweep.main(["--resume", str(out), "--epochs", "9"])
    after = {one: one.read_bytes() for one in out.rglob("*") if one.is_file()}
    assert {one.name for one in after if after[one] != before.get(one)} <= {"holder"}


def test_a_policy_that_does_not_fit_is_refused_before_anything_is_made(
    whole: Path, tmp_path: Path
) -> None:
    policy = next((whole / "policies").glob("*.npz"))
    line = r"^from: its layers are 6x32x32x2 in the source and 6x8x2 "
    with pytest.raises(SettingError, match=line):
        train(tmp_path / "out", "--from", str(policy), "--hidden-layers", "8")
    assert not (tmp_path / "out").exists()


def test_sweeps_that_compare_numbers_of_epochs_are_not_trained_for_longer(tmp_path: Path) -> None:
    with RunDirectory.claimed(tmp_path / "out", fresh=True) as directory:
        directory.config.write(build_groups("smoke", {"epochs": [1, 2]}), "smoke", "cpu")
    with pytest.raises(SettingError, match=r"^epochs: .* compares 1 and 2 epochs, which stay$"):
        sweep.main(["--resume", str(directory.path), "--epochs", "4"])


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "config.json is damaged: JSONDecodeError"),
        ("[" * 100_000, "config.json is damaged"),
        ("{}", "config.json is damaged: KeyError: 'groups'"),
        ('{"groups": [{"settings": {"epochs": 3}}]}', "config.json is damaged: KeyError: 'runs'"),
        ('{"format": 99, "groups": []}', "config.json is damaged: format: 99 is none that this"),
        ('{"groups": []}', "config.json is damaged"),
    ],
)
def test_a_damaged_config_is_refused(text: str, complaint: str, tmp_path: Path) -> None:
    (tmp_path / "config.json").write_text(text)
    for option in ("--resume", "--config"):
        with pytest.raises(SettingError, match=complaint) as refused:
            sweep.main([option, str(tmp_path)])
        assert str(refused.value).count("is damaged") == 1


def test_metrics_of_another_sweep_are_refused_before_anything_is_made_or_built(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(to_train, "plan", lambda *_, **__: pytest.fail("it was built"))
    (tmp_path / "metrics.jsonl").write_text("theirs")
    with pytest.raises(SettingError, match=f"^out: {tmp_path} already holds a sweep; name another"):
        train(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["metrics.jsonl"]


def test_without_a_config_or_a_checkpoint_to_restore_it_from_a_directory_is_refused(
    whole: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    shutil.copytree(whole, out)
    shutil.rmtree(out / "checkpoints")
    config = out / "config.json"
    config.write_bytes(config.read_bytes()[:100])
    before = {one: one.read_bytes() for one in out.rglob("*") if one.is_file()}
    with pytest.raises(
        SettingError, match=f"^{config} is damaged: JSONDecodeError: [^:]*: "
    ) as one:
        train(out)
    assert str(one.value).count("is damaged") == 1
    config.unlink()
    with pytest.raises(SettingError, match=f"^out: {out} already holds a sweep; name another"):
        train(out)
    after = {one: one.read_bytes() for one in out.rglob("*") if one.is_file()}
    assert {one for one in before if after.get(one) != before[one]} <= {config, out / "holder"}


@pytest.mark.parametrize(("field", "value"), [("epochs", "4"), ("batch_size", 1.5), ("env", None)])
def test_a_config_with_a_value_of_the_wrong_type_is_refused(
    field: str, value: Any, whole: Path, tmp_path: Path
) -> None:
    config = json.loads((whole / "config.json").read_text())
    config["groups"][0]["runs"][0][field] = value
    (tmp_path / "config.json").write_text(json.dumps(config))
    with pytest.raises(SettingError, match=f"config.json is damaged: {field}: "):
        sweep.main(["--resume", str(tmp_path)])
