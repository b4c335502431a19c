"""Starting from what another run has learned: `--from DIR` or `--from policy.npz`.

From a run directory: the whole state of the agent (actor, critics, targets, optimisers) and the
statistics of the normaliser, of the last checkpoint. From a policy file: its actor and statistics,
which count as if they came from one epoch of the new run; all else of the agent is fresh. Replay,
curriculum, counters and seeds are the new run's own in both cases, and so is every setting.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from cgm_jax.config.fields import SettingError
from cgm_jax.config.settings import Hyperparameters
from cgm_jax.host.checkpoint import named_leaves, restore_leaf, stored_like
from cgm_jax.loop.normaliser import with_statistics
from cgm_jax.loop.state import TrainingState
from cgm_jax.loop.training import Programs
from cgm_jax.storage.arrays import open_arrays, read_arrays
from cgm_jax.storage.checkpoints import FORMAT, damage, finished_checkpoints, format_of
from cgm_jax.storage.config_file import read_groups
from cgm_jax.storage.layout import CONFIG
from cgm_jax.storage.looking import is_directory
from cgm_jax.storage.policies import MAX_POLICY_BYTES, load_policy
from cgm_jax.storage.run_directory import RunDirectory
from cgm_jax.storage.untrusted import UNREADABLE

TAKEN = (".agent", ".normaliser.observation", ".normaliser.goal")
"""Parts of a training state that are copied from the source; of the normaliser not its limit, which
is a setting."""

Arrays = Mapping[str, np.ndarray]
"""Of a policy file, or leaves of one run's training state by their names in checkpoints."""


def read_source(path: Path, run: str | None = None) -> dict[str, np.ndarray]:
    """What to start from.

    Args:
        path: a run directory, a policy file, or the start.npz of a run directory.
        run: which run of a directory; None if it has one only.

    Raises:
        SettingError: there is nothing to start from.
        ReadError: a checkpoint cannot be read just now.
    """
    if is_directory("from", path):
        return _from_directory(path, run)
    if run is not None:
        raise SettingError(f"from_run: {path} is no run directory")
    try:
        arrays = read_arrays(path, MAX_POLICY_BYTES)
        return arrays if _holds_state(arrays) else load_policy(path)
    except ValueError as error:
        raise SettingError(f"from: {error}") from None


def check_start(source: Arrays, programs: Programs, hyper: Hyperparameters) -> None:
    """Check that runs can start from a source, by shapes alone.

    Raises:
        SettingError: it does not fit; the message says what differs.
    """
    start_from(source, programs, hyper, jax.eval_shape(jax.vmap(programs.trainer.init), hyper))


def start_from(
    source: Arrays, programs: Programs, hyper: Hyperparameters, state: TrainingState
) -> TrainingState:
    """The state of runs before any training, with what another run has learned.

    Args:
        source: as `read_source` returns it.
        programs: of the runs.
        hyper: of the runs, every leaf [runs].
        state: as `programs.start` returns it. Shapes will do: then shapes are returned.

    Raises:
        SettingError: the source does not fit; the message says what differs.
    """
    if _holds_state(source):
        return _with_leaves(source, state)
    settings, env = programs.trainer.setup.settings, programs.trainer.setup.env
    episodes = settings.cycles_per_epoch * settings.environments
    actor = _actor(source, mask_input=settings.mask_input)
    mine = jax.eval_shape(jax.vmap(lambda one, agent: one.agent.actor(agent)), hyper, state.agent)
    _check_sizes(source, state)
    actor = _with_inputs(actor, mine)
    _check_widths(actor, mine)
    take = jax.vmap(lambda one, agent: one.agent.with_actor(agent, actor))
    observe = jax.vmap(lambda own: with_statistics(own, source, episodes * env.episode_length))
    compute: Callable[..., Any] = jax.eval_shape if _is_shape(state) else lambda f, *x: f(*x)
    return state.replace(
        agent=compute(take, hyper, state.agent), normaliser=compute(observe, state.normaliser)
    )


def _from_directory(path: Path, run: str | None) -> dict[str, np.ndarray]:
    """Leaves of one run's agent and normaliser, from the last checkpoint that is whole."""
    RunDirectory.open(path)
    groups = read_groups(path / CONFIG)
    names = [name for group in groups for name in group]
    if run is None and len(names) > 1:
        shown = ", ".join(names[:3]) + (", ..." if len(names) > 3 else "")
        raise SettingError(f"from: {path} has {len(names)} runs; choose --from-run of {shown}")
    run = names[0] if run is None else run
    if run not in names:
        raise SettingError(f"from_run: {path} has no run {run!r}")
    ((number, group),) = [(i, group) for i, group in enumerate(groups) if run in group]
    for checkpoint in reversed(finished_checkpoints(path / "checkpoints", number)):
        if format_of(checkpoint) == FORMAT and damage(checkpoint) is None:
            return _leaves(checkpoint, list(group).index(run))
    raise SettingError(
        f"from: {path} has no whole checkpoint of this version of {run}; take its policy, "
        f"{path / 'policies' / f'{run}.npz'}"
    )


