import dataclasses
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import pytest

from cgm_jax.agents.ddpg import DDPG
from cgm_jax.config.fields import SettingError, settings
from cgm_jax.config.grid import Run, hyperparameters
from cgm_jax.config.settings import Hyperparameters
from cgm_jax.curricula.full import Full
from cgm_jax.loop.own_components import check_components
from cgm_jax.loop.training import Trainer, make_trainer
from tests.cgm_jax.probe import TINY, tiny
from tests.examples.my_agent import MyAgent
from tests.examples.point_mass import PointMass

TRAINER = make_trainer(PointMass(), TINY)


def check(*, curriculum: Any = None, agent: Any = None, trainer: Trainer = TRAINER) -> None:
    small = tiny().agent
    hyper = Hyperparameters(curriculum=curriculum or Full(), agent=agent or small)
    names = {"curriculum": "full", "agent": "ddpg", "relabelling": "future"}
    own = "curriculum" if agent is None else "agent"
    check_components(trainer, Run("a", hyper, {**names, own: "own.py:Own"}))


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
        (Silent(), "curriculum: own.py:Own fails with AttributeError: "),
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
    cut = make_trainer(PointMass(), dataclasses.replace(TINY, environments=1025))
    with pytest.raises(SettingError, match=r"^curriculum: own.py:Own fails with TypeError: Shapes"):
        check(curriculum=Remembers(), trainer=cut)


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
    with pytest.raises(SettingError, match=r"^agent: own.py:Own fails with KeyError: 'no_such'"):
        check(agent=Unlogged(**layers))
    with pytest.raises(SettingError, match=r"^agent: what train logs are arrays of different"):
        check(agent=Delayed(**layers))
    check(agent=Mute(**layers))
    check(agent=DDPG(**layers))


@pytest.mark.parametrize("name", ["mega", "starts", "vds"])
def test_curricula_that_ask_critics_refuse_an_agent_without(name: str) -> None:
    curriculum = hyperparameters(curriculum=name).curriculum
    with pytest.raises(SettingError, match=f"^critics: 0, but curriculum {name} needs"):
        TRAINER.init(Hyperparameters(curriculum=curriculum, agent=MyAgent()))
