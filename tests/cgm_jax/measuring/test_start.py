"""Starts in processes of their own, and what is said where they fail."""

import itertools
import sys

import pytest

from cgm_jax import benchmark
from cgm_jax.config.fields import SettingError
from cgm_jax.measuring import start
from cgm_jax.measuring.child import MeasurementError, output_of
from cgm_jax.measuring.start import measure_starts


def test_medians_of_pairs_of_starts_count_after_one_that_reads_the_disk(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pairs = iter([(90.0, 80.0), (3.0, 2.0), (9.0, 1.0), (4.0, 3.0)])
    monkeypatch.setattr(start, "_starts", lambda: next(pairs))
    cold, warm = measure_starts(3)
    assert (cold.value, warm.value) == (4.0, 2.0)


def test_the_first_start_of_a_pair_has_an_empty_cache_and_the_second_what_it_left(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    caches: list[str] = []
    ends = itertools.count(1000.0, 10.0)

    def ended(command: list[str], variables: dict[str, str]) -> str:
        caches.append(variables["JAX_COMPILATION_CACHE_DIR"])
        return f"noise\n{next(ends)}\n"

    monkeypatch.setattr(start, "output_of", ended)
    monkeypatch.setattr(start.time, "time", lambda: 990.0)
    assert start._starts() == (10.0, 20.0)
    assert start._starts() == (30.0, 40.0)
    assert caches[0] == caches[1] != caches[2] == caches[3]


def test_a_program_that_fails_says_so_in_its_last_line() -> None:
    assert output_of([sys.executable, "-c", "print(1)"]) == "1\n"
    fails = "import sys; print('noise\\nerror: out of memory', file=sys.stderr); sys.exit(3)"
    with pytest.raises(MeasurementError, match=r"^out of memory$"):
        output_of([sys.executable, "-c", fails])
    assert output_of([sys.executable, "-c", fails], accepted=(0, 3)) == ""


def test_what_is_not_a_cpu_is_refused_before_anything_is_measured(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("JAX_PLATFORMS", "cuda")
    monkeypatch.setattr(benchmark, "measure_starts", None)  # which fails if it is called
    with pytest.raises(SettingError, match=r"^JAX_PLATFORMS: .* is the CPU, not 'cuda'$"):
        benchmark.main([])
