"""Trained policies that come with the package, one for each Fetch task.

pretrained.json says how each was trained and how often it succeeds: the command, the commit, and
its success over 1,000 episodes that chose nothing. `make pretrained` trains and measures them anew.

    python -m cgm_jax.evaluate --pretrained pick_and_place --video pick.mp4
"""

from pathlib import Path

from cgm_jax.config.fields import SettingError

NAMES = ("reach", "push", "pick_and_place")
"""Of the tasks, and so of the policies."""

FOLDER = Path(__file__).parent
RECORD = FOLDER / "pretrained.json"


def pretrained_policy(name: str) -> Path:
    """The policy file of a task, for `storage.policies.load_policy` or numpy.

    Raises:
        SettingError: there is none for such a task.
    """
    if name not in NAMES:
        raise SettingError(f"pretrained: no policy {name!r}; choose from {', '.join(NAMES)}")
    return FOLDER / f"{name}.npz"
