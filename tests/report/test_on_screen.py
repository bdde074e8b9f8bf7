"""What a script is given to read figures: places and values of lines, cells and bars."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from datetime import UTC, datetime, timedelta, timezone
from typing import Any
from zoneinfo import ZoneInfo

import numpy as np
import pytest
from matplotlib.figure import Figure

from fusion_sfdia.common.clock import Clock
from fusion_sfdia.report.figure_files import figure_svg
from fusion_sfdia.report.on_screen import NO_CLOCK, offsets, on_screen
from fusion_sfdia.report.plots import Bars, TimeAxis, bars, isolation_matrix, panels, roc_curves
from fusion_sfdia.study.comparison.figures import heat


def read(draw: Callable[[], Figure], clock: Clock = NO_CLOCK) -> tuple[str, Any]:
    """The SVG of a figure, and what a script is given."""
    plots: list[str] = []
    svg = figure_svg("f", draw, laid_out=lambda figure: plots.append(on_screen(figure, clock)))
    return svg, json.loads(plots[0])


def points_of(svg: str, line: str) -> np.ndarray[Any, Any]:
    (path,) = re.findall(rf'id="{line}">\s*<path d="([^"]*)"', svg)
    return np.array(re.findall(r"[ML] (\S+) (\S+)", path), float)


@pytest.mark.parametrize("start", [None, datetime(2026, 3, 1, 12, tzinfo=timezone(timedelta(hours=1)))])
def test_lines_are_read_as_times_and_values(start: datetime | None) -> None:
    t, y, clock = np.arange(0.0, 300.0, 5.0), np.random.default_rng(0).normal(size=60), Clock(start)

    def draw() -> Figure:
        figure, (axes,) = panels([""])
        axis = TimeAxis(clock, 1.0, "" if start else "s", "time" if start else "time (s)")
        axes.plot(axis(t), y, label="reading")
        axes.set_ylabel("flow [m3/s]")
        axis.label_on(axes)
        return figure

    svg, found = read(draw, clock)
    (group,) = found["groups"]
    x, (panel,) = group["x"], group["panels"]
    assert (x["name"], x["unit"], found["offsets"]) == (("", "", [[x["ends"][0], 3600.0]]) if start else ("time", "s", None))
    ((line,), y_axis), (left, top, right, bottom) = (panel["lines"], panel["y"]), panel["box"]
    assert (line["name"], y_axis["unit"], group["zoom"]) == ("reading", "m3/s", True)
    points = points_of(svg, line["id"])
    first = start.timestamp() if start else 0.0
    times = x["ends"][0] + (points[:, 0] - left) / (right - left) * np.ptp(x["ends"]) - first
    np.testing.assert_allclose(times, t, atol=0.01)
    values = y_axis["ends"][0] + (bottom - points[:, 1]) / (bottom - top) * np.ptp(y_axis["ends"])
    np.testing.assert_allclose(values, y, atol=1e-5)  # an SVG of matplotlib has 6 decimals, its lines a ninth of a pixel less
    assert svg.count(f'id="{panel["id"]}"') == 1


def test_panels_beneath_each_other_are_a_group_and_an_equal_axis_is_read_where_it_is() -> None:
    def draw() -> Figure:
        figure, axes = panels(["a", "b", "c"], columns=2)
        for one in axes:
            roc_curves(one, {"ours": (np.array([0.0, 0.1, 1.0]), np.array([0.0, 0.8, 1.0]))})
        axes[1].set(xscale="log", xlim=(1e-3, 1))
        return figure

    svg, found = read(draw)
    assert [[p["title"] for p in group["panels"]] for group in found["groups"]] == [["a", "c"], ["b"]]
    assert [group["x"]["log"] for group in found["groups"]] == [False, True]
    for panel in found["groups"][0]["panels"]:
        assert [line["name"] for line in panel["lines"]] == ["ours"]  # the line of chance has no name
        left, top, right, bottom = panel["box"]
        assert right - left == pytest.approx(bottom - top)
        np.testing.assert_allclose(
            points_of(svg, panel["lines"][0]["id"])[1, 0], left + 0.11 / 1.02 * (right - left), atol=0.01
        )


def test_cells_and_bars_are_read_by_their_names() -> None:
    nan = math.nan

    def draw() -> Figure:
        figure, (numbers, shares, one, lying) = panels(["numbers", "shares", "bars", "lying"])
        heat(numbers, np.array([[0.5, nan, 1e-6], [0.1, 0.2, 0.3]]), ["a", "b"], ["x", "y", "z"], form="{:.1e}", log=True)
        numbers.tick_params(labelleft=False)
        isolation_matrix(shares, np.array([[3.0, 1.0], [0.0, 0.0]]))
        series = [Bars("ours", [1, nan], [0.5, nan], [2, nan], [1.5, nan]), Bars("<b>", [2, 3], [1, 2], [3, 4], [nan, nan])]
        bars(one, ["p", "T"], series, ylabel="m")
        for label, left in (("missed", 0.0), ("false", 0.25)):
            lying.barh([0, 1], [0.25, 0.5], left=left, label=label)
        lying.set_yticks([0, 1], ["limits", "pca"])
        return figure

    _, found = read(draw)
    shown = {p["title"]: (group, p) for group in found["groups"] for p in group["panels"]}

    def texts(title: str) -> list[list[str]]:
        cells = shown[title][1]["cells"]
        return [[cells["texts"][k] for k in line] for line in cells["index"]]

    group, numbers = shown["numbers"]
    assert texts("numbers") == [["5.0e-01", "", "1.0e-06"], ["1.0e-01", "2.0e-01", "3.0e-01"]] and not group["zoom"]
    assert numbers["rows"]["names"] == {"0": "a", "1": "b"} and numbers["columns"]["names"] == {"0": "x", "1": "y", "2": "z"}
    assert (numbers["rows"]["first"], numbers["rows"]["span"], numbers["columns"]["span"]) == (0, 2, 3)
    first, second = texts("shares")
    assert [float(text) for text in first] == [0.75, 0.25] and second == ["", ""]
    assert texts("bars") == [["ours 1; <b> 2; ours, published 1.5", "<b> 3"]]
    assert shown["bars"][1]["columns"]["names"] == {"0": "p", "1": "T"} and shown["bars"][1]["lines"] == []
    assert texts("lying") == [["missed 0.25; false 0.25"], ["missed 0.5; false 0.5"]]
    assert shown["lying"][1]["rows"]["names"] == {"0": "limits", "1": "pca"}


def test_of_a_figure_without_numbers_nothing_is_given() -> None:
    figure = Figure()
    figure.subplots().set_axis_off()
    assert on_screen(figure) == ""


def test_the_offsets_of_a_zone_are_known_from_their_first_second() -> None:
    first, last = (datetime(2026, month, 20, tzinfo=UTC).timestamp() for month in (3, 11))
    spring, autumn = datetime.fromisoformat("2026-03-29T01:00Z"), datetime.fromisoformat("2026-10-25T01:00Z")
    in_time = [[first, 3600.0], [spring.timestamp(), 7200.0], [autumn.timestamp(), 3600.0]]
    assert offsets(ZoneInfo("Europe/Amsterdam"), first, last) == in_time
    assert offsets(ZoneInfo("Asia/Kolkata"), first, last) == [[first, 19_800.0]]
    assert offsets(None, first, last) == [[first, 0.0]]
