"""The figures, the table and the sentences of network/consensus."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure as Drawing

from fusion_sfdia.evaluation.results import Row
from fusion_sfdia.models.power_network.model import PROCESS_VARIANCE
from fusion_sfdia.report.content import Figure, Table
from fusion_sfdia.report.findings import pick, span
from fusion_sfdia.report.plots import COLOURS, Bars, bars, legend_above, panels

ALONE = "alone"
WEIGHTS = ("corrected", "paper")  # modes of consensus: (17) as it should be and as printed
READINGS = ("equal", "unequal")
COPIES = ("its area", "a neighbour")
SHARERS = ("2 sharers", "3 sharers", "4 sharers")
LABELS = {
    "process": "noise of the process",
    "drive": "drive",
    "readings": "readings that are averaged",
    "own": "reading that is judged",
}
Parts = Mapping[str, Mapping[str, Mapping[str, Mapping[str, float]]]]  # of variances by case, sharers, weights, source


def ratio_figure(rows: Sequence[Row]) -> Figure:
    """Variance with consensus over variance without, beside theory and what (15) says."""
    cases = [(noise, lam) for noise in PROCESS_VARIANCE for lam in ("0", "0.3")]

    def draw() -> Drawing:
        figure, axes = panels([f"process noise '{n}', memory {m}" for n, m in cases], height=2.5, width=8.0)
        for panel, (noise, lam) in zip(axes, cases, strict=True):
            series = []
            for label, metric in (("measured", "residual_variance_ratio"), ("theory", "residual_variance_ratio_theory")):
                found = [
                    _one(rows, metric, f"theta, {s}, read by its area, equal readings, memory {lam}, {noise}") for s in SHARERS
                ]
                series.append(Bars(label, *_limits(found), [np.nan] * 3))
            bars(panel, SHARERS, series, ylabel="variance over that alone")
            panel.plot(range(3), [1 / 2, 1 / 3, 1 / 4], "D", mfc="white", mec="black", ms=4.5, label="(15): 1 / sharers")
            panel.set_ylim(0, 1.1)
        legend_above(figure)
        return figure

    found = pick(rows, metric="residual_variance_ratio", detector="chebyshev:corrected")
    equal = [r for r in found if "unequal" not in r.quantity]
    return Figure(
        "ratio",
        "Variance of the angles' residuals with consensus over that without",
        f"All read an angle equally well. Consensus leaves {span(r.value for r in equal)} of the variance, where (15) counts "
        " 1/2 to 1/4. Whiskers: 95 % intervals over runs, with and without on the same readings.",
        draw,
        "Bars of measured and reckoned variance ratios by number of sharers for two process noises and two memories, with the "
        "much lower values of (15) as diamonds",
    )


def parts_figure(kinds: Parts) -> Figure:
    """Where the variance comes from."""

    def draw() -> Drawing:
        figure, axes = panels([f"process noise '{k.split(',')[0]}',{k.split(',')[1]}" for k in kinds], height=2.5, width=8.0)
        for panel, of_case in zip(axes, kinds.values(), strict=True):
            groups = [(s, w) for s in of_case for w in of_case[s]]
            base = np.zeros(len(groups))
            for i, (part, label) in enumerate(LABELS.items()):
                height = np.array([of_case[s][w][part] for s, w in groups]) * 1e4
                panel.bar(range(len(groups)), height, 0.7, base, color=COLOURS[i], label=label)
                base += height
            named = [f"{s.split()[0]},\n{'alone' if w == ALONE else 'agreed'}" for s, w in groups]
            panel.set_xticks(range(len(groups)), named, fontsize=7)
            panel.grid(visible=False, axis="x")
            panel.set_ylabel("variance ($10^{-4}$ rad$^2$)")
        legend_above(figure)
        return figure

    shares = [p[ALONE]["readings"] / sum(p[ALONE].values()) for k in kinds.values() for p in k.values()]
    return Figure(
        "parts",
        "Where the variance of an angle's residual comes from",
        "By theory, for an angle that 2, 3 or 4 areas share, each using its own reading or all agreed. Consensus averages "
        f"one of four parts, {span(shares)} of the whole without it; the noise of the process and the drive's error are the "
        "same for all who share, and the reading that is judged is nobody else's.",
        draw,
        "Stacked bars of four parts of the residual's variance with and without consensus",
    )


def unequal_figure(rows: Sequence[Row]) -> Figure:
    """Both weights where neighbours read worse."""
    cases = [(noise, copy) for noise in PROCESS_VARIANCE for copy in COPIES]

    def draw() -> Drawing:
        figure, axes = panels([f"process noise '{n}', read by {c}" for n, c in cases], height=2.5, width=8.0)
        for panel, (noise, copy) in zip(axes, cases, strict=True):
            series = []
            for label, detector in (("(17) corrected", "chebyshev:corrected"), ("(17) as printed", "chebyshev:paper")):
                where = [f"theta, {s}, read by {copy}, unequal readings, memory 0, {noise}" for s in SHARERS]
                found = [_one(rows, "residual_variance_ratio", w, detector) for w in where]
                series.append(Bars(label, *_limits(found), [np.nan] * 3))
            bars(panel, SHARERS, series, ylabel="variance over that alone")
            panel.axhline(1.0, color="black", lw=1, ls="--", label="alone")
        legend_above(figure)
        return figure

    found = [r for r in pick(rows, metric="residual_variance_ratio") if "unequal readings, memory 0," in r.quantity]
    area = [r for r in found if "its area" in r.quantity and r.detector == "chebyshev:paper"]
    right = [r for r in found if "its area" in r.quantity and r.detector == "chebyshev:corrected"]
    return Figure(
        "weights",
        "Weights (17) where neighbours read worse",
        f"Variance over that alone, memory 0. The area that reads its angle best has {span(r.value for r in area)} by the "
        "printed weights, which count what is common to all as if it were each one's own and so hide who reads well; "
        f"{span(r.value for r in right)} by the corrected ones. Whiskers: 95 % intervals.",
        draw,
        "Bars of variance ratios by number of sharers for corrected and printed weights, for the area itself and a neighbour",
    )


def table(rows: Sequence[Row]) -> Table:
    """Measured beside theory."""
    lines = []
    for r in pick(rows, metric="residual_variance_ratio"):
        expected = _one(rows, "residual_variance_ratio_theory", r.quantity, r.detector)
        stated = "" if r.published is None else f"{r.published:.3g}"
        lines.append(
            (
                r.detector,
                r.quantity,
                f"{r.value:.4f}",
                f"{r.low:.4f} to {r.high:.4f}",
                f"{expected.value:.4f}" if expected else "",
                stated,
            )
        )
    return Table(
        "Variance of the angles' residuals over that without consensus",
        ("weights", "copies", "measured", "95 % interval", "theory", "(15) as printed"),
        tuple(lines),
    )


def remarks(rows: Sequence[Row]) -> list[str]:
    """What consensus saves and what it cannot, the first for the top of the report."""
    equal = [r for r in pick(rows, metric="residual_variance_ratio", detector="chebyshev:paper") if "unequal" not in r.quantity]
    inside = outside = 0
    for r in pick(rows, metric=("residual_variance_ratio", "residual_variance")):
        expected = _one(rows, f"{r.metric}_theory", r.quantity, r.detector)
        if expected is not None and np.isfinite(r.low):
            good = r.low <= expected.value <= r.high
            inside, outside = inside + good, outside + (not good)
    saved = {n: [1 - r.value for r in equal if r.quantity.endswith(n)] for n in PROCESS_VARIANCE}
    lost = [r for r in pick(rows, metric="residual_variance_ratio") if r.low > 1]
    worst = {d: span(r.value for r in lost if r.detector == d) for d in sorted({r.detector for r in lost})}
    return [
        "Consensus on shared angles takes "
        + ", ".join(f"{span(100 * v for v in values)} % ('{n}')" for n, values in saved.items())
        + " off the variance of their residuals; (15) as printed counts 50 to 75 %. That it lowers the variance holds; that it "
        "lowers the threshold by the root of the sharers' number does not, and the thresholds so lowered alarm falsely.",
        f"Theory, Var e = (Var drive + Var w + (a - lam)^2 Var r_bar) / (1 - lam^2) + sigma_i^2, lies within {inside} of "
        f"{inside + outside} intervals of 95 %.",
        "Where all read equally well, both weights are 1 / sharers. Where they do not, consensus can raise the variance over "
        "that alone: " + ("; ".join(f"{d} to {v} times" for d, v in worst.items()) or "nowhere here") + ".",
    ]


def _one(rows: Sequence[Row], metric: str, quantity: str, detector: str = "chebyshev:corrected") -> Row | None:
    return next(iter(pick(rows, detector=detector, quantity=quantity, metric=metric)), None)


def _limits(found: Sequence[Row | None]) -> tuple[list[float], list[float], list[float]]:
    value, low, high = ([np.nan if r is None else float(getattr(r, c)) for r in found] for c in ("value", "low", "high"))
    return value, low, high
