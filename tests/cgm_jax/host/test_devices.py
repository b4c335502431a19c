import dataclasses

import jax
import pytest

from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import build_groups
from cgm_jax.host import devices
from cgm_jax.host.devices import (
    POOL_THREADS,
    POOL_VARIABLE,
    check_devices,
    cpu_devices,
    describe_devices,
    parse_devices,
)


def test_a_number_of_devices_or_all() -> None:
    assert parse_devices("all") is None
    assert parse_devices("12") == 12


@pytest.mark.parametrize("text", ["0", "-1", "1.5", "some", "", "9" * 30, "²"])
def test_anything_else_is_refused(text: str) -> None:
    with pytest.raises(SettingError, match=r"devices: .* is neither a number"):
        parse_devices(text)


def test_more_than_a_cpu_can_be_made_into_are_refused() -> None:
    check_devices(256)
    with pytest.raises(SettingError, match="devices: 257, but the most on this cpu are 256"):
        check_devices(257)


def test_a_cpu_has_a_device_for_each_core_that_has_a_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(devices, "available_cores", lambda: 4)
    (group,) = build_groups("smoke", {"seed": [0, 1, 2], "kappa": [4.0]})
    one, two = (
        dataclasses.replace(
            group, settings=dataclasses.replace(group.settings, side_by_side=number)
        )
        for number in (1, 2)
    )
    assert cpu_devices(None, [group]) == 3
    assert cpu_devices(None, [one, two]) == 2
    assert cpu_devices(None, [one]) == 1
    assert cpu_devices(2, [group]) == 2
    assert cpu_devices(8, [group]) == 3
    monkeypatch.setattr(devices, "available_cores", lambda: 64)
    (many,) = build_groups("smoke", {"seed": list(range(20)), "kappa": [4.0]})
    assert cpu_devices(None, [many]) == POOL_THREADS
    assert cpu_devices(12, [many]) == 12


def test_the_number_of_cpu_devices_counts_where_it_decides_how_many_threads_they_have(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv(POOL_VARIABLE, "8")
    for number, shown in ((1, "cpu"), (8, "cpu"), (9, "9 x cpu")):
        monkeypatch.setattr(jax, "devices", lambda number=number: jax.local_devices()[:1] * number)
        assert describe_devices() == shown
