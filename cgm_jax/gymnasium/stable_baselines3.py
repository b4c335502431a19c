"""For Stable-Baselines3, which is imported here alone: evaluations that feed the curriculum."""

# Stable-Baselines3 is not among the requirements.
# pyright: reportMissingImports=false

from typing import Any

import numpy as np
from stable_baselines3.common.callbacks import EvalCallback

from cgm_jax.gymnasium.goal_masking import GoalMasking


class CurriculumEvalCallback(EvalCallback):
    """Stable-Baselines3's `EvalCallback`, which also tells the curriculum what it saw.

    The evaluation environment is wrapped in `GoalMasking(..., evaluating=True)`, so that it has
    the full goal; `deterministic` stays True, as the paper estimates success without noise.
    Every evaluation episode then counts in all training environments, also those of other
    processes. Success rates and the share of full goals are logged as `curriculum/...`, beside
    what `EvalCallback` logs of the same evaluation.
    """

    def _init_callback(self) -> None:
        """Check both environments.

        Raises:
            ValueError: one is not wrapped in `GoalMasking`, or the wrong one is `evaluating`; or
                `deterministic` is False.
        """
        super()._init_callback()
        if not self.deterministic:
            raise ValueError("deterministic: the curriculum needs evaluations without noise")
        for name, env, evaluating in (
            ("training", self.training_env, False),
            ("evaluation", self.eval_env, True),
        ):
            if not all(env.env_is_wrapped(GoalMasking)):
                raise ValueError(f"the {name} environment is not wrapped in GoalMasking")
            if any(value != evaluating for value in env.get_attr("evaluating")):
                raise ValueError(f"the {name} environment needs evaluating={evaluating}")
        self._outcomes: list[np.ndarray] = []

    def _log_success_callback(self, locals_: dict[str, Any], globals_: dict[str, Any]) -> None:
        """Called after every step of an evaluation; takes the last one of each episode."""
        super()._log_success_callback(locals_, globals_)
        if not locals_["done"]:
            return
        self._outcomes.append(locals_["info"]["subgoal_success"])
        if len(self._outcomes) == self.n_eval_episodes:
            # Now, as this callback has no other chance before the evaluation's row is written.
            self._tell_curriculum(np.stack(self._outcomes))

    def _on_step(self) -> bool:
        """Called after every step of training; evaluates now and then."""
        self._outcomes = []
        return super()._on_step()

    def _tell_curriculum(self, outcomes: np.ndarray) -> None:
        """Pass episodes [k, n] on to all training environments, and log what they make of them."""
        self.training_env.env_method("record_evaluation", outcomes)
        sampler = self.training_env.get_attr("sampler", indices=0)[0]
        for i, rate in enumerate(sampler.subgoal_rates):
            self.logger.record(f"curriculum/subgoal_success_{i}", float(rate))
        self.logger.record("curriculum/full_goal_probability", sampler.full_goal_probability)
