"""Figures of a comparison."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure as Drawing
from matplotlib.patches import Patch
from matplotlib.ticker import NullFormatter
from numpy.typing import NDArray

from fusion_sfdia.common.run_statistics import Estimate
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.report.content import Figure
from fusion_sfdia.report.plots import entry, number_decades, panels
from fusion_sfdia.study import detection_metrics as metrics
from fusion_sfdia.study.comparison.cell import CellNumber, Cells, ComparisonCell, of_plant
from fusion_sfdia.study.comparison.example import PREFIX, SIGMAS
from fusion_sfdia.study.comparison.looks import GREY, OTHERS, looks, prominent, quieted
from fusion_sfdia.study.comparison.loss import DELAY, FALSE, FALSE_IF_WRONG, MISSED, loss_parts
from fusion_sfdia.study.comparison.metric_rows import Measure, confusion, exact_isolation
from fusion_sfdia.study.comparison.protocol import GRADED, HEALTHY, LENGTH, PROCESS
from fusion_sfdia.study.comparison.ranking import LOSS
from fusion_sfdia.study.comparison.result_tables import EVERY, Standings, cost_words
from fusion_sfdia.study.experiments.scenario import Settings

Array = NDArray[Any]
LEAST = 2  # runs behind a point
VERDICTS = ("no alarm", "alarm, no sensor isolated", "only the faulty sensor isolated", "a healthy sensor isolated")
COLOURS = ("#F2F2F2", "#E69F00", "#0072B2", "#A02020")
LEAST_SCORE = 1e-2  # shown
PARTS = {MISSED: "#0072B2", FALSE: "#E69F00", FALSE_IF_WRONG: "#D55E00", DELAY: "0.7"}
Losses = Mapping[str, Mapping[str, Mapping[str, float]]]  # plant, detector, part


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


def example_figure(settings: Settings, cells: Mapping[str, ComparisonCell]) -> Figure:
    """The example of a plant; cells by detector."""
    some = next(iter(cells.values()))
    sensor = some.model.sensor_names[int(some[f"{PREFIX}sensor"])]
    examples = {d: {k: v for k, v in c.arrays.items() if k.startswith(PREFIX)} for d, c in cells.items()}
    named = prominent({d: exact_isolation(settings, c).value for d, c in cells.items()})
    return Figure(
        f"{some.subject.slug}-example",
        f"An example: one faulty run, {some.plant}",
        f"Which detectors isolate the fault, how soon, and what they reconstruct. {sensor}, the middle one of the "
        f"plant's sensors, has a bias of {SIGMAS:g} sigma; thresholds are those of the common rate of false alarms. "
        "Reconstructions are cut off where they leave the range of the readings.",
        partial(draw_example, some.model, examples, named),
        f"Readings of {sensor} on {some.plant}, reconstructions, residuals over thresholds and alarms of {len(cells)} "
        "detectors over the same time",
    )


def draw_example(plant: Plant, examples: Mapping[str, Mapping[str, Array]], named: Collection[str]) -> Drawing:
    """Four panels over one time axis. examples: by detector, the arrays of `example`; named: those not drawn in grey."""
    some, look_of = next(iter(examples.values())), looks(list(examples))
    t, sensor = some[f"{PREFIX}t"], plant.sensors[int(some[f"{PREFIX}sensor"])]
    figure = Drawing(figsize=(11.5, 6.6 + 0.21 * len(examples)), layout="constrained")
    heights = (1.5, 1.5, 1.7, 0.4 + 0.16 * len(examples))
    readings, restored, scores, verdicts = figure.subplots(4, 1, sharex=True, gridspec_kw={"height_ratios": heights})
    unit = f"{sensor.name} ({sensor.unit})"

    readings.plot(t, some[f"{PREFIX}y"], color="black", linewidth=1.0, label="reading")
    readings.plot(t, some[f"{PREFIX}signal"], color="0.55", linestyle="--", label="without noise and fault")
    titled(readings, f"Readings of {sensor.name}, with a bias of {SIGMAS:g} sigma in the grey time", unit)
    restored.plot(t, some[f"{PREFIX}signal"], color="0.55", linestyle="--", label="without noise and fault")
    titled(restored, "Reconstruction by each detector", unit)
    titled(scores, "Largest residual over its threshold: an alarm above 1", "residual / threshold")
    for name, one in sorted(examples.items(), key=lambda item: item[0] in named):  # the named on top
        look = {k: v for k, v in look_of[name].items() if k in ("color", "linestyle")} if name in named else {"color": GREY}
        label = entry(name) if name in named else None
        restored.plot(t, one[f"{PREFIX}reconstruction"], linewidth=1.3, label=label, gid=name, **look)
        scores.plot(t, np.maximum(one[f"{PREFIX}score"], LEAST_SCORE), linewidth=1.3, label=label, gid=name, **look)
    if set(examples) - set(named):
        scores.plot([], [], color=GREY, label=OTHERS)
    scores.axhline(1.0, color="black", linewidth=1.0)
    scores.set_yscale("log")
    number_decades(scores.yaxis)
    for axis in (readings, restored, scores):
        acting = t[some[f"{PREFIX}active"] > 0]
        if acting.size:
            axis.axvspan(acting[0], acting[-1], color="0.93", zorder=0)
    limit_to(restored, [some[f"{PREFIX}y"], some[f"{PREFIX}signal"]])
    for axis in (readings, scores):
        axis.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0))

    names = list(examples)
    rows = np.array([examples[name][f"{PREFIX}verdict"] for name in names])
    step = t[1] - t[0] if t.size > 1 else 1.0
    sides = (float(t[0] - step / 2), float(t[-1] + step / 2), len(names) - 0.5, -0.5)
    colours, levels = ListedColormap(COLOURS), BoundaryNorm(np.arange(len(COLOURS) + 1) - 0.5, len(COLOURS))
    image = verdicts.imshow(rows, cmap=colours, norm=levels, extent=sides, aspect="auto", interpolation="nearest")
    image.format_cursor_data = lambda code: VERDICTS[int(code)]
    verdicts.set_yticks(np.arange(len(names)), names, fontsize=7)
    verdicts.grid(visible=False)
    verdicts.tick_params(axis="y", length=0)
    titled(verdicts, "Alarm and isolation", "")
    verdicts.set_xlabel("time (s)")
    shown = [Patch(facecolor=colour, edgecolor="0.6", label=label) for colour, label in zip(COLOURS, VERDICTS, strict=True)]
    verdicts.legend(handles=shown, fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def titled(axis: Axes, title: str, label: str) -> None:
    """A panel's title and the label of its vertical axis."""
    axis.set_title(title, fontsize=10, loc="left")
    axis.set_ylabel(label)


