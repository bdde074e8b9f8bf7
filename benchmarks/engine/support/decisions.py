"""Rows, figures and sentences of engine runs with several faulty sensors: modules that fire, and isolated sensors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np
from matplotlib.figure import Figure as Drawing
from matplotlib.lines import Line2D

from fusion_sfdia.benchmarks.engine.support.trials import NAMES, Array, Timeline, engine, row
from fusion_sfdia.common.run_statistics import Estimate, mean_over_runs, proportion
from fusion_sfdia.detectors.adaptive_thresholds.adaptive_threshold import AdaptiveThreshold
from fusion_sfdia.models.marine_engine.published import Experiment
from fusion_sfdia.report.content import Figure, ResultTable
from fusion_sfdia.report.plots import COLOURS, Bars, bars, legend_above, panels
from fusion_sfdia.report.results import Published, Row
from fusion_sfdia.report.scenario_sentences import pick, span
from fusion_sfdia.study.diagnosis_metrics import exoneration_performance, isolation_performance
from fusion_sfdia.study.experiments.scenario import Arrays

UNITS = {s.name: s.unit for s in engine(0.05, "K24").sensors}


def module_rows(scenario: str, detector: str, fault: str, arrays: Arrays, experiment: Experiment) -> list[Row]:
    """Of each module: share of runs in which it fires, mean time of its first alarm, and false alarms before any fault."""
    rows = []
    onset = min(f.onset for f in experiment.faults)
    for j, name in enumerate(NAMES):
        first = arrays["first"][:, j]
        fired = np.isfinite(first)
        at = partial(row, scenario, detector, fault, name)
        early = int((arrays["healthy"][:, j] > 1).sum())
        rows += [
            at("fired_share", proportion(int(fired.sum()), fired.size)),
            at("first_alarm_time", mean_over_runs(np.where(fired, first, 0.0), fired), experiment.first_alarm(name)),
            at("false_alarm_share", proportion(early, fired.size)),
            at("largest_healthy_score", _largest(arrays["healthy"][:, j])),
        ]
    early = int((arrays["first"] < onset).any(axis=-1).sum())
    return [*rows, row(scenario, detector, fault, "all", "false_alarm_share", proportion(early, len(arrays["first"])))]


def _largest(score: Array) -> Estimate:
    return Estimate(float(score.max()), float("nan"), float("nan"), score.size)


def isolation_rows(
    scenario: str,
    detector: str,
    fault: str,
    lines: Timeline,
    *,
    published: tuple[Published | None, Published | None] = (None, None),
    condition: str = "",
) -> list[Row]:
    """P^U and P^E, (25) and (26); at the end of a run: whether S^F contains all faulty sensors, its size, explained."""
    alarm = np.asarray(lines.decisions.any(axis=-1))
    logic = AdaptiveThreshold(engine(0.05, "K24")).logic
    isolated, faulty, runs = lines.isolated[-1], lines.active[-1], lines.isolated.shape[1]
    at = partial(row, scenario, detector, fault, "all", condition=condition)
    return [
        at(
            "isolation_performance_percent",
            _percent(isolation_performance(lines.t, lines.isolated, lines.active, alarm)),
            published[0],
        ),
        at("exoneration_performance_percent", _percent(exoneration_performance(lines.t, lines.isolated, alarm)), published[1]),
        at("faults_isolated_share", proportion(int((isolated | ~faulty).all(axis=-1).sum()), runs)),
        at("isolated_sensors", mean_over_runs(isolated.sum(axis=-1), np.ones(runs))),
        at("explained_share", proportion(int(logic.explained(lines.decisions[-1]).sum()), runs)),
    ]


def _percent(e: Estimate) -> Estimate:
    return Estimate(100 * e.value, 100 * e.low, 100 * e.high, e.n)


def pattern_share(first: Array, experiment: Experiment, without: tuple[str, ...] = ()) -> Estimate:
    """Share of runs in which exactly the modules of the paper's figure fire; some modules may be left out."""
    compared = [j for j, name in enumerate(NAMES) if name not in without]
    expected = np.array([name in experiment.fired for name in NAMES])
    same = (np.isfinite(first) == expected)[:, compared].all(axis=-1)
    return proportion(int(same.sum()), same.size)


