"""Curriculum goal masking (CGM) for goal-conditioned reinforcement learning, in JAX.

Programs, one file a command: `python -m cgm_jax.sweep`, `.train` (a sweep of one), `.launch` (a
sweep in parts) and `.merge`, `.evaluate`, `.export`, `.report`, `.benchmark`. Behind
them, in folders:

    config/      what is asked for: settings, presets, the grid of a sweep
    curricula/   what to practise: CGM of Eppe, Magg and Wermter (2019), and others
    agents/      who learns: DDPG, TD3, SAC
    replay/      what is replayed: the ring of episodes, hindsight
    loop/        the training loop: rollout, cycle, epoch, evaluation, pure functions over one state
    envs/        what is acted in: the Fetch tasks (in a checkout a link to the folder `envs`)

    storage/     what lies on the disk: run directories, files of arrays
    host/        the process around training: signals, memory, progress
    machine/     what the process runs on: cores, memory, what fails below JAX
    launching/   many processes for one sweep: this machine, SLURM, Ray
    results/     what is made of runs: figures, a page, merged parts, measured policies, videos,
                 trackers, ONNX
    pretrained/  policies that come with the package
    measuring/   how fast it is: what the benchmark measures
    gymnasium/   for other libraries, without JAX: CGM as a wrapper, names of the Fetch tasks

What other programs may import (tests/test_public_imports.py holds this list to its word); all else
may change with any version:

    from cgm_jax.agents.ddpg import DDPG
    from cgm_jax.agents.gradients import ADAM, descend
    from cgm_jax.agents.networks import apply_actor, apply_critic, init_actor
    from cgm_jax.agents.products import product
    from cgm_jax.agents.protocol import Agent, Info, Minibatch, Parameters
    from cgm_jax.agents.sac import SAC
    from cgm_jax.agents.td3 import TD3
    from cgm_jax.config.fields import SettingError, check, settings, stack, static, traced
    from cgm_jax.config.grid import build_groups, hyperparameters
    from cgm_jax.config.settings import Hyperparameters, Settings
    from cgm_jax.config.sizes import Sizes
    from cgm_jax.curricula.cgm import CGM
    from cgm_jax.curricula.protocol import Curriculum, Goals, Outcomes, View, with_mask
    from cgm_jax.envs import ENGINES, TASKS, GoalEnvironment, StartableEnvironment, make
    from cgm_jax.envs import JudgingEnvironment, RenderableEnvironment, Stage, StagedEnvironment
    from cgm_jax.evaluate import main
    from cgm_jax.gymnasium import GoalMasking, VectorGoalMasking
    from cgm_jax.gymnasium.stable_baselines3 import CurriculumEvalCallback
    from cgm_jax.loop.training import Programs, Trainer, make_programs, make_trainer
    from cgm_jax.pretrained import pretrained_policy
    from cgm_jax.replay.future import Drawn, Future
    from cgm_jax.replay.protocol import Relabelling, Transitions
    from cgm_jax.replay.ring import Episodes, Replay, steps_taken
    from cgm_jax.report import main
    from cgm_jax.results.trackers.protocol import Tracker
    from cgm_jax.storage.policies import act, load_policy
    from cgm_jax.storage.run_directory import RunDirectory
    from cgm_jax.sweep import main
    from cgm_jax.train import main

The loop knows environments only through `envs.GoalEnvironment`. Importing the package registers
the Fetch tasks with Gymnasium (gymnasium/registration.py).
"""

from cgm_jax.host.early_signals import end_on_early_signals as _end_on_early_signals

_end_on_early_signals()  # before anything that takes a moment to import

from cgm_jax.gymnasium.registration import register_fetch as _register_fetch  # noqa: E402
from cgm_jax.machine import forking as _forking  # noqa: E402, F401 -- sees every fork from now on

_register_fetch()

__version__ = "0.1.0"
