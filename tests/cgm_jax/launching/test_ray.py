"""Launches on a real Ray cluster of two nodes, by `make test-ray`."""

# pyright: reportMissingImports=false

import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.cgm_jax.launching.launches import (
    assert_as_if_never_disturbed,
    attempts,
    begun,
    launch,
    trainer,
    uninterrupted,
    wait_for_checkpoint,
    wait_until,
)

# Ray reads these when it is imported. Without them it talks to the machine's outer address.
LOOPBACK = {
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0",
    "RAY_worker_niceness": "0",
}
os.environ.update(LOOPBACK)
pytest.importorskip("ray", reason="needs Ray: make test-ray")

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]

NODE: dict[str, Any] = {
    "num_cpus": 1,
    "num_gpus": 0,
    "object_store_memory": 80 * 2**20,
    "node_ip_address": "127.0.0.1",
    "include_dashboard": False,
}


@pytest.fixture
def cluster() -> Iterator[Any]:
    """A cluster whose head runs no tasks; two nodes are added."""
    from ray.cluster_utils import Cluster

    made = Cluster(initialize_head=True, head_node_args={**NODE, "num_cpus": 0})
    try:
        yield made, [made.add_node(**NODE), made.add_node(**NODE)]
    finally:
        made.shutdown()


def test_a_lost_node_and_a_killed_trainer_lose_nothing(cluster: Any, tmp_path: Path) -> None:
    made, nodes = cluster
    whole, out = uninterrupted(tmp_path / "whole"), tmp_path / "out"
    with begun(launch("ray", out, "--address", made.address)) as process:
        before = {part: wait_for_checkpoint(process, out, part) for part in (1, 2)}
        made.remove_node(nodes[0], allow_graceful=False)
        lost = wait_until(
            process, lambda: [part for part in (1, 2) if len(attempts(out, part)) > 1], "a retry"
        )
        (kept,) = {1, 2} - {*lost}
        assert len(attempts(out, kept)) == 1
        second, _ = attempts(out, lost[0])[1]
        resumed = wait_for_checkpoint(process, out, lost[0], after=second)
        os.kill(wait_until(process, lambda: trainer(out, lost[0]), "a trainer"), signal.SIGKILL)
        assert process.wait(300) == 0
    assert len(lost) == 1
    assert attempts(out, kept) == [(0, 0)]
    (first, _), (_, code), (third, last) = attempts(out, lost[0])
    assert (first, code, last) == (0, -9, 0)
    assert before[lost[0]] <= second < resumed <= third
    assert_as_if_never_disturbed(whole, out)


def test_a_launcher_that_is_stopped_has_its_parts_write_checkpoints(
    cluster: Any, tmp_path: Path
) -> None:
    made, _ = cluster
    out = tmp_path / "out"
    with begun(launch("ray", out, "--address", made.address)) as process:
        wait_for_checkpoint(process, out, 1)  # the other part may be anywhere
        process.send_signal(signal.SIGTERM)
        assert process.wait(60) == 75
    assert attempts(out, 1) == [(0, 75)]
    assert trainer(out, 1) is trainer(out, 2) is None
