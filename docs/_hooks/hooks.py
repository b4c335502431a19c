"""Pages of the site that are made from the repository: the results, and the API from docstrings."""

import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[2]
EXPERIMENTS = ROOT / "experiments"
PACKAGE = ROOT / "cgm_jax"
IMAGE = re.compile(r"!\[[^]]*\]\((?:\.\./experiments/)?(results/[^)]+)\)")
LINK = re.compile(r"(?<!!)\[([^]]*)\]\(([^)#]+)\)")
OUTSIDE = re.compile(r"\[([^]]*)\]\(\.\./([^)#]+)(#[^)]*)?\)")
"""Links of pages to what lies beside docs/, which lead somewhere in a checkout, too."""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the results with their figures and records, and a page of the API for every room."""
    files.append(File.generated(config, "results.md", content=results(files, config)))
    rooms = sorted(path.parent for path in PACKAGE.glob("*/__init__.py"))
    for room in rooms:
        files.append(File.generated(config, f"api/{room.name}.md", content=api(room)))
    files.append(File.generated(config, "api.md", content=overview(rooms)))
    return files


def results(files: Files, config: MkDocsConfig) -> str:
    """experiments/README.md, whose links to files beyond its folder become plain text."""

    def local(match: re.Match[str]) -> str:
        text, target = match.groups()
        path = EXPERIMENTS / target
        if not path.is_file() or path.suffix not in (".csv", ".md", ".gif", ".png"):
            return text
        if files.get_file_from_path(target) is None:
            files.append(File.generated(config, target, abs_src_path=str(path)))
        return match.group()

    report = (EXPERIMENTS / "README.md").read_text()
    pages = [page.content_string for page in files.documentation_pages()]
    for image in {image for text in (report, *pages) for image in IMAGE.findall(text)}:
        files.append(File.generated(config, image, abs_src_path=str(EXPERIMENTS / image)))
    return LINK.sub(local, report)


def overview(rooms: list[Path]) -> str:
    """What other programs may import, and a line for every room."""
    lines = ["# API", "", "::: cgm_jax", "    options: {members: []}", ""]
    return "\n".join([*lines, *(f"- [cgm_jax.{room.name}](api/{room.name}.md)" for room in rooms)])


def api(room: Path) -> str:
    """Every public module of a room, from its docstrings."""
    modules = [
        ".".join(path.relative_to(PACKAGE).with_suffix("").parts)
        for path in sorted(room.rglob("*.py"))
        if not path.stem.startswith("_")
    ]
    lines = [f"# {room.name}", "", f"::: cgm_jax.{room.name}", "    options: {members: []}", ""]
    for module in modules:
        lines += [f"::: cgm_jax.{module}", ""]
    return "\n".join(lines)


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Links beyond docs/ lead to pages of the site; comments that tests read are not shown."""

    def here(match: re.Match[str]) -> str:
        text, target, anchor = match.groups()
        found = place(target)
        return f"[{text}]({found}{anchor or ''})" if found else text

    return OUTSIDE.sub(here, re.sub(r"<!--.*?-->\n?", "", markdown))


def place(target: str) -> str | None:
    """Where the site has a file of the repository; None where it does not show it."""
    if target == "experiments/README.md":
        return "results.md"
    if room := re.match(r"(?:cgm_jax/)?(\w+)/.*py$", target):
        return f"api/{room[1]}.md" if (PACKAGE / room[1]).is_dir() else None
    local = target.removeprefix("experiments/")
    return local if Path(local).suffix in (".png", ".gif") else None
