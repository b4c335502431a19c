"""The page in headless Chromium: `make test-page`."""

import itertools
import math
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from cgm_jax.results.figures.runs import by_settings
from cgm_jax.results.page.page import write_page
from cgm_jax.results.page.sweeps import read_sweep
from cgm_jax.results.statistics import first_to_hold, quartiles
from tests.cgm_jax.results.page.browser import PHONE, chromium, opened
from tests.cgm_jax.results.page.made import (
    TROUBLE,
    directory,
    follow_on,
    grid,
    masks,
    timed_run,
    troubled,
)

# Not among the requirements: tests/page-requirements.txt.
pytest.importorskip("playwright")

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as started:
        yield started


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Pages of all kinds of directories, by name."""
    folder = tmp_path_factory.mktemp("pages")
    one = directory(folder / "one/run", timed_run([0.0, 0.5, 1.0]), batch_size=16)
    other = directory(folder / "other/run", timed_run([0.0] * 9), batch_size=32)
    single = directory(folder / "single", timed_run([0.25]), epochs=5)
    never = directory(folder / "never", timed_run([None, None], **masks(3)))
    begun = directory(folder / "begun", timed_run([0.0]))
    (begun / "metrics.jsonl").unlink()
    directories = {
        "grid": [grid(folder / "grid")],
        "trouble": [troubled(folder / TROUBLE.replace("/", "|"))],
        "two": [one, other],
        "single": [single],
        "never": [never],
        "begun": [begun],
    }
    for name, paths in directories.items():
        write_page(folder / f"{name}.html", [read_sweep(path) for path in paths])
    return {name: folder / f"{name}.html" for name in directories}


KINDS = ("grid", "trouble", "two", "single", "never", "begun")


@pytest.mark.parametrize(("name", "phone"), itertools.product(KINDS, (False, True)))
def test_pages_load_without_errors_and_fit(
    browser: Any, pages: dict[str, Path], name: str, phone: bool
) -> None:
    with opened(browser, pages[name], size=PHONE if phone else None) as view:
        width = view.evaluate("document.documentElement.scrollWidth")
        assert width <= view.viewport_size["width"]
        assert view.title() != "1"  # what the directory's name would make of it
        shown = view.locator("main > section:visible h2").all_inner_texts()
        if name == "begun":
            assert shown == ["Settings"]
            assert view.locator("#notice").inner_text() == "No epoch is finished yet."
        else:
            assert shown[:3] == ["Learning", "Time to success", "Final success"]


def test_every_control_at_every_value_draws_without_errors(
    browser: Any, pages: dict[str, Path]
) -> None:
    for name in ("grid", "trouble", "two"):
        with opened(browser, pages[name]) as view:
            for label in ("seconds", "epochs", "steps"):
                view.get_by_role("button", name=label, exact=True).click()
            for select in ("colour", "panel", "across", "down", "group", "measure"):
                box = view.locator(f"select[name={select}]").first
                if not box.count():  # there is nothing to choose
                    continue
                for value in box.evaluate("box => [...box.options].map(option => option.value)"):
                    box.select_option(value)


def table(view: Any, of: str) -> list[list[str]]:
    """The rows of a section's table."""
    return view.locator(f"#{of}-table tbody tr").evaluate_all(
        "rows => rows.map(row => [...row.cells].map(cell => cell.textContent))"
    )


def times(row: list[str]) -> tuple[str, list[float]]:
    """Of how many runs reached a level, and their quartiles, from a row of the table."""
    return row[1], [
        math.inf if text == "not reached" else float(text.replace(",", "")) for text in row[2:5]
    ]


def expected_times(path: Path, column: str, level: float) -> dict[str, Any]:
    """The same by statistics.py, for every setting."""
    found = {}
    for same in by_settings(read_sweep(path).runs):
        rows = [first_to_hold(run.rows, level) for run in same]
        reached = [row[column] if row else math.inf for row in rows]
        arrived = f"{sum(map(math.isfinite, reached))} of {len(same)}"
        # Tenths are shown.
        found[_label(same[0].settings)] = arrived, pytest.approx(quartiles(reached), abs=0.051)
    return found