def draw_modules(
    trace: Array, first: Array, experiment: Experiment, mark: str = "a fault begins (thick: in this module's sensor)"
) -> Drawing:
    """The papers' figure: one row per agent, one panel per module, with residual, thresholds and decision of one run.

    trace (3, K, M) as in `trials.module_scores`; first (M,) s; mark: what the vertical lines at the onsets of `experiment` are.
    """
    agents = [[name for name in NAMES if name[2] == agent] for agent in "1234"]
    figure, axes = panels([""] * 12, columns=3, width=11.0, height=2.1)
    for r, members in enumerate(agents):
        for c in range(3):
            axis = axes[3 * r + c]
            if c >= len(members):
                axis.remove()
                continue
            j = NAMES.index(members[c])
            sensor = engine(0.05, "K24").sensors[j]
            t, residual, threshold = trace[..., j]
            axis.set_title(f"{members[c]}  {sensor.measures}", fontsize=9, loc="left")
            axis.plot(t, residual, color=COLOURS[0], linewidth=0.5)
            for sign, colour in ((1, COLOURS[2]), (-1, COLOURS[3])):
                axis.plot(t, sign * threshold, color=colour, linewidth=1)
            settled = threshold[(t > 0.05 * experiment.duration) & np.isfinite(threshold)]
            reach = 1.25 * max(float(settled.max(initial=0.0)), float(np.abs(residual).max()))
            axis.set_ylim(-reach, reach)
            axis.set_ylabel(sensor.unit, fontsize=8)
            axis.ticklabel_format(axis="y", style="sci", scilimits=(-2, 4))
            for fault in experiment.faults:
                own = fault.sensor == sensor.name
                axis.axvline(fault.onset, color="black", linestyle=":", linewidth=1.6 if own else 0.5)
            decision = axis.twinx()
            decision.plot(*_decision(float(first[j]), experiment.duration), color=COLOURS[1], linestyle="-.", linewidth=1.4)
            decision.set(ylim=(-1.25, 1.25), yticks=[0, 1])
            decision.grid(visible=False)
            decision.spines["right"].set_visible(True)
            text = "silent" if np.isinf(first[j]) else f"{first[j]:.2f} s"
            if experiment.fired:
                text += f" ({experiment.fired[members[c]]:g} s)" if members[c] in experiment.fired else " (silent)"
            axis.set_title(text, fontsize=8, loc="right")
            axis.set_xlim(0, experiment.duration)
            if r == len(agents) - 1:
                axis.set_xlabel("time (s)")
    entries = {
        "residual": Line2D([], [], color=COLOURS[0], linewidth=1),
        "upper threshold": Line2D([], [], color=COLOURS[2]),
        "lower threshold": Line2D([], [], color=COLOURS[3]),
        "decision": Line2D([], [], color=COLOURS[1], linestyle="-."),
        mark: Line2D([], [], color="black", linestyle=":"),
    }
    figure.legend(list(entries.values()), list(entries), loc="outside upper center", ncols=len(entries), fontsize=8)
    return figure


def _decision(first: float, duration: float) -> tuple[list[float], list[float]]:
    if np.isinf(first):
        return [0.0, duration], [0.0, 0.0]
    return [0.0, first, first, duration], [0.0, 0.0, 1.0, 1.0]


