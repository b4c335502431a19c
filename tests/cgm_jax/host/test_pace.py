from cgm_jax.host.pace import Pace


def test_chunks_start_with_one_cycle_and_then_fill_two_seconds() -> None:
    pace = Pace()
    assert pace.next_chunk(100) == 1
    pace.record(1, 30.0)  # with compilation
    assert pace.next_chunk(99) == 1
    pace.record(1, 0.25)
    assert pace.next_chunk(98) == 8
    assert pace.next_chunk(3) == 3
    pace.record(8, 80.0)
    assert pace.next_chunk(90) == 1


def test_a_cycle_outlasts_what_is_shorter_once_one_is_timed_that_did_not_compile() -> None:
    pace = Pace()
    assert not pace.outlasts(8.0)
    pace.record(1, 30.0)
    assert not pace.outlasts(8.0)
    pace.record(2, 18.0)
    assert pace.outlasts(8.0)
    assert not pace.outlasts(9.0)
