import itertools
from collections import defaultdict

import jax

from cgm_jax.config.components import ROOMS, builtin, builtin_fields
from cgm_jax.config.fields import declared
from cgm_jax.config.settings import LOOP_FIELDS


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


def test_no_component_has_an_option_of_the_loop() -> None:
    assert not set(builtin_fields()) & {*LOOP_FIELDS, *ROOMS}