def draw_shares(firsts: dict[str, Array], experiment: Experiment) -> Drawing:
    """Share of runs in which each module fires, a bar for each detector; diamonds: the paper's single run."""
    figure, (axis,) = panels(["share of runs in which the module fires"], columns=1, width=12.0, height=3.0)
    theirs = [float(name in experiment.fired) for name in NAMES]
    series = []
    for i, (detector, first) in enumerate(firsts.items()):
        found = [proportion(int(np.isfinite(first[:, j]).sum()), len(first)) for j in range(len(NAMES))]
        shown = theirs if i == len(firsts) // 2 else [float("nan")] * len(NAMES)
        series.append(Bars(detector, [e.value for e in found], [e.low for e in found], [e.high for e in found], shown))
    bars(axis, NAMES, series, ylabel="share of runs")
    axis.set_ylim(0, 1.05)
    legend_above(figure)
    return figure


def module_figures(found: Mapping[str, Arrays], experiment: Experiment, what: str) -> list[Figure]:
    """The shares of all detectors, and the papers' figure of the first run of each."""
    shares = Figure(
        "modules",
        f"Which modules fire, {what}",
        "Share of runs in which each module fires at some time, with its 95 % interval; diamonds: 1 where the module fires in "
        "the one run that the paper shows, 0 where it is silent.",
        partial(draw_shares, {d: a["first"] for d, a in found.items()}, experiment),
        "Bars of the share of runs in which each of ten modules fires, one colour per detector",
    )
    runs = [
        Figure(
            detector.partition(":")[2] or "valid",
            f"{what}: residuals, thresholds and decisions, {detector}",
            "One run, as in the paper with one row per agent and one panel per module: residual in the sensor's unit, its two "
            "thresholds and the latched decision. Of each 0.1 s the samples nearest to either threshold are drawn. Right of a "
            "title: first alarm here (in the paper).",
            partial(draw_modules, arrays["trace"], arrays["first"][0], experiment),
            "Ten panels, one per monitoring module, with its residual, adaptive thresholds and decision over time",
        )
        for detector, arrays in found.items()
    ]
    return [shares, *runs]


def value_of(rows: list[Row], **expected: str) -> str:
    """The value of the rows with such columns, as text."""
    return span(r.value for r in pick(rows, **expected))


def shares(rows: list[Row], **expected: str) -> str:
    """The shares of runs of each detector, as text."""
    return "; ".join(f"{r.detector} {r.value:.0%}" for r in pick(rows, **expected)) or "unknown"


def differences(rows: list[Row], detector: str, experiment: Experiment, figure: str) -> str:
    """A sentence on the modules that fire in most runs but are silent in the paper's figure, and the other way round."""
    share = {r.quantity: r.value for r in pick(rows, metric="fired_share", detector=detector)}
    when = {r.quantity: r.value for r in pick(rows, metric="first_alarm_time", detector=detector)}
    loud = ", ".join(f"{m} ({when[m]:.1f} s)" for m in NAMES if m not in experiment.fired and share.get(m, 0) > 0.5)
    quiet = ", ".join(f"{m} ({share[m]:.0%})" for m in experiment.fired if share.get(m, 1) <= 0.5)
    return (
        f"{detector}: modules that fire in most runs but are silent in {figure}: {loud or 'none'}. Modules that fire in at "
        f"most half of the runs but alarm in {figure}: {quiet or 'none'}."
    )


def alarms_table(rows: list[Row], experiment: Experiment, detectors: Sequence[str]) -> ResultTable:
    """First alarm of each module in each detector, compared with the paper."""
    cells = {(r.detector, r.quantity, r.metric): r.value for r in rows if r.metric in ("fired_share", "first_alarm_time")}

    def shown(detector: str, name: str) -> str:
        share, when = (cells[detector, name, metric] for metric in ("fired_share", "first_alarm_time"))
        return "silent" if share == 0 else f"{when:.2f} s in {share:.0%}"

    return ResultTable(
        "First alarm of each module: mean over the runs in which it fires, and their share",
        ("module", *detectors, "paper, one run"),
        tuple(
            (
                name,
                *(shown(d, name) for d in detectors),
                f"{experiment.fired[name]:g} s" if name in experiment.fired else "silent",
            )
            for name in NAMES
        ),
    )
