import itertools
import re
from collections import defaultdict
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import pytest

from cgm_jax.config.components import ROOMS, builtin, builtin_fields, component
from cgm_jax.config.fields import SettingError, declared
from cgm_jax.config.grid import hyperparameters
from cgm_jax.config.settings import LOOP_FIELDS

EXAMPLES = Path(__file__).parents[2] / "examples"


def test_components_are_found_under_the_names_of_their_files() -> None:
    names = {kind: set(builtin(kind)) for kind in ROOMS}
    assert names["curriculum"] >= {
        "full",
        "uniform",
        "cgm",
        "learnability",
        "progress",
        "accuracy",
    }
    assert names["agent"] >= {"ddpg"}
    assert names["relabelling"] >= {"future"}
    for kind in ROOMS:
        for name, found in builtin(kind).items():
            assert found.__module__.endswith(f".{name}")


def test_components_whose_settings_are_alike_are_different_structures() -> None:
    for kind in ROOMS:
        structures = [jax.tree.structure(found()) for found in builtin(kind).values()]
        for one, other in itertools.combinations(structures, 2):  # by comparison, not by hash
            assert one != other


def test_components_that_share_an_option_declare_it_alike() -> None:
    declarations = defaultdict(dict)
    for kind in ROOMS:
        for name, found in builtin(kind).items():
            for item in declared(found):
                said = (item.type, dict(item.metadata))
                declarations[item.name][f"{kind} {name}"] = said
    shared = {option: owners for option, owners in declarations.items() if len(owners) > 1}
    assert set(shared["progress_window"]) >= {"curriculum progress", "curriculum accuracy"}
    for option, owners in shared.items():
        first = next(iter(owners.values()))
        assert all(said == first for said in owners.values()), (option, owners)


def test_an_own_component_shares_no_setting_by_accident(tmp_path: Path) -> None:
    growing = (EXAMPLES / "my_curriculum.py").read_text()
    path, line = tmp_path / "mine.py", 'discount: float = traced(0.9, "of what I practise", 0, 1)'
    path.write_text(growing.replace("    gain: float", f"    {line}\n    gain: float"))
    with pytest.raises(SettingError) as caught:
        hyperparameters(curriculum=f"{path}:Growing")
    assert str(caught.value).startswith(
        f"agent: ddpg and {path}:Growing both have a setting called discount, but do not mean"
    )
    path.write_text(
        "from cgm_jax.agents.ddpg import DDPG\nfrom cgm_jax.config.fields import shared\n"
        + path.read_text().replace(line, 'discount: float = shared(DDPG, "discount")')
    )
    again = tmp_path / "again.py"
    path.rename(again)
    hyper = hyperparameters(curriculum=f"{again}:Growing", discount=0.7)
    assert getattr(hyper.curriculum, "discount") == hyper.agent.discount == 0.7  # noqa: B009


def test_no_component_has_an_option_of_the_loop() -> None:
    assert not set(builtin_fields()) & {*LOOP_FIELDS, *ROOMS}


@pytest.mark.parametrize(
    ("kind", "example", "name", "lacking", "protocol"),
    [
        ("curriculum", "my_curriculum", "Growing", ["sample"], "curricula.protocol.Curriculum"),
        ("agent", "my_agent", "MyAgent", ["actor"], "agents.protocol.Agent"),
        ("agent", "my_agent", "MyAgent", ["critics", "act", "train"], "agents.protocol.Agent"),
    ],
)
def test_a_class_that_lacks_what_its_protocol_leaves_to_it_is_refused(
    kind: str, example: str, name: str, lacking: list[str], protocol: str, tmp_path: Path
) -> None:
    source = (EXAMPLES / f"{example}.py").read_text()
    for each in lacking:
        source = re.sub(rf"(def )?\b{each}\b(?=\(self|.= 0)", rf"\1my_{each}", source)
    (tmp_path / "mine.py").write_text(source)
    text = f"{tmp_path / 'mine.py'}:{name}"
    with pytest.raises(SettingError) as caught:
        component(kind, text)
    assert str(caught.value) == f"{kind}: {text} lacks {', '.join(lacking)}; see cgm_jax.{protocol}"


def test_an_agent_without_critics_needs_no_value(tmp_path: Path) -> None:
    source = (EXAMPLES / "my_agent.py").read_text()
    (tmp_path / "mine.py").write_text(source.replace("def value(", "def my_own("))
    agent: Any = component("agent", f"{tmp_path / 'mine.py'}:MyAgent")()
    assert agent.critics == 0
    assert agent.value(None, jnp.zeros((5, 3)), jnp.zeros((5, 2))).shape == (0, 5)
