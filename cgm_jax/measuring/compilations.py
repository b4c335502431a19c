"""What XLA compiles in this process, as JAX itself reports it."""

import jax

_seconds: list[float] = []


def programs_compiled() -> int:
    """How many programs XLA has compiled since this file was imported."""
    return len(_seconds)


def _note(event: str, duration_secs: float, **_: object) -> None:
    if event == "/jax/core/compile/backend_compile_duration":
        _seconds.append(duration_secs)


jax.monitoring.register_event_duration_secs_listener(_note)
