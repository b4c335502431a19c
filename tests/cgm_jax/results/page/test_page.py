import hashlib
import json
import os
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from cgm_jax.results.page.data import page_data
from cgm_jax.results.page.page import (
    FOLDER,
    LIBRARIES,
    LICENCES,
    PROGRAMS,
    page_text,
    unpacked,
    write_page,
)
from cgm_jax.results.page.sweeps import read_sweep
from cgm_jax.results.page.videos import MAX_BYTES
from tests.cgm_jax.results.page.made import TROUBLE, directory, grid, masks, timed_run, troubled

GIF = b"GIF89a\x01\x00\x01\x00\x80\x00\x00\x00\x00\x00\xff\xff\xff!\xf9\x04\x01\x00\x00\x00\x00,"


class Tags(HTMLParser):
    """Tags of a page in the order in which a browser meets them, with their attributes."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))

    def named(self, *names: str) -> list[dict[str, str | None]]:
        return [attributes for tag, attributes in self.found if tag in names]


def test_the_page_holds_the_data_and_loads_nothing(tmp_path: Path) -> None:
    sweep = read_sweep(grid(tmp_path / "run"))
    page = page_text([sweep])
    data = unpacked(page)
    assert data.pop("reload") is None
    expected = json.loads(json.dumps(page_data([sweep])))
    assert data | {"made": ""} == expected | {"made": ""}
    tags = Tags(page)
    assert len(tags.named("script")) == 2 + len(LIBRARIES)
    assert tags.named("link") == [{"rel": "icon", "href": "data:,"}]
    assert not [own for _, own in tags.found if own.get("src")]
    assert "@import" not in page
    assert not re.search(r"url\(|\bfetch\(|XMLHttpRequest", _own(page))


def _own(page: str) -> str:
    """A page without the libraries, which can load data, but are not asked to."""
    for name in LIBRARIES:
        page = page.replace((FOLDER / name).read_text(), "")
    return page


def test_no_name_in_a_directory_becomes_html(tmp_path: Path) -> None:
    path = troubled(tmp_path / TROUBLE.replace("/", "|"))
    film = path / "<video onerror=x>.gif"
    film.write_bytes(GIF)
    tags = Tags(page_text([read_sweep(path)]))
    assert len(tags.named("script")) == 2 + len(LIBRARIES)
    assert [own["alt"] for own in tags.named("img")] == [f"{path.name}/{film.name}"]
    assert not [own for _, own in tags.found if any(name.startswith("on") for name in own)]


def test_videos_are_in_the_page_and_links_are_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = grid(tmp_path / "run", seeds=1, epochs=3)
    (path / "videos").mkdir()
    (path / "videos/best.mp4").write_bytes(b"\x00\x00\x00\x18ftypmp42")
    (path / "secret.gif").symlink_to(tmp_path / "elsewhere.gif")
    os.mkfifo(path / "endless.gif")
    with (path / "huge.mp4").open("wb") as file:
        file.truncate(MAX_BYTES + 1)
    (video,) = Tags(page_text([read_sweep(path)])).named("video")
    assert video["aria-label"] == "run/videos/best.mp4"
    assert video["src"] == "data:video/mp4;base64,AAAAGGZ0eXBtcDQy"
    assert "huge.mp4 is not in the page" in capsys.readouterr().err


@pytest.mark.slow
def test_a_page_of_100_runs_and_100_epochs_is_small(tmp_path: Path) -> None:
    draw = np.random.default_rng(0).random
    rows = []
    for seed in range(100):
        metrics = {name: lambda _: draw(8).round(7).tolist() for name in (*masks(1), "mask_share")}
        for name in ("actor_loss", "critic_loss", "value", "moved_share"):
            metrics[name] = lambda _: round(float(draw()), 7)
        metrics["subgoal_success"] = lambda _: draw(3).round(2).tolist()
        rows += timed_run(draw(100).round(2).tolist(), seed, (), **metrics)
    out = tmp_path / "page.html"
    write_page(out, [read_sweep(directory(tmp_path / "run", rows))])
    assert out.stat().st_size < 6e6


def test_every_program_is_put_together_and_every_library_is_what_it_says() -> None:
    assert {path.stem for path in (FOLDER / "js").iterdir()} == {*PROGRAMS}
    told = (FOLDER / "vendor/README.md").read_text()
    for name in LIBRARIES:
        digest = hashlib.sha256((FOLDER / name).read_bytes()).hexdigest()
        assert f"| {Path(name).name} |" in told
        assert digest in told


def test_a_page_carries_the_licences_of_what_draws_it(tmp_path: Path) -> None:
    page = page_text([read_sweep(directory(tmp_path / "run", timed_run([0.5], 0, ())))])
    for name in LICENCES:
        text = (FOLDER / name).read_text()
        assert "Copyright" in text
        assert text in page
        assert "--" not in text  # which would end the comment that they stand in
