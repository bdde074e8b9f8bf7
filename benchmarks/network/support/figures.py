"""Figures of the power network's scenarios: those of Boem et al. 2018 in its layout, times by run, and shares of runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawing
from numpy.typing import NDArray

from fusion_sfdia.benchmarks.network.support.trials import ALPHA, BOUND, Arrays
from fusion_sfdia.models.power_network.published import GOVERNOR, PLUGGED_IN, SIGN_FLIP
from fusion_sfdia.report.content import Figure
from fusion_sfdia.report.plots import COLOURS, legend_above, panels

Array = NDArray[Any]


def waves(axes: Axes, t: Array, values: Array, names: Sequence[str], ylabel: str, loads: Array | None = None) -> None:
    """Signals (K, k) of the named areas over t (s), their loads as dashed lines."""
    for k, name in enumerate(names):
        colour = COLOURS[k % len(COLOURS)]
        axes.plot(t, values[:, k], color=colour, linewidth=1.2, label=f"area {name}")
        if loads is not None:
            axes.plot(t, loads[:, k], color=colour, linestyle="--", linewidth=1.0)
    axes.set(xlabel="time (s)", ylabel=ylabel, xlim=(t[0], t[-1]))


def legend_beside(axes: Axes) -> None:
    """The legend to the right of a panel."""
    axes.legend(fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5), handlelength=1.2)


def grey(axes: Axes, start: float, end: float) -> None:
    """The time from the fault to its end in grey, as in the paper; nothing if the end is infinite."""
    if np.isfinite(end):
        axes.axvspan(start, end, color="0.85", zorder=0)


def residuals(axes: Axes, trace: Arrays, components: Sequence[int], until: float = np.inf, alpha: float = ALPHA) -> None:
    """Residuals (dashed) and thresholds (solid) of some of an area's readings, from the second on."""
    chosen = (trace["t"] <= until) & (trace["t"] > trace["t"][0])
    t = trace["t"][chosen]
    for k, c in enumerate(components):
        threshold = alpha * trace["deviation"][chosen, c]
        threshold = np.where(threshold > 0, threshold, np.nan)
        which = f" {{{c + 1}}}" if k else ""
        axes.plot(t, trace["residual"][chosen, c], "--", color=COLOURS[k], linewidth=1.1, label=f"residual{which}")
        for sign in (-1, 1):
            label = f"threshold{which}" if sign > 0 else None
            axes.plot(t, sign * threshold, color=COLOURS[k], linewidth=1.4, label=label)
    axes.set(xlabel="time (s)", ylabel="residual", xlim=(trace["t"][0], trace["t"][-1]))


def times_figure(
    name: str, title: str, cells: Mapping[str, Sequence[tuple[str, Array]]], published: Mapping[str, float], end: float
) -> Figure:
    """A panel for each cell: the share of its runs with each event by a time, and its time in the published run."""

    def draw() -> Drawing:
        figure, axes = panels(list(cells))
        for one, events in zip(axes, cells.values(), strict=True):
            for k, (event, times) in enumerate(events):
                came = np.sort(times[np.isfinite(times)])
                steps = np.concatenate([[came.min(initial=end)], came, [end]])
                level = np.concatenate([[0.0], np.arange(1, came.size + 1), [came.size]]) / max(times.size, 1)
                one.step(steps, level, where="post", color=COLOURS[k], label=event)
                if event in published:
                    one.axvline(published[event], color=COLOURS[k], linestyle=":", linewidth=1.4, label="published")
            one.set(xlabel="time (s)", ylabel="share of runs", ylim=(-0.02, 1.04))
        low = min((t[np.isfinite(t)].min(initial=end) for events in cells.values() for _, t in events), default=0.0)
        for one in axes:
            one.set_xlim(min([low, *published.values()]) - 2, min(end, max([low + 25, *published.values()]) + 2))
        legend_above(figure)
        return figure

    stated = ", ".join(f"{event} {time:g} s" for event, time in published.items())
    return Figure(
        name,
        title,
        f"Share of the runs in which each event has occurred, by time; dotted: the one published run ({stated}).",
        draw,
        f"Steps from 0 to 1 over time for {', '.join(cells)}, with dotted vertical lines at the published times",
    )


def unplugged_operation(trace: Arrays) -> Figure:
    """Fig. 3, of the first run of network/governor."""
    detected = float(trace["detected"][0, 1])

    def draw() -> Drawing:
        groups = [[str(i) for i in range(k, k + 5)] for k in (1, 6, 11)]
        titles = [f"{what}, areas {g[0]} to {g[-1]}" for g in groups for what in ("References", "Speeds")]
        figure, axes = panels(titles, width=8.5)
        for k, group in enumerate(groups):
            at = [int(name) - 1 for name in group]
            t, loads = trace["unplugged_t"], trace["unplugged_load"][:, at]
            gone = np.array([name == GOVERNOR.fault.area for name in group])  # as in the paper, not shown
            away = gone & (t > detected)[:, None]
            for one, key, label in (
                (axes[2 * k], "unplugged_reference", "reference (per unit)"),
                (axes[2 * k + 1], "unplugged_speeds", "speed (rad/s)"),
            ):
                values = np.where(away, np.nan, trace[key][:, at])
                waves(one, t, values, group, label, np.where(away, np.nan, loads) if key.endswith("reference") else None)
                grey(one, GOVERNOR.fault.onset, detected)
            legend_beside(axes[2 * k + 1])
        return figure

    return Figure(
        "operation",
        "References, loads and speeds with the area unplugged (as Fig. 3)",
        "One run. Solid: references (left) and speeds (right); dashed: loads. Grey: from the fault at "
        f"{GOVERNOR.fault.onset:g} s to its detection at {detected:g} s, after which area {GOVERNOR.fault.area} is "
        f"unplugged and not shown. Area 15 is plugged in at {PLUGGED_IN:g} s.",
        draw,
        "References and speeds of five areas in each of three rows; after unplugging the others follow their loads",
    )


