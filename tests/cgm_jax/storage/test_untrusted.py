"""JSON from anybody is read only as deep as it can be written again."""

import json
from typing import Any

import pytest

from cgm_jax.storage.untrusted import MAX_DEPTH, from_json


def nested(depth: int, kind: str) -> str:
    opened, closed = {"list": ("[", "]"), "object": ('{"a": ', "}")}[kind]
    return opened * depth + "1" + closed * depth


@pytest.mark.parametrize("kind", ["list", "object"])
def test_what_nests_deeper_than_can_be_borne_is_refused(kind: str) -> None:
    value = from_json(nested(MAX_DEPTH, kind))
    assert json.dumps(value, indent=None) == nested(MAX_DEPTH, kind)
    for depth in (MAX_DEPTH + 1, 600, 100_000):
        with pytest.raises(RecursionError):
            from_json(nested(depth, kind))
        with pytest.raises(RecursionError):
            from_json(f'{{"a": [1, {nested(depth, kind)}], "b": 2}}')


@pytest.mark.parametrize("value", [None, 1.5, "[[", [], {}, [1, {"a": [True, None]}]])
def test_all_else_is_read_as_it_is(value: Any) -> None:
    assert from_json(json.dumps(value).encode()) == value
