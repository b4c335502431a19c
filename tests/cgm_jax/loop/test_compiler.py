import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brax.envs.base import State

from cgm_jax import envs
from cgm_jax.config.fields import stack
from cgm_jax.envs.names import make_deferred
from cgm_jax.loop.compiler import Compiler, is_compiling
from cgm_jax.loop.training import SELDOM_RUN, Programs, make_programs, make_trainer
from cgm_jax.measuring.compilations import programs_compiled
from tests.cgm_jax.loop.programs import PROGRAMS
from tests.cgm_jax.probe import TINY, tiny
from tests.cgm_jax.protocols import assert_same
from tests.examples.point_mass import PointMass

QUICK = PROGRAMS._replace(
    train=jax.jit(lambda states, hyper, cycles: states),  # pyright: ignore[reportArgumentType]
    evaluate=jax.jit(lambda states, hyper: (states, {})),  # pyright: ignore[reportArgumentType]
)
"""Programs of which nothing takes long to compile but what makes states."""

THREE, FOUR = (stack([tiny(seed=seed) for seed in range(count)]) for count in (3, 4))


def trained(programs: Programs) -> Any:
    """Two epochs of three runs; on more devices, and with rows left over, see test_devices.py."""
    state = programs.start(THREE)
    for cycles in (1, 2):
        state = programs.train(state, THREE, cycles)
        state, metrics = programs.evaluate(state, THREE)
    return state, metrics


def test_training_has_the_bits_of_programs_that_compile_when_called_and_compiles_once() -> None:
    expected = trained(PROGRAMS)
    with Compiler() as compiler:
        programs = compiler.programs(PROGRAMS, THREE)
        first, before = trained(programs), programs_compiled()
        assert_same(first, expected)
        assert_same(trained(compiler.programs(PROGRAMS, THREE)), expected)
        assert programs_compiled() == before


OF_MJX = {"xla_cpu_use_fusion_emitters": False}


