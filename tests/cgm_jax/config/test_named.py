"""Code in the user's own files: what it may import, what becomes of its faults, when it may run."""

import errno
import os
import py_compile
import re
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from cgm_jax.config import allowed, named, user_code
from cgm_jax.config.fields import SettingError
from cgm_jax.config.named import label, load_named, name_now, require_named
from cgm_jax.config.user_code import digest_of


@pytest.fixture(autouse=True)
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A machine on which nothing has been named, and a process that has imported nothing."""
    modules, finders = dict(sys.modules), list(sys.meta_path)
    for names in ("_named_now", "_from_config", "_texts_named_now", "_texts_from_config"):
        monkeypatch.setattr(named, names, set())
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    yield tmp_path / "state"
    sys.meta_path[:] = finders
    for name in set(sys.modules) - set(modules):
        del sys.modules[name]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a file of the user's and its neighbours."""
    folder = tmp_path / "mine"
    (folder / "parts").mkdir(parents=True)
    (folder / "env.py").write_text("import helpers\n\ndef make():\n    return helpers.WHO\n")
    (folder / "helpers.py").write_text("from parts import more\n\nWHO = more.WHO\n")
    (folder / "parts" / "more.py").write_text("WHO = 'mine'\n")
    return folder


def run(folder: Path, code: str, name: str = "make") -> object:
    (folder / "code.py").write_text(code)
    return load_named("env", f"{folder / 'code.py'}:{name}")()


def in_a_new_process() -> None:
    """Forget what was named and imported in this one."""
    named._named_now.clear()
    named._from_config.clear()
    for finder in user_code._finders.values():
        finder.forget(finder.found)