def _leaves(checkpoint: Path, index: int) -> dict[str, np.ndarray]:
    """What a run has learned, of a checkpoint whose leaves have a leading axis of runs."""
    try:
        with open_arrays(checkpoint) as arrays:
            return {name: arrays[name][index] for name in arrays if name.startswith(TAKEN)}
    except (OSError, *UNREADABLE) as error:
        raise SettingError(f"from: {checkpoint} cannot be read: {error}") from None


def _holds_state(arrays: Arrays) -> bool:
    return any(name.startswith(TAKEN) for name in arrays)


def _with_leaves(source: Arrays, state: TrainingState) -> TrainingState:
    """A state whose agent and normaliser are those of the source in every run."""
    named = named_leaves(state)
    mine = {name for name, _ in named if name.startswith(TAKEN)}
    for name in sorted(mine ^ set(source)):
        where = "in the source" if name in source else "here"
        raise SettingError(f"from: the agents differ: {_said(name)} is only {where}")
    leaves = []
    for name, leaf in named:
        if name in mine:
            (_, *shape), dtype = stored_like(leaf)
            if [*source[name].shape] != shape or source[name].dtype != dtype:
                there = f"{source[name].dtype}{[*source[name].shape]}"
                raise SettingError(
                    f"from: {_said(name)} is {there} in the source and {dtype}{shape} here"
                )
            leaf = leaf if _is_shape(state) else _repeated(source[name], leaf)
        leaves.append(leaf)
    return jax.tree.unflatten(jax.tree.structure(state), leaves)


def _repeated(array: np.ndarray, like: jax.Array) -> jax.Array:
    return restore_leaf(np.repeat(array[None], len(like), axis=0), like)


def _said(name: str) -> str:
    """A leaf's name for people: agent.actor.layer_0.kernel."""
    return name.replace("['params']", "").replace("['", ".").replace("']", "").lstrip(".")


def _is_shape(state: TrainingState) -> bool:
    return isinstance(state.env_steps, jax.ShapeDtypeStruct)


def _actor(policy: Arrays, *, mask_input: bool) -> dict[str, Any]:
    """Parameters of a policy file's actor, with what it sees of masks."""
    count = sum(name.endswith("_kernel") for name in policy)
    parts = ("kernel", "bias")
    layers = {
        f"layer_{i}": {part: jnp.asarray(policy[f"layer_{i}_{part}"]) for part in parts}
        for i in range(count)
    }
    if mask_input and "mask_weights" in policy:
        whole = (policy["layer_0_kernel"], policy["mask_weights"])
        layers["layer_0"]["kernel"] = jnp.concatenate(whole)
    return {"params": layers}


def _with_inputs(actor: Any, mine: Any) -> Any:
    """An actor that takes what those of the runs, [runs, ...], see besides, such as stages.

    All of that is 0 for the full goal, so that policy files leave it out; here it has weights of 0.
    """
    first = actor["params"]["layer_0"]
    seen, wanted = len(first["kernel"]), mine["params"]["layer_0"]["kernel"].shape[1]
    kernel = jnp.pad(first["kernel"], [(0, max(0, wanted - seen)), (0, 0)])
    return {"params": {**actor["params"], "layer_0": {**first, "kernel": kernel}}}


def _check_sizes(policy: Arrays, state: TrainingState) -> None:
    """Check that a policy file was made for observations and goals as those of the runs.

    Raises:
        SettingError: it was not.
    """
    for kind in ("observation", "goal"):
        size, own = policy[f"{kind}_mean"].size, getattr(state.normaliser, kind).mean.shape[-1]
        if size != own:
            raise SettingError(f"from: it was made for {kind}s of size {size}, not {own}")


def _check_widths(actor: Any, mine: Any) -> None:
    """Check that an actor has the layers of those of the runs, [runs, ...].

    Raises:
        SettingError: it has not.
    """
    there, here = (_widths(one) for one in (actor, mine))
    if there != here:
        raise SettingError(
            f"from: its layers are {there} in the source and {here} here, from inputs to actions"
        )


def _widths(actor: Any) -> str:
    layers = actor["params"]
    kernels = [layers[f"layer_{i}"]["kernel"].shape[-2:] for i in range(len(layers))]
    return "x".join(map(str, [kernels[0][0], *(width for _, width in kernels)]))
