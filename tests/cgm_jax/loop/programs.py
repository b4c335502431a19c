"""Programs that tests of this folder share; as long as all train three runs, they compile once."""

from cgm_jax.loop.training import make_programs, make_trainer
from tests.cgm_jax.probe import TINY
from tests.examples.point_mass import PointMass

PROGRAMS = make_programs(make_trainer(PointMass(), TINY))
