"""Curricula, agents and ways to relabel of the user's own: what the loop relies on, checked first.

Shapes only: nothing is run or compiled.
"""

from functools import partial
from typing import Any

import jax

from cgm_jax.config.components import ROOMS, builtin_fields, check_names
from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import Run
from cgm_jax.config.named import is_own
from cgm_jax.config.settings import RESERVED
from cgm_jax.config.user_code import user_code
from cgm_jax.loop.cycle import cycle
from cgm_jax.loop.own_returns import check_agent, check_curriculum, check_relabelling
from cgm_jax.loop.setup import init_state
from cgm_jax.loop.training import Trainer

CHECKS = {
    "relabelling": check_relabelling,
    "agent": check_agent,
    "curriculum": check_curriculum,
}
"""Each relies on those before it."""


def check_components(trainer: Trainer, run: Run) -> None:
    """Check what a run's components do with the shapes that they will get.

    Those that come with this package are checked by tests.

    Raises:
        SettingError: one fails, misspells what it means to override, returns something else than
            its protocol says, or reports under a name that is taken; one line says what.
    """
    own = {kind: run.values[kind] for kind in ROOMS if is_own(run.values[kind])}
    if not own:
        return
    for part in own:
        check_names(part, own[part], type(getattr(run.hyper, part)))
    kind, name = next(iter(own)), " with ".join(own.values())
    with user_code(kind, name):
        begun = jax.eval_shape(partial(init_state, trainer.setup), run.hyper)
    for part, check in CHECKS.items():
        if part in own:
            with user_code(part, own[part]):
                check(f"{part}: {own[part]}", trainer.setup, begun, run.hyper)
    with user_code(kind, name):
        state = jax.eval_shape(trainer.init, run.hyper)
        after = jax.eval_shape(partial(cycle, trainer.setup), state, run.hyper)
        _check_alike(f"{kind}: {name}", state, after)
        if trainer.setup.is_cut:  # what a cycle hands on to itself then goes through the state
            jax.eval_shape(trainer.train, state, run.hyper, 1)
        after, _ = jax.eval_shape(trainer.evaluate, state, run.hyper)
        _check_alike(f"{kind}: {name}", state, after)
        reported = jax.eval_shape(run.hyper.curriculum.report, state.curriculum)
    for part, names, others in (
        ("curriculum", reported, run.hyper.agent.logged),
        ("agent", run.hyper.agent.logged, reported),
    ):
        if taken := sorted(set(names) & (RESERVED | {*builtin_fields(), *others})):
            raise SettingError(f"{part}: {name} reports {taken[0]}, a name that is taken")


def _check_alike(what: str, before: Any, after: Any) -> None:
    """Check that a state has kept its structure, shapes and types.

    Raises:
        SettingError: it has not; the line names the first leaf that differs.
    """
    if jax.tree.structure(before) != jax.tree.structure(after):
        raise SettingError(f"{what} returns a state of another structure than its init does")
    pairs = zip(jax.tree_util.tree_leaves_with_path(before), jax.tree.leaves(after), strict=True)
    for (path, leaf), other in pairs:
        if (leaf.shape, leaf.dtype) != (other.shape, other.dtype):
            was, now = (f"{x.dtype}{list(x.shape)}" for x in (leaf, other))
            raise SettingError(f"{what} makes {now} of {was} in {jax.tree_util.keystr(path)}")
