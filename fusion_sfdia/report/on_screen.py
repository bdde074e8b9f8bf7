"""What a script needs to read and zoom the figures of a page: see figures.js."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from datetime import datetime, timedelta, tzinfo
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.container import BarContainer, ErrorbarContainer
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator

from fusion_sfdia.common.clock import Clock
from fusion_sfdia.common.numerals import for_json
from fusion_sfdia.common.plain_text import plain
from fusion_sfdia.report.figure_files import SVG_DPI

NO_CLOCK = Clock()
NOTHING = ("None", "", " ", None)  # as the style of a line, and as its marker
Names = Mapping[int, str]


def on_screen(figure: Figure, clock: Clock = NO_CLOCK) -> str:
    """What figures.js needs of a figure that is laid out, as JSON; "" where nothing can be read. Its panels and lines get ids.

    {"groups": [{"x", "zoom", "panels"}], "offsets"}. The panels of a group share an axis x: its ends, s since 1970 on a clock,
    else in its unit; zoom: whether along it. offsets: of the clock's zone (s), each with the time from which it holds, [[first,
    3600], [1774746000, 7200]] where summer time begins within; null without a clock. Of each panel its box [left, top, right,
    bottom] in the units of the SVG, its y axis, its lines, the names of its rows and columns where it has names in place of
    numbers, and what is read in their cells.
    """
    groups: dict[Any, dict[str, Any]] = {}
    for k, axes in enumerate(figure.axes):
        if axes.get_label() == "<colorbar>" or not {axes.get_xscale(), axes.get_yscale()} <= {"linear", "log"}:
            continue
        panel = _panel(axes, k)
        if not (panel["lines"] or panel["rows"]["names"] or panel["cells"]):
            continue
        key = (round(panel["box"][0]), round(panel["box"][2]), axes.get_xscale(), axes.get_xlim())
        group = groups.setdefault(key, {"x": {}, "zoom": True, "panels": []})
        group["panels"].append(panel)
        group["x"] |= {k: v for k, v in _scale(axes.xaxis, axes.get_xlim(), clock).items() if v != "" or k not in group["x"]}
        if not panel["columns"]["names"]:
            group["x"]["marks"] = [[at, text] for at, text in _names(axes.xaxis).items() if text]
        group["zoom"] &= not panel["columns"]["names"] and not any(isinstance(c, BarContainer) for c in axes.containers)
    if not groups:
        return ""
    found = list(groups.values())
    zone = None if clock.start is None else offsets(clock.start.tzinfo, *found[0]["x"]["ends"])
    return json.dumps(for_json({"groups": found, "offsets": zone}))


def offsets(zone: tzinfo | None, first: float, last: float) -> list[list[float]]:
    """The offsets of a zone from UTC (s) between two times, each with the time from which it holds; times in s since 1970."""

    def at(t: float) -> float:
        return 0.0 if zone is None else (datetime.fromtimestamp(t, zone).utcoffset() or timedelta(0)).total_seconds()

    found = [[first, at(first)]]
    for low, high in pairwise([*np.arange(first, last, 86_400.0).tolist(), last]):
        if at(high) != found[-1][1]:
            while high - low > 0.5:
                middle = (low + high) / 2
                low, high = (middle, high) if at(middle) == found[-1][1] else (low, middle)
            found.append([float(round(high)), at(high)])
    return found


def _panel(axes: Axes, k: int) -> dict[str, Any]:
    """A panel, the k-th of its figure."""
    axes.set_gid(f"panel{k}")
    axes.apply_aspect()
    points, height = SVG_DPI / axes.figure.dpi, axes.figure.bbox.height
    lines = dict(_lines(axes))
    curves = any(line.get_linestyle() not in NOTHING for line in lines)
    columns, rows = ({} if curves else _names(axis) for axis in (axes.xaxis, axes.yaxis))
    for i, line in enumerate(lines):
        line.set_gid(f"panel{k}-{i}")
    image = axes.images[0] if axes.images else None
    cells = _bar_cells(axes, lines, columns, rows) if image is None else _image_cells(axes, image)
    left, right, bottom, top = (-0.5, 0.5, 0.5, -0.5) if image is None else image.get_extent()
    across, down = (1, 1) if image is None else (len(cells[0]), len(cells))
    low, high = axes.get_ylim()
    texts = {text: number for number, text in enumerate(sorted({text for line in cells for text in line}))}
    return {
        "id": axes.get_gid(),
        "box": [points * v for v in (axes.bbox.x0, height - axes.bbox.y1, axes.bbox.x1, height - axes.bbox.y0)],
        "title": axes.get_title(loc="left"),
        "y": _scale(axes.yaxis, (low, high)),
        "lines": [
            {
                "id": line.get_gid(),
                "name": name,
                "dots": line.get_marker() not in NOTHING,
                "steps": line.get_drawstyle() != "default",
            }
            for line, name in lines.items()
            if not columns
        ],
        "columns": {"names": columns, **_steps(axes.get_xlim(), (left, right), across)},
        "rows": {"names": rows, **_steps((high, low), (top, bottom), down)},
        "cells": {"texts": list(texts), "index": [[texts[text] for text in line] for line in cells]} if any(texts) else None,
    }


def _scale(axis: Axis, ends: tuple[float, float], clock: Clock = NO_CLOCK) -> dict[str, Any]:
    """The ends of an axis, whether it is logarithmic, and the name and the unit in its label, "delay (s)" or "T1 [degC]"."""
    found = re.fullmatch(r"(.*?)(?:\s*[\[(]([^][()]*)[])])?", axis.get_label_text(), re.DOTALL)
    assert found is not None
    seconds = 1.0 if clock.start is None else 86_400.0
    name, unit = ("", "") if clock.start is not None else (" ".join(found[1].split()), found[2] or "")
    return {"ends": [seconds * end for end in ends], "log": axis.get_scale() == "log", "name": name, "unit": unit}


def _lines(axes: Axes) -> Iterator[tuple[Line2D, str]]:
    """The lines that rise along x, with their names: the ids that they were given, else those in the legend."""
    dots = {c.lines[0]: c.get_label() for c in axes.containers if isinstance(c, ErrorbarContainer) and c.lines[0] is not None}
    for line in axes.get_lines():
        name = plain(str(line.get_gid() or dots.get(line) or line.get_label())).strip()
        with np.errstate(invalid="ignore"):
            back = np.any(np.diff(np.asarray(line.get_xdata(orig=False), float)) < 0)
        if not name.startswith("_") and not back:
            yield line, name


def _names(axis: Axis) -> dict[int, str]:
    """The names at the ticks of an axis, by their places; none where the ticks are numbers."""
    if not isinstance(axis.get_major_locator(), FixedLocator):
        return {}
    places = axis.get_ticklocs()
    return {round(at): text for at, text in zip(places, axis.get_major_formatter().format_ticks(list(places)), strict=True)}


def _steps(ends: tuple[float, float], extent: tuple[float, float], count: int) -> dict[str, float]:
    """Of an axis with `count` steps within an extent: at which one it begins, and how many it spans."""
    size = (extent[1] - extent[0]) / count
    return {"first": (ends[0] - extent[0]) / size, "span": (ends[1] - ends[0]) / size}


def _image_cells(axes: Axes, image: AxesImage) -> list[list[str]]:
    """What stands in the cells of an image, else what they are."""
    values: Any = np.ma.asarray(image.get_array())
    if axes.texts:
        written = {tuple(map(round, text.get_position())): text.get_text() for text in axes.texts}
        return [[written.get((j, i), "") for j in range(values.shape[1])] for i in range(values.shape[0])]
    known = ~np.ma.getmaskarray(values)
    return [
        [image.format_cursor_data(v).strip("[]") if k else "" for v, k in zip(*line, strict=True)]
        for line in zip(np.ma.getdata(values), known, strict=True)
    ]


def _bar_cells(axes: Axes, lines: Mapping[Line2D, str], columns: Names, rows: Names) -> list[list[str]]:
    """The values of the bars and dots at each name, of which an axis has some."""
    found: dict[int, list[str]] = {}

    def add(place: float, name: str, value: float) -> None:
        if np.isfinite(value):
            found.setdefault(round(place), []).append(f"{name} {value:.3g}".strip())

    for bars in (c for c in axes.containers if isinstance(c, BarContainer)):
        label = str(bars.get_label())
        name = "" if label.startswith("_") else plain(label).strip()
        for bar in bars:
            if bars.orientation == "vertical":
                add(bar.get_x() + bar.get_width() / 2, name, bar.get_height())
            else:
                add(bar.get_y() + bar.get_height() / 2, name, bar.get_width())
    if columns:
        for line, name in lines.items():
            for place, value in zip(*np.asarray(line.get_data(orig=False), float).tolist(), strict=True):
                add(place, name, value)
    texts = ["; ".join(found.get(k, ())) for k in range(max(columns or rows, default=-1) + 1)]
    return [texts] if columns else [[text] for text in texts]
