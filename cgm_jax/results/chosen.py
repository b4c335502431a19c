"""Which policy files a command is about: a run directory's, one file, or one of the package's."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from cgm_jax.config.components import NAMES, ROOMS
from cgm_jax.config.fields import SettingError
from cgm_jax.config.settings import Settings
from cgm_jax.pretrained import pretrained_policy
from cgm_jax.storage.looking import is_directory, is_ordinary_file, is_there
from cgm_jax.storage.run_directory import RunDirectory

SUFFIX = ".npz"
IMPROVEMENT = re.compile(r"(.+)_epoch\d+")


@dataclass(frozen=True)
class Policies:
    """Policy files that were trained in one environment.

    Attributes:
        settings: name the environment.
        files: by the name of the policy.
    """

    settings: Settings
    files: Mapping[str, Path]


def chosen_policies(
    source: Path | None, pretrained: str | None, run: str | None, named: Mapping[str, Sequence[str]]
) -> list[Policies]:
    """The policies that a user's options choose.

    Args:
        source: a run directory, or a policy file of one or from elsewhere.
        pretrained: the task of a policy of the package's; then there is no source.
        run: the one run of a directory; None for all.
        named: what own code the user names now, by setting.

    Raises:
        SettingError: there is no such policy; it is not known what the policy was trained in; or
            the user has not named the code that a run directory names.
    """
    if pretrained is not None:
        return [Policies(Settings(env=pretrained), {pretrained: pretrained_policy(pretrained)})]
    if source is None:
        raise SettingError("source: name a run directory or a policy file, or give --pretrained")
    if source.suffix != SUFFIX or is_directory("source", source):
        directory = RunDirectory.open(source)
        return _of_directory(directory, run, directory.config.moved(named))
    if run is not None:
        raise SettingError("run: goes with a run directory, not with a policy file")
    if not is_ordinary_file("source", source):
        raise SettingError(f"source: there is no file {source}")
    return [Policies(_settings_of_file(source, named), {source.stem: source})]


def _of_directory(
    directory: RunDirectory, only: str | None, moved: Mapping[str, str]
) -> list[Policies]:
    """The policies of a run directory, by run name; runs without one are left out."""
    groups = directory.config.groups(moved)
    if only is not None and not any(run.name == only for group in groups for run in group.runs):
        raise SettingError(f"run: {directory.path} holds no run {only!r}")
    found = []
    for group in groups:
        paths = {run.name: directory.policy_path(run) for run in group.runs}
        files = {
            name: path
            for name, path in paths.items()
            if only in (None, name) and is_there("source", path)
        }
        found += [Policies(group.settings, files)] if files else []
    if not found:
        raise SettingError(f"{directory.path} holds no policy yet")
    return found


def _settings_of_file(path: Path, named: Mapping[str, Sequence[str]]) -> Settings:
    """Settings of the environment that a policy file was trained in.

    Those of its run, if it lies in a run directory's `policies` or `policies/improvements`; else
    of the environment that the user names.

    Raises:
        SettingError: there is neither, or the user names what only a run directory has.
    """
    folder, run = path.resolve().parent, path.stem
    if folder.name == "improvements" and (improvement := IMPROVEMENT.fullmatch(run)):
        folder, run = folder.parent, improvement[1]
    if folder.name == "policies" and RunDirectory(folder.parent).holds_sweep():
        directory = RunDirectory.open(folder.parent)
        for group in directory.config.groups(directory.config.moved(named)):
            if run in (one.name for one in group.runs):
                return group.settings
    for kind in ROOMS:
        if named.get(kind):
            raise SettingError(f"{kind}: {path} lies in no run directory, and needs --env alone")
    environments = named.get("env", ())
    if len(environments) != 1:
        raise SettingError(f"env: name the environment of {path}, which lies in no run directory")
    return Settings(env=environments[0])


def named_code(options: object) -> dict[str, list[str]]:
    """What a command's options name, by setting."""
    return {setting: list(getattr(options, setting, None) or ()) for setting in NAMES}
