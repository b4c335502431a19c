from typing import Any

import pytest

from cgm_jax.config.components import builtin_fields
from cgm_jax.config.fields import SettingError
from cgm_jax.config.settings import LOOP_FIELDS
from cgm_jax.config.spelling import layers_of, spelled, value_of

FIELDS = LOOP_FIELDS | builtin_fields()
LAYERS = FIELDS["hidden_layers"]


def test_layers_are_one_value_or_several() -> None:
    assert layers_of(LAYERS, ["256", "128"]) == [(256, 128)]
    assert layers_of(LAYERS, ["64x64", "128"]) == [(64, 64), (128,)]


@pytest.mark.parametrize(
    ("name", "value", "word"),
    [
        ("her", True, "on"),
        ("hidden_layers", (64,), "64"),
        ("hidden_layers", (64, 32), "64x32"),
        ("kappa", 0.1, "0.1"),
        ("epochs", 3, "3"),
        ("engine", "3", "3"),  # a text, whatever it looks like
        ("leave_at", None, "None"),
        ("leave_at", 0.5, "0.5"),
    ],
)
def test_a_value_is_read_as_it_is_spelled(name: str, value: Any, word: str) -> None:
    assert spelled(value) == word
    assert value_of(FIELDS[name], word) == value
    assert type(value_of(FIELDS[name], word)) is type(value)


@pytest.mark.parametrize(
    ("name", "word", "message"),
    [
        ("her", "yes", "her: 'yes' is not on or off"),
        ("hidden_layers", "64x", "hidden_layers: '64x' is not of a form such as 64x64"),
        ("epochs", "2.5", "epochs: '2.5' is not of type int"),
        ("leave_at", "never", "leave_at: 'never' is not of type float"),
    ],
)
def test_a_word_that_spells_no_value_is_refused_by_name(name: str, word: str, message: str) -> None:
    with pytest.raises(SettingError, match=message):
        value_of(FIELDS[name], word)
