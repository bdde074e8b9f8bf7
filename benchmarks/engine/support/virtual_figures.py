"""Figures of engine/virtual-sensors as in V22: sizes of all faults, errors and an interval, and neighbouring modules."""

from __future__ import annotations

from functools import partial

import numpy as np
from matplotlib.figure import Figure as Drawing
from matplotlib.lines import Line2D

from fusion_sfdia.benchmarks.engine.support.trials import DETECTORS, NAMES, engine
from fusion_sfdia.benchmarks.engine.support.virtual_trials import FAULTS, INTERSECTED, MAPE, PRINTED, SINCE, SIZED, VARIANTS
from fusion_sfdia.common.run_statistics import proportion
from fusion_sfdia.report.content import Figure
from fusion_sfdia.report.plots import COLOURS, Bars, bars, legend_above, panels
from fusion_sfdia.study.experiments.scenario import Arrays

TRUE, FOUND, INSTANT, LOWER, UPPER = COLOURS[0], COLOURS[2], COLOURS[4], COLOURS[1], COLOURS[3]
DRAWN = {INTERSECTED: FOUND, PRINTED: INSTANT}
SHOWN = {"N m": ("kN m", 1e-3), "Pa": ("kPa", 1e-3), "kg": ("g", 1e3), "K": ("K", 1.0)}


def virtual_sensor_figures(found: dict[str, Arrays], duration: float) -> list[Figure]:
    """The figures whose variants were run."""
    if not {*DRAWN, "alone"} <= set(found):
        return []
    return [
        Figure(
            "sizes",
            "Sizes of the faults (V22, Fig. 3)",
            "One run, one panel per module and one row per agent as in the paper: the actual offset of its sensor, and its "
            "estimate with intervals intersected over time and of each sample alone, as printed; 0 before the sensor is "
            "isolated. In M(3,1) both are from an adaptive observer. Right of a title: the sensor.",
            partial(draw_sizes, {v: found[v]["trace"][:, 0] for v in DRAWN}, duration),
            "Ten panels, one per module, with actual and estimated fault over time",
        ),
        Figure(
            "errors",
            "Errors of the sizes, and the torque's interval (V22, Fig. 4)",
            "(a) to (c): absolute percentage error of the estimate, of one run (faint) and on average over all runs; dashed: "
            "the paper's mean, over its time span. (d): ends and middle of the interval of M(2,3) "
            "in that run, intersected over time, which restarts when another sensor is isolated.",
            partial(draw_errors, {v: found[v]["trace"] for v in DRAWN}, duration),
            "Three panels with percentage errors over time, and one with an interval that narrows around the actual fault",
        ),
        Figure(
            "neighbours",
            "Which modules fire with and without reconstructed readings",
            "Share of runs in which each module fires at some time, with its 95 % interval. The sensors of "
            f"{', '.join(SIZED)} are faulty; other modules fire because they read them.",
            partial(draw_neighbours, {k: found[k]["first"] for k in ("alone", *VARIANTS) if k in found}),
            "Bars of the share of runs in which each of ten modules fires, one colour for each kind of readings",
        ),
    ]