def _label(settings: Mapping[str, Any]) -> str:
    if settings["curriculum"] == "full":
        return "full goals"
    return f"CGM, c_g {100 * settings['c_g']:g} %, κ {settings['kappa']:g}"


def test_times_to_a_level_are_those_of_statistics(browser: Any, pages: dict[str, Path]) -> None:
    path = pages["grid"].parent / "grid"
    seen = set()
    for column, level in itertools.product(("env_steps", "wall_s", "epoch"), (25, 50, 90)):
        with opened(browser, pages["grid"], f"x={column}&level={level}") as view:
            shown = {row[0]: times(row) for row in table(view, "levels")}
        assert shown == expected_times(path, column, level / 100)
        seen.add(str(shown))
    assert len(seen) == 9
    assert any("inf" in text for text in seen)


def lines(view: Any) -> int:
    """Lines of all learning curves."""
    return view.locator("#learning-panels g[aria-label=line] path").count()


def test_controls_change_what_is_shown(browser: Any, pages: dict[str, Path]) -> None:
    with opened(browser, pages["grid"]) as view:
        titles = view.locator("#learning-panels h3")
        assert titles.all_inner_texts() == ["κ 1", "κ 32"]
        assert lines(view) == 2 * 4  # three c_g, and the baseline in both panels
        view.locator("select[name=panel]").select_option("none")
        assert lines(view) == 7
        view.locator("select[name=colour]").select_option("kappa")
        view.locator("select[name=panel]").select_option("others")
        assert titles.all_inner_texts() == ["c_g 0 %", "c_g 10 %", "c_g 40 %"]
        view.locator(".chip", has_text=re.compile("^10 %$")).click()
        assert titles.all_inner_texts() == ["c_g 0 %", "c_g 40 %"]
        assert len(table(view, "levels")) == 5
        view.get_by_role("button", name="every run").click()
        assert lines(view) == 2 * 3 * (1 + 3)
        view.get_by_role("button", name="epochs", exact=True).click()
        assert "over epochs" in view.locator("#learning-caption").inner_text()
        assert "epochs" in view.locator("#learning-panels svg").first.text_content()
        before = table(view, "levels")
        view.locator("input[name=level]").fill("95")
        view.locator("input[name=level]").dispatch_event("change")
        assert table(view, "levels") != before
        view.locator("select[name=measure]").select_option("critic_loss")
        assert view.locator("#measures-caption").inner_text().startswith("Critic loss over epochs")
        chosen = view.evaluate("location.hash")
        view.reload()
        view.wait_for_selector("body[data-ready]")
        assert view.evaluate("location.hash") == chosen
        assert titles.all_inner_texts() == ["c_g 0 %", "c_g 40 %"]


def test_the_heat_map_and_its_axes(browser: Any, pages: dict[str, Path]) -> None:
    with opened(browser, pages["grid"], "x=epoch") as view:
        texts = view.locator("#levels-views svg").first.locator("text").all_text_contents()
        table_ = {row[0]: row for row in table(view, "levels")}
        for c_g, kappa in itertools.product((0, 10), (1, 32)):
            assert table_[f"CGM, c_g {c_g} %, κ {kappa}"][3] in texts
        assert "not reached" in texts
        assert "1 of 3" in texts
        assert "full goals 11 (3 of 3)" in view.locator("#levels-views").inner_text()
        view.locator("select[name=across]").select_option("kappa")
        view.locator("select[name=down]").select_option("c_g")
        turned = view.locator("#levels-views svg").first.locator("text").all_text_contents()
        assert turned != texts
        assert sorted(turned) != turned


