"""One name for a file of the user's own that lay in another folder for each part of a sweep."""

from collections.abc import Sequence
from typing import Any

from cgm_jax.config.components import NAMES
from cgm_jax.config.named import is_own, portable
from cgm_jax.storage.config_file import recorded_names


def same_names(configs: Sequence[dict[str, Any]]) -> list[dict[str, str]]:
    """What each part is to call its runs' own code: as the first part does that has it.

    Otherwise what is merged could be used only where there are all of these folders, and figures
    would tell one environment from itself.

    Args:
        configs: what the parts' config.json say, in order.

    Returns:
        Of each part its own names, and what they become.
    """
    first: dict[str, str] = {}
    found = []
    for config in configs:
        texts = [text for kind in NAMES for text in recorded_names(config, kind)]
        found.append(
            {text: first.setdefault(portable(text), text) for text in texts if is_own(text)}
        )
    return found
