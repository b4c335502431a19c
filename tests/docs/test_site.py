"""The site: what pages point to is there. `make test-docs` also builds it and runs the notebook."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = sorted((ROOT / "docs").glob("*.md"))
NOTEBOOK = ROOT / "docs" / "first_run.ipynb"
README, REPORT = ROOT / "README.md", ROOT / "experiments" / "README.md"
REPOSITORY = [README, REPORT, ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md"]
LINK = re.compile(r"\]\((?!http)([^)#\s]*)(?:#([^)]*))?\)")
SHOWN = {
    "environment.html": {"Semi", "velocity", "make_trainer"},
    "curriculum.html": {"Growing", "MyState"},
    "other_libraries.html": {"make_vec", "HerReplayBuffer"},
}
"""Words that pages have from files that are put into them."""


@pytest.mark.parametrize("page", [*PAGES, *REPOSITORY], ids=lambda page: page.stem)
def test_links_lead_somewhere_in_a_checkout(page: Path) -> None:
    for target, anchor in LINK.findall(without_code(page.read_text())):
        path = page.parent / target if target else page
        assert path.exists(), target
        # GitHub does not follow symlinks.
        assert path.resolve().as_posix().endswith(target.strip("./")), target
        if anchor:
            assert anchor in {slug for slugs in anchors(path) for slug in slugs}, anchor


@pytest.mark.parametrize("page", [*PAGES, README, REPORT], ids=lambda page: page.stem)
def test_a_heading_that_is_linked_has_the_same_anchor_on_github_and_on_the_site(page: Path) -> None:
    for target, anchor in LINK.findall(without_code(page.read_text())):
        if anchor:
            path = page.parent / target if target else page
            assert (anchor, anchor) in anchors(path), anchor


def anchors(page: Path) -> set[tuple[str, str]]:
    """Of every heading: its anchor on GitHub, and by Python-Markdown's rule."""
    headings = re.findall(r"^#+ (.+)$", without_code(page.read_text()), re.MULTILINE)
    plain = [re.sub(r"[^\w\s-]", "", heading).lower() for heading in headings]
    return {(line.replace(" ", "-"), re.sub(r"[-\s]+", "-", line.strip())) for line in plain}


def without_code(text: str) -> str:
    """A page without its blocks of code, which may hold what looks like a heading or a link."""
    return re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_snippets_are_there(page: Path) -> None:
    text = page.read_text()
    for target in re.findall(r'^--8<-- "([^"]+)"', text, re.MULTILINE):
        name, _, section = target.partition(":")
        source = (ROOT / name).read_text()
        assert (
            not section
            or source.count(f"[start:{section}]") == source.count(f"[end:{section}]") == 1
        )


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_commands_and_snippets_are_what_the_site_takes_them_for(page: Path) -> None:
    text = page.read_text()
    assert not re.findall(r"^(?:python|make|pip|source) .*", text, re.MULTILINE)  # not indented
    assert len(re.findall(r"8 ?<", text)) == len(re.findall(r'^--8<-- "', text, re.MULTILINE))


def test_every_page_is_in_the_menu() -> None:
    menu = (ROOT / "mkdocs.yml").read_text()
    made = {"results.md", "api.md"}
    assert set(re.findall(r"^  - .*: ([\w/]+\.md)$", menu, re.MULTILINE)) - made == {
        page.name for page in PAGES
    }


def test_the_site_builds_strictly(tmp_path: Path) -> None:
    pytest.importorskip("mkdocs", reason="make test-docs has it")
    build = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)]
    result = subprocess.run(build, cwd=ROOT, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    assert "is proportional to (1 - |c_m - c_g|)^kappa" in (tmp_path / "method.html").read_text()
    assert "normalised_limit" in (tmp_path / "index.html").read_text()  # the README's lines
    for page, shown in SHOWN.items():
        assert shown <= {*re.findall(r"\w+", (tmp_path / page).read_text())}
    for page in tmp_path.glob("*.html"):
        assert "8&lt;" not in page.read_text().replace(" ", "")
    assert (tmp_path / "results" / "page.png").is_file()
    for room in (path.parent.name for path in (ROOT / "cgm_jax").glob("*/__init__.py")):
        assert f"cgm_jax.{room}" in (tmp_path / "api" / f"{room}.html").read_text()


def test_the_notebook_runs(tmp_path: Path) -> None:
    nbclient = pytest.importorskip("nbclient", reason="make test-docs has it")
    nbformat = pytest.importorskip("nbformat", reason="make test-docs has it")
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    (parameters,) = [cell for cell in notebook.cells if "tags" in cell.metadata]
    parameters.source = "REACH_EPOCHS = 1\nSWEEP_EPOCHS = 2"
    nbclient.NotebookClient(
        notebook, timeout=600, resources={"metadata": {"path": str(tmp_path)}}
    ).execute()
    rows = (tmp_path / "runs/reach/metrics.jsonl").read_text().splitlines()
    assert [json.loads(row)["epoch"] for row in rows] == [1]
    assert (tmp_path / "runs/c_g/figures/learning_curves.png").is_file()
    shown = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    assert any("image/png" in output.get("data", {}) for output in shown)


def test_the_notebook_is_committed_without_outputs() -> None:
    cells = json.loads(NOTEBOOK.read_text())["cells"]
    assert all(not cell.get("outputs") for cell in cells)
