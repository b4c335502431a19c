import os
from pathlib import Path

import pytest

from cgm_jax import benchmark
from cgm_jax.config.fields import SettingError
from cgm_jax.measuring import checkouts
from cgm_jax.measuring.checkouts import Checkout, find_commit, prepare, this_checkout, worktree
from tests.cgm_jax.measuring.stand_in import commit, git, write_checkout


@pytest.fixture
def repository(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A repository of two commits, taken for the one that the code runs from."""
    root = tmp_path / "repository"
    write_checkout(root, start=0, epoch=1)
    commit(root, "Before")
    write_checkout(root, start=0, epoch=2)
    commit(root, "After")
    monkeypatch.setattr(checkouts, "HERE", root)
    return root


def refusal(monkeypatch: pytest.MonkeyPatch, temporary: Path, against: str) -> str:
    """What `--against` says, which must leave nothing behind."""
    temporary.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(temporary))
    with pytest.raises(SettingError) as refused:
        benchmark.main([f"--against={against}"])
    assert list(temporary.iterdir()) == []
    return str(refused.value)


def test_a_checkouts_packages_come_before_those_of_the_users_own_path(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("PYTHONPATH", "/modules/jax")
    paths = Checkout(tmp_path, "abcdef").environment()["PYTHONPATH"].split(os.pathsep)
    assert paths == [str(tmp_path), "/modules/jax"]
    monkeypatch.delenv("PYTHONPATH")
    assert Checkout(tmp_path, "abcdef").environment()["PYTHONPATH"] == str(tmp_path)


@pytest.mark.parametrize("name", ["nowhere", "", "--all", "HEAD~2", "HEAD:cgm_jax", "HEAD HEAD"])
def test_an_unknown_commit_is_refused(
    repository: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, name: str
) -> None:
    said = refusal(monkeypatch, tmp_path / "temporary", name)
    assert said == f"against: there is no commit {name!r} in {repository}"


def test_uncommitted_changes_are_refused(
    repository: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (repository / "cgm_jax" / "sweep.py").write_text("changed")
    said = refusal(monkeypatch, tmp_path / "temporary", "HEAD")
    assert said == f"against: {repository} has uncommitted changes: cgm_jax/sweep.py"


def test_files_that_git_does_not_know_are_no_changes(repository: Path) -> None:
    (repository / "notes.txt").touch()
    assert this_checkout().root == repository


@pytest.mark.parametrize("inside", [".", "lib/site-packages"])
def test_an_installed_package_is_refused(
    repository: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, inside: str
) -> None:
    # Also one that is installed below somebody else's repository.
    root = repository / inside if inside != "." else tmp_path
    root.mkdir(parents=True, exist_ok=True)
    monkeypatch.setattr(checkouts, "HERE", root)
    said = refusal(monkeypatch, tmp_path / "temporary", "HEAD")
    assert said == f"against: {root} is not a git checkout"


def test_a_missing_git_is_refused(
    repository: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    said = refusal(monkeypatch, tmp_path / "temporary", "HEAD")
    assert said == "against: cannot run git: No such file or directory"


def test_a_commit_from_before_there_were_sweeps_is_refused(
    repository: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    git(repository, "rm", "--quiet", "cgm_jax/sweep.py")
    commit(repository, "Nothing")
    said = refusal(monkeypatch, tmp_path / "temporary", "HEAD")
    assert said == "against: commit HEAD has no cgm_jax/sweep.py"


def test_a_commit_has_one_name_however_it_is_asked_for(repository: Path) -> None:
    whole = git(repository, "rev-parse", "HEAD~1").strip()
    git(repository, "tag", "--annotate", "before", "--message", "Before", "HEAD~1")
    names = {find_commit(repository, name) for name in ("HEAD~1", whole, whole[:7], "before")}
    assert names == {whole[:8]}


def test_a_worktree_holds_the_commit_and_is_removed(repository: Path, tmp_path: Path) -> None:
    hook = repository / ".git" / "hooks" / "post-checkout"
    hook.write_text(f"#!/bin/sh\ntouch {tmp_path}/hook_ran\n")
    hook.chmod(0o755)
    path = tmp_path / "other"
    with worktree(repository, find_commit(repository, "HEAD~1"), path) as checkout:
        assert "burn(1)" in (checkout.root / "cgm_jax" / "sweep.py").read_text()
        assert "burn(2)" in (repository / "cgm_jax" / "sweep.py").read_text()
        (path / "cgm_jax" / "sweep.py").write_text("changed")
        assert len(git(repository, "worktree", "list").splitlines()) == 2
    assert not path.exists()
    assert len(git(repository, "worktree", "list").splitlines()) == 1
    assert git(repository, "status", "--porcelain") == ""
    assert not (tmp_path / "hook_ran").exists()


def test_a_worktree_is_removed_if_its_block_fails(repository: Path, tmp_path: Path) -> None:
    path = tmp_path / "other"
    with pytest.raises(KeyboardInterrupt), worktree(repository, "HEAD", path):
        raise KeyboardInterrupt
    assert not path.exists()
    assert len(git(repository, "worktree", "list").splitlines()) == 1


def test_a_checkout_that_python_does_not_import_is_refused(repository: Path) -> None:
    # Otherwise another installation would be measured twice.
    git(repository, "mv", "cgm_jax", "moved")
    with pytest.raises(SettingError, match=f"in place of {repository}"):
        prepare(checkouts.Checkout(repository, "0"))


def test_a_checkout_that_cannot_be_imported_is_refused(repository: Path) -> None:
    (repository / "cgm_jax" / "__init__.py").write_text("import nowhere")
    with pytest.raises(SettingError, match=r"0 cannot be imported: .*No module named 'nowhere'"):
        prepare(checkouts.Checkout(repository, "0"))
