"""What `--dry-run` says of a sweep, of which nothing is made."""

import json
import re
import shutil
from pathlib import Path

import pytest

from cgm_jax import sweep
from cgm_jax.config.fields import SettingError
from cgm_jax.host import dry_run
from cgm_jax.storage.checkpoints import FORMAT
from cgm_jax.storage.run_directory import RunDirectory
from tests.cgm_jax.host.in_process import OPTIONS, train
from tests.cgm_jax.sweeps import POINT_MASS, rows

pytestmark = pytest.mark.usefixtures("in_process")


def files(path: Path) -> dict[Path, int]:
    return {one: one.stat().st_mtime_ns for one in path.rglob("*") if one.is_file()}


def test_a_dry_run_says_what_would_be_trained_and_makes_nothing(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(dry_run, "MEASURED_SECONDS", 0.0)
    assert sweep.main([*OPTIONS, "--dry-run"]) == 0
    assert train(tmp_path / "out", "--dry-run", "--leave-at", "0.5") == 0
    assert not list(tmp_path.iterdir())
    out = capsys.readouterr().out
    names = {row["run"] for row in rows(whole)}
    assert all(out.count(f"   {name}\n") == 2 for name in names)
    assert out.count("2 runs in 1 program; nothing is written") == 2
    each = f"4 epochs of {rows(whole)[0]['env_steps']} environment steps each"
    assert f"\n1. {POINT_MASS}, cgm, ddpg: 2 runs side by side, {each}\n" in out
    assert len(re.findall(r": memory for [^\n]*iB( on 2 devices)?\n", out)) == 2
    assert re.search(r"\ntime: about \d+ s, \d+ s of it to compile, as measured just now; ", out)
    assert "\ntime: at most about " in out  # runs may leave


def test_a_dry_run_of_a_begun_sweep_takes_its_recorded_pace(
    whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    shutil.copytree(whole, out)
    lines = [json.loads(line) for line in (out / "metrics.jsonl").read_text().splitlines()]
    for line in lines:  # 120 s to compile, 1,000 s for an epoch
        line["wall_s"] = 120 + 1000 * line["epoch"]
    (out / "metrics.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    before = files(out)
    assert sweep.main(["--resume", str(out), "--epochs", "7", "--dry-run"]) == 0
    text = capsys.readouterr().out
    assert "\ntime: about 52 min, 2 min of it to compile, as recorded there; " in text
    assert sweep.main(["--resume", str(out), "--dry-run"]) == 0
    assert capsys.readouterr().out.endswith("time: none, all is done\n")
    with pytest.raises(SettingError, match=r"^epochs: 3 are fewer"):
        sweep.main(["--resume", str(out), "--epochs", "3", "--dry-run"])
    assert files(out) == before


def test_a_dry_run_counts_no_checkpoint_that_is_damaged(
    whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    shutil.copytree(whole, out)
    checkpoints = sorted((out / "checkpoints").glob("*.npz"))
    for path in checkpoints:
        path.write_bytes(path.read_bytes()[:-1])
    before = files(out)
    assert sweep.main(["--resume", str(out), "--dry-run"]) == 0
    said = capsys.readouterr()
    assert "\ntime: about " in said.out
    for path in checkpoints:
        assert re.search(rf"{re.escape(str(path))} is damaged \(.*\) and would be set", said.err)
    assert files(out) == before


def test_a_dry_run_refuses_what_resuming_refuses(whole: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    shutil.copytree(whole, out)
    for path in (out / "checkpoints").glob("*.json"):
        path.write_text(json.dumps({**json.loads(path.read_text()), "format": FORMAT + 1}))
    before = files(out)
    with pytest.raises(SettingError, match=rf"^resume: .* of format {FORMAT + 1}, of a newer"):
        sweep.main(["--resume", str(out), "--dry-run"])
    assert files(out) == before


@pytest.mark.parametrize(
    "line", ["[" * 10**5, "5", '{"run": []}', '{"run": "a", "wall_s": 1' + "0" * 400 + "}"]
)
def test_metrics_that_cannot_be_read_record_no_pace(line: str, tmp_path: Path) -> None:
    (tmp_path / "metrics.jsonl").write_text(f"{line}\n")
    assert dry_run._recorded_paces([], RunDirectory(tmp_path)) == {}
