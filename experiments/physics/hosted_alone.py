"""Rollouts of a Gymnasium vector environment with random actions, one for each line of input.

A script, for an interpreter that has the task's packages and need not have ours:
`python hosted_alone.py MODULE ID ROWS`. Answers each line with how many steps the rollout took.
"""

import importlib
import os
import sys


def main(module: str, env_id: str, rows: int) -> None:
    """Serve until the input ends."""
    replies = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what the environment prints is no reply
    sys.path[0] = ""  # in place of this folder, whose files are nobody's modules
    import gymnasium

    if module:
        importlib.import_module(module)
    env = gymnasium.make_vec(env_id, num_envs=rows)
    length = gymnasium.spec(env_id).max_episode_steps
    assert length is not None
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(length)]
    for _ in sys.stdin:
        env.reset(seed=0)
        for action in actions:
            env.step(action)
        print(rows * length, file=replies, flush=True)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]))
