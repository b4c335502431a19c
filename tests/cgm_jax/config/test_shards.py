"""Parts of a sweep: whole runs, balanced, the same wherever they are made."""

import dataclasses
import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from cgm_jax import sweep
from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import Group, build_groups
from cgm_jax.config.shards import MAX_PARTS, cut, digest, former_digests, parse_shard
from cgm_jax.host.asked import Asked, asked_for
from cgm_jax.host.command_line import parse
from cgm_jax.host.to_train import _record_shard, _recorded_groups
from cgm_jax.storage.run_directory import RunDirectory
from tests.cgm_jax.sweeps import POINT_MASS


@pytest.fixture(scope="module")
def groups() -> list[Group]:
    """Seven runs of two programs: five of CGM, two without."""
    cgm = build_groups("smoke", {"kappa": [4.0], "seed": [0, 1, 2, 3, 4]})
    full = build_groups("smoke", {"curriculum": ["full"], "seed": [0, 1]})
    return [*cgm, *full]


def names(groups: list[Group]) -> list[list[str]]:
    return [[run.name for run in group.runs] for group in groups]


def test_parts_are_consecutive_and_cut_programs_only_where_they_must(groups: list[Group]) -> None:
    assert [len(group.runs) for group in groups] == [5, 2]
    (cgm, full) = names(groups)
    pieces = [names(cut(groups, part, 3)[0]) for part in (1, 2, 3)]
    assert pieces == [[cgm[:2]], [cgm[2:4]], [cgm[4:], full]]


@pytest.mark.parametrize("parts", range(1, 8))
def test_parts_hold_every_run_once_and_differ_by_one_at_most(
    groups: list[Group], parts: int
) -> None:
    pieces = [cut(groups, part, parts)[0] for part in range(1, parts + 1)]
    sizes = [sum(len(group.runs) for group in piece) for piece in pieces]
    assert max(sizes) - min(sizes) <= 1
    together = [run.name for piece in pieces for group in piece for run in group.runs]
    assert together == [run.name for group in groups for run in group.runs]


def test_a_part_knows_the_whole(groups: list[Group]) -> None:
    first, second = (cut(groups, part, 7)[1] for part in (1, 2))
    assert (first.part, first.parts, second.part) == (1, 7, 2)
    assert first.sweep == second.sweep
    assert first.swept == ("curriculum",)  # though the part itself holds but one run
    fewer = cut([groups[0]], 1, 5)[1]
    assert fewer.sweep != first.sweep
    assert fewer.swept == ()
    other = build_groups("smoke", {"kappa": [4.5], "seed": [0, 1, 2, 3, 4]})
    assert cut(other, 1, 5)[1].sweep != fewer.sweep


def own_groups(folder: Path) -> list[Group]:
    """Two runs of an environment of the user's own that lies in a folder."""
    file = folder / "sharded_point.py"
    folder.mkdir(exist_ok=True)
    shutil.copy(POINT_MASS.partition(":")[0], file)
    return build_groups("smoke", {"env": [f"{file}:PointMass"], "kappa": [4.0], "seed": [0, 1]})


def test_parts_belong_together_wherever_their_own_code_lies(
    groups: list[Group], tmp_path: Path
) -> None:
    one, other = (cut(own_groups(tmp_path / name), 1, 2)[1] for name in "ab")
    assert one == other
    former = [former_digests(own_groups(tmp_path / name)) for name in "ab"]
    assert former[0][0] == former[1][0]
    assert former[0][1] != former[1][1]  # which had the folders in them
    assert one.sweep not in former[0]
    renamed = build_groups("smoke", {"env": ["reach"], "kappa": [4.0], "seed": [0, 1]})
    assert cut(renamed, 1, 2)[1] != one


def without(groups: list[Group], name: str) -> list[Group]:
    """Runs as a version recorded them that did not have a setting."""
    return [
        Group(
            group.settings,
            tuple(
                dataclasses.replace(run, values={k: v for k, v in run.values.items() if k != name})
                for run in group.runs
            ),
        )
        for group in groups
    ]


def test_settings_that_a_version_has_besides_do_not_make_another_sweep(groups: list[Group]) -> None:
    assert digest(without(groups, "full_share")) == digest(groups)
    assert digest(without(groups, "epochs")) != digest(groups)  # smoke's are not the default


