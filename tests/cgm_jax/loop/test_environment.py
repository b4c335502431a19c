from pathlib import Path

import pytest

from cgm_jax import envs
from cgm_jax.config.fields import SettingError
from cgm_jax.config.settings import Settings
from cgm_jax.loop.environment import make_environment

EXAMPLE = (Path(__file__).parents[2] / "examples" / "point_mass.py").read_text()


def make(directory: Path, code: str, factory: str = "PointMass") -> object:
    path = directory / "envs.py"  # named like a package of ours, which it must not replace
    path.write_text(code)
    return make_environment(Settings(env=f"{path}:{factory}"))


def test_an_environment_comes_from_a_file_of_any_name(tmp_path: Path) -> None:
    env = make(tmp_path, EXAMPLE)
    assert type(env).__name__ == "PointMass"
    assert envs.__file__ is not None
    assert Path(envs.__file__).parent.name == "envs"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("import jax\n", "import nothing_of_that_name\n", "fails with ModuleNotFoundError"),
        ("class PointMass", "class Other", "has no function or class 'PointMass'"),
        ("    action_size: int = 2", "    action_size: int", "fails with TypeError"),
        ("    distance_threshold: float = 0.1\n", "", "lacks distance_threshold"),
        ('"desired_goal": goal', '"goal": goal', "is no dict with observation"),
        ('"achieved_goal": position', '"achieved_goal": velocity[:1]', "have shapes"),
        ("0.7 * velocity", "jnp.zeros(3) * velocity", "fails with TypeError"),
    ],
)
def test_what_is_wrong_with_an_environment_is_said_in_one_line(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    assert old in EXAMPLE
    with pytest.raises(SettingError, match=message) as caught:
        make(tmp_path, EXAMPLE.replace(old, new))
    assert "\n" not in str(caught.value)


def test_settings_of_the_fetch_tasks_are_refused_for_other_environments(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(EXAMPLE)
    with pytest.raises(SettingError, match="are for the Fetch tasks"):
        make_environment(Settings(env=f"{tmp_path / 'mine.py'}:PointMass", engine="mjx"))
