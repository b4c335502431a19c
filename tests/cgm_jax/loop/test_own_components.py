import dataclasses
import re
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import pytest

from cgm_jax.agents.ddpg import DDPG
from cgm_jax.agents.protocol import Agent
from cgm_jax.config.components import ROOMS, TRACK, builtin, check_names
from cgm_jax.config.fields import SettingError, settings, traced
from cgm_jax.config.grid import Run, hyperparameters
from cgm_jax.config.settings import Hyperparameters
from cgm_jax.curricula.cgm import CGM
from cgm_jax.curricula.full import Full
from cgm_jax.loop.own_components import check_components
from cgm_jax.loop.training import Trainer, make_trainer
from cgm_jax.replay.future import Future
from tests.cgm_jax.probe import TINY, tiny
from tests.examples.my_agent import MyAgent
from tests.examples.my_curriculum import Growing
from tests.examples.point_mass import PointMass

TRAINER = make_trainer(PointMass(), TINY)
CUT = make_trainer(PointMass(), dataclasses.replace(TINY, environments=1025))
"""Whose cycles are cut."""


def check(trainer: Trainer = TRAINER, *, beside: Any = None, **own: Any) -> None:
    """Check components of the user's own, by kind, beside a curriculum of the package."""
    ours = {"curriculum": beside or Full(), "agent": tiny().agent}
    hyper = Hyperparameters(**{**ours, **own})
    names = {"curriculum": "full", "agent": "ddpg", "relabelling": "future"}
    check_components(trainer, Run("a", hyper, {**names, **dict.fromkeys(own, "own.py:Own")}))


@settings
class Silent(Full):
    def sample(self, state: Any, key: Any, drawn: Any, view: Any) -> Any:
        return None


@settings
class Raises(Full):
    def sample(self, state: Any, key: Any, drawn: Any, view: Any) -> Any:
        raise ZeroDivisionError("by nothing")


@settings
class Grows(Full):
    def init(self, sizes: Any) -> Any:
        return jnp.zeros(1)

    def sample(self, state: Any, key: Any, drawn: Any, view: Any) -> Any:
        return drawn

    def after_training(self, state: Any, outcomes: Any) -> Any:
        return jnp.concatenate([state, state])


@settings
class Claims(Full):
    def report(self, state: Any) -> dict[str, jax.Array]:
        return {"success_rate": jnp.ones(())}


@settings
class Borrows(Full):
    def report(self, state: Any) -> dict[str, jax.Array]:
        return {"value": jnp.ones(())}


@settings
class Restructures(Full):
    def after_evaluation(self, state: Any, outcomes: Any, examined: Any = None) -> Any:
        return (jnp.zeros(()),)


@pytest.mark.parametrize(
    ("curriculum", "complaint"),
    [
        (Silent(), "curriculum: own.py:Own: what sample returns is None, not Goals$"),
        (Raises(), "curriculum: own.py:Own fails with ZeroDivisionError: by nothing"),
        (Grows(), r"curriculum: own.py:Own makes float32\[2\] of float32\[1\] in .curriculum"),
        (Claims(), "curriculum: own.py:Own reports success_rate, a name that is taken"),
        (Borrows(), "curriculum: own.py:Own reports value, a name that is taken"),  # by the agent
        (Restructures(), "curriculum: own.py:Own returns a state of another structure"),
    ],
)
def test_a_curriculum_that_breaks_its_protocol_is_refused(curriculum: Any, complaint: str) -> None:
    with pytest.raises(SettingError, match=f"^{complaint}"):
        check(curriculum=curriculum)


@settings
class Remembers(Full):
    def sample(self, state: Any, key: Any, drawn: Any, view: Any) -> Any:
        return drawn.replace(memo=3)

    def after_training(self, state: Any, outcomes: Any) -> Any:
        jnp.zeros(outcomes.goals.memo)  # a shape, which an array cannot be
        return state


def test_a_memo_that_is_no_array_is_refused_where_cycles_are_cut() -> None:
    check(curriculum=Remembers())
    with pytest.raises(SettingError, match=r"^curriculum: own.py:Own fails with TypeError: Shapes"):
        check(CUT, curriculum=Remembers())


