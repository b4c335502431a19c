"""How settings are declared."""

from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from cgm_jax.config.components import component
from cgm_jax.config.fields import SettingError, declared, settings, static, traced
from cgm_jax.config.settings import Hyperparameters

GROWING = (Path(__file__).parents[2] / "examples" / "my_curriculum.py").read_text()


def test_a_field_that_is_declared_as_no_setting_is_refused(tmp_path: Path) -> None:
    bare = GROWING.replace('traced(0.5, "how far q follows the success of a cycle", 0, 1)', "0.5")
    assert bare != GROWING
    (tmp_path / "mine.py").write_text(bare)
    line = 1 + bare[: bare.index("@settings")].count("\n")
    with pytest.raises(SettingError) as caught:
        component("curriculum", f"{tmp_path / 'mine.py'}:Growing")
    assert str(caught.value) == (
        f"curriculum: {tmp_path / 'mine.py'} fails with TypeError: gain of Growing is not a "
        "setting: declare it by traced(DEFAULT, HELP) or static(DEFAULT, HELP), or as a ClassVar "
        f"({tmp_path / 'mine.py'}, line {line})"
    )


@pytest.mark.parametrize(
    ("declare", "default"),
    [
        (traced, np.float32(0.5)),
        (traced, (64, 64)),
        (traced, None),
        (traced, "a"),
        (static, Path()),
    ],
)
def test_a_default_of_a_type_that_no_setting_has_is_refused(declare: Any, default: Any) -> None:
    body = {"__annotations__": {"gain": object}, "gain": declare(default, "help")}
    with pytest.raises(TypeError, match=r"^gain of Own has the default .* setting is a whole"):
        settings(type("Own", (), body))


def test_what_is_of_the_class_is_no_field_and_stays_allowed() -> None:
    @settings
    class Mine:
        kind: ClassVar[int] = 3
        plain = "word"
        gain: float = traced(0.5, "a number")
        width: int = static(4, "another")

    assert [item.name for item in declared(Mine)] == ["gain", "width"]
    assert (Mine().kind, Mine().plain) == (3, "word")
    assert [item.name for item in declared(Hyperparameters)][:2] == ["seed", "action_noise"]
