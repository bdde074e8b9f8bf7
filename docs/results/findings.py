"""What the comparison shows, in sentences filled from its numbers."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

from comparison import FALSE_ISOLATION, PLANTS, Row, index_of, interval

TEXT = """- **Windowed tests detect more, whatever their rule.** With a CUSUM, an EWMA or a window any test of a Kalman filter's
  innovations finds a bias of 3 sigma on the tanks, the engine and the pipeline as `loo-glr` does. On the network,
  which is disturbed all the time, each sensor has to be tested against all others: `loo-*` and `mhe-l1` find it,
  `kf-*` do not. A bias of two samples is found about as well without memory: ROC area {chi2_short} of `loo-chi2`,
  {glr_short} of `loo-glr`.
- **What each detector costs.** One loss weighs missed faults, false isolation and delay, half of the time with a wrong
  model ([weights and figure](comparison.md#loss)). The least, and those not worse beyond chance: {cheapest}. Over all plants
  `robust-glr` costs {robust_loss}, the next {next_loss}; part of the mismatch cases are of parameters that the plants declare
  as uncertain, which it alone uses: [other errors](when-the-model-is-wrong.md) have a page of their own. First in isolation
  alone, pooled over the plants:
  {first_isolation}; first in detection alone: {first_detection}.
- **Without a model** `dynamic-pca` isolates faults of 10 sigma in {pca_exact} of the samples, where `loo-glr` does in
  {glr_exact}; on a plant at rest `limits-ewma` is as good as anything. In an operation that they have not learnt both
  isolate healthy sensors: `dynamic-pca` in {pca_swings} of the samples where the pipeline's demand swings,
  `dynamic-pca` in {pca_turbine} and `limits-ewma` in {ewma_turbine} where the area of the engine's turbine is 5 %
  smaller.
- **Where the model is wrong, the strongest detectors isolate healthy sensors.** With a pipe 25 % rougher `loo-glr`
  does in {glr_rough} of the samples, as do all others with memory, `loo-chi2` in {chi2_rough}, `uio` in {uio_rough},
  `adaptive-threshold` in {adaptive_rough} and `chebyshev` in {chebyshev_rough}. With a turbine area 5 % smaller the
  shares are, in the same order, {turbine}. With outlets 5 % off on the tanks all do that isolate at all.
- **Nearly all take a process fault for a sensor fault.** With a leak of the pipe `loo-glr`, `chebyshev` and
  `adaptive-threshold` isolate a healthy sensor in {leaks} of the samples. `uio`, whose test no error of an input can
  move, does so in {uio_leak} there and in {uio_worst} at most on the tanks and the network, but in {uio_fouling}
  where the turbine fouls.
- **Thresholds that bounded noise cannot cross** (`adaptive-threshold`) report suspects rather than the sensor. Scaled
  to the common rate they lose their guarantee, and as their alarms last, a healthy engine is in alarm in
  {engine_alarms} of its samples.
- **At their own thresholds** {kept} of {claiming} pairs of plant and detector that claim a rate of false alarms are
  not shown to exceed it; some repeat another with the same scores. `loo-*`, `kf-*` and `mhe-l1` exceed it on the
  network (`loo-glr` {glr_net}, `loo-window` {window_net} where 0.001 is claimed): they take the discretisation area
  by area for the truth. `pca`, `dynamic-pca` and `one-class` exceed it on the pipeline ({learnt_pipe}), where it
  matters how long ago the demand last moved; `kf-cusum` and `loo-cusum` on the tanks ({cusum_tanks}), as their limits
  are an approximation.
- **At most half of the sensors can be isolated at once.** With three of four faulty on the tanks `loo-*` report that
  the limit binds and isolate two; `limits` and `pca` isolate all three."""


def findings(rows: Sequence[Row]) -> str:
    """TEXT with its numbers; plants in the order of PLANTS."""
    index = index_of(rows)
    detectors = list(dict.fromkeys(r["detector"] for r in rows))
    tanks, engine, pipe, net = PLANTS
    own, claimed = "nominal_false_alarm_probability", "claimed_false_alarm_probability"
    rough, turbine = "roughness +25 %", "turbine area -5 %"  # mismatch cases

    def at(plant: str, detector: str, fault: str, metric: str, of: str = "all", digits: int = 2) -> str:
        return f"{float(index[plant, detector, fault, of, metric]['value']):.{digits}f}"

    def each(detector: str, fault: str, metric: str, of: str = "all") -> str:
        return ", ".join(at(plant, detector, fault, metric, of) for plant in PLANTS)

    def mismatch(plant: str, detector: str, case: str) -> str:
        return at(plant, detector, "none", FALSE_ISOLATION, case)

    def loss(plant: str) -> dict[str, float]:
        known = (d for d in detectors if (plant, d, "ranked", "loss", "score") in index)
        found = {d: float(index[plant, d, "ranked", "loss", "score"]["value"]) for d in known}
        return dict(sorted(found.items(), key=lambda item: item[1]))

    def cheapest(plant: str) -> str:
        equal = [d for d in loss(plant) if index[plant, d, "ranked", "loss", "rank"]["value"] == "1"]
        return f"{plant} {' '.join(f'`{d}` {loss(plant)[d]:.2f}' for d in equal)}"

    def first(plant: str, criterion: str) -> str:
        known = [d for d in detectors if (plant, d, "ranked", criterion, "rank") in index]
        ranks = {d: float(index[plant, d, "ranked", criterion, "rank"]["value"]) for d in known}
        return ", ".join(f"`{d}`" for d, rank in ranks.items() if rank == min(ranks.values()))

    claiming = [(p, d) for p in PLANTS for d in detectors if (p, d, "none", "all", claimed) in index]
    kept = [
        key
        for key in claiming
        if float(index[(*key, "none", "all", own)]["low"]) <= float(index[(*key, "none", "all", claimed)]["value"])
    ]
    process = [
        float(row["value"])
        for (plant, detector, fault, _, metric), row in index.items()
        if (detector, metric) == ("uio", FALSE_ISOLATION) and plant in (tanks, net) and fault not in ("none", "dropout")
    ]
    robust = ("loo-glr", "loo-chi2", "uio", "adaptive-threshold", "chebyshev")
    text = TEXT.format(
        chi2_short=each("loo-chi2", "bias-3-sigma", "auc", "2 samples"),
        glr_short=each("loo-glr", "bias-3-sigma", "auc", "2 samples"),
        first_isolation=first("all plants", "isolation"),
        first_detection=first("all plants", "detection"),
        cheapest="; ".join(cheapest(p) for p in PLANTS),
        robust_loss=f"{loss('all plants')['robust-glr']:.2f}",
        next_loss=", ".join(f"`{d}` {v:.2f}" for d, v in list(loss("all plants").items())[1:2]),
        pca_exact=each("dynamic-pca", "graded-10-sigma", "exact_isolation"),
        glr_exact=each("loo-glr", "graded-10-sigma", "exact_isolation"),
        pca_swings=mismatch(pipe, "dynamic-pca", "demand swings"),
        pca_turbine=mismatch(engine, "dynamic-pca", turbine),
        ewma_turbine=mismatch(engine, "limits-ewma", turbine),
        glr_rough=mismatch(pipe, "loo-glr", rough),
        chi2_rough=mismatch(pipe, "loo-chi2", rough),
        uio_rough=mismatch(pipe, "uio", rough),
        adaptive_rough=mismatch(pipe, "adaptive-threshold", rough),
        chebyshev_rough=mismatch(pipe, "chebyshev", rough),
        turbine=", ".join(mismatch(engine, d, turbine) for d in robust),
        leaks=", ".join(at(pipe, d, "leak", FALSE_ISOLATION) for d in ("loo-glr", "chebyshev", "adaptive-threshold")),
        uio_leak=at(pipe, "uio", "leak", FALSE_ISOLATION),
        uio_worst=f"{max(process):.2f}",
        uio_fouling=at(engine, "uio", "turbine-fouling", FALSE_ISOLATION),
        engine_alarms=interval(index[engine, "adaptive-threshold", "none", "all", "deployed_false_alarm_probability"]),
        kept=len(kept),
        claiming=len(claiming),
        glr_net=at(net, "loo-glr", "none", own, digits=3),
        window_net=at(net, "loo-window", "none", own),
        learnt_pipe=", ".join(at(pipe, d, "none", own, digits=3) for d in ("pca", "dynamic-pca", "one-class")),
        cusum_tanks=at(tanks, "kf-cusum", "none", own, digits=3),
    )
    return "\n".join(wrapped(" ".join(item.split())) for item in text.split("\n- "))


def wrapped(item: str) -> str:
    """An item of a list in lines of the width of the pages."""
    item = f"- {item.removeprefix('- ')}"
    return textwrap.fill(item, 128, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False)
