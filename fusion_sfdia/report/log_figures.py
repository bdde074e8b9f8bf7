"""Figures of a diagnosis: all sensors, a time line of the verdicts, each finding from near, how far the process is off."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, PercentFormatter
from numpy.typing import NDArray

from fusion_sfdia.diagnosis.diagnose import Diagnosis
from fusion_sfdia.diagnosis.events import Event, ProcessEvent, UndecidedEvent, listed
from fusion_sfdia.diagnosis.sentences import KINDS
from fusion_sfdia.plant.gaps import Gap
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.report.log_units import with_brackets
from fusion_sfdia.report.plots import COLOURS, TimeAxis, shade

Array = NDArray[Any]

MOST_ROWS = 10
MOST_COLUMNS = 500  # of the overview
MOST_LABELS = 100
MOST_POINTS = 1500  # of a line
MANY = 500  # events, of which more are drawn as pixels
MOST_DOTS = 200  # of a line whose points are marked
MOST_BESIDE = 3  # other verdicts beside that of a finding
WIDE = 24  # characters of a line beside a vertical axis
LONGEST, BRIEF = 36, 33  # characters of a name beside the axis of a time line, and of a picture of a finding
USUAL, LOUD = 3.0, 6.0  # standard deviations within which readings are as usual, and that the overview shows as the darkest
COLOUR = {  # of events by their kind
    "process": COLOURS[1],
    "outside": COLOURS[2],
    "undecided": COLOURS[4],
    "sensor": COLOURS[0],
    "other": COLOURS[3],
}


def time_axis(found: Diagnosis) -> TimeAxis:
    """The axis of a diagnosis: of its clock, else in seconds, as the sentences are and the log is."""
    first, zone = found.clock.moment(float(found.t[0])), found.clock.zone
    if first is None:
        return TimeAxis(found.clock, 1.0, "s", "time (s)")
    return TimeAxis(found.clock, 1.0, "", f"time{f' ({zone})' if zone else ''} from {first:%Y-%m-%d} on")


def time_line(axes: Axes, found: Diagnosis, most: int = MOST_ROWS) -> None:
    """A bar for each event over time, a row for each hypothesis, in the order of findings; `most` rows at most."""
    at = time_axis(found)
    rows = list(dict.fromkeys((e.kind, e.hypothesis) for e in found.findings))
    named = {(e.kind, e.hypothesis): label(found, e) for e in found.events}
    shown = rows if len(rows) <= most else rows[: most - 1]
    step = _step(found.t)
    for row, one in enumerate(shown):
        own = [e for e in found.events if (e.kind, e.hypothesis) == one]
        _bars(axes, found, own, (float(found.t[0]), float(found.t[-1])), row, COLOUR[one[0]])
    shade(axes, [(float(at(g.start)), float(at(g.end))) for g in found.gaps], color="0.85", zorder=0)
    labels = [named[one] for one in shown]
    for row, (kind, name) in enumerate(shown):
        word = _kinds(found, name) if kind == "sensor" else KINDS[kind].word
        axes.text(1.01, row, word, transform=axes.get_yaxis_transform(), va="center", color="0.3", fontsize=8)
    if more := len(rows) - len(shown):
        labels.append(f"and {more} more")
    axes.set_yticks(range(len(labels)), labels, fontsize=8)
    axes.set(xlim=(float(at(found.t[0])), float(at(found.t[-1] + step))), ylim=(max(len(labels), 4) - 0.4, -0.6))
    at.label_on(axes)
    axes.grid(visible=False, axis="y")


def _bars(axes: Axes, found: Diagnosis, events: Sequence[Event], window: tuple[float, float], row: int, colour: str) -> None:
    """A bar for each event, one for those that are too near each other in a window (s) to be seen apart."""
    at, step, least = time_axis(found), _step(found.t), (window[1] - window[0]) / MOST_COLUMNS
    joined: list[list[float]] = []
    for start, end in sorted((e.start, e.end + step) for e in events):
        if joined and start - joined[-1][1] < least:
            joined[-1][1] = max(end, joined[-1][1])
        else:
            joined.append([start, end])
    axes.broken_barh(
        [(float(at(a)), float(at(b) - at(a))) for a, b in joined],
        (row - 0.35, 0.7),
        color=colour,
        rasterized=len(found.events) > MANY,
    )


def _kinds(found: Diagnosis, sensor: str) -> str:
    """The kinds of faults of a sensor, in words."""
    kinds = [e.fault for e in found.events if e.kind == "sensor" and e.hypothesis == sensor and e.fault]
    return ", ".join(dict.fromkeys(kinds)) or "sensor"


def _step(t: Array) -> float:
    """The width of a single sample (s)."""
    return float(np.min(np.diff(t))) if len(t) > 1 else 60.0


def overview(plant: Plant, y: Array, found: Diagnosis) -> Figure:
    """Every sensor over time: the darker, the further its reading (K, N) is from what the others predict, see `_differences`,
    white where missing; a line under what is a fault.
    """
    at, names, step = time_axis(found), plant.sensor_names, _step(found.t)
    edges = np.linspace(found.t[0], found.t[-1] + step, min(len(found.t), MOST_COLUMNS) + 1)
    which = np.clip(np.searchsorted(edges, found.t, side="right") - 1, 0, edges.size - 2)
    first = np.flatnonzero(np.diff(which, prepend=-1))  # of each cell that has samples
    cells = np.full((edges.size - 1, len(names)), -1.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        for i in range(len(names)):
            error, usual = _differences(found, i)
            z = np.abs(error / usual)
            z[~(np.isfinite(y[:, i]) & np.isfinite(z))] = -1.0
            cells[which[first], i] = np.maximum.reduceat(z, first)
    height = max(1.8, 0.9 + len(names) * (0.17 if len(names) <= MOST_LABELS else 0.06))
    figure = Figure(figsize=(6.0, height), layout="constrained")
    axes = figure.subplots()
    mesh = axes.pcolormesh(
        at(edges), np.arange(len(names) + 1) - 0.5, np.ma.masked_less(cells.T, 0.0), cmap="Blues", vmin=0, vmax=LOUD / USUAL,
        rasterized=True,
    )  # fmt: skip
    faults = [e for e in found.events if e.hypothesis in names and e.kind == "sensor"]
    rows = [names.index(e.hypothesis) + 0.4 for e in faults]
    starts, ends = (
        [float(at(when)) for when in times] for times in ([e.start for e in faults], [e.end + step for e in faults])
    )
    axes.hlines(rows, starts, ends, color=COLOURS[1], linewidth=2.5, capstyle="butt", rasterized=len(faults) > MANY)
    shade(axes, [(float(at(g.start)), float(at(g.end))) for g in found.gaps], color="0.85", zorder=3)
    faulty = {e.hypothesis for e in found.events}
    labels = [(i, name) for i, name in enumerate(names) if len(names) <= MOST_LABELS or name in faulty]
    axes.set_yticks([i for i, _ in labels], [name for _, name in labels], fontsize=7)
    for text, (_, name) in zip(axes.get_yticklabels(), labels, strict=True):
        text.set_color(COLOURS[1] if name in faulty else "0.25")
    axes.set(xlim=(float(at(edges[0])), float(at(edges[-1]))), ylim=(len(names) - 0.5, -0.5))
    at.label_on(axes)
    axes.grid(visible=False)
    bar = figure.colorbar(mesh, ax=axes, location="top", shrink=0.6, aspect=40, pad=0.01)
    if found.after is not None:
        bar.formatter = FuncFormatter(lambda z, _: f"{USUAL * z:g}")
        bar.set_label(f"distance from the prediction, in standard deviations (darkest: {LOUD:g} or more)", fontsize=8)
    else:
        bar.set_label(f"distance from the prediction over its limit (darkest: {LOUD / USUAL:g} or more)", fontsize=8)
    return figure


def near(plant: Plant, y: Array, found: Diagnosis, events: Sequence[Event], points: int = MOST_POINTS) -> Figure:
    """A finding from near, about the first of its events and those of the others that follow each other: readings (K, N) of its
    sensor with what is expected, the difference between them, and the verdicts. Of a finding that is no sensor the readings are
    those that are furthest off.

    points: of a line at most; readings have dots where few are drawn.
    """
    i, t, at = shown_sensor(plant, found, events), found.t, time_axis(found)
    a, b, margin = _extent(t, events)
    window = slice(max(0, a - margin), min(len(t), b + margin + 1))
    predicted = is_predicted(found, i)
    error, usual = (v[window] for v in _differences(found, i))
    reading, unit = y[window, i], plant.sensors[i].unit
    expected = found.decisions.reconstruction[window, i]
    if predicted:
        expected = np.where(np.isfinite(error), reading - error, expected)
    else:
        expected = np.where(expected == reading, np.nan, expected)  # only what replaces a reading
    shown = thinned(reading, points)
    line = ".-" if shown.size == reading.size and shown.size < MOST_DOTS else "-"
    ends = (float(t[window][0]), float(t[window][-1]))
    inside = [e for e in found.findings if e.start <= ends[1] and e.end >= ends[0]]
    rows = list(dict.fromkeys((e.kind, e.hypothesis) for e in (events[0], *inside)))[: MOST_BESIDE + 1]
    figure = Figure(figsize=(4.8, 4.1 + 0.1 * len(rows)), layout="constrained")
    upper, lower, strip = figure.subplots(3, 1, sharex=True, height_ratios=(6, 3, 0.8 + 0.4 * len(rows)))
    sd = usual / USUAL
    each = [v[shown] for v in (expected - 2 * sd, expected + 2 * sd, expected, reading, error, usual)]
    times, (low, high, middle, read, difference, limit) = broken(t[window][shown], each, found.gaps)
    x, step, word, colour = at(times), _step(t), KINDS[events[0].kind].word, COLOUR[events[0].kind]
    if predicted:
        upper.fill_between(x, low, high, color=COLOURS[2], alpha=0.25, lw=0, label="expected range (95 %)")
    dots = {"color": COLOURS[0], "markersize": 3, "linewidth": 0.8}
    replaces = "expected" if predicted else "reconstructed"
    if np.any(np.isfinite(middle)):
        upper.plot(x, middle, color=COLOURS[2], linewidth=1.2, label=replaces, gid=replaces)
    upper.plot(x, read, line, **dots, label="reading", gid="reading")
    lower.plot(x, difference, line, **dots, gid="difference" if predicted else "over its limit")
    lower.fill_between(x, -limit, limit, color="0.85", lw=0, zorder=0)
    spans = [(float(at(e.start)), float(at(e.end + step))) for e in events]
    for axes in (upper, lower):
        shade(axes, spans, color=colour, alpha=0.15, zorder=0, lw=0, label=f"found: {word}" if axes is upper else None)
    _strip(strip, found, rows, inside, ends)
    name = fill(plant.sensor_names[i], WIDE)
    upper.set_ylabel(with_brackets(name, unit, " " if len(name) + len(unit) < WIDE else "\n"))
    lower.set_ylabel(with_brackets("difference", unit, "\n") if predicted else "over its\nlimit")
    strip.set_xlim(float(x[0]), float(at(t[window][-1] + step)))
    at.label_on(strip)
    figure.legend(*upper.get_legend_handles_labels(), loc="outside upper left", ncols=4, fontsize=7, columnspacing=1.0)
    return figure


def _extent(t: Array, events: Sequence[Event]) -> tuple[int, int, int]:
    """First and last sample of the first event, with those of the others within a margin, and that margin in samples."""
    a, b = (int(np.searchsorted(t, when)) for when in (events[0].start, events[0].end))
    margin = max(20, (b - a) // 2)
    in_time = sorted((np.searchsorted(t, (e.start, e.end)) for e in events), key=lambda span: int(span[0]))
    for first, last in in_time:
        if first >= a and first <= b + margin:
            b = max(b, int(last))
    for first, last in reversed(in_time):
        if last <= b and last >= a - margin:
            a = min(a, int(first))
    return a, b, max(20, (b - a) // 2)


def shown_sensor(plant: Plant, found: Diagnosis, events: Sequence[Event]) -> int:
    """The position of the sensor of a finding; of one that is none the sensor that is furthest off meanwhile, of an undecided
    one among its suspects, if there are any.
    """
    names = [events[0].hypothesis, *(events[0].suspects if isinstance(events[0], UndecidedEvent) else ())]
    own = [plant.sensor_index(name) for name in names if name in plant.sensor_names] or list(range(len(plant.sensors)))
    within = np.zeros(len(found.t), bool)
    for e in events:
        within |= (found.t >= e.start) & (found.t <= e.end)
    off = []
    for i in own:
        error, usual = _differences(found, i)
        with np.errstate(divide="ignore", invalid="ignore"):
            z = np.abs(error[within] / usual[within])
        off.append(float(np.mean(z[np.isfinite(z)])) if np.any(np.isfinite(z)) else -1.0)
    return own[int(np.argmax(off))]


def is_predicted(found: Diagnosis, i: int) -> bool:
    """Whether a second look has predicted readings of a sensor: not of one of which the model predicts nothing."""
    return found.after is not None and bool(np.isfinite(found.after.error[:, i]).any())


def _differences(found: Diagnosis, i: int) -> tuple[Array, Array]:
    """Of a sensor how far its readings are from what is expected (K,), and how far is usual: USUAL standard deviations of the
    second look. Without that the detector's residual over its threshold, and 1.
    """
    if found.after is not None and is_predicted(found, i):
        return found.after.error[:, i], USUAL * found.after.sd[:, i]
    with np.errstate(divide="ignore", invalid="ignore"):
        over = found.decisions.residual[:, i] / found.decisions.threshold[:, i]
    return over, np.ones_like(over)


def _strip(
    axes: Axes, found: Diagnosis, rows: Sequence[tuple[str, str]], inside: Sequence[Event], window: tuple[float, float]
) -> None:
    """The verdicts in a window (s): a bar for each event inside, each in the row of its kind and hypothesis."""
    for row, (kind, hypothesis) in enumerate(rows):
        own = [e for e in inside if (e.kind, e.hypothesis) == (kind, hypothesis)]
        _bars(axes, found, own, window, row, COLOUR[kind])
    labels = {(e.kind, e.hypothesis): label(found, e, BRIEF) for e in inside}
    axes.set_yticks(range(len(rows)), [labels.get(row, row[1]) for row in rows], fontsize=7)
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.grid(visible=False, axis="y")


def label(found: Diagnosis, e: Event, longest: int = LONGEST) -> str:
    """The name of an event beside an axis: of an undecided one those of the first suspects, as many as have room, or the only
    one with a question mark.
    """
    names = [short(found, name, longest) for name in (e.suspects if isinstance(e, UndecidedEvent) else (e.hypothesis,))]
    if isinstance(e, UndecidedEvent) and len(names) == 1:
        names = [f"{names[0]}?"]
    texts = [listed(names, " or ", most) for most in (2, 1)]
    text = next((text for text in texts if len(text) <= longest), texts[-1])
    if len(text) > longest and len(names) > 1:
        text = f"{names[0]} or {len(names) - 1} more"
    return text if len(text) <= longest else f"{text[: longest - 1]}…"


def short(found: Diagnosis, hypothesis: str, longest: int) -> str:
    """What a hypothesis is called where there is little room: a sensor or an input its tag, others in few words."""
    w = found.words.get(hypothesis)
    words = "" if w is None or w.part in ("sensor", "input") else w.meaning.removeprefix("the ")
    return words if 0 < len(words) <= longest else w.name if w else hypothesis


def broken(t: Array, series: Sequence[Array], gaps: Sequence[Gap]) -> tuple[Array, list[Array]]:
    """Times and series (K,) with NaN after each gap between them, over which no line is drawn."""
    over = np.unique(np.searchsorted(t, [g.end for g in gaps]).astype(int))
    over = over[(over > 0) & (over < len(t))]
    return np.insert(t, over, t[over]), [np.insert(v, over, np.nan) for v in series]


def thinned(values: Array, most: int = MOST_POINTS) -> Array:
    """Positions (k,) among values (K,), about `most`, that keep lowest and highest of each of many parts."""
    if values.size <= most:
        return np.arange(values.size)
    part, (length, longer) = np.arange(most // 2), divmod(values.size, most // 2)
    starts = part * length + np.minimum(part, longer)
    low, high = (_first_lowest(np.where(np.isfinite(values), sign * values, np.inf), starts) for sign in (1, -1))
    return np.unique([0, values.size - 1, *low, *high])


def _first_lowest(values: Array, starts: Array) -> Array:
    """Positions of the first of the lowest among values (K,) in each of the parts that begin at `starts`, at 0 first."""
    lengths = np.diff(starts, append=values.size)
    lowest = np.flatnonzero(values == np.repeat(np.minimum.reduceat(values, starts), lengths))
    return lowest[np.searchsorted(lowest, starts)]


def process_size(axes: Axes, found: Diagnosis, name: str) -> None:
    """How far the process is above the model by a hypothesis, with 2 standard deviations; in percent of a nominal value."""
    events = [e for e in found.events if isinstance(e, ProcessEvent) and e.hypothesis == name]
    j = [h.name for h in found.process_hypotheses].index(name)
    size, sd = (np.asarray(a)[:, j] for a in (found.decisions.process_size, found.decisions.process_sd))
    nominal = events[0].nominal
    share = np.isfinite(nominal) and nominal != 0
    scale = 1 / abs(nominal) if share else 1.0
    at, shown = time_axis(found), thinned(size)
    x, size, sd = at(found.t[shown]), size[shown], sd[shown]
    axes.plot(x, size * scale, color=COLOURS[1], label="above the model")
    axes.fill_between(x, (size - 2 * sd) * scale, (size + 2 * sd) * scale, color=COLOURS[1], alpha=0.2, label="95 %", lw=0)
    axes.axhline(0.0, color="0.4", linewidth=1)
    unit = "1" if share else events[0].unit
    axes.set(ylabel=with_brackets("above the model", unit))
    at.label_on(axes)
    if share:
        axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=None))
    axes.legend(fontsize=8)
