import pytest

from cgm_jax.machine.device_errors import DeviceError, device_errors, summary

FROM_A_CALLBACK = """ValueError: INTERNAL: Error when calling buffer callback: Traceback:
  File "runner.py", line 164, in _train_chunk
    state = programs.train(state)
  File "native.py", line 97, in _advance
    batch.step(nstep=10)
SimulationError: MuJoCo raised in 8 of 8 simulations; simulation 0: out of memory
  max = 40960, available = 38568
"""


def test_a_callbacks_traceback_becomes_its_error_and_its_place() -> None:
    assert summary(FROM_A_CALLBACK) == (
        "SimulationError: MuJoCo raised in 8 of 8 simulations; simulation 0: out of memory "
        '(File "native.py", line 97, in _advance)'
    )


def test_other_errors_become_their_first_line() -> None:
    with pytest.raises(DeviceError) as caught, device_errors():
        raise RuntimeError("RESOURCE_EXHAUSTED: out of memory\nbuffers: ...")
    assert str(caught.value) == "RuntimeError: RESOURCE_EXHAUSTED: out of memory"
