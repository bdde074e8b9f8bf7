"""The figures, the table and the sentences of network/consensus, all from its rows by measured variance."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure as Drawing

from fusion_sfdia.models.power_network.model import PROCESS_VARIANCE
from fusion_sfdia.report.content import Figure, ResultTable
from fusion_sfdia.report.plots import COLOURS, Bars, bars, legend_above, panels
from fusion_sfdia.report.results import Row
from fusion_sfdia.report.scenario_sentences import span

ALONE = "alone"
WEIGHTS = ("corrected", "paper")  # modes of consensus: (17) as it should be and as printed
READINGS = ("equal", "unequal")
COPIES = ("its area", "a neighbour")
SHARERS = (2, 3, 4)
RATIO = "residual_variance_ratio"
LABELS = {
    "process": "process noise",
    "drive": "drive",
    "readings": "readings that are averaged",
    "own": "reading that is evaluated",
}
Parts = Mapping[tuple[str, float], Mapping[int, Mapping[str, Mapping[str, float]]]]  # {(noise, memory): {sharers: {weights: ...


class SharedCopies(NamedTuple):
    """Copies of the angles that `sharers` areas share, read by one of COPIES, with weights ALONE or one of WEIGHTS."""

    noise: str
    readings: str
    memory: float
    sharers: int
    copy: str
    weights: str


class Variance(NamedTuple):
    """The key of a row: a metric of a case."""

    metric: str
    of: SharedCopies

    @property
    def quantity(self) -> str:
        """The quantity of the row."""
        return f"theta, {self.of.sharers} sharers, read by {self.of.copy}"

    @property
    def condition(self) -> str:
        """The condition of the row."""
        return f"{self.of.readings} readings, memory {self.of.memory:g}, {self.of.noise}" + ", alone" * (
            self.of.weights == ALONE
        )


Rows = Mapping[Variance, Row]


def ratio_figure(rows: Rows) -> Figure:
    """Variance with consensus over variance without, compared with theory and (15)."""
    cases = [(noise, lam) for noise in PROCESS_VARIANCE for lam in (0.0, 0.3)]

    def draw() -> Drawing:
        figure, axes = panels([f"process noise '{n}', memory {m:g}" for n, m in cases], height=2.5, width=8.0)
        for panel, (noise, lam) in zip(axes, cases, strict=True):
            series = []
            for label, metric in (("measured", RATIO), ("theory", f"{RATIO}_theory")):
                keys = [Variance(metric, SharedCopies(noise, "equal", lam, s, COPIES[0], "corrected")) for s in SHARERS]
                found = [_one(rows, key) for key in keys]
                series.append(Bars(label, *_limits(found), [np.nan] * 3))
            bars(panel, [f"{s} sharers" for s in SHARERS], series, ylabel="variance over that alone")
            panel.plot(range(3), [1 / 2, 1 / 3, 1 / 4], "D", mfc="white", mec="black", ms=4.5, label="(15): 1 / sharers")
            panel.set_ylim(0, 1.1)
        legend_above(figure)
        return figure

    equal = _ratios(rows, readings="equal", weights="corrected").values()
    return Figure(
        "ratio",
        "Variance of the angles' residuals with consensus over that without",
        f"All areas read an angle equally precisely. Consensus leaves {span(r.value for r in equal)} of the variance, where "
        "(15) states 1/2 to 1/4. Whiskers: 95 % intervals over runs, with and without consensus on the same readings.",
        draw,
        "Bars of measured and theoretical variance ratios by number of sharers for two process noises and two memories, with "
        "the much lower values of (15) as diamonds",
    )


def parts_figure(kinds: Parts) -> Figure:
    """Contributions to the variance."""

    def draw() -> Drawing:
        figure, axes = panels([f"process noise '{noise}', memory {lam:g}" for noise, lam in kinds], height=2.5, width=8.0)
        for panel, of_case in zip(axes, kinds.values(), strict=True):
            groups = [(s, w) for s in of_case for w in of_case[s]]
            base = np.zeros(len(groups))
            for i, (part, label) in enumerate(LABELS.items()):
                height = np.array([of_case[s][w][part] for s, w in groups]) * 1e4
                panel.bar(range(len(groups)), height, 0.7, base, color=COLOURS[i], label=label)
                base += height
            labels = [f"{s},\n{'alone' if w == ALONE else 'agreed'}" for s, w in groups]
            panel.set_xticks(range(len(groups)), labels, fontsize=7)
            panel.grid(visible=False, axis="x")
            panel.set_ylabel("variance (10⁻⁴ rad²)")
        legend_above(figure)
        return figure

    shares = [p[ALONE]["readings"] / sum(p[ALONE].values()) for k in kinds.values() for p in k.values()]
    return Figure(
        "parts",
        "Contributions to the variance of an angle's residual",
        "By theory, for an angle that 2, 3 or 4 areas share, each using its own reading or all agreed. Consensus averages "
        f"one of four parts, {span(shares)} of the whole without it. The process noise and the error of the drive are "
        "common to all sharers, and the reading that is evaluated is the area's own.",
        draw,
        "Stacked bars of four parts of the residual's variance with and without consensus",
    )


def unequal_figure(rows: Rows) -> Figure:
    """Both weights for less precise readings of the neighbours."""
    cases = [(noise, copy) for noise in PROCESS_VARIANCE for copy in COPIES]

    def draw() -> Drawing:
        figure, axes = panels([f"process noise '{n}', read by {c}" for n, c in cases], height=2.5, width=8.0)
        for panel, (noise, copy) in zip(axes, cases, strict=True):
            series = []
            for label, weights in (("(17) corrected", "corrected"), ("(17) as printed", "paper")):
                keys = [Variance(RATIO, SharedCopies(noise, "unequal", 0.0, s, copy, weights)) for s in SHARERS]
                found = [_one(rows, key) for key in keys]
                series.append(Bars(label, *_limits(found), [np.nan] * 3))
            bars(panel, [f"{s} sharers" for s in SHARERS], series, ylabel="variance over that alone")
            panel.axhline(1.0, color="black", lw=1, ls="--", label="alone")
        legend_above(figure)
        return figure

    of_area = {"readings": "unequal", "memory": 0.0, "copy": COPIES[0]}
    printed, right = (_ratios(rows, **of_area, weights=w).values() for w in ("paper", "corrected"))
    return Figure(
        "weights",
        "Weights (17) for less precise readings of the neighbours",
        f"Variance over that alone, memory 0. The area that reads its angle best has {span(r.value for r in printed)} by the "
        "printed weights, which count errors common to all as if they were independent and so mask the more precise reading; "
        f"{span(r.value for r in right)} by the corrected ones. Whiskers: 95 % intervals.",
        draw,
        "Bars of variance ratios by number of sharers for corrected and printed weights, for the area itself and a neighbour",
    )


def table(rows: Rows) -> ResultTable:
    """Measured ratios compared with theory."""
    lines = []
    for key, r in _ratios(rows).items():
        expected = _one(rows, key._replace(metric=f"{RATIO}_theory"))
        stated = "" if r.published is None else f"{r.published:.3g}"
        lines.append(
            (
                r.detector,
                r.quantity,
                r.condition,
                f"{r.value:.4f}",
                f"{r.low:.4f} to {r.high:.4f}",
                f"{expected.value:.4f}" if expected else "",
                stated,
            )
        )
    return ResultTable(
        "Variance of the angles' residuals over that without consensus",
        ("weights", "copies", "condition", "measured", "95 % interval", "theory", "(15) as printed"),
        tuple(lines),
    )


def remarks(rows: Rows) -> list[str]:
    """How much variance consensus removes, the first for the top of the report."""
    inside = outside = 0
    for key, r in rows.items():
        expected = _one(rows, key._replace(metric=f"{key.metric}_theory"))
        if expected is not None and np.isfinite(r.low):
            good = r.low <= expected.value <= r.high
            inside, outside = inside + good, outside + (not good)
    removed = {
        n: [1 - r.value for r in _ratios(rows, noise=n, readings="equal", weights="paper").values()] for n in PROCESS_VARIANCE
    }
    lost = [r for r in _ratios(rows).values() if r.low > 1]
    worst = {d: span(r.value for r in lost if r.detector == d) for d in sorted({r.detector for r in lost})}
    return [
        "Consensus on shared angles removes "
        + ", ".join(f"{span(100 * v for v in values)} % ('{n}')" for n, values in removed.items())
        + " of the variance of their residuals; (15) as printed states 50 to 75 %. It lowers the variance, but not by the "
        "number of sharers, and thresholds lowered by the root of that number cause false alarms.",
        f"Theory, Var e = (Var drive + Var w + (a - lam)^2 Var r_bar) / (1 - lam^2) + sigma_i^2, is within {inside} of "
        f"{inside + outside} intervals of 95 %.",
        "With equally precise readings both weights are 1 / sharers. Otherwise consensus can raise the "
        "variance over that alone: " + ("; ".join(f"{d} to {v} times" for d, v in worst.items()) or "nowhere here") + ".",
    ]


def _one(rows: Rows, key: Variance) -> Row | None:
    return rows[key] if key in rows and math.isfinite(rows[key].value) else None


def _ratios(rows: Rows, **expected: object) -> dict[Variance, Row]:
    """Finite variance ratios of the cases with these entries."""
    return {
        key: r
        for key, r in rows.items()
        if key.metric == RATIO and math.isfinite(r.value)
        and all(getattr(key.of, name) == value for name, value in expected.items())
    }  # fmt: skip


def _limits(found: Sequence[Row | None]) -> tuple[list[float], list[float], list[float]]:
    value, low, high = ([np.nan if r is None else float(getattr(r, c)) for r in found] for c in ("value", "low", "high"))
    return value, low, high