def both_bounds(trace: Arrays) -> Figure:
    """Fig. 4, of the first run of network/governor."""
    detected = float(trace["detected"][0, 1])
    groups = ((0,), (1,), (2, 3))

    def draw() -> Drawing:
        sets = ["{1}", "{2}", "{3, 4}"]
        figure, axes = panels([f"{kind}, {s}" for s in sets for kind in ("Stochastic", "Deterministic")], width=8.5)
        for k, group in enumerate(groups):
            left, right = axes[2 * k], axes[2 * k + 1]
            residuals(left, trace, group, until=detected)
            t = trace["t"][1:]
            for j, c in enumerate(group):
                right.plot(t, np.abs(trace["residual"][1:, c]), "--", color=COLOURS[j], linewidth=1.1)
                right.axhline(trace["bounds"][c], color=COLOURS[j], linewidth=1.4)
            right.set(xlabel="time (s)", ylabel="|residual|", xlim=(t[0] - 1, t[-1]))
            for one in (left, right):
                grey(one, GOVERNOR.fault.onset, detected)
        legend_above(figure)
        return figure

    seen = float(trace["deterministic"][0])
    crossed = f"crossed at {seen:g} s" if np.isfinite(seen) else "never crossed"
    return Figure(
        "residuals",
        f"Residuals and thresholds of area {GOVERNOR.fault.area} (as Fig. 4)",
        f"One run. Dashed: residuals of angle {{1}}, speed {{2}}, mechanical power and valve {{3, 4}}; solid: thresholds, left "
        f"stochastic (until the area is unplugged), right by the bound {BOUND}, {crossed} in the run without unplugging. Grey: "
        f"from fault to detection at {detected:g} s.",
        draw,
        "Six panels: residuals leave the stochastic thresholds soon after the fault and stay far below the deterministic ones",
    )


def area_residuals(trace: Arrays) -> Figure:
    """Fig. 5, of the first run of network/sign-flip."""
    detected = float(trace["detected"][0, 1])

    def draw() -> Drawing:
        groups = ((0,), (1,), (2, 3))
        figure, axes = panels(["{1}: angle", "{2}: speed", "{3, 4}: mechanical power, valve"], columns=1, width=9.0, height=2.2)
        for one, group in zip(axes, groups, strict=True):
            residuals(one, trace, group)
            grey(one, SIGN_FLIP.fault.onset, detected)
        legend_above(figure)
        return figure

    return Figure(
        "residuals",
        f"Residuals and thresholds of area {SIGN_FLIP.fault.area} (as Fig. 5)",
        f"One run. Dashed: residuals; solid: thresholds. Grey: from the fault at {SIGN_FLIP.fault.onset:g} s to its detection "
        f"at {detected:g} s. Once the fault is isolated, at {trace['answered'][0]:g} s, the model of the diagnosers has the "
        "isolated gain of the input.",
        draw,
        "Three panels: after the flip the residuals of mechanical power and valve leave their thresholds until the isolation",
    )


def reconfigured_operation(trace: Arrays) -> list[Figure]:
    """Figs. 6 and 7, of the first run of network/sign-flip."""
    until = float(trace["answered"][0])
    names = [str(i) for i in range(1, 6)]

    def figure(name: str, title: str, key: str, label: str, alt: str) -> Figure:
        def draw() -> Drawing:
            drawn, axes = panels(["reconfigured", "not reconfigured"], columns=1, width=9.6, height=2.6)
            for one, values in zip(axes, (trace[key], trace[f"alone_{key}"]), strict=True):
                waves(one, trace["t"], values[:, :5], names, label, trace["load"][:, :5] if key == "reached" else None)
                grey(one, SIGN_FLIP.fault.onset, until)
                legend_beside(one)
            return drawn

        loads = "; references as they reach the areas, dashed: loads" if key == "reached" else ""
        return Figure(
            name, title,
            f"One run, areas 1 to 5{loads}. Grey: from the fault to the reconfiguration of area {SIGN_FLIP.fault.area} at "
            f"{until:g} s. Below: the same run without isolation.",
            draw, alt,
        )  # fmt: skip

    return [
        figure("references", "References with and without reconfiguration (as Fig. 6)", "reached", "reference (per unit)",
               "References of five areas; without reconfiguration, that of area 5 diverges from its load"),
        figure("speeds", "Speeds with and without reconfiguration (as Fig. 7)", "speeds", "speed (rad/s)",
               "Speeds of five areas around zero"),
    ]  # fmt: skip
