"""The figures, tables and sentences of network/false-alarms, all from its rates."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawing

from fusion_sfdia.benchmarks.network.support.claims import (
    AFTER,
    ALPHAS,
    B18_ALPHA,
    CONFIRMED,
    CONSECUTIVE,
    LEVELS,
    ONE_SHOCK,
    RULES_SHOWN,
    SINGLE,
    Counted,
    Rates,
    chosen,
    claim,
    claim_kept,
)
from fusion_sfdia.benchmarks.network.support.residuals import CORRECTED, MEMORYLESS, PAPER, VARIANTS
from fusion_sfdia.models.power_network.model import PROCESS_VARIANCE
from fusion_sfdia.report.content import Figure, ResultTable
from fusion_sfdia.report.plots import COLOURS, MARKERS, Bars, bars, legend_above, panels
from fusion_sfdia.report.results import Row
from fusion_sfdia.report.scenario_sentences import span

SYMBOLS = {  # of the groups of components
    **{f"theta, {k} sharers": f"θ\n{k} sharers" for k in (2, 3, 4)},
    "omega": "ω",
    "p_m": "pₘ",
    "p_v": "pᵥ",
}
LABELS = {
    PAPER.name: "as printed, memory 0.3",
    CORRECTED.name: "corrected, memory 0.3",
    MEMORYLESS.name: "corrected, without memory",
}
SHOCKED = (("", ONE_SHOCK), ("lit", "three-point 90"), ("lit", "three-point 180"), ("lit", "gaussian"))  # noise, law
WHO = ("one component", "one area")


def exceeded(rates: Rates, *detectors: str) -> str:
    """Quantities whose components exceed the false-alarm rate of (12), where the interval decides."""
    of = {k: r for d in detectors for k, r in chosen(rates, detector=d, metric=SINGLE, rule="").items()}
    over = {k: r for k, r in of.items() if claim_kept(r, k.claim) == "no"}
    return "; ".join(f"{r.value:.2g} for {k.claim:.2g} ({k.quantity}, {k.condition})" for k, r in over.items()) or "nowhere"


def groups_figure(rates: Rates) -> Figure:
    """False alarms of each quantity at alpha = 2."""
    cases = [(noise, law) for noise in PROCESS_VARIANCE for law in ("gaussian", "student-t")]

    def draw() -> Drawing:
        figure, axes = panels([f"{law}, process noise {noise!r}" for noise, law in cases], height=2.7, width=9.0)
        for panel, (noise, law) in zip(axes, cases, strict=True):
            series = []
            for v in VARIANTS:
                found = [_one(rates, Counted(SINGLE, v.name, q, noise, law, B18_ALPHA)) for q in SYMBOLS]
                series.append(Bars(LABELS[v.name], *_limits(found), [np.nan] * len(found)))
            bars(panel, list(SYMBOLS.values()), series, ylabel="")
            panel.axhline(1 / B18_ALPHA**2, color="black", linestyle="--", linewidth=1, label="claim 1/α²")
            panel.tick_params(axis="x", labelsize=7)
            panel.set(ylabel="false alarms per step", ylim=(0, 0.27))
        legend_above(figure)
        return figure

    keys = [Counted(SINGLE, PAPER.name, f"theta, {k} sharers", "lit", "gaussian", B18_ALPHA) for k in (2, 3, 4)]
    printed = [span(r.value for r in (_one(rates, key),) if r is not None) for key in keys]
    return Figure(
        "quantities",
        "False alarms at alpha = 2 by quantity",
        f"By (15) as printed, an angle that 2, 3 or 4 areas share has {', '.join(printed)} false alarms per step (lit, "
        "gaussian): the more areas share it, the more the common noise is underestimated. By the corrected equation "
        "it has as many as any other quantity. Whiskers: 95 % intervals.",
        draw,
        "Bars of false alarms per step by quantity for three kinds of thresholds, two process noises and two laws of noise",
    )


def claims_figure(rates: Rates, laws: Sequence[str]) -> Figure:
    """Measured over claimed probabilities of each rule."""

    def draw() -> Drawing:
        figure, axes = panels(list(laws), columns=3, width=9.6, height=3.0)
        for panel, law in zip(axes, laws, strict=True):
            for i, rule in enumerate(RULES_SHOWN):
                keys = [Counted(SINGLE, MEMORYLESS.name, "all", "lit", law, rule=rule, level=p) for p in LEVELS]
                _points(panel, np.array(LEVELS) * 1.06 ** (i - 2), [_one(rates, key) for key in keys], i, rule)
            ends = np.array([4e-4, 0.25])
            panel.plot(ends, ends, "--", color="black", lw=1, label="as claimed")
            panel.set(xscale="log", yscale="log", xlim=ends, ylim=(3e-7, 0.5), xlabel="claimed", ylabel="measured per step")
        legend_above(figure)
        return figure

    return Figure(
        "rules",
        "Claimed and measured false alarms of each rule",
        "All components, corrected thresholds without memory, process noise 'lit'. Below the dashed line a claim is kept; "
        f"without a point, no false alarm occurred. {_broken(rates, MEMORYLESS.name)} The rules gaussian (for "
        "gaussian noise) and conformal claim the probability itself, so that at one level in forty the whole 95 % interval "
        "(whiskers) is above it by chance.",
        draw,
        "Measured over claimed false-alarm probability on logarithmic axes for five rules, one panel for each law of noise",
    )


def consecutive_figure(rates: Rates) -> Figure:
    """Consecutive alarms compared with (1 / alpha^2)^q."""
    runs = [where for where in SHOCKED if chosen(rates, metric=CONSECUTIVE, noise=where[0], law=where[1], alpha=ALPHAS[1], q=3)]

    def draw() -> Drawing:
        figure, axes = panels([f"α = {a:g}" for a in ALPHAS], columns=3, width=9.6, height=3.0)
        q = np.array([1, 2, 3])
        for panel, alpha in zip(axes, ALPHAS, strict=True):
            for i, where in enumerate(runs):
                keys = [Counted(CONSECUTIVE, CORRECTED.name, "all", *where, alpha, q=int(k)) for k in q]
                label = ", ".join(filter(None, where))
                _points(panel, q + 0.06 * (i - 1.5), [_one(rates, key) for key in keys], i, label)
            panel.plot(q, [claim(alpha, k) for k in (1, 2, 3)], "k--", lw=1, label="Proposition 5")
            panel.set(yscale="log", xticks=q, xlabel="consecutive alarms", ylabel="probability per step", ylim=(3e-7, 0.5))
        legend_above(figure)
        return figure

    return Figure(
        "consecutive",
        "Consecutive alarms compared with Proposition 5",
        f"Corrected thresholds with memory 0.3. {_fifth(rates)} Without a point, none occurred.",
        draw,
        "Probability of one, two and three consecutive alarms on a logarithmic axis with the claim, for alpha 2, 5 and 10",
    )


def tables(rates: Rates, laws: Sequence[str]) -> list[ResultTable]:
    """Which claims are kept; confirmed false alarms."""
    audit = []
    for v in VARIANTS:
        for law in laws:
            for rule in RULES_SHOWN:
                cells = []
                for p in LEVELS:
                    found = chosen(rates, metric=SINGLE, detector=v.name, law=law, rule=rule, level=p).values()
                    worst = max(found, key=lambda r: r.value, default=None)
                    cells.append("none" if worst is None else f"{worst.value:.3g} ({claim_kept(worst, p)})")
                audit.append((v.name, law, rule, *cells))
    confirmed = [
        (k.detector, k.quantity, k.condition, f"{r.value:.0%}", f"{r.low:.0%} to {r.high:.0%}", r.n)
        for k, r in chosen(rates, metric=CONFIRMED).items()
    ]
    return [
        ResultTable(
            "Measured false alarms per step, and whether the claim is kept",
            ("thresholds", "law", "rule", *(f"claimed {p:g}" for p in LEVELS)),
            tuple(audit),
            "The larger rate of both process noises, over all components.",
        ),
        ResultTable(
            "Runs of 100 s in which a false alarm is confirmed by three consecutive steps",
            ("thresholds", "where", "condition", "share", "95 % interval", "runs"),
            tuple(confirmed),
        ),
    ]


def remarks(rates: Rates) -> list[str]:
    """The claims that hold and those that do not; the first sentence is for the top of the report."""
    after = {v.name: _after(rates, v.name) for v in VARIANTS}

    def share(who: str, detector: str) -> str:
        return span(r.value for r in chosen(rates, metric=CONFIRMED, quantity=who, detector=detector, law="gaussian").values())

    return [
        f"At alpha = 2, {_angles(rates, PAPER.name)} of the angles have a false alarm in a step by (15) as printed, "
        f"{_angles(rates, CORRECTED.name)} by the corrected equation (gaussian, both noises). (12) allows 0.25, which is wide "
        f"enough to mask the error. The printed thresholds exceed (12): {exceeded(rates, PAPER.name)}; the corrected ones: "
        f"{exceeded(rates, MEMORYLESS.name, CORRECTED.name)}.",
        f"The claim of every rule but gaussian is for any law. {_broken(rates, MEMORYLESS.name)} {_broken(rates, PAPER.name)} "
        "Where a claim is the probability itself, not a bound, one in forty is exceeded by chance.",
        "Consecutive alarms are not independent, contrary to (40): after an alarm, with gaussian noise and alpha 2, another "
        f"follows with probability {after[CORRECTED.name]} (corrected), {after[PAPER.name]} (as printed), "
        f"{after[MEMORYLESS.name]} (corrected, without memory). Consecutive residuals depend on each other by the memory of "
        "the filter, and by the reading that both contain.",
        _fifth(rates),
        "Runs of 100 s with a false alarm confirmed by three consecutive steps, gaussian: in the same component "
        f"{share(WHO[0], PAPER.name)} as printed, {share(WHO[0], CORRECTED.name)} corrected; in one area, in any of its "
        f"components, {share(WHO[1], PAPER.name)} and {share(WHO[1], CORRECTED.name)}. Proposition 5 bounds it by "
        "1 - (1 - 1/64)^(98 x 94) = 1: at alpha = 2 it guarantees nothing for a network.",
        "An area has an alarm if any of its 5 to 7 components has one: at alpha = 2 the sum of their bounds is more than 1.",
    ]


def _one(rates: Rates, key: Counted) -> Row | None:
    return next(iter(chosen({key: rates[key]}).values()), None) if key in rates else None


def _limits(found: Sequence[Row | None]) -> tuple[list[float], list[float], list[float]]:
    return tuple([np.nan if r is None else getattr(r, c) for r in found] for c in ("value", "low", "high"))  # type: ignore[return-value]


def _points(panel: Axes, x: np.ndarray, found: Sequence[Row | None], i: int, label: str) -> None:
    """Values above 0 with their intervals, in the i-th colour."""
    value, low, high = (np.array(a) for a in _limits(found))
    seen = value > 0
    spread = [np.maximum(value - low, 0)[seen], np.maximum(high - value, 0)[seen]]
    panel.errorbar(
        x[seen], value[seen], spread,
        color=COLOURS[i], marker=MARKERS[i], markersize=4, lw=0.8, capsize=2, label=label,
    )  # fmt: skip


def _angles(rates: Rates, detector: str) -> str:
    of = chosen(rates, detector=detector, metric=SINGLE, law="gaussian", alpha=B18_ALPHA)
    return span(r.value for k, r in of.items() if k.quantity.startswith("theta"))


def _after(rates: Rates, detector: str) -> str:
    common = {"detector": detector, "law": "gaussian", "alpha": B18_ALPHA}
    found = chosen(rates, metric=AFTER, **common).values()
    plain = chosen(rates, metric=CONSECUTIVE, q=1, **common).values()
    return f"{span(r.value for r in found)} against {span(r.value for r in plain)} at any step"


def _broken(rates: Rates, detector: str) -> str:
    """Which rules' claims are exceeded, over all components."""
    broken: dict[str, set[str]] = {}
    for k, r in chosen(rates, detector=detector, metric=SINGLE, quantity="all").items():
        if claim_kept(r, k.claim) == "no":
            broken.setdefault(k.rule, set()).add(k.law)
    cases = "; ".join(f"{rule} ({', '.join(sorted(laws))})" for rule, laws in broken.items())
    return f"Claims exceeded by {LABELS[detector]}: {cases or 'none'}."


def _fifth(rates: Rates) -> str:
    """Where (1/alpha^2)^q is exceeded by consecutive alarms."""
    over: dict[str, list[str]] = {}
    for k, r in chosen(rates, metric=CONSECUTIVE, detector=CORRECTED.name).items():
        if k.q > 1 and claim_kept(r, k.claim) == "no":
            over.setdefault(k.runs, []).append(
                f"{k.q} consecutive at alpha {k.alpha:g} {r.value:.1e} for at most {k.claim:.1e}"
            )
    cases = "; ".join(f"{runs}: {', '.join(cells)}" for runs, cells in over.items())
    return f"The corrected thresholds exceed (1/alpha^2)^q: {cases or 'nowhere'}."
