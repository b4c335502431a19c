"""Whether the sweep that a launch's directory holds is that of its parts, merged and at its end."""

from cgm_jax.config.fields import SettingError
from cgm_jax.machine.commands import shell_command
from cgm_jax.storage.run_directory import RunDirectory


def is_merged(directory: RunDirectory) -> bool:
    """Whether a launch's directory holds its parts, merged and with all epochs, or no sweep yet.

    Earlier versions began a sweep wherever they were told to.

    Raises:
        SettingError: it holds something else, or what it holds is damaged.
    """
    if not directory.holds_sweep():
        return False
    path = directory.path
    if "parts" not in directory.config.read():
        raise SettingError(
            f"out: {path} holds another sweep besides the launch; move its config.json, "
            "metrics.jsonl, policies, figures and checkpoints elsewhere"
        )
    directory.checked_metrics()
    from cgm_jax.results.page.sweeps import read_sweep  # which takes a moment to import

    if not read_sweep(path).finished:
        how = shell_command("cgm_jax.sweep", "--resume", path)
        raise SettingError(f"resume: {path} is merged, and trained for longer since; go on: {how}")
    return True