@settings
class Unlogged(DDPG):
    logged: ClassVar[tuple[str, ...]] = ("critic_loss", "no_such")


@settings
class Delayed(DDPG):
    def train(self, state: Any, batches: Any, key: Any) -> Any:
        state, info = super().train(state, batches, key)
        return state, {**info, "actor_loss": info["actor_loss"][::2]}


@settings
class Mute(DDPG):
    logged: ClassVar[tuple[str, ...]] = ()


def test_an_agent_must_return_what_it_logs() -> None:
    layers: dict[str, Any] = {"hidden_layers": (16, 16)}
    lacking = "^agent: own.py:Own: logged has no_such, but what train returns has actor_loss, "
    with pytest.raises(SettingError, match=lacking):
        check(agent=Unlogged(**layers))
    with pytest.raises(SettingError, match=r"^agent: what train logs are arrays of different"):
        check(agent=Delayed(**layers))
    check(agent=Mute(**layers))
    check(agent=DDPG(**layers))


@settings
class Misshapen(Full):
    """Its goals, masks of examination and report are whatever it is made with."""

    goals: ClassVar[dict[str, Any]] = {}
    begins: ClassVar[bool] = False
    masks: ClassVar[Any] = None
    told: ClassVar[Any] = {}

    def sample(self, state: Any, key: Any, drawn: Any, view: Any) -> Any:
        return drawn.replace(start=view.first if self.begins else None).replace(**self.goals)

    def examination(self, sizes: Any) -> Any:
        return self.masks

    def report(self, state: Any) -> Any:
        return self.told


def misshapen(**values: Any) -> Any:
    """Such a curriculum; each class is another structure to JAX."""
    return settings(type("Own", (Misshapen,), values))()


@pytest.mark.parametrize(
    ("curriculum", "complaint"),
    [
        ({"goals": {"mask": jnp.ones((8, 1))}}, "mask of sample is float32[8,1], not float32[8,2]"),
        ({"goals": {"mask": jnp.ones((8, 2), bool)}}, "mask of sample is bool[8,2], not float32"),
        ({"goals": {"desired": jnp.ones(2)}}, "desired of sample is float32[2], not float32[8,2]"),
        ({"goals": {"threshold": 0.1}}, "threshold of sample is float32[], not float32[8]"),
        ({"goals": {"start": jnp.ones(8)}}, "start of sample is not 8 states as reset and step"),
        ({"masks": jnp.ones((3, 1))}, "what examination returns is float32[3,1], not float32[3,2]"),
        ({"masks": jnp.ones(())}, "what examination returns is float32[], not float32[2]"),
        ({"told": jnp.ones(3)}, "what report returns is float32[3], not a dict"),
        ({"told": {"q": "high"}}, "q of report is of type str, not an array"),
        ({"told": {"q": None}}, "q of report is None, not an array"),
    ],
)
def test_what_a_curriculum_returns_has_the_shapes_of_its_protocol(
    curriculum: dict[str, Any], complaint: str
) -> None:
    with pytest.raises(SettingError, match=re.escape(f"curriculum: own.py:Own: {complaint}")):
        check(curriculum=misshapen(**curriculum))


def test_starts_and_masks_to_examine_that_fit_are_allowed() -> None:
    check(curriculum=misshapen(begins=True, masks=jnp.ones((3, 2))))


@settings
class Short(DDPG):
    def act(self, state: Any, inputs: Any, key: Any = None) -> Any:
        return super().act(state, inputs, key)[..., :1]


@settings
class Blind(DDPG):
    value = Agent.value  # of no critics


@settings
class Wordy(DDPG):
    def actor(self, state: Any) -> Any:
        return state


@settings
class Narrow(DDPG):
    def actor(self, state: Any) -> Any:
        actor = state.actor["params"]
        last = {name: values[..., :1] for name, values in actor["layer_2"].items()}
        return {"params": {**actor, "layer_2": last}}


@settings
class Forgetful(DDPG):
    def train(self, state: Any, batches: Any, key: Any) -> Any:
        return super().train(state, batches, key)[0]