@pytest.mark.parametrize(
    ("env", "platform", "expected"),
    [
        (envs.make("reach", engine="native"), "cpu", [SELDOM_RUN, {}, SELDOM_RUN]),
        (envs.make("reach", engine="mjx"), "cpu", [SELDOM_RUN, OF_MJX, OF_MJX]),
        (make_deferred("reach", engine="mjx"), "gpu", [OF_MJX, OF_MJX, OF_MJX]),
        (PointMass(), "cpu", [SELDOM_RUN, {}, {}]),
        (PointMass(), "gpu", [{}, {}, {}]),
    ],
    ids=["native", "mjx", "mjx-gpu", "own", "gpu"],
)
def test_only_what_runs_seldom_and_none_of_an_environments_code_is_compiled_to_start_soon(
    env: Any, platform: str, expected: list[dict[str, Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    options, jit = {}, jax.jit

    def recording(function: Callable[..., Any], **given: Any) -> Any:
        options[program := jit(function, **given)] = given.get("compiler_options")
        return program

    trainer = make_trainer(env, TINY, platform)
    monkeypatch.setattr(jax, "jit", recording)
    made = make_programs(trainer)
    assert [options[program] for program in (made.start, made.train, made.evaluate)] == expected


class Wide:
    """A goal of so many dimensions that masks are not counted one by one."""

    action_size, episode_length, distance_threshold = 2, 10, 0.3

    def reset(self, rng: jax.Array) -> State:
        position, goal = jax.random.uniform(rng, (2, 20), minval=-1.0, maxval=1.0)
        return self._state(position, goal)

    def step(self, state: Any, action: jax.Array) -> State:
        return self._state(state.obs["achieved_goal"] + 0.1 * action[0], state.obs["desired_goal"])

    def _state(self, position: jax.Array, goal: jax.Array) -> State:
        obs = {"observation": position, "achieved_goal": position, "desired_goal": goal}
        return State(None, obs, jnp.zeros(()), jnp.zeros(()))


def train_wide() -> None:
    """Train on it, with an idle device beside the one that trains, as programs have it."""
    plain = make_programs(make_trainer(Wide(), TINY))  # pyright: ignore[reportArgumentType]
    assert not plain.shapes(THREE).statistics.mask_episodes.size
    with Compiler() as compiler:
        state, _ = trained(compiler.programs(plain, THREE))
    print(np.asarray(state.env_steps).max())


@pytest.mark.slow
def test_states_hold_arrays_without_elements_where_masks_are_too_many_to_count() -> None:
    result = subprocess.run(
        [sys.executable, "-c", f"from {__name__} import train_wide; train_wide()"],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "JAX_NUM_CPU_DEVICES": "2"},
    )
    assert int(result.stdout.split()[-1]) > 0


def test_states_from_a_checkpoint_need_no_program_that_makes_states() -> None:
    with Compiler() as compiler:
        programs = compiler.programs(QUICK, THREE, starts=False)
        assert programs.start is QUICK.start
        assert programs.train is compiler.programs(QUICK, THREE).train


def test_another_number_of_runs_has_programs_of_its_own() -> None:
    with Compiler() as compiler:
        three, four = (compiler.programs(QUICK, hyper) for hyper in (THREE, FOUR))
        assert three.train is not four.train
        assert four.start(FOUR).env_steps.shape == (4,)


@pytest.mark.slow
def test_curricula_with_the_same_settings_have_programs_of_their_own() -> None:
    full, uniform = (stack([tiny(curriculum=name)]) for name in ("full", "uniform"))
    assert jax.tree.structure(full) != jax.tree.structure(uniform)
    with Compiler() as compiler:
        for hyper in (full, uniform):
            apart = make_programs(make_trainer(PointMass(), TINY))
            programs = compiler.programs(PROGRAMS, hyper)
            assert_same(*(one.train(one.start(hyper), hyper, 3) for one in (apart, programs)))


class Slow:
    """Stands for what `jax.jit` returns: lowers at once, and compiles when it is let go."""

    def __init__(self, log: list[str], name: str, let_go: threading.Event) -> None:
        self._log, self._name, self._let_go = log, name, let_go
        self.begun = threading.Event()

    def lower(self, *_: object) -> "Slow":
        self._log.append(f"{self._name} traced")
        return self

    def compile(self) -> Any:
        assert threading.current_thread() is not threading.main_thread()
        self.begun.set()
        assert self._let_go.wait(timeout=60)
        self._log.append(f"{self._name} compiled")
        if self._name == "train":
            raise RuntimeError("it does not compile")
        return lambda *_: f"{self._name} has run"


def slow_programs(log: list[str], let_go: threading.Event) -> Programs:
    return PROGRAMS._replace(
        **{name: Slow(log, name, let_go) for name in ("start", "train", "evaluate")}  # pyright: ignore
    )


def test_each_is_waited_for_by_itself_and_evaluation_is_traced_last() -> None:
    log, let_go = [], threading.Event()
    with Compiler() as compiler:
        programs = compiler.programs(slow_programs(log, let_go), THREE)
        assert log == ["start traced", "train traced"]
        assert is_compiling(programs.start)
        let_go.set()
        assert programs.start(THREE) == "start has run"
        with pytest.raises(RuntimeError, match="it does not compile"):
            programs.train(None, THREE, 1)  # pyright: ignore[reportArgumentType]
        assert programs.evaluate(None, THREE) == "evaluate has run"  # pyright: ignore
        assert not is_compiling(programs.evaluate)
    assert log[2:] == ["start compiled", "train compiled", "evaluate traced", "evaluate compiled"]


def test_leaving_drops_what_has_not_begun_to_compile_and_waits_for_what_has() -> None:
    log, let_go = [], threading.Event()
    slow = slow_programs(log, let_go)
    with Compiler() as compiler:
        compiler.programs(slow, THREE)
        assert slow.start.begun.wait(timeout=60)  # pyright: ignore[reportFunctionMemberAccess]

        def let_go_once_left() -> None:
            while not compiler._worker._shutdown:
                time.sleep(0.01)
            let_go.set()

        threading.Thread(target=let_go_once_left).start()
    assert log[2:] == ["start compiled"]
