"""Named experiments: values that replace the defaults of settings.py.

A preset gives every setting a list of values; a list longer than one is a grid axis. Options
on the command line replace the preset's lists one by one.
"""

from typing import Any

Grid = dict[str, list[Any]]

# The manipulation tasks with HER on a CPU, where network updates are the cost: narrow networks,
# half the batch, the actor every second time, which saved more time than it seemed to cost learning
# in trials (experiments/results/cpu_settings/tried.csv). Targets follow by Polyak averaging at
# every update, and the target actor is the steadier policy. Hindsight only where something moved.
_CPU: Grid = {
    "cycles_per_epoch": [25],
    "batch_size": [512],
    "hidden_layers": [(128, 128, 128)],
    "actor_update_every": [2],
    "target_update_every": [1],
    "target_rate": [0.005],
    "her_filter": [True],
    "evaluate_target": [True],
    "evaluation_episodes": [50],
    "replay_transitions": [600_000],
}

# Exploration pursues first the grip where it can move the block, then the block; question `stages`
# of experiments/plans.toml. Whether masks help beside that, five seeds do not tell.
_PUSH: Grid = {"relabelling": ["relay"], "relay_share": [0.15]}

# Something carried is let go at the next random action; so as many of them, but in a row. Pushing
# does not need that; in a trial of one seed it learned a little faster without.
_CARRYING: Grid = {"random_action_steps": [5]}

_PICK_AND_PLACE: Grid = {"relabelling": ["relay"], "relay_share": [0.2], **_CARRYING}

# They need HER, wider networks and more steps than reach; so `quick` has fewer points of them.
_FEW_POINTS: Grid = {
    "her": [True],
    "c_g": [0.1, 0.4],
    "kappa": [32.0],
    "seed": [0],
    "environments": [16],
}

PRESETS: dict[str, Grid] = {
    # Seconds; proves that the whole path works, and learns nothing.
    "smoke": {
        "env": ["reach"],
        "kappa": [4.0, 32.0],
        "epochs": [2],
        "cycles_per_epoch": [2],
        "environments": [4],
        "updates_per_cycle": [4],
        "batch_size": [32],
        "hidden_layers": [(32, 32)],
        "replay_transitions": [1000],
        "evaluation_episodes": [10],
    },
    # The paper's question on the fastest task: what do c_g and kappa do to DDPG? The whole
    # grid, three seeds and the baseline without CGM, within ten minutes on two cores.
    "quick": {
        "env": ["reach"],
        "her": [False],
        "curriculum": ["cgm", "full"],
        "c_g": [0.0, 0.1, 0.2, 0.4, 0.6, 0.8],
        "kappa": [1.0, 4.0, 32.0],
        "seed": [0, 1, 2],
        "epochs": [18],
        "cycles_per_epoch": [5],
        "environments": [8],
        "batch_size": [128],
        "target_update_every": [1],
        "target_rate": [0.02],
        "hidden_layers": [(64, 64)],
        "replay_transitions": [50_000],
    },
    # The manipulation tasks with HER on a CPU, in minutes per run.
    "cpu": {**_CPU, "env": ["push"], "epochs": [20]},
    # Thousands of environments side by side, as a GPU wants them. A cycle is 51,200 environment
    # steps and an epoch of its own. Updates and batch are from trials on a CPU of one seed each,
    # which were not recorded; what three seeds did there is question `thousands` of
    # experiments/plans.toml. No GPU has run it yet: `make gpu` measures it there.
    "gpu": {
        **_CPU,
        "env": ["push"],
        "epochs": [16],
        "cycles_per_epoch": [1],
        "environments": [1024],
        "batch_size": [1024],
        "updates_per_cycle": [640],
    },
    # As printed: all 18 points, both tasks, with and without HER. For a GPU, or for patience.
    "paper": {
        "env": ["push", "pick_and_place"],
        "c_g": [0.0, 0.1, 0.2, 0.4, 0.6, 0.8],
        "kappa": [1.0, 4.0, 32.0],
        "her": [True, False],
        "seed": [0, 1, 2, 3, 4],
        "epochs": [300],
    },
}

# Where a preset's tasks differ. The paper's push used 4 workers of 4 rollouts, pick-and-place
# 16; summed gradients of w workers act, under Adam, like one batch of 256 w.
BY_ENV: dict[str, dict[str, Grid]] = {
    "quick": {
        "push": {**_CPU, **_FEW_POINTS, "epochs": [20]},
        "pick_and_place": {**_CPU, **_FEW_POINTS, **_CARRYING, "epochs": [40]},
    },
    "cpu": {
        "reach": {"epochs": [3]},
        "push": _PUSH,
        "pick_and_place": {**_PICK_AND_PLACE, "epochs": [45]},
    },
    "gpu": {
        "reach": {"epochs": [3]},
        "push": _PUSH,
        "pick_and_place": {**_PICK_AND_PLACE, "epochs": [30], "updates_per_cycle": [800]},
    },
    "paper": {
        "push": {"environments": [16], "batch_size": [1024]},
        "pick_and_place": {"environments": [64], "batch_size": [4096]},
    },
}


def preset_grid(name: str, env: str | None = None) -> Grid:
    """The values of a preset, for one environment if the preset differs between them."""
    return {**PRESETS[name], **BY_ENV.get(name, {}).get(env or "", {})}
