"""The published numbers of K24's Fig. 5 and Table VI for engine/noise, and its figures."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawing

from fusion_sfdia.benchmarks.engine.support.trials import NAMES
from fusion_sfdia.common.run_statistics import Estimate
from fusion_sfdia.models.marine_engine.plant import SENSORS
from fusion_sfdia.models.marine_engine.published import DELAYS, DELAYS_SOURCE, K24
from fusion_sfdia.report.content import Figure
from fusion_sfdia.report.plots import COLOURS, legend_above, panels
from fusion_sfdia.report.results import MORE_THAN, Published, Row
from fusion_sfdia.report.scenario_sentences import pick
from fusion_sfdia.study.diagnosis_metrics import Response

FAULTS = {"S(1){1}": 0.07, "S(2){3}": 0.65}  # share of the sensor's nominal value (K24, sec. VII)
OWN, AGENTS, OTHERS = "own module", "other agents", "other modules"
GROUPS = {OWN: "local", OTHERS: "neighbours"}  # as in DELAYS: Table VI is of all modules but the own, (21) of other agents
MISSED = ("S(2){3}", (0.06, 0.07))  # by its own module in every run, by the text on Fig. 5(b)

ISOLATION = {
    "isolation_performance_percent": "isolation performance P^U",
    "exoneration_performance_percent": "exoneration performance P^E",
}

Found = dict[tuple[str, str, float], Response]
TITLES = [f"({letter}) {sensor} +{size:.0%}" for letter, (sensor, size) in zip("ab", FAULTS.items(), strict=True)]


def condition(level: float) -> str:
    """The condition of a row: the noise level, as a share of the nominal values."""
    return f"noise {level:.0%}"


def modules_of(sensor: str, group: str) -> list[int]:
    """The modules whose silence counts: of the sensor itself, of all other agents, all but its own."""
    own = NAMES[list(SENSORS).index(sensor)]
    counted = {OWN: lambda n: n == own, AGENTS: lambda n: n[:3] != own[:3], OTHERS: lambda n: n != own}
    return [i for i, name in enumerate(NAMES) if counted[group](name)]


def published(sensor: str, group: str, level: float, metric: str) -> Published | None:
    """The value that K24 states for a fault at a noise level, or None. A delay is stated where no run misses the fault."""
    if metric == "missed_detection_rate":
        if group == OWN and sensor == MISSED[0] and level in MISSED[1]:
            return Published(1.0, f"{K24}, sec. VII on Fig. 5(b)")
        stated = DELAYS[sensor][GROUPS[OWN if group == OWN else OTHERS]].get(level)
        return None if stated is None or stated.mean is None else Published(0.0, f"{DELAYS_SOURCE}: a delay is stated")
    stated = DELAYS[sensor][GROUPS[group]].get(level) if group in GROUPS else None
    place = ("detection_delay", "detection_delay_shortest", "detection_delay_longest").index(metric)
    if stated is None or (value := stated[place]) is None:
        return None
    return Published(value, DELAYS_SOURCE + MORE_THAN * (stated.mean is None))


def missed_figure(levels: list[float], found: Found) -> Figure:
    """Missed-detection rates, (20) and (21)."""

    def draw() -> Drawing:
        figure, axes = panels(TITLES, height=3.0)
        for panel, sensor in zip(axes, FAULTS, strict=True):
            for i, group in enumerate((OWN, AGENTS)):
                rates = [found[sensor, group, level].missed for level in levels]
                _line(panel, i, [100 * level for level in levels], rates, group)
            stated = {level: p.value for level in levels if (p := published(sensor, OWN, level, "missed_detection_rate"))}
            _diamonds(panel, stated, "published, own module")
            panel.set(xlabel="noise (% of the nominal values)", ylabel="missed-detection rate", ylim=(-0.05, 1.05))
        legend_above(figure)
        return figure

    return Figure(
        "missed",
        "Missed detections by noise level (K24, Fig. 5)",
        "Share of runs in which the faulty sensor's own module, and all modules of the other agents, stay silent after the "
        "onset. Shaded: Wilson's 95 % interval. Diamonds: values stated in Table VI and its text for the own module.",
        draw,
        "Curves of the missed-detection rate over the noise level for two faults, by the own module and by other agents",
    )


def delay_figure(levels: list[float], found: Found) -> Figure:
    """Delays, (22), as in Table VI."""

    def draw() -> Drawing:
        figure, axes = panels(TITLES, height=3.0)
        for panel, sensor in zip(axes, FAULTS, strict=True):
            for i, group in enumerate((OWN, OTHERS)):
                seen = [(100 * level, r) for level in levels if (r := found[sensor, group, level]).delay.n]
                x, mean = [s[0] + (-0.08, 0.08)[i] for s in seen], np.array([s[1].delay.value for s in seen])
                reach = np.abs(np.array([[s[1].shortest for s in seen], [s[1].longest for s in seen]]) - mean)
                panel.errorbar(x, mean, reach, color=COLOURS[i], marker="os"[i], markersize=4, capsize=3, lw=1, label=group)
                stated = {level: p.value for level in levels if (p := published(sensor, group, level, "detection_delay"))}
                _diamonds(panel, stated, "published")
            panel.set_yscale("symlog", linthresh=0.01)
            panel.set_ylim(-0.002, 200)
            panel.yaxis.set_major_formatter("{x:g}")
            panel.set(xlabel="noise (% of the nominal values)", ylabel="detection delay (s)")
        legend_above(figure)
        return figure

    return Figure(
        "delays",
        "Detection delays by noise level (K24, Table VI)",
        "Mean over the runs that detect the fault; bars from the shortest to the longest. Diamonds: published means.",
        draw,
        "Mean detection delays over the noise level for two faults, by the own module and by the first of the others",
    )


def isolation_figure(levels: list[float], rows: list[Row]) -> Figure:
    """P^U and P^E."""

    def draw() -> Drawing:
        figure, axes = panels(TITLES, height=3.0)
        for panel, (sensor, size) in zip(axes, FAULTS.items(), strict=True):
            for i, (metric, label) in enumerate(ISOLATION.items()):
                of = {r.condition: r for r in pick(rows, fault=f"{sensor} +{size:.0%}", metric=metric)}
                found = [of[condition(level)] for level in levels if condition(level) in of]
                _line(panel, i, [100 * level for level in levels if condition(level) in of], found, label)
            panel.set(xlabel="noise (% of the nominal values)", ylabel="performance (%)", ylim=(-5, 105))
        legend_above(figure)
        return figure

    return Figure(
        "isolation",
        "Isolation and exoneration by noise level (K24, (25) and (26))",
        "Means over the runs with an alarm, from the first alarm on: P^U falls as healthy sensors are isolated with the "
        "faulty one, P^E as few sensors are exonerated. Shaded: 95 % interval of the mean.",
        draw,
        "Curves of isolation and exoneration performance over the noise level for two faults",
    )


def _line(axes: Axes, i: int, x: Sequence[float], values: Sequence[Estimate | Row], label: str) -> None:
    """The i-th of two lines with its 95 % intervals shaded."""
    axes.plot(x, [v.value for v in values], f"{'os'[i]}{('-', '-.')[i]}", color=COLOURS[i], ms=4, label=label)
    axes.fill_between(x, [v.low for v in values], [v.high for v in values], color=COLOURS[i], alpha=0.15)


def _diamonds(axes: Axes, stated: dict[float, float], label: str) -> None:
    if stated:
        x = [100 * level for level in stated]
        axes.plot(x, list(stated.values()), linestyle="none", marker="D", markersize=5, mfc="none", mec="black", label=label)