def draw_sizes(traces: dict[str, np.ndarray], duration: float) -> Drawing:
    """The ten modules; traces (4, K, N) as in virtual_trials.follow."""
    figure, axes = panels([""] * 12, columns=3, width=11.0, height=1.9)
    sensors = engine(0.03, "K22").sensors
    places = [(r, c) for r, agent in enumerate("1234") for c in range(sum(n[2] == agent for n in NAMES))]
    for j, (r, c) in enumerate(places):
        axis = axes[3 * r + c]
        axis.set_title(f"({'abcdefghij'[j]}) {NAMES[j]}", fontsize=9, loc="left")
        axis.set_title(f"{sensors[j].name}  {sensors[j].measures}", fontsize=8, loc="right")
        unit, scale = SHOWN[sensors[j].unit]
        for variant, colour in reversed(DRAWN.items()):
            thin = 0.6 if variant == PRINTED else 1.5
            axis.plot(traces[variant][0, :, j], scale * traces[variant][1, :, j], color=colour, linewidth=thin)
        of = {f.sensor: f for f in FAULTS}.get(sensors[j].name)
        actual = [0.0, 0.0] if of is None else [0.0, 0.0, scale * of.magnitude, scale * of.magnitude]
        axis.plot([0.0, duration] if of is None else [0.0, of.onset, of.onset, duration], actual, color=TRUE, linestyle="--")
        if of is None and not any(np.any(t[1, :, j]) for t in traces.values()):
            axis.set_ylim(-1, 1)
        axis.set_ylabel(unit, fontsize=8)
        axis.set_xlim(0, duration)
        axis.set_xlabel("time (s)" if r == 3 else "")
    for k, axis in enumerate(axes):
        if divmod(k, 3) not in places:
            axis.remove()
    entries = {"actual fault": Line2D([], [], color=TRUE, linestyle="--")}
    entries |= {f"estimate, {v}": Line2D([], [], color=colour) for v, colour in DRAWN.items()}
    figure.legend(list(entries.values()), list(entries), loc="outside upper center", ncols=len(entries), fontsize=8)
    return figure


def draw_errors(traces: dict[str, np.ndarray], duration: float) -> Drawing:
    """Errors of the three faults' sizes and the interval of the first; traces (4, B, K, N)."""
    titles = [f"({letter}) error, {n}" for letter, n in zip("abc", SIZED, strict=True)] + [f"(d) interval of {SIZED[0]}"]
    figure, axes = panels(titles, columns=2, width=10.0, height=2.8)
    for i, (axis, n) in enumerate(zip(axes[:3], SIZED, strict=True)):
        for variant, colour in reversed(DRAWN.items()):
            t, size = traces[variant][0, 0, :, 0], traces[variant][1, :, :, NAMES.index(n)]
            error = 100 * np.abs(size / FAULTS[i].magnitude - 1)
            after = t >= FAULTS[i].onset
            axis.plot(t[after], error[0, after], color=colour, linewidth=0.4, alpha=0.5)
            axis.plot(t[after], error[:, after].mean(axis=0), color=colour, label=variant, linewidth=1.2)
        axis.plot([SINCE[i], duration], [MAPE[i]] * 2, color="black", linestyle="--", linewidth=1.2, label="paper, mean")
        axis.set(ylim=(0, 20 if i == 2 else 110), xlim=(0, duration), ylabel="percent")
    (unit, scale), fault = SHOWN["N m"], FAULTS[0]
    t, _, low, high = traces[INTERSECTED][:, 0, :, NAMES.index(SIZED[0])]
    lines = {"lower end": (low, LOWER), "upper end": (high, UPPER), "middle": ((low + high) / 2, TRUE)}
    for label, (values, colour) in lines.items():
        axes[3].plot(t, scale * values, color=colour, label=label)
    actual = [0, 0, scale * fault.magnitude, scale * fault.magnitude]
    axes[3].plot([0, fault.onset, fault.onset, duration], actual, color="black", label="actual")
    axes[3].set(xlim=(0, duration), ylim=(-2 * actual[-1], 4 * actual[-1]), ylabel=unit)
    for axis in axes[2:]:
        axis.set_xlabel("time (s)")
    legend_above(figure)
    return figure


def draw_neighbours(firsts: dict[str, np.ndarray]) -> Drawing:
    """Shares of runs by module, a bar for each kind; first (B, M) s."""
    figure, (axis,) = panels(["share of runs in which the module fires"], columns=1, width=12.0, height=3.0)
    series = []
    for kind, first in firsts.items():
        found = [proportion(int(np.isfinite(first[:, j]).sum()), len(first)) for j in range(len(NAMES))]
        label = f"without ({DETECTORS[0]})" if kind == "alone" else f"with, {kind}"
        value, low, high = ([getattr(e, part) for e in found] for part in ("value", "low", "high"))
        series.append(Bars(label, value, low, high, [float("nan")] * len(NAMES)))
    bars(axis, [n + " *" * (n in SIZED) for n in NAMES], series, ylabel="share of runs")
    axis.set_ylim(0, 1.05)
    legend_above(figure)
    return figure
