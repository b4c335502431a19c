import dataclasses
import re
import subprocess
import sys
from types import SimpleNamespace

import jax
import pytest

from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import build_groups
from cgm_jax.host import devices
from cgm_jax.host.devices import (
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
    assert cpu_devices(None, [many]) == 20
    assert cpu_devices(12, [many]) == 12


@pytest.mark.parametrize(("kind", "shown"), [("cpu", "cpu"), ("A100", "3 x A100")])
def test_the_number_of_devices_counts_where_bits_depend_on_it(
    monkeypatch: pytest.MonkeyPatch, kind: str, shown: str
) -> None:
    monkeypatch.setattr(jax, "devices", lambda: [SimpleNamespace(device_kind=kind)] * 3)
    assert describe_devices() == shown


def test_devices_that_there_are_share_all_cores_though_more_were_asked_for() -> None:
    code = """
import jax
jax.config.update("jax_num_cpu_devices", 2)
jax.devices()  # as in a notebook, where one run was trained before
from cgm_jax.config.grid import build_groups
from cgm_jax.host import devices, to_train
from cgm_jax.machine import allotment
devices.available_cores = allotment.available_cores = lambda: 8
jobs, _ = to_train.plan(build_groups("smoke", {"env": ["reach"], "seed": [0, 1, 2, 3]}), None)
print(len(jax.devices()), allotment.cores_each())
"""
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert result.stdout == "2 4\n"


def test_runs_on_one_core_share_one_device_though_jax_has_more(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Not among tests that have started JAX with devices of their own.
    code = """
from cgm_jax.config.grid import build_groups
from cgm_jax.host import devices, to_train
devices.available_cores = lambda: 1
jobs, (note, *_) = to_train.plan(build_groups("smoke", {"env": ["reach"]}), None)
import jax
print(len(jax.devices()), note)
"""
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert re.fullmatch(r"2 reach: memory for 2 runs: [\d.]+ MiB\n", result.stdout)
