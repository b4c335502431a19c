"""One name for a file of the user's own that lay in another folder for each part of a sweep."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from cgm_jax.config.components import NAMES
from cgm_jax.config.named import is_own, portable
from cgm_jax.storage.config_file import recorded_names, renamed

if TYPE_CHECKING:
    from cgm_jax.results.merging import Part


def with_same_names(parts: "Sequence[Part]") -> "list[Part]":
    """Parts whose runs name their own code as the first part that has it does.

    Otherwise what is merged could be used only where there are all of these folders, and figures
    would tell one environment from itself.
    """
    first: dict[str, str] = {}
    found = []
    for part in parts:
        texts = [text for kind in NAMES for text in recorded_names(part.config, kind)]
        names = {text: first.setdefault(portable(text), text) for text in texts if is_own(text)}
        groups = renamed(part.config["groups"], names)
        pieces = [replace(piece, rows=renamed(piece.rows, names)) for piece in part.pieces]
        found.append(replace(part, config={**part.config, "groups": groups}, pieces=pieces))
    return found