@pytest.mark.parametrize("version", [0, 1])
def test_a_part_of_an_earlier_version_is_known_again_and_recorded_as_a_new_one(
    version: int, tmp_path: Path
) -> None:
    whole = own_groups(tmp_path / "a")
    pieces, shard = cut(whole, 2, 2)
    former = dataclasses.replace(shard, sweep=former_digests(whole)[version])
    with RunDirectory.claimed(tmp_path / "part", fresh=True) as directory:
        directory.config.write(pieces, "smoke", "cpu", shard=former)
        words = ["--preset", "smoke", "--env", str(pieces[0].runs[0].values["env"])]
        words += ["--kappa", "4", "--seeds", "2", "--shard", "2/2"]
        asked = asked_for(parse(sweep.SweepOptions, words, ""))
        assert asked.shard == shard
        assert _recorded_groups(directory.path, asked, {}) == pieces
        _record_shard(directory, asked.shard)
        assert directory.config.shard() == shard
        assert directory.config.groups() == pieces
        before = directory.config.read_bytes()
        _record_shard(directory, None)  # as with --resume
        assert directory.config.read_bytes() == before
    with RunDirectory.claimed(tmp_path / "whole", fresh=True) as directory:
        directory.config.write(pieces, "smoke", "cpu")
    with pytest.raises(SettingError, match="already holds another part, or a whole sweep"):
        _recorded_groups(directory.path, asked, {})


def test_more_parts_than_runs_are_refused_in_every_part(groups: list[Group]) -> None:
    for part in (1, 8):
        with pytest.raises(SettingError, match=r"^shard: 8 parts of 7 runs are too many; .* 7$"):
            cut(groups, part, 8)


@pytest.mark.parametrize(
    "text", ["", "1", "0/2", "3/2", "1/0", "-1/2", "1/2/3", "a/b", "1/99999", "1 / 2", "\u0661/2"]
)
def test_what_is_no_part_is_refused(text: str) -> None:
    with pytest.raises(SettingError, match=r"^shard: "):
        parse_shard(text)


def test_a_part_is_a_number_of_a_number() -> None:
    assert parse_shard("2/3") == (2, 3)


def test_a_directory_knows_which_part_it_holds(groups: list[Group], tmp_path: Path) -> None:
    pieces, shard = cut(groups, 2, 3)
    with RunDirectory.claimed(tmp_path / "part", fresh=True) as directory:
        directory.config.write(pieces, "smoke", "cpu", shard=shard)
    assert directory.config.shard() == shard
    assert directory.config.groups() == pieces
    asked = Asked("smoke", {}, pieces, shard=shard)
    assert _recorded_groups(directory.path, asked, {}) == pieces
    # The same runs may be another part of another sweep.
    for other in (None, dataclasses.replace(shard, sweep="0"), dataclasses.replace(shard, parts=4)):
        with pytest.raises(SettingError, match="already holds another part, or a whole sweep"):
            _recorded_groups(directory.path, asked._replace(shard=other), {})


@pytest.mark.parametrize(
    "change",
    [
        {"part": 0},
        {"part": 4},
        {"parts": MAX_PARTS + 1},  # each of which would be looked for
        {"part": "1"},
        {"sweep": 3},
        {"swept": None},
        {"swept": [1]},
        {"x": 1},
    ],
)
def test_a_damaged_part_is_refused(
    groups: list[Group], tmp_path: Path, change: dict[str, Any]
) -> None:
    pieces, shard = cut(groups, 2, 3)
    with RunDirectory.claimed(tmp_path / "part", fresh=True) as directory:
        directory.config.write(pieces, "smoke", "cpu", shard=shard)
    config = json.loads(directory.config.read_bytes())
    config["shard"] |= change
    (directory.path / "config.json").write_text(json.dumps(config))
    with pytest.raises(SettingError, match=r"config\.json is damaged"):
        directory.config.shard()


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["--shard", "3/2"], "shard: 3/2 is not I/N"),
        (["--shard", "1/3"], "shard: 3 parts of 2 runs are too many; give at most 2"),
        (["--resume", "out", "--shard", "1/2"], "resume: a sweep resumes as it was begun, without"),
    ],
)
def test_sweeps_refuse_bad_parts_before_anything_is_made(
    words: list[str], line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    smoke = [] if "--resume" in words else ["--preset", "smoke"]
    with pytest.raises(SettingError, match=line):
        sweep.main([*smoke, *words])
    assert not list(tmp_path.iterdir())