def test_all_of_twenty_lines_are_told_apart(browser: Any, pages: dict[str, Path]) -> None:
    with opened(browser, pages["trouble"]) as view:
        labels = view.locator("#learning .key li").all_inner_texts()
        colours = view.locator("#learning .key line").evaluate_all(
            "lines => lines.map(line => getComputedStyle(line).stroke)"
        )
        assert len({*labels}) == len(labels) == 20
        assert len({*colours}) == 20
        assert view.locator("#learning-panels g[aria-label=dot] path").count() == 1  # the cross
        assert TROUBLE in view.locator("#sweeps-tables").inner_text()
        assert "those of one dimension and the full goal" in view.locator("#masks").inner_text()


def test_dark_and_light(browser: Any, pages: dict[str, Path]) -> None:
    paper = "getComputedStyle(document.body).backgroundColor"
    light, dark = "rgb(255, 255, 255)", "rgb(18, 20, 24)"
    with opened(browser, pages["grid"]) as view:
        assert view.evaluate(paper) == light
        view.get_by_role("button", name="dark", exact=True).click()
        assert view.evaluate(paper) == dark
        view.emulate_media(media="print")
        assert view.evaluate(paper) == light
        assert not view.locator(".toolbar").is_visible()
    with opened(browser, pages["grid"], dark=True) as view:
        assert view.evaluate(paper) == dark
        view.emulate_media(color_scheme="light")
        view.wait_for_function(f"{paper} === '{light}'")


def test_it_prints_on_paper(browser: Any, pages: dict[str, Path]) -> None:
    with opened(browser, pages["grid"]) as view:
        wide = view.locator("#learning-panels svg").first.get_attribute("width")
        assert view.pdf(format="A4").startswith(b"%PDF")
        view.evaluate("dispatchEvent(new Event('beforeprint'))")
        narrow = view.locator("#learning-panels svg").first.get_attribute("width")
        assert float(narrow) < float(wide)
        view.evaluate("dispatchEvent(new Event('afterprint'))")
        assert view.locator("#learning-panels svg").first.get_attribute("width") == wide


def test_a_followed_page_takes_up_new_epochs_and_keeps_what_is_chosen(
    browser: Any, tmp_path: Path
) -> None:
    path = directory(tmp_path / "run", timed_run([0.0, 0.5]), epochs=4)
    out = tmp_path / "page.html"
    write_page(out, [read_sweep(path)], reload_seconds=0.2)
    with opened(browser, out) as view:
        assert "being followed" in view.locator("#notice").inner_text()
        view.get_by_role("button", name="epochs", exact=True).click()
        follow_on(path, 2)
        write_page(out, [read_sweep(path)])
        view.wait_for_function("!document.querySelector('#notice:not([hidden])')", timeout=20000)
        view.wait_for_selector("body[data-ready]")
        assert "finished" in view.locator("#cards").inner_text()
        assert "over epochs" in view.locator("#learning-caption").inner_text()


def sizes(path: Path, epochs: Mapping[int, int]) -> Path:
    """A directory of batch sizes, each trained for so many epochs without any success."""
    rows = [
        row
        for size, count in epochs.items()
        for row in timed_run([0.0] * count, 0, ("batch_size",), run=f"b{size}", batch_size=size)
    ]
    return directory(path, rows)


def test_what_is_hidden_stays_hidden_when_training_adds_values(
    browser: Any, tmp_path: Path
) -> None:
    out = tmp_path / "page.html"
    shown = ".chip[aria-pressed=true]"
    write_page(out, [read_sweep(sizes(tmp_path / "two", {128: 3, 512: 3}))])
    with opened(browser, out) as view:
        view.locator(".chip", has_text=re.compile("^512$")).click()
        assert view.locator(shown).all_inner_texts() == ["128"]
        write_page(out, [read_sweep(sizes(tmp_path / "three", {128: 3, 512: 3, 256: 1}))])
        view.reload()
        view.wait_for_selector("body[data-ready]")
        assert view.locator(shown).all_inner_texts() == ["128", "256"]


