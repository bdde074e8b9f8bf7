"""The report: self-contained, escaped, with every number; figures with the same bytes each time and of colours apart."""

from __future__ import annotations

import math
import re
from html.parser import HTMLParser
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure as Drawing
from toy_scenario import NASTY, TOY

from fusion_sfdia.report.figure_files import write_figure
from fusion_sfdia.report.page import inline, number
from fusion_sfdia.report.plots import (
    COLOURS,
    Bars,
    bars,
    isolation_matrix,
    legend_above,
    number_decades,
    panels,
    roc_curves,
)
from fusion_sfdia.report.results import Row
from fusion_sfdia.report.scenario_sentences import left_out, listed, pick, span
from fusion_sfdia.study.experiments.runner import run_scenarios

VOID = {"meta", "link", "br", "img", "input", "hr"}


class Page(HTMLParser):
    """Checks that elements nest, and collects what the tests ask for."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.ids: list[str] = []
        self.links: list[str] = []
        self.tags: set[str] = set()
        self.text = ""
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        if tag not in VOID:
            self.open.append(tag)
        self.ids += [v for k, v in attrs if k == "id" and v]
        self.links += [v for k, v in attrs if k in ("href", "src", "xlink:href") and v]

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> str:
    out = tmp_path_factory.mktemp("report")
    outcome = run_scenarios([TOY], out, workers=1)
    assert not outcome.failures
    return outcome.report.read_text(encoding="utf-8")


def test_nothing_is_fetched_and_names_are_escaped(page: str) -> None:
    read = Page(page)
    assert page.count("<script") == 1 and NASTY not in page  # our own; what a name says is text
    assert not {"link", "iframe", "object", "img"} & read.tags
    assert read.links and all(link.startswith("#") for link in read.links)
    assert len(set(read.ids)) == len(read.ids)
    assert {link[1:] for link in read.links} <= set(read.ids)
    assert not re.search(r"url\((?!#)|@import", page)
    assert read.text.count(NASTY) >= 6  # title, about, fault, figure's title and caption, remark: as text
    assert 'aria-label="&lt;script&gt;' in page


def test_what_a_reader_looks_for(page: str) -> None:
    read = Page(page)
    assert "6 seeds of 50 in the full size" in page
    assert "2 published values" not in page
    assert re.search(r"1 published values?: 1 of 1 lies? within the 95 % interval", " ".join(read.text.split()))
    assert "Author 1999, Table I, p. 1" in read.text
    assert "(within)" in read.text
    assert "undefined" in read.text
    assert "fusion-sfdia run toy/mean" in read.text
    for expected in ('name="viewport"', "prefers-color-scheme: dark", "<svg", 'role="img"', 'lang="en"', "overflow-x: auto"):
        assert expected in page


def test_a_chapter_has_its_place_and_an_entry_in_the_contents(page: str) -> None:
    read = Page(page)
    assert "#s1-toys" in read.links and "s1-toys" in read.ids
    chapter = page[page.index('id="s1-toys"') :]
    assert page.count("<svg") == 2 and chapter.count("<svg") == 1
    assert re.search(r"<td class=\"n\" data-sort=\"[\d.]+\">[\d.]+ <small>\[-?[\d.]+, [\d.]+\]</small></td>", chapter)


def test_the_page_opens_with_what_was_found_and_folds_how(page: str) -> None:
    places = [page.index(text) for text in ("3 rows.", "<figure>", "Nothing is published.", "As printed", 'id="s1-toys"')]
    assert places == sorted(places)
    folded = re.findall(r'<details class="method">.*?</details>', page, re.DOTALL)
    for expected in ("Method of all", "Chapter&#39;s method", "Table&#39;s method", "levels high, low"):
        assert sum(expected in text for text in folded) == page.count(expected) == 1


def test_estimates_show_what_their_interval_can_tell() -> None:
    expected = {
        (0.93123, 0.8812, 0.9634, 60): "0.931 [0.881, 0.963]",
        (0.5, 0.1, 0.9, 3): "0.50 [0.10, 0.90]",
        (123.4, 100.0, 150.0, 3): "123 [100, 150]",
        (0.0, 0.0, 0.0, 3): "0.00 [0.00, 0.00]",
        (1e-9, 0.0, 2e-9, 3): "1e-09 [0, 2e-09]",
        (math.nan, math.nan, math.nan, 0): "none",
        (2.5, math.nan, math.nan, 1): "2.5",
    }
    assert [number(e) for e in expected] == list(expected.values())


def test_numbers() -> None:
    expected = {0.123456: "0.1235", 1e-7: "1e-7", 123456.0: "1.235e5", 2.0: "2", math.nan: "undefined", math.inf: "inf"}
    assert [number(v) for v in expected] == list(expected.values())
    assert number(12345) == "12345"
    assert number("text") == "text"


def test_two_figures_in_a_page_share_no_names() -> None:
    svg = '<?xml?><svg width="1pt" height="2pt" viewBox="0 0 1 2"><g id="a"/><use href="#a" clip-path="url(#a)"/></svg>'
    page = str(inline(svg, "one", 'says "so"'))
    assert page == (
        '<svg viewBox="0 0 1 2" role="img" aria-label="says &#34;so&#34;">'
        '<g id="one-a"/><use href="#one-a" clip-path="url(#one-a)"/></svg>'
    )


def draw_everything() -> Drawing:
    figure, (first, second, third) = panels(["ROC", "isolation", "bars"])
    grid = np.linspace(0, 1, 20)
    roc_curves(first, {"ours": (grid, np.sqrt(grid)), "chance": (grid, grid)})
    isolation_matrix(second, np.diag([4.0, 3.0, 0.0, 5.0]), boundaries={"none": 0, "p": 1, "T": 3})
    nan = math.nan
    bars(
        third,
        ["a", "b"],
        [Bars("x", [1, nan], [0.5, nan], [2, nan], [1.5, nan]), Bars("y", [2, 3], [1, 2], [3, 4], [nan, nan])],
        ylabel="m",
    )
    return figure


def test_figures_have_the_same_bytes_whatever_the_style(tmp_path: Path) -> None:
    text = write_figure(tmp_path, "one", draw_everything)
    first = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    assert first.keys() == {"one.svg", "one.png"}
    assert text.encode() == first["one.svg"]
    assert b"<dc:date>" not in first["one.svg"]
    with matplotlib.rc_context({"font.size": 20, "axes.facecolor": "red"}):
        write_figure(tmp_path, "one", draw_everything)
        assert matplotlib.rcParams["font.size"] == 20  # the user's style is left as it was
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == first


def test_isolation_matrix_shows_shares_of_rows() -> None:
    figure, (axes,) = panels(["isolation"])
    isolation_matrix(axes, np.array([[3.0, 1.0], [0.0, 0.0]]))
    shown = axes.images[0].get_array()
    assert shown is not None
    np.testing.assert_array_equal(np.ma.filled(shown, np.nan), [[0.75, 0.25], [np.nan, np.nan]])
    assert axes.images[0].get_cmap().get_bad()[:3] == pytest.approx([0.8] * 3)  # no such fault: grey, not "never named"
    assert [a.get_ylabel() for a in figure.axes] == ["faulty", "share of the row"]


def test_chance_is_on_the_diagonal_of_a_logarithmic_axis_too() -> None:
    _, (axes,) = panels(["ROC"])
    roc_curves(axes, {})
    x, y = (np.asarray(v, float) for v in axes.lines[0].get_data())
    np.testing.assert_array_equal(x, y)
    assert x[0] == 0 and x[-1] == 1 and np.sum((x > 1e-4) & (x < 1e-1)) > 20  # straight pieces would leave the curve


def test_one_legend_above_all_panels() -> None:
    figure, axes = panels(["a", "b"])
    nan = math.nan
    for axis in axes:
        bars(axis, ["x"], [Bars("ours", [1], [0.5], [2], [1.5]), Bars("theirs", [2], [nan], [nan], [nan])], ylabel="m")
    legend_above(figure)
    assert [t.get_text() for t in figure.legends[0].get_texts()] == ["published", "ours", "theirs"]
    assert all(axis.get_legend() is None for axis in axes)
    empty, _ = panels(["a"])
    legend_above(empty)
    assert not empty.legends


def test_sentences_are_filled_from_rows() -> None:
    rows = [
        Row("s", "p", "a", "none", "pressure", "auc", 0.5),
        Row("s", "p", "b", "none", "pressure", "auc", math.nan),
        Row("s", "p", "a", "bias", "pressure", "auc", 0.75),
        Row("s", "p", "b", "bias", "flow", "auc", 1234.5),
    ]
    assert pick(rows, detector="a", fault=("bias", "drift")) == [rows[2]]
    assert [r.detector for r in pick(rows, metric="auc")] == ["a", "a", "b"]  # what is undefined is left out
    assert listed(pick(rows)) == "a 0.5 to 0.75; b 1234"
    assert listed(pick(rows), "quantity") == "pressure 0.5 to 0.75; flow 1234"
    assert (span([]), span([math.nan]), span([0.12345, 0.1234])) == ("unknown", "unknown", "0.123")
    assert listed([]) == "unknown"


def test_runs_that_are_left_out_are_reported() -> None:
    rows = [
        Row("s", "p", "a", "bias", "pressure", "diverged", 0.5),
        Row("s", "p", "a", "bias", "pressure", "diverged_unaccommodated", 1.0),
        Row("s", "p", "b", "bias", "pressure", "diverged", 0.0),
    ]
    (line,) = left_out(rows)
    assert line.endswith(": a 50% (pressure, bias); a 100% (pressure, bias, without diagnosis) of the runs.")
    assert left_out(rows[2:]) == []


def test_curves_differ_in_published_colours_and_in_their_lines() -> None:
    """RGB of Okabe and Ito's table (Color Universal Design, 2008); curves do not rest on colour alone."""
    blue, vermilion, green, purple = (0, 114, 178), (213, 94, 0), (0, 158, 115), (204, 121, 167)
    orange, sky, black, yellow = (230, 159, 0), (86, 180, 233), (0, 0, 0), (240, 228, 66)
    found = [tuple(round(255 * part) for part in to_rgb(c)) for c in COLOURS]
    assert found == [blue, vermilion, green, purple, orange, sky, black, yellow]
    _, (axes,) = panels(["ROC"])
    grid = np.linspace(0, 1, 3)
    roc_curves(axes, {name: (grid, grid) for name in "abcd"})
    assert len({line.get_linestyle() for line in axes.lines[:4]}) == 4


def test_a_logarithmic_axis_has_plain_numbers_within_a_decade_too() -> None:
    def numbers(low: float, high: float) -> list[str]:
        figure, (axes,) = panels([""], height=3.0)
        axes.set(xscale="log", xlim=(low, high))
        number_decades(axes.xaxis)
        figure.draw_without_rendering()
        return [text for minor in (False, True) for tick in axes.get_xticklabels(minor=minor) if (text := tick.get_text())]

    assert {"0.3", "0.4", "0.5"} <= set(numbers(0.22, 0.61))
    assert {"0.1", "1", "10"} <= set(numbers(0.05, 30.0)) and "0.2" not in numbers(0.05, 30.0)
