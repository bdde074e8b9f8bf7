"""The figures, tables and sentences of network/false-alarms, all from its rows."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from matplotlib.figure import Figure as Drawing

from fusion_sfdia.benchmarks.network.support.claims import ALPHAS, B18_ALPHA, LEVELS, RULES_SHOWN, bound, claim, verdict
from fusion_sfdia.benchmarks.network.support.residuals import VARIANTS
from fusion_sfdia.evaluation.results import Row
from fusion_sfdia.models.power_network.model import PROCESS_VARIANCE
from fusion_sfdia.report.content import Figure, Table
from fusion_sfdia.report.findings import pick, span
from fusion_sfdia.report.plots import COLOURS, MARKERS, Bars, bars, legend_above, panels

QUANTITIES = ("theta, 2 sharers", "theta, 3 sharers", "theta, 4 sharers", "omega", "p_m", "p_v")
SYMBOLS = {"theta": "$\\theta$", "omega": "$\\omega$", "p_m": "$p_m$", "p_v": "$p_v$"}
LABELS = {
    "chebyshev:paper": "as printed, memory 0.3",
    "chebyshev:corrected": "corrected, memory 0.3",
    "chebyshev": "corrected, without memory",
}


def exceeded(rows: Sequence[Row], *detectors: str) -> str:
    """Where a quantity alarms more often than (12) allows, decidedly."""
    of = [r for r in pick(rows, detector=detectors, metric="false_alarm_probability") if "alpha" in r.quantity]
    found = [f"{r.value:.2g} for {bound(r):.2g} ({r.quantity})" for r in of if verdict(r, bound(r)) == "no"]
    return "; ".join(found) or "nowhere"


def groups_figure(rows: Sequence[Row]) -> Figure:
    """False alarms of each quantity at alpha = 2."""

    def draw() -> Drawing:
        titles = [f"{law}, process noise {noise!r}" for noise in PROCESS_VARIANCE for law in ("gaussian", "student-t")]
        figure, axes = panels(titles, height=2.7, width=9.0)
        for panel, title in zip(axes, titles, strict=True):
            law, noise = title.split(",")[0], title.split("'")[1]
            series = []
            for v in VARIANTS:
                found = [_one(rows, v.name, f"{q}, alpha {B18_ALPHA:g}, {noise}, {law}") for q in QUANTITIES]
                series.append(Bars(LABELS[v.name], *_limits(found), [np.nan] * len(found)))
            named = ["\n".join(SYMBOLS.get(part, part) for part in q.split(", ")) for q in QUANTITIES]
            bars(panel, named, series, ylabel="")
            panel.axhline(1 / B18_ALPHA**2, color="black", linestyle="--", linewidth=1, label="claim $1/\\alpha^2$")
            panel.tick_params(axis="x", labelsize=7)
            panel.set(ylabel="false alarms per step", ylim=(0, 0.27))
        legend_above(figure)
        return figure

    of = pick(rows, metric="false_alarm_probability", detector="chebyshev:paper")
    printed = [
        span(r.value for r in of if r.quantity == f"theta, {k} sharers, alpha {B18_ALPHA:g}, lit, gaussian") for k in (2, 3, 4)
    ]
    return Figure(
        "quantities",
        "False alarms at alpha = 2 by quantity",
        f"By (15) as printed, an angle that 2, 3 or 4 areas share has {', '.join(printed)} false alarms per step (lit, "
        "gaussian), for the more share it the less of the noise common to all is counted; corrected, it is as any other "
        "quantity. Whiskers: 95 % intervals.",
        draw,
        "Bars of false alarms per step by quantity for three kinds of thresholds, two process noises and two laws of noise",
    )


def claims_figure(rows: Sequence[Row], laws: Sequence[str]) -> Figure:
    """Counted against claimed probabilities of each rule."""

    def draw() -> Drawing:
        figure, axes = panels([f"{law}" for law in laws], columns=3, width=9.6, height=3.0)
        for panel, law in zip(axes, laws, strict=True):
            for i, rule in enumerate(RULES_SHOWN):
                found = [_one(rows, "chebyshev", f"all, {rule} {p:g}, lit, {law}") for p in LEVELS]
                x = np.array(LEVELS) * 1.06 ** (i - 2)
                value, low, high = (np.array(a) for a in _limits(found))
                seen = value > 0
                spread = [np.maximum(value - low, 0)[seen], np.maximum(high - value, 0)[seen]]
                panel.errorbar(
                    x[seen], value[seen], spread,
                    color=COLOURS[i], marker=MARKERS[i], markersize=4, lw=0.8, capsize=2, label=rule,
                )  # fmt: skip
            ends = np.array([4e-4, 0.25])
            panel.plot(ends, ends, "--", color="black", lw=1, label="as claimed")
            panel.set(xscale="log", yscale="log", xlim=ends, ylim=(3e-7, 0.5), xlabel="claimed", ylabel="counted per step")
        legend_above(figure)
        return figure

    return Figure(
        "rules",
        "Claimed and counted false alarms of each rule",
        "All components of the corrected thresholds without memory, process noise 'lit'; below the dashed line a claim is "
        f"kept; where there is no point, none was counted. {_broken(rows, 'chebyshev')} gaussian (of gaussian noise) and "
        "conformal claim the probability itself: at one level in forty luck puts the whole 95 % interval (whiskers) above.",
        draw,
        "Counted against claimed false-alarm probability on logarithmic axes for five rules, one panel for each law of noise",
    )


def row_figure(rows: Sequence[Row]) -> Figure:
    """Several alarms in a row beside (1 / alpha^2)^q."""
    wheres = [w for w in ("one white shock", "lit, three-point 90", "lit, three-point 180", "lit, gaussian")
              if pick(rows, metric="consecutive_alarm_probability", quantity=f"3 in a row, alpha 5, {w}")]  # fmt: skip

    def draw() -> Drawing:
        figure, axes = panels([f"$\\alpha$ = {a:g}" for a in ALPHAS], columns=3, width=9.6, height=3.0)
        q = np.array([1, 2, 3])
        for panel, alpha in zip(axes, ALPHAS, strict=True):
            for i, where in enumerate(wheres):
                found = [_one(rows, "chebyshev:corrected", f"{k} in a row, alpha {alpha:g}, {where}") for k in q]
                value, low, high = (np.array(a) for a in _limits(found))
                seen = value > 0
                spread = [np.maximum(value - low, 0)[seen], np.maximum(high - value, 0)[seen]]
                panel.errorbar(
                    (q + 0.06 * (i - 1.5))[seen], value[seen], spread,
                    color=COLOURS[i], marker=MARKERS[i], markersize=4, lw=0.8, capsize=2, label=where,
                )  # fmt: skip
            panel.plot(q, [claim(alpha, k) for k in (1, 2, 3)], "k--", lw=1, label="Proposition 5")
            panel.set(yscale="log", xticks=q, xlabel="alarms in a row", ylabel="probability per step", ylim=(3e-7, 0.5))
        legend_above(figure)
        return figure

    return Figure(
        "in-a-row",
        "Alarms in a row beside Proposition 5",
        f"Thresholds corrected, with memory 0.3. {_fifth(rows)} Where there is no point, none was counted.",
        draw,
        "Probability of one, two and three alarms in a row on a logarithmic axis beside the claim, for alpha 2, 5 and 10",
    )


def tables(rows: Sequence[Row], laws: Sequence[str]) -> list[Table]:
    """Which claims are kept; confirmed false alarms."""
    audit = []
    for v in VARIANTS:
        for law in laws:
            for rule in RULES_SHOWN:
                cells = []
                for p in LEVELS:
                    found = pick(rows, detector=v.name, quantity=[f"all, {rule} {p:g}, {n}, {law}" for n in PROCESS_VARIANCE])
                    worst = max(found, key=lambda r: r.value, default=None)
                    cells.append("none" if worst is None else f"{worst.value:.3g} ({verdict(worst, p)})")
                audit.append((v.name, law, rule, *cells))
    confirmed = [
        (r.detector, r.quantity, f"{r.value:.0%}", f"{r.low:.0%} to {r.high:.0%}", r.n)
        for r in pick(rows, metric="false_confirmation_share")
    ]
    return [
        Table(
            "Counted false alarms per step, and whether the claim is kept",
            ("thresholds", "law", "rule", *(f"claimed {p:g}" for p in LEVELS)),
            tuple(audit),
            "The larger of both process noises, over all components.",
        ),
        Table(
            "Runs of 100 s in which a false alarm is confirmed by three steps in a row",
            ("thresholds", "who alarms", "share", "95 % interval", "runs"),
            tuple(confirmed),
        ),
    ]


def remarks(rows: Sequence[Row], laws: Sequence[str]) -> list[str]:
    """What holds and what does not, the first for the top of the report."""
    again = {v.name: _after(rows, v.name) for v in VARIANTS}
    confirmed = {
        who: [
            r for r in pick(rows, metric="false_confirmation_share") if r.quantity.startswith(who) and "gaussian" in r.quantity
        ]
        for who in ("one component", "one area")
    }

    def share(who: str, detector: str) -> str:
        return span(r.value for r in confirmed[who] if r.detector == detector)

    return [
        f"At alpha = 2, {_angles(rows, 'chebyshev:paper')} of the angles alarm falsely in a step by (15) as printed, "
        f"{_angles(rows, 'chebyshev:corrected')} corrected (gaussian, both noises), where (12) allows 0.25, room enough to "
        f"hide the error. (12) is exceeded by the printed thresholds: {exceeded(rows, 'chebyshev:paper')}; by the corrected "
        f"ones: {exceeded(rows, 'chebyshev', 'chebyshev:corrected')}.",
        f"Every rule but gaussian claims for any law. {_broken(rows, 'chebyshev')} {_broken(rows, 'chebyshev:paper')} Of the "
        "claims that are the probability itself, not a bound, one in forty is exceeded by luck.",
        f"Consecutive alarms are not independent, against (40): after an alarm, gaussian noise, alpha 2, another follows "
        f"with probability {again['chebyshev:corrected']} (corrected), {again['chebyshev:paper']} (as printed), "
        f"{again['chebyshev']} (corrected, without memory). What is known of the last residual stays in the next "
        "one with the memory, and through the reading that both contain.",
        _fifth(rows),
        "Runs of 100 s with a false alarm that three steps in a row confirm, gaussian: in one and the same component "
        f"{share('one component', 'chebyshev:paper')} as printed, {share('one component', 'chebyshev:corrected')} corrected; "
        f"in one area, whichever its components, {share('one area', 'chebyshev:paper')} and "
        f"{share('one area', 'chebyshev:corrected')}. By Proposition 5 it would be at most 1 - (1 - 1/64)^(98 x 94) = 1: at "
        "alpha = 2 it promises nothing for a network.",
        "An area alarms where any of its 5 to 7 components does: at alpha = 2 the sum of their bounds is more than 1.",
    ]


def _one(rows: Iterable[Row], detector: str, quantity: str) -> Row | None:
    metric = ("false_alarm_probability", "consecutive_alarm_probability")
    return next(iter(pick(rows, detector=detector, quantity=quantity, metric=metric)), None)


def _limits(found: Sequence[Row | None]) -> tuple[list[float], list[float], list[float]]:
    return tuple([np.nan if r is None else getattr(r, c) for r in found] for c in ("value", "low", "high"))  # type: ignore[return-value]


def _angles(rows: Sequence[Row], detector: str) -> str:
    of = pick(rows, detector=detector, metric="false_alarm_probability")
    expected = f"alpha {B18_ALPHA:g}"
    return span(r.value for r in of if r.quantity.startswith("theta") and expected in r.quantity and "gaussian" in r.quantity)


def _after(rows: Sequence[Row], detector: str) -> str:
    found = pick(rows, metric="alarm_after_alarm_probability", detector=detector,
                 quantity=[f"alpha {B18_ALPHA:g}, {n}, gaussian" for n in PROCESS_VARIANCE])  # fmt: skip
    plain = pick(rows, metric="consecutive_alarm_probability", detector=detector,
                 quantity=[f"1 in a row, alpha {B18_ALPHA:g}, {n}, gaussian" for n in PROCESS_VARIANCE])  # fmt: skip
    return f"{span(r.value for r in found)} against {span(r.value for r in plain)} at any step"


def _broken(rows: Sequence[Row], detector: str) -> str:
    """Which rules' claims are exceeded, over all components."""
    broken: dict[str, set[str]] = {}
    for r in pick(rows, detector=detector, metric="false_alarm_probability"):
        parts = r.quantity.split(", ")
        if parts[0] != "all":
            continue
        rule, level = parts[1].split(" ")
        if verdict(r, float(level)) == "no":
            broken.setdefault(rule, set()).add(parts[3])
    told = "; ".join(f"{rule} ({', '.join(sorted(laws))})" for rule, laws in broken.items())
    return f"Claims exceeded by {LABELS[detector]}: {told or 'none'}."


def _fifth(rows: Sequence[Row]) -> str:
    """Where (1/alpha^2)^q is exceeded."""
    over: dict[str, list[str]] = {}
    for r in pick(rows, metric="consecutive_alarm_probability", detector="chebyshev:corrected"):
        if r.quantity[0] != "1" and verdict(r, bound(r)) == "no":
            q, alpha, where = r.quantity.split(", ", 2)
            over.setdefault(where, []).append(f"{q} at {alpha} {r.value:.1e} for at most {bound(r):.1e}")
    told = "; ".join(f"{where}: {', '.join(cells)}" for where, cells in over.items())
    return f"(1/alpha^2)^q is exceeded by the corrected thresholds: {told or 'nowhere'}."