def limit_to(axis: Axes, values: list[Array]) -> None:
    """The vertical range of some values, with a margin: what leaves it is cut off."""
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    margin = 0.25 * max(high - low, abs(high) * matplotlib.rcParams["axes.ymargin"] * 1e-3)
    axis.set_ylim(low - margin, high + margin)


def loss_figure(settings: Settings, cells: Cells, standings: Standings) -> Figure:
    """All detectors in the order of their loss, one panel per plant."""
    losses = {
        plant: {
            d: {part: float(v.mean()) for part, v in loss_parts(c, settings).items()} for d, c in of_plant(cells, plant).items()
        }
        for plant in dict.fromkeys(plant for plant, _ in cells)
    }
    best = {plant: [d for d, s in of[LOSS].items() if s.rank == 1] for plant, of in standings.items() if plant != EVERY}
    return Figure(
        "loss",
        "What each detector costs",
        f"Shorter is better; bold: no detector costs less beyond chance. {cost_words(settings)}",
        lambda: draw_loss(losses, best),
        "Bars of the loss of every detector by plant, the least on top, each divided into missed faults, false isolation with "
        "the right and with a wrong model, and delay",
    )


def draw_loss(losses: Losses, best: Mapping[str, Collection[str]]) -> Drawing:
    """Bars of the parts of the loss, the least on top. best: the detectors by plant that none beats, in bold."""
    most = max(map(len, losses.values()))
    figure, axes = panels(list(losses), columns=2, width=11.5, height=1.0 + 0.19 * most)
    for axis, (plant, of) in zip(axes, losses.items(), strict=True):
        order = sorted(of, key=lambda d: sum(of[d].values()))
        left = np.zeros(len(order))
        for part, colour in PARTS.items():
            width = np.array([of[d][part] for d in order])
            axis.barh(range(len(order)), width, left=left, color=colour, label=part, height=0.75)
            left += width
        axis.set_yticks(range(len(order)), order, fontsize=7)
        for label, name in zip(axis.get_yticklabels(), order, strict=True):
            label.set_fontweight("bold" if name in best[plant] else "normal")
        axis.set_ylim(most - 0.5, -0.5)  # bars are equally thick in all panels
        axis.grid(visible=False, axis="y")
        axis.set_xlabel("loss")
    legend_columns(figure, columns=4)
    return figure