def test_a_file_imports_its_neighbours_from_any_working_directory(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "helpers.py").write_text("WHO = 'the working directory'\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.chdir(tmp_path)
    assert load_named("env", "mine/env.py:make")() == "mine"
    relative = "from . import helpers\nfrom .parts.more import WHO\ndef make(): return WHO"
    assert run(folder, relative) == "mine"
    lazily = "def make():\n    import helpers\n    return helpers.WHO"
    assert run(folder, lazily) == "mine"


def test_neighbours_of_the_same_name_in_two_folders_are_two_modules(
    folder: Path, tmp_path: Path
) -> None:
    other = tmp_path / "other"
    other.mkdir()
    (other / "env.py").write_text("import helpers\ndef make(): return helpers.WHO\n")
    (other / "helpers.py").write_text("WHO = 'other'\n")
    made = [load_named("env", f"{path / 'env.py'}:make") for path in (folder, other, folder)]
    assert [make() for make in made] == ["mine", "other", "mine"]
    assert made[0] is made[2]


def test_a_module_of_a_package_can_be_named(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "__init__.py").touch()
    (folder / "inner.py").write_text(
        "from mine.parts import more\nfrom . import __name__ as NAME\n"
    )
    with (folder / "inner.py").open("a") as file:
        file.write("def make(): return NAME, more.WHO\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    assert load_named("env", "mine.inner:make")() == ("mine", "mine")
    for text in ("mine.other:make", "nowhere.inner:make", "sys:exit", "mine..inner:make"):
        module = re.escape(repr(text.partition(":")[0]))
        with pytest.raises(SettingError, match=f"^env: there is no Python module {module} here$"):
            load_named("env", text)


FAULTS = {
    "import sys\nsys.exit(3)": r"fails with SystemExit: 3 \(.*code.py, line 2\)",
    "x = 1\nx = (": r"fails with SyntaxError: .*\(.*code.py, line 2\)",
    "def f():\n    raise ValueError('one\\ntwo')\nf()": r"ValueError: one \(.*code.py, line 2\)",
    "class Odd(BaseException): pass\nraise Odd": r"fails with Odd \(.*code.py, line 2\)",
    "x = \x00": "fails with SyntaxError",
    "from . import nothing": r"fails with ImportError: cannot import name 'nothing'.*line 1\)",
    "make = 5": "has no function or class 'make'",
}


@pytest.mark.parametrize("code", FAULTS)
def test_faults_of_a_file_are_one_line_with_their_place(code: str, folder: Path) -> None:
    with pytest.raises(SettingError, match=f"^env: .*{FAULTS[code]}") as caught:
        run(folder, code)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "text",
    ["a.py", ":", "a.py:", ":make", "a.py:1", "a\0b.py:make", "a\nb.py:make", "nowhere.py:F"],
)
def test_what_names_nothing_is_refused(text: str) -> None:
    with pytest.raises(SettingError, match=r"^curriculum: .* is (neither|not) FILE.py:NAME"):
        load_named("curriculum", text)


def test_what_a_file_prints_and_where_it_goes_stays_with_it(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = Path.cwd()
    code = "import os\nos.chdir('/')\nprint('hello')\ndef make(): return os.getcwd()\n"
    assert run(folder, code) == str(before)
    captured = capsys.readouterr()
    assert (captured.out, captured.err) == ("", "hello\n")


def test_code_that_takes_long_is_said_to_stand_where_it_stands(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = folder / "code.py"
    run(folder, "import time\ndef make(): return 1\ndef wait():\n    time.sleep(0.5)\n")
    wait = load_named("env", f"{path}:wait")
    with user_code.user_code("env", str(path), patience=0.1):
        wait()
    time.sleep(0.2)
    first, *_ = capsys.readouterr().err.splitlines()
    assert first == f"env: {path} has taken 0 s so far; it is at {path}, line 4"


def test_a_file_is_run_again_only_if_it_or_a_neighbour_was_edited(folder: Path) -> None:
    text = f"{folder / 'env.py'}:make"
    first = load_named("env", text)
    assert load_named("env", text) is first
    (folder / "parts" / "more.py").write_text("WHO = 'edited'\n")
    assert load_named("env", text)() == "edited"
    assert first() == "mine"


def name_and_load(text: str) -> None:
    name_now(text)
    load_named("env", text)
    in_a_new_process()


def refused(text: str, complaint: str) -> None:
    """What a config.json names does not run; one line says how to name it."""

    def load() -> None:
        require_named("env", text)
        load_named("env", text)

    with pytest.raises(SettingError, match=complaint) as caught:
        load()
    assert str(caught.value).endswith(f"if you trust it, name it: --env {text}")


def test_what_only_a_config_names_does_not_run(folder: Path) -> None:
    (folder / "code.py").write_text("from pathlib import Path\nPath(__file__ + '.ran').touch()\n")
    refused(f"{folder / 'code.py'}:make", r"code.py was never named by you on this machine")
    assert not (folder / "code.py.ran").exists()


def test_a_file_that_cannot_be_read_is_refused_in_one_line(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unreadable(path: Path) -> bytes:
        raise PermissionError(errno.EACCES, "Permission denied")

    name_and_load(f"{folder / 'env.py'}:make")
    assert digest_of(folder / "env.py") is not None
    monkeypatch.setattr(Path, "read_bytes", unreadable)
    with pytest.raises(SettingError, match=r"^env: cannot read .*env.py: Permission denied$"):
        require_named("env", f"{folder / 'env.py'}:make")
    assert digest_of(folder / "env.py") is None


EDITS: dict[str, Callable[[Path], object]] = {
    "env.py": lambda folder: (folder / "env.py").write_text("def make(): return 'evil'\n"),
    "helpers.py": lambda folder: (folder / "helpers.py").write_text("WHO = 'evil'\n"),
    "more.py": lambda folder: (folder / "parts" / "more.py").write_text("WHO = 'evil'\n"),
}


@pytest.mark.parametrize("file", EDITS)
def test_a_file_that_was_named_runs_until_it_or_a_neighbour_is_edited(
    file: str, folder: Path
) -> None:
    text = f"{folder / 'env.py'}:make"
    name_and_load(text)
    require_named("env", text)
    assert load_named("env", text)() == "mine"
    in_a_new_process()
    EDITS[file](folder)
    refused(text, f"{file} has changed since you named it on this machine")
    in_a_new_process()
    name_and_load(text)  # named again
    require_named("env", text)
    assert load_named("env", text)() == ("evil")


def test_a_neighbour_that_was_not_there_is_not_run(folder: Path) -> None:
    (folder / "env.py").write_text(
        "try: import later\nexcept ModuleNotFoundError: later = None\ndef make(): return later\n"
    )
    text = f"{folder / 'env.py'}:make"
    name_and_load(text)
    (folder / "later.py").write_text("")
    refused(text, r"later.py was never named by you")


def test_compiled_files_are_not_run_in_place_of_their_source(folder: Path) -> None:
    for path in (folder / "env.py", folder / "helpers.py"):
        source, times = path.read_text(), (1_700_000_000, 1_700_000_000)
        evil = "WHO = 'evil'\ndef make(): return 'evil'\n"
        path.write_text(evil + "#" * (len(source) - len(evil)))
        os.utime(path, times)
        py_compile.compile(str(path))
        path.write_text(source + "#" * (len(evil) - len(source)))
        os.utime(path, times)  # the same time and size: Python takes the compiled one
    assert load_named("env", f"{folder / 'env.py'}:make")() == "mine"


def test_modules_that_only_a_config_names_do_not_run(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "__init__.py").write_text("raise ValueError('run')\n")
    (folder / "inner.py").write_text("def make(): return 1\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    refused("mine.inner:make", r"inner.py was never named by you")
    refused("antigravity:make", r"antigravity.py was never named by you")
    (folder / "__init__.py").write_text("")
    name_and_load("mine.inner:make")
    (folder / "__init__.py").write_text("raise ValueError('run')\n")
    refused("mine.inner:make", r"__init__.py has changed since you named it")


def test_a_file_that_has_moved_is_said_to_be_nameable(tmp_path: Path) -> None:
    text = f"{tmp_path / 'gone.py'}:make"
    complaint = f"file that exists; if it has moved, name it: --env {re.escape(text)}"
    with pytest.raises(SettingError, match=complaint):
        require_named("env", text)


def test_a_module_that_another_interpreter_has_is_said_to_be_nameable() -> None:
    text = "gymnasium:nobody_has_this:Push-v4"
    complaint = f"here; if it has moved or is another interpreter's, name it: --env {text}$"
    with pytest.raises(SettingError, match=complaint):
        require_named("env", text)
    name_now(text)
    require_named("env", text)


@pytest.mark.parametrize("variables", [{"HOME": ""}, {"XDG_STATE_HOME": "here", "HOME": "here"}])
def test_without_a_home_only_what_is_named_now_runs(
    variables: dict[str, str], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)  # where relative directories would be
    for name, value in {"XDG_STATE_HOME": "", **variables}.items():
        monkeypatch.setenv(name, value)
    text = f"{folder / 'env.py'}:make"
    name_now(text)
    require_named("env", text)
    assert load_named("env", text)() == "mine"
    in_a_new_process()
    refused(text, "never named by you")
    assert sorted(path.name for path in folder.iterdir()) == ["env.py", "helpers.py", "parts"]


def test_where_nothing_can_be_kept_what_is_named_now_runs(folder: Path, state: Path) -> None:
    state.write_text("a file where the directory should be")
    name_and_load(f"{folder / 'env.py'}:make")
    refused(f"{folder / 'env.py'}:make", "never named by you")


def test_an_entry_is_for_one_path_and_one_content(tmp_path: Path) -> None:
    allowed.remember(tmp_path / "a.py", b"1")
    assert allowed.remembers(tmp_path / "a.py", b"1")
    assert not allowed.remembers(tmp_path / "a.py", b"2")
    assert not allowed.remembers(tmp_path / "b.py", b"1")
    assert allowed.remembers_other(tmp_path / "a.py")
    assert not allowed.remembers_other(tmp_path / "b.py")


def test_an_entry_that_somebody_else_was_made_to_write_does_not_count(
    tmp_path: Path, state: Path
) -> None:
    file = tmp_path / "ä\udcff.py"
    allowed.remember(file, b"1")
    (entry,) = state.rglob("*-*")
    assert entry.read_bytes() == f"{tmp_path}/ä\\udcff.py\n".encode()
    assert allowed.remembers(file, b"1")
    for content in (b"# a completion script\n", b"", entry.read_bytes() + b"\n"):
        entry.write_bytes(content)
        assert not allowed.remembers(file, b"1")
    allowed.remember(file, b"1")
    assert allowed.remembers(file, b"1")


def test_labels_are_names_for_files() -> None:
    assert label("/some/where/point_mass.py:PointMass") == "point_mass-PointMass"
    assert label("package.module:Name") == "package.module-Name"
    assert label("pick_and_place") == "pick_and_place"