@pytest.mark.parametrize(
    ("agent", "complaint"),
    [
        (Short, "what act returns is float32[8,1], not float32[8,2]"),
        (Blind, "what value returns is float32[0,8], not float32[3,8]"),
        (Wordy, "actor returns no parameters of networks.Actor for inputs float32[8,6]"),
        (Narrow, "the action of what actor returns is float32[8,1], not float32[8,2]"),
        (Forgetful, "train returns something else than a state and a dict"),
    ],
)
@pytest.mark.parametrize("curriculum", ["full", "vds"])
def test_what_an_agent_returns_has_the_shapes_of_its_protocol(
    curriculum: str, agent: Any, complaint: str
) -> None:
    asking = hyperparameters(curriculum=curriculum).curriculum
    with pytest.raises(SettingError, match=re.escape(f"agent: own.py:Own: {complaint}")):
        check(agent=agent(hidden_layers=(16, 16), critics=3), beside=asking)


@settings
class Tall(Future):
    def sample(self, *arguments: Any, **others: Any) -> Any:
        drawn = super().sample(*arguments, **others)
        return drawn.replace(reward=drawn.reward[:, None])


def test_what_a_way_to_relabel_draws_has_the_shapes_of_its_protocol() -> None:
    complaint = "relabelling: own.py:Own: reward of sample is float32[128,1], not float32[128]"
    with pytest.raises(SettingError, match=f"^{re.escape(complaint)}$"):
        check(relabelling=Tall())
    check(relabelling=Future())


@pytest.mark.parametrize("trainer", [TRAINER, CUT], ids=["whole", "cut"])
def test_examples_are_what_their_protocols_ask_for(trainer: Trainer) -> None:
    check(trainer, curriculum=Growing(), agent=MyAgent())
    ours = hyperparameters(curriculum="starts", agent="sac", relabelling="future")
    check(trainer, curriculum=ours.curriculum, agent=ours.agent, relabelling=ours.relabelling)


@settings
class Misspelt(Full):
    def after_traning(self, state: Any, outcomes: Any) -> Any:
        return state


@settings
class Unseen(Full):
    want_visited = True


@settings
class Helped(Full):
    """Names of its own that are like those of the protocol, but not taken for them."""

    reports: int = traced(1, "a setting")

    def report(self, state: Any) -> dict[str, jax.Array]:
        return self.reported(state)

    def reported(self, state: Any) -> dict[str, jax.Array]:
        return {"state": jnp.zeros(())}

    def _after_traning(self, state: Any) -> Any:
        return state


@settings
class Derived(CGM):
    def after_evalution(self, state: Any, outcomes: Any, examined: Any) -> Any:
        return state


@settings
class Handy(Full):
    """Helpers that are less like the protocol's functions than misspellings are."""

    def before_training(self, state: Any) -> Any:
        return state

    def file(self) -> str:
        return __file__


@settings
class HandyAgent(MyAgent):
    def evaluate(self) -> None: ...

    def q_value(self) -> None: ...


def test_helpers_may_have_names_of_their_own() -> None:
    check(curriculum=Handy(), agent=HandyAgent())


def test_what_is_nearly_the_name_of_a_function_is_refused() -> None:
    unknown = "^curriculum: own.py:Own has {}, which training does not know; write {}, or _"
    with pytest.raises(SettingError, match=unknown.format("after_traning", "after_training")):
        check(curriculum=Misspelt())
    with pytest.raises(SettingError, match=unknown.format("want_visited", "wants_visited")):
        check(curriculum=Unseen())
    with pytest.raises(SettingError, match=unknown.format("after_evalution", "after_evaluation")):
        check(curriculum=Derived())
    check(curriculum=Helped())


def test_no_component_of_ours_misspells_what_it_overrides() -> None:
    for kind in (*ROOMS, TRACK):
        assert builtin(kind)
        for name, found in builtin(kind).items():
            check_names(kind, name, found)


@pytest.mark.parametrize("name", ["mega", "starts", "vds"])
def test_curricula_that_ask_critics_refuse_an_agent_without(name: str) -> None:
    curriculum = hyperparameters(curriculum=name).curriculum
    with pytest.raises(SettingError, match=f"^critics: 0, but curriculum {name} needs"):
        TRAINER.init(Hyperparameters(curriculum=curriculum, agent=MyAgent()))
