"""More epochs for a sweep that was begun with fewer, finished or not.

Nothing in a training state depends on how many epochs are still to come, so that a sweep which is
trained for longer has the bits of one that was asked for all of them from the start.
"""

import dataclasses
from collections.abc import Sequence

from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import Group
from cgm_jax.config.presets import Grid
from cgm_jax.storage.run_directory import RunDirectory


def extended(directory: RunDirectory, groups: Sequence[Group], chosen: Grid) -> list[Group]:
    """A directory's groups, for as many epochs as are asked for now.

    Args:
        directory: that is resumed.
        groups: what it holds.
        chosen: lists of values by setting, of which epochs count.

    Raises:
        SettingError: they are fewer than have been done, several numbers, or the sweep varies them.
    """
    asked = chosen.get("epochs")
    recorded = sorted({group.settings.epochs for group in groups})
    if asked is None or sorted(asked) == recorded:
        return list(groups)
    if len(asked) != 1:
        raise SettingError("epochs: takes one value with --resume")
    if len(recorded) > 1:
        numbers = " and ".join(map(str, recorded))
        raise SettingError(f"epochs: {directory.path} compares {numbers} epochs, which stay")
    if directory.config.shard() is not None:
        raise SettingError(
            f"epochs: {directory.path} is a part of a sweep; merge the parts, then train the whole"
        )
    (epochs,), done = asked, directory.epochs_begun()
    if epochs < done:
        raise SettingError(
            f"epochs: {epochs} are fewer than the {done} that {directory.path} has begun"
        )
    return [_with_epochs(group, epochs) for group in groups]


def _with_epochs(group: Group, epochs: int) -> Group:
    runs = [dataclasses.replace(run, values={**run.values, "epochs": epochs}) for run in group.runs]
    return Group(dataclasses.replace(group.settings, epochs=epochs), tuple(runs))
