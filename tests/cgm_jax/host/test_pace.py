from cgm_jax.host.pace import Pace


def test_chunks_start_with_one_unit_and_then_fill_two_seconds() -> None:
    pace = Pace()
    assert pace.next_chunk("cycle", 100) == 1
    pace.record("cycle", 1, 0.25)
    assert pace.next_chunk("cycle", 99) == 8
    assert pace.next_chunk("cycle", 3) == 3
    pace.record("cycle", 8, 80.0)
    assert pace.unit("cycle") == 10.0
    assert pace.next_chunk("cycle", 90) == 1


def test_each_kind_has_a_pace_of_its_own() -> None:
    pace = Pace()
    pace.record("rollout", 2, 1.0)
    assert pace.next_chunk("rollout", 50) == 4
    assert pace.unit("updates") is None
    assert pace.next_chunk("updates", 50) == 1
    pace.record("updates", 1, 0.1)
    assert pace.next_chunk("updates", 50) == 20
    assert pace.next_chunk("rollout", 50) == 4


def test_what_is_at_risk_adds_up_until_there_is_a_checkpoint() -> None:
    pace = Pace()
    pace.record("rollout", 50, 3.0)
    pace.record("updates", 20, 4.0)
    pace.record_evaluation(1.5)
    assert (pace.evaluation, pace.at_risk) == (1.5, 8.5)
    pace.record_checkpoint()
    pace.record("rollout", 50, 3.0)
    assert (pace.evaluation, pace.at_risk) == (1.5, 3.0)