def test_what_was_not_reached_stands_where_its_own_training_ended(
    browser: Any, tmp_path: Path
) -> None:
    out = tmp_path / "page.html"
    write_page(out, [read_sweep(sizes(tmp_path / "run", {128: 3, 256: 6, 512: 12}))])
    with opened(browser, out, "x=epoch&across=batch_size") as view:
        lines = view.locator("#levels-views svg[role=img]").last
        heights = lines.locator("g[aria-label=dot]").last.locator("path, circle")
        places = heights.evaluate_all("dots => dots.map(dot => dot.getBoundingClientRect().y)")
        least, middle, most = sorted(places, reverse=True)
        assert (least - middle) / (least - most) == pytest.approx(3 / 9, abs=0.02)


def test_a_run_without_a_valid_episode_is_told(browser: Any, pages: dict[str, Path]) -> None:
    with opened(browser, pages["never"]) as view:
        assert [row[2] for row in table(view, "final")] == ["no valid episode"]
        assert "Open dots are runs without a valid" in view.locator("#final-caption").inner_text()
    with opened(browser, pages["single"]) as view:
        assert [row[2] for row in table(view, "final")] == ["25\u00a0%"]
        assert "or of as many as there are" in view.locator("#final-caption").inner_text()


def test_runs_that_left_early_are_told(browser: Any, tmp_path: Path) -> None:
    rows = [*timed_run([0.5] * 3, 0), *timed_run([0.2] * 9, 1)]
    path = directory(tmp_path / "run", rows, epochs=9, leave_at=0.5)
    out = tmp_path / "page.html"
    write_page(out, [read_sweep(path)])
    with opened(browser, out) as view:
        assert "1 run could leave training on holding 50" in view.locator("#final").inner_text()
        assert "could leave" not in view.locator("#levels-caption").inner_text()
        view.locator("input[name=level]").fill("60")
        view.locator("input[name=level]").dispatch_event("change")
        assert "1 run could leave" in view.locator("#levels-caption").inner_text()


def test_masks_are_of_a_setting_that_learned_and_left_early(browser: Any, tmp_path: Path) -> None:
    rows = timed_run([0.0, 0.2, 0.5, 0.6, 0.6], 0, ("c_g",), c_g=0.1, **masks(4))
    rows += timed_run([0.0, 0.1, *[0.45] * 58], 0, ("c_g",), c_g=0.4, **masks(4))
    out = tmp_path / "page.html"
    write_page(out, [read_sweep(directory(tmp_path / "run", rows))])
    with opened(browser, out) as view:
        caption = view.locator("#masks-caption").inner_text()
        assert "c_g 10 %" in caption
        assert "c_g 40 %" not in caption


def test_runs_that_nothing_tells_apart_are_named(browser: Any, tmp_path: Path) -> None:
    rows = [
        *timed_run([0.5] * 3, run="one"),
        *timed_run([0.9] * 3, run="two"),
        *timed_run([0.5] * 3, run="three", swept=("kappa",), kappa=1.0),
    ]
    out = tmp_path / "page.html"
    write_page(out, [read_sweep(directory(tmp_path / "run", rows))])
    with opened(browser, out) as view:
        assert [row[0] for row in table(view, "levels")] == ["κ 1", "κ 32, one", "κ 32, two"]
        views = view.locator("#levels-views")
        assert views.locator("svg").count() == 0
        assert "κ 32, two 3,000 (1 of 1)" in views.inner_text()


def test_more_points_than_a_function_takes_arguments_have_a_range(
    browser: Any, pages: dict[str, Path]
) -> None:
    with opened(browser, pages["single"]) as view:
        extent = "extentOf(Array.from({ length: 200_000 }, (_, i) => ({ y: i - 5 })))"
        assert view.evaluate(extent) == [-5, 199_994]
        assert view.evaluate("extentOf([])") == [0, 1]
