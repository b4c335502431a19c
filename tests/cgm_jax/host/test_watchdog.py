import time

import pytest

from cgm_jax.host.watchdog import watchdog


def hang() -> None:
    time.sleep(0.6)


def test_silence_shows_where_the_program_stands_and_ends_nothing(
    capfd: pytest.CaptureFixture[str],
) -> None:
    with watchdog(0.3):
        hang()
    text = capfd.readouterr().err
    assert "in hang" in text
    assert "test_watchdog.py" in text
    hang()  # no longer watched
    assert capfd.readouterr().err == ""


def test_a_program_that_gets_on_is_left_in_peace(capfd: pytest.CaptureFixture[str]) -> None:
    with watchdog(2.0) as something_happened:
        for _ in range(30):
            time.sleep(0.1)
            something_happened()
    assert capfd.readouterr().err == ""
