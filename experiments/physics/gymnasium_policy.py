"""Play a policy file in Gymnasium-Robotics, with the README's lines of numpy and nothing of ours.

`python -m experiments.physics.gymnasium_policy POLICY.npz ENV_ID EPISODES SEED OUT.npz`, in an
environment with gymnasium-robotics (`make transfer` builds it), writes, per episode, `object_xy`
[episodes, 2], `desired_goal` [episodes, 3] and `success` [episodes].
"""

# gymnasium-robotics is not installed where the type checker runs.
# pyright: reportMissingImports=false

import sys
from collections.abc import Callable
from pathlib import Path

import gymnasium
import gymnasium_robotics
import numpy as np

README = Path(__file__).resolve().parents[2] / "README.md"


def readme_policy(path: Path) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """The function `act` of the README's lines, reading the policy file at `path`."""
    code = README.read_text().split("<!-- policy -->\n```python\n")[1].split("```")[0]
    namespace: dict[str, object] = {"path": path}
    exec(code, namespace)
    return namespace["act"]  # pyright: ignore[reportReturnType]


def play(policy: Path, env_id: str, episodes: int, seed: int) -> dict[str, np.ndarray]:
    """Starts, goals and success of episodes under the policy."""
    gymnasium.register_envs(gymnasium_robotics)
    env, act = gymnasium.make(env_id), readme_policy(policy)
    starts, goals, successes = [], [], []
    for episode in range(episodes):
        observation, info = env.reset(seed=seed + episode)
        starts.append(observation["observation"][3:5])
        goals.append(observation["desired_goal"])
        done = False
        while not done:
            action = act(observation["observation"], observation["desired_goal"])
            observation, _, terminated, truncated, info = env.step(action.astype(np.float32))
            done = terminated or truncated
        successes.append(bool(info["is_success"]))
    return {
        "object_xy": np.array(starts),
        "desired_goal": np.array(goals),
        "success": np.array(successes),
    }


if __name__ == "__main__":
    if len(sys.argv) != 6:
        sys.exit(__doc__)
    results = play(Path(sys.argv[1]), sys.argv[2], int(sys.argv[3]), int(sys.argv[4]))
    np.savez(sys.argv[5], **results)  # pyright: ignore[reportArgumentType]
