"""The joint progress of all parts, read from their metrics."""

from pathlib import Path

from cgm_jax.launching.progress import JointProgress, Rows
from cgm_jax.storage.metrics import to_lines


def test_rows_are_read_once_and_anew_when_an_attempt_begins(tmp_path: Path) -> None:
    path = tmp_path / "metrics.jsonl"
    found = Rows(path)
    found.update()
    assert (found.count, found.success) == (0, {})
    path.write_text('{"run": "a", "success_rate": 0.5}\n{"run": "b", "succ')
    found.update()
    assert (found.count, found.success) == (1, {"a": 0.5})
    with path.open("a") as file:
        file.write('ess_rate": null}\n')
    found.update()
    assert (found.count, found.success) == (2, {"a": 0.5, "b": None})
    other = tmp_path / "other"
    other.write_text('{"run": "a", "success_rate": 0.25}\n')
    other.replace(path)
    found.update()
    assert (found.count, found.success) == (1, {"a": 0.25})


def test_progress_is_one_line(tmp_path: Path) -> None:
    paths = {part: tmp_path / f"{part}.jsonl" for part in (1, 2)}
    written = [{"run": "a", "success_rate": 1.0}, {"run": "b", "success_rate": 0.0}]
    paths[1].write_text(to_lines(written))
    paths[2].write_text('{"run": "c", "success_rate": null}\n')
    progress = JointProgress(paths, {1: 4, 2: 6})
    progress.show([], 2)
    line = "30 % of 10 epochs over all runs; 0 of 2 parts done, 2 running"
    success = "; success median 50 % of 3 runs (0 % to 100 %)"
    assert progress.line([], 2) == line + success
    assert progress.line([2], 1).startswith("80 % of 10 epochs over all runs; 1 of 2 parts done")
