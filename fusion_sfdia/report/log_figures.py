"""Panels for a detector that tests the process, too: a time line of all its verdicts, and how far the process is off."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import PercentFormatter

from fusion_sfdia.evaluation.diagnose import Diagnosis
from fusion_sfdia.evaluation.events import ProcessEvent, UndecidedEvent, listed
from fusion_sfdia.report.plots import COLOURS

MOST_ROWS = 10
KINDS = {  # of events: the word and the colour
    "process": ("process or model", COLOURS[1]),
    "undecided": ("cannot tell", COLOURS[4]),
    "sensor": ("sensor", COLOURS[0]),
    "other": ("other fault", COLOURS[3]),
}


def time_line(axes: Axes, found: Diagnosis) -> None:
    """A bar for each event over time (min), a row for each hypothesis, the process first."""
    rows = list(dict.fromkeys((e.kind, e.hypothesis) for e in found.events))
    named = {e.hypothesis: listed(e.suspects, " or ", most=2) for e in found.events if isinstance(e, UndecidedEvent)}
    shown = rows if len(rows) <= MOST_ROWS else rows[: MOST_ROWS - 1]
    step = float(np.min(np.diff(found.t))) if len(found.t) > 1 else 60.0  # s: the width of a single sample
    for e in found.events:
        if (e.kind, e.hypothesis) in shown:
            bar = (e.start / 60, (e.end - e.start + step) / 60)
            axes.broken_barh([bar], (shown.index((e.kind, e.hypothesis)) - 0.35, 0.7), color=KINDS[e.kind][1])
    labels = [named.get(name, name) for _, name in shown]
    for row, (kind, _) in enumerate(shown):
        axes.text(1.01, row, KINDS[kind][0], transform=axes.get_yaxis_transform(), va="center", color="0.3", fontsize=8)
    if more := len(rows) - len(shown):
        labels.append(f"and {more} more")
    axes.set_yticks(range(len(labels)), labels, fontsize=8)
    axes.set(xlabel="time (min)", xlim=(found.t[0] / 60, (found.t[-1] + step) / 60), ylim=(max(len(labels), 4) - 0.4, -0.6))
    axes.grid(visible=False, axis="y")


def process_size(axes: Axes, found: Diagnosis, name: str) -> None:
    """How far the process is above the model by a hypothesis, with 2 standard deviations; in percent of a nominal value."""
    events = [e for e in found.events if isinstance(e, ProcessEvent) and e.hypothesis == name]
    j = [h.name for h in found.process_hypotheses].index(name)
    size, sd = (np.asarray(a)[:, j] for a in (found.decisions.process_size, found.decisions.process_sd))
    nominal = events[0].nominal
    share = np.isfinite(nominal) and nominal != 0
    scale = 1 / abs(nominal) if share else 1.0
    t = found.t / 60
    axes.plot(t, size * scale, color=COLOURS[1], label="above the model")
    axes.fill_between(t, (size - 2 * sd) * scale, (size + 2 * sd) * scale, color=COLOURS[1], alpha=0.2, label="+- 2 sd", lw=0)
    axes.axhline(0.0, color="0.4", linewidth=1)
    axes.set(xlabel="time (min)", ylabel=name if share else f"{name} [{events[0].unit}]")
    if share:
        axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=None))
    axes.legend(fontsize=8)
