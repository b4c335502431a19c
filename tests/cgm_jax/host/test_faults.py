"""Faults in random order; `make faults` runs fifty sequences more."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.cgm_jax.faults import STEPS, compiled_once, run_sequence, undisturbed


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    with compiled_once():
        yield undisturbed(tmp_path_factory.mktemp("whole") / "out")


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1000, 1005))
def test_after_any_sequence_of_faults_a_sweep_resumes_to_the_same_bits(
    seed: int, whole: Path, tmp_path: Path
) -> None:
    steps = 0
    for step in run_sequence(seed, tmp_path, whole):
        print(step)
        steps += 1
    assert steps == STEPS
