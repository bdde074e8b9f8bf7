"""Names that a spreadsheet, a terminal, a browser or matplotlib would act on, through everything that is written."""

from __future__ import annotations

import csv
import re
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.figure import Figure
from toy_plants import readings, tanks

from fusion_sfdia.cli.main import main
from fusion_sfdia.common.plain_text import ACTING, FORMULA, plain
from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.diagnoser import diagnose
from fusion_sfdia.logs.csv_log import read_log, write_log
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.report.figure_files import figure_svg, write_figure
from fusion_sfdia.report.log_page import About
from fusion_sfdia.report.log_report import write_diagnosis
from fusion_sfdia.report.plots import entry, legend_above, panels, roc_curves, time_series
from fusion_sfdia.report.results import Row, read_rows, write_rows
from fusion_sfdia.study.experiments.provenance import versions

ESCAPE = "\x1b]0;title\x07\x1b[31m"
NAMES = (
    f"=HYPERLINK(1) $\\frac{{1$ {ESCAPE}",
    "<script>alert(1)</script>&\"'",
    "_p $^$ {_\\ \u202egnp.exe",
    "@SUM(1+1)*cmd|' /c calc'!A0 \x9b2J",
)


def named(names: tuple[str, ...] = NAMES) -> Plant:
    return replace(tanks(), sensors=tuple(replace(s, name=n) for s, n in zip(tanks().sensors, names, strict=True)))


def faulty() -> tuple[Any, Any, Any]:
    t, _, y, u = readings(tanks(), 120, 1, seed=1)
    y = y[:, 0].copy()
    for i, size in enumerate((0.5, 0.5, 3e-4, 3e-4)):
        y[20 + 25 * i : 40 + 25 * i, i] += size
    return t, y, u[:, 0]


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out, plant = tmp_path_factory.mktemp("out"), named()
    t, y, u = faulty()
    found = diagnose(LeaveOneOutBank(plant, window=1), t, y, u)
    assert {e.hypothesis for e in found.events} & set(NAMES)
    write_diagnosis(out, plant, y, u, found, About(f"<b>log{ESCAPE}\udc80.csv", "<i>detector", (f"note {ESCAPE}<u>",)))
    return out


def test_no_character_that_acts_is_in_any_file(written: Path) -> None:
    for path in written.iterdir():
        if path.suffix != ".png":
            assert not ACTING.search(path.read_text(encoding="utf-8")), path.name


def test_no_cell_is_a_formula(written: Path) -> None:
    texts = 0
    for path in written.glob("*.csv"):
        with path.open(encoding="utf-8", newline="") as file:
            for row in csv.reader(file):
                for value in row:
                    if re.fullmatch(r"-?(\d.*|inf|nan)", value) is None:
                        texts += 1
                        assert not value.startswith(FORMULA), (path.name, value)
    assert texts > 10


def test_no_tag_of_others_is_in_the_page(written: Path) -> None:
    page = (written / "report.html").read_text(encoding="utf-8")
    assert "&lt;script&gt;alert(1)" in page and "&lt;b&gt;log" in page and "\\u001b" in page
    assert not re.search(r"<script>alert|<b>log|<i>detector|<u>|&\"'", page)


def test_the_figure_is_xml_without_a_script(written: Path) -> None:
    root = ElementTree.fromstring((written / "diagnosis.svg").read_text(encoding="utf-8"))
    assert not [element for element in root.iter() if element.tag.endswith("script")]
    assert "--" not in re.sub(r"<!--|-->", "", " ".join(re.findall(r"<!--.*?-->", (written / "diagnosis.svg").read_text())))


@pytest.mark.slow
def test_no_character_that_acts_is_in_the_files_of_a_monitor(tmp_path: Path) -> None:
    """So far monitor.txt had the titles as they are."""
    rng, log = np.random.default_rng(3), tmp_path / "log.csv"
    level = np.cumsum(rng.normal(size=200)) / 20
    columns = (level, 2 * level + rng.normal(size=200) / 9, rng.normal(size=200))
    rows = [f"{k},{','.join(f'{c[k]:.4f}' for c in columns)}" for k in range(200)]
    log.write_text("\n".join([f"time,a{ESCAPE[:8]},b\x1b[31m,c", *rows, ""]), encoding="utf-8")
    out = tmp_path / "out"
    assert main(["monitor", "--healthy", str(log), "--data", str(log), "--out", str(out)]) == 0
    assert "b\\u001b[31m" in (out / "monitor.txt").read_text(encoding="utf-8")
    for path in out.iterdir():
        if path.suffix != ".png":
            assert not ACTING.search(path.read_text(encoding="utf-8")), path.name


