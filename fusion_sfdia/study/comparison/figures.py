"""Figures of a comparison."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple, TypeVar

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawing
from matplotlib.ticker import NullFormatter
from numpy.typing import NDArray

from fusion_sfdia.common.run_statistics import Estimate
from fusion_sfdia.report.plots import entry, number_decades, panels
from fusion_sfdia.study import detection_metrics as metrics
from fusion_sfdia.study.comparison.cell import CellNumber, ComparisonCell
from fusion_sfdia.study.comparison.looks import OTHERS, looks, quieted
from fusion_sfdia.study.comparison.metric_rows import Measure, confusion
from fusion_sfdia.study.comparison.protocol import GRADED, HEALTHY, LENGTH, PROCESS

Array = NDArray[Any]
Cells = Mapping[tuple[str, str], ComparisonCell]
T = TypeVar("T")

LEAST = 2  # runs behind a point


def of_plant(found: Mapping[tuple[str, str], T], plant: str) -> dict[str, T]:
    """The part of one plant of what is known by plant and detector, by detector."""
    return {detector: one for (where, detector), one in found.items() if where == plant}


def heat(
    axes: Axes,
    values: Array,
    rows: Sequence[str],
    columns: Sequence[str],
    *,
    form: str = "{:.2f}",
    log: bool = False,
    less: bool = False,
) -> None:
    """Numbers on colours, larger darker, orange where less is better and else blue; NaN is grey and blank."""
    shown = np.log10(np.maximum(values, 1e-4)) if log else values
    low, high = (-4.0, 0.0) if log else (0.0, 1.0)
    colours = matplotlib.colormaps["Oranges" if less else "Blues"].with_extremes(bad="0.85")
    axes.imshow(np.ma.masked_invalid(shown), cmap=colours, vmin=low, vmax=high, aspect="auto")
    for i, j in np.ndindex(*values.shape):
        if np.isfinite(values[i, j]):
            dark = (shown[i, j] - low) / (high - low) > 0.6
            axes.text(
                j, i, form.format(values[i, j]), ha="center", va="center", fontsize=6.5, color="white" if dark else "black"
            )
    axes.set_xticks(range(len(columns)), columns, fontsize=7, rotation=30, ha="right")
    axes.set_yticks(range(len(rows)), rows, fontsize=7)
    axes.tick_params(length=0)
    axes.grid(visible=False)


def draw_overview(cells: Cells, measures: Mapping[str, Measure]) -> Drawing:
    """A panel a measure, detectors down, plants across."""
    plants, detectors = (list(dict.fromkeys(key[i] for key in cells)) for i in (0, 1))
    figure, axes = panels(list(measures), columns=4, width=14.0, height=1.2 + 0.22 * len(detectors))
    for axis, measure in zip(axes, measures.values(), strict=True):
        values = np.array([[measure.of(cells[p, d]).value if (p, d) in cells else np.nan for p in plants] for d in detectors])
        form = "{:.2g}" if measure.decades else "{:.2f}"
        heat(axis, values, detectors, plants, form=form, log=measure.decades, less=measure.less)
    for i, axis in enumerate(axes):
        if i % 4:
            axis.tick_params(labelleft=False)
    return figure


def draw_roc(cells: Mapping[str, ComparisonCell], conditions: Sequence[str], named: Collection[str]) -> Drawing:
    """Detection against false alarms of the silent detectors, on a logarithmic axis. named: those not drawn in grey."""
    figure, axes = panels([c.replace("-", " ") for c in conditions], columns=3, width=11.5, height=3.4)
    look = quieted(looks(list(cells)), named)
    for axis, name in zip(axes, conditions, strict=True):
        for detector, cell in cells.items():
            scores, active = cell.swept(name)
            curve = metrics.roc(scores, active)
            style = {k: v for k, v in look[detector].items() if k != "marker"}
            shown = detector if detector in named else OTHERS
            axis.plot(*curve[:2], label=entry(shown), gid=detector, drawstyle="steps-post", **style)
        chance = np.geomspace(1e-4, 1.0, 100)
        axis.plot(chance, chance, color="0.6", linewidth=0.8)
        least = min(1.0 / cell["trunk"].size for cell in cells.values())
        axis.set(xscale="log", xlim=(least, 1.05), ylim=(-0.02, 1.02))
        axis.set(xlabel="false-alarm probability of a sample", ylabel="detection probability of a sample")
    legend_columns(figure)
    return figure


def legend_columns(figure: Drawing, columns: int = 5) -> None:
    """The legend of all panels above them, in rows of some entries."""
    entries: dict[str, Any] = {}
    for axes in figure.axes:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            entries.setdefault(str(label), handle)
    if OTHERS in entries:
        entries[OTHERS] = entries.pop(OTHERS)  # the last
    figure.legend(list(entries.values()), list(entries), loc="outside upper center", ncols=columns, fontsize=8)


def draw_magnitudes(cells: Mapping[str, ComparisonCell], named: Collection[str]) -> Drawing:
    """Runs with an alarm, exact isolation and delay against the size of a fault: a column a kind. named: as in draw_roc."""
    some = next(iter(cells.values()))
    sizes = sorted(some.settings["magnitudes"])
    kinds = [k for k in GRADED if k in some.settings["faults"]]
    look = quieted(looks(list(cells)), named)
    measures: list[tuple[str, CellNumber]] = [
        ("runs with an alarm", lambda cell, rows: cell.detected(rows)),
        ("samples with exact isolation", lambda cell, rows: cell.exact(rows)),
        ("delay (s)", lambda cell, rows: cell.delay(rows)),
    ]
    figure, axes = panels(
        [kind if r == 0 else "" for r in range(3) for kind in kinds], columns=len(kinds), width=11.5, height=2.5
    )
    for r, (label, measure) in enumerate(measures):
        for c, kind in enumerate(kinds):
            axis = axes[r * len(kinds) + c]
            for i, (detector, cell) in enumerate(cells.items()):
                found = [measure(cell, cell.rows_of(f"{kind}-{m:g}-sigma")) for m in sizes]
                values = [e.value if e.n >= LEAST else np.nan for e in found]
                shift = 1.0 + 0.02 * (i - len(cells) / 2)  # lines that coincide stay visible
                shown = detector if detector in named else OTHERS
                style = {"markersize": 3.5, "linewidth": 1.2, **look[detector]}
                axis.plot(np.array(sizes) * shift, values, label=entry(shown), gid=detector, **style)
            axis.set(xscale="log", xlim=(sizes[0] / 1.5, sizes[-1] * 1.5))
            axis.xaxis.set_minor_formatter(NullFormatter())
            axis.set_xticks(sizes, [f"{m:g}" for m in sizes])
            if r < 2:
                axis.set_ylim(-0.03, 1.03)
            else:
                axis.set_ylim(bottom=0.0)
                axis.set_xlabel("size (sigma of the noise)")
            if c == 0:
                axis.set_ylabel(label)
    legend_columns(figure)
    return figure


def draw_confusion(cells: Mapping[str, ComparisonCell]) -> Drawing:
    """A panel a detector: the quantity of the faulty sensor against shares of what is isolated."""
    some = next(iter(cells.values()))
    quantities = list(some.model.quantities)
    columns = ["none", *(f"another {q}" for q in quantities), "the faulty sensor"]
    figure, axes = panels(list(cells), columns=4, width=12.5, height=1.5 + 0.28 * len(quantities))
    for axis, cell in zip(axes, cells.values(), strict=True):
        counts = confusion(cell).sum(axis=1)
        total = counts.sum(axis=1, keepdims=True)
        heat(axis, np.divide(counts, total, out=np.full(counts.shape, np.nan), where=total > 0), quantities, columns)
    return figure


class PanelColumn(NamedTuple):
    """A column of a panel: its label, a condition and a mismatch case ("" for none)."""

    label: str
    name: str
    mismatch: str = ""


class Panel(NamedTuple):
    """Numbers of detectors under conditions: title, what is measured, and the columns."""

    title: str
    measure: CellNumber
    columns: Sequence[PanelColumn]
    less: bool = False  # is better


def draw_panels(cells: Mapping[str, ComparisonCell], shown: Sequence[Panel]) -> Drawing:
    """Detectors down and conditions across; grey where there is no number."""
    figure, axes = panels([p.title for p in shown], columns=3, width=13.0, height=1.9 + 0.24 * len(cells))
    for axis, panel in zip(axes, shown, strict=True):
        values = [
            [panel.measure(c, c.rows_of(k.name, mismatch=k.mismatch)).value for k in panel.columns] for c in cells.values()
        ]
        heat(axis, np.array(values), list(cells), [k.label for k in panel.columns], less=panel.less)
    for axis in axes[1:]:
        axis.tick_params(labelleft=False)
    return figure


def mismatch_panels(cell: ComparisonCell, biased: str) -> list[Panel]:
    """Alarms, false isolation and exact isolation by mismatch case; the first column has none."""
    cases = [("no mismatch", ""), *((m, m) for m in cell.mismatches)]
    healthy = [PanelColumn(label, HEALTHY, mismatch) for label, mismatch in cases]
    faulty = [PanelColumn(label, biased, mismatch) for label, mismatch in cases]
    return [
        Panel("healthy: samples with an alarm", ComparisonCell.alarms, healthy, less=True),
        Panel("healthy: samples with false isolation", ComparisonCell.false_isolation, healthy, less=True),
        Panel(f"{biased.replace('-', ' ')}: exact isolation", ComparisonCell.exact, faulty),
    ]


def other_panels(cell: ComparisonCell) -> list[Panel]:
    """What is not a single fault of a size: alarms, exact isolation where sensors are faulty, false isolation."""
    shown = [c for c in cell.conditions.values() if c.kind not in (*GRADED, HEALTHY, LENGTH)]
    columns = [PanelColumn(c.name, c.name) for c in shown]
    faulty = [PanelColumn(c.name, c.name) for c in shown if c.kind not in (PROCESS, "dropout")]
    found = [
        Panel("runs with an alarm", ComparisonCell.detected, columns),
        Panel("samples with exact isolation", ComparisonCell.exact, faulty),
        Panel("samples with false isolation", ComparisonCell.false_isolation, columns, less=True),
    ]
    return [panel for panel in found if panel.columns]


def draw_cost(cells: Mapping[str, ComparisonCell], score: Mapping[str, Estimate]) -> Drawing:
    """What is found against what a step costs."""
    figure, (axis,) = panels([""], width=10.5, height=3.8)
    look = looks(list(cells))
    for detector, e in score.items():
        style = {"color": look[detector]["color"], "marker": look[detector]["marker"]}
        spread = [[max(e.value - e.low, 0.0)], [max(e.high - e.value, 0.0)]]
        filled = look[detector]["linestyle"] == "-"
        axis.errorbar(
            cells[detector].step_seconds * 1e3, e.value, spread, linestyle="none", markersize=6, elinewidth=0.8, capsize=2,
            mfc=style["color"] if filled else "white", label=entry(detector), **style,
        )  # fmt: skip
    axis.set(xscale="log", ylim=(-0.03, 1.03), xlabel="processor time of a step (ms)", ylabel="samples with exact isolation")
    number_decades(axis.xaxis)
    legend_columns(figure)
    return figure
