from cgm_jax.host.pace import Pace


def test_chunks_start_with_one_cycle_and_then_fill_two_seconds() -> None:
    pace = Pace()
    assert pace.next_chunk(100) == 1
    pace.record(1, 0.25)
    assert pace.next_chunk(99) == 8
    assert pace.next_chunk(3) == 3
    pace.record(8, 80.0)
    assert pace.cycle == 10.0
    assert pace.next_chunk(90) == 1