def test_a_log_with_such_names_is_read_to_the_bit(tmp_path: Path) -> None:
    plant = named(("=l1", "+5V", "-l2", "@q"))
    t, y, u = faulty()
    write_log(tmp_path / "log.csv", plant, t, y, u)
    header = (tmp_path / "log.csv").read_text().splitlines()[0]
    assert header.startswith("time [s],'=l1 [m],'+5V [m],'-l2 [m3/s],'@q [m3/s]")
    np.testing.assert_array_equal(read_log(tmp_path / "log.csv", plant).y, y)


def test_metrics_with_such_names_come_back(tmp_path: Path) -> None:
    row = Row(
        "a/b",
        "=plant",
        "-detector",
        "@fault",
        "+quantity",
        "metric",
        1.0,
        0.5,
        2.0,
        3,
        published=1.0,
        source="=p. 9",
        condition="'=x",
    )
    write_rows(tmp_path / "metrics.csv", [row])
    assert "'=plant,'-detector,'@fault,'+quantity,''=x,metric,1.0" in (tmp_path / "metrics.csv").read_text()
    assert read_rows(tmp_path / "metrics.csv") == [row]


@pytest.mark.parametrize(
    "text",
    ["$x$", "$\\frac{1$ and $", "a_b^c", "$$", "{", "}", "\\", "\\$ $a$ $", "$\\mathdefault{\\frac}$", "%", "a$1 b$2", "_x"],
)
def test_every_text_of_a_figure_is_drawn_as_it_is(text: str, tmp_path: Path) -> None:
    drawn: list[Figure] = []

    def draw() -> Figure:
        figure, axes = panels([text, "log"], columns=2)
        time_series(axes[0], np.arange(3.0), {text: np.arange(3.0)}, ylabel=text, levels={text: 1.0})
        axes[0].set_xticks([0.0, 0.01], [text, f"{text}\x1b"])
        axes[0].annotate(text, (0, 0))
        roc_curves(axes[1], {text: (np.array([0.1, 1.0]), np.array([0.5, 1.0]))})
        axes[1].set_xscale("log")
        axes[1].set_yscale("symlog", linthresh=0.01)
        legend_above(figure)
        drawn.append(figure)
        return figure

    svg = write_figure(tmp_path, "figure", draw)
    (figure,) = drawn
    axes = figure.axes[0]
    assert axes.get_title(loc="left") == axes.get_ylabel() == text
    assert [label.get_text() for label in axes.get_xticklabels()] == [text, f"{text}\\u001b"]
    assert [t.get_text() for t in axes.get_legend().get_texts()][:2] == [
        entry(text)
    ] * 2  # a name beginning with _ is there, too
    assert {entry(text)} <= {t.get_text() for t in figure.legends[0].get_texts()}
    assert not ACTING.search(svg) and ElementTree.fromstring(svg) is not None


def test_powers_of_ten_are_text_at_the_ticks(tmp_path: Path) -> None:
    figure, axes = panels(["log", "symlog"], columns=2)
    for axis, scale in zip(axes, ("log", "symlog"), strict=True):
        axis.plot([1e-3, 1.0], [1.0, 1000.0])
        axis.set_xscale("log")
        axis.set_yscale(scale)
    write_figure(tmp_path, "figure", lambda: figure)
    for axis in axes:
        assert {"10⁻³", "10⁻²", "10⁰"} <= {label.get_text() for label in axis.get_xticklabels()}
        assert {"10¹", "10²"} <= {label.get_text() for label in axis.get_yticklabels()}


def test_a_name_in_a_figure_leaves_usual_ones_as_they_were() -> None:
    assert entry("l1") == "l1" and entry(None) is None and plain(entry("_l1") or "") == "\u2009_l1"
    assert "matplotlib" in str(versions()) and figure_svg("f", lambda: panels(["a"])[0]).startswith("<?xml")


def test_errors_and_printed_events_have_no_escape_sequences(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    t, y, u = faulty()
    write_log(tmp_path / "log.csv", tanks(), t, y, u)
    text = (tmp_path / "log.csv").read_text().replace("l1 [m]", f"{ESCAPE}l1 [{ESCAPE}]").replace("q2 [", "\u202eq2\x9b [")
    (tmp_path / f"log{ESCAPE}.csv").write_text(text)
    for command in ("check-log", "diagnose"):
        code = main([command, "--plant", "two-tanks", "--data", str(tmp_path / f"log{ESCAPE}.csv")])
        said = capsys.readouterr()
        assert code != 0 and "\\u001b" in said.err + said.out and not ACTING.search(said.err + said.out)
    with pytest.raises(SystemExit):
        main(["diagnose", "--data", "x", f"{ESCAPE}\u202e"])
    assert not ACTING.search(capsys.readouterr().err)
