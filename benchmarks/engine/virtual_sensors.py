"""engine/virtual-sensors: sizes of three faults, and false alarms of neighbouring modules (V22, Figs. 3 and 4)."""

from __future__ import annotations

from functools import partial

import numpy as np

from fusion_sfdia.benchmarks.engine.support.trials import DETECTORS, NAMES, SAMPLING, Array, Results, engine, row, sampled
from fusion_sfdia.benchmarks.engine.support.virtual_figures import virtual_sensor_figures
from fusion_sfdia.benchmarks.engine.support.virtual_trials import (
    DELAYED,
    DETECTOR,
    DURATION,
    FAULTS,
    GUARANTEED,
    IDENTIFIED,
    INTERSECTED,
    INVERSIONS,
    LEARNING_RATES,
    MAPE,
    PRINTED,
    REMAINS,
    SINCE,
    SIZED,
    V22,
    VARIANTS,
    WITHIN,
    by_kind,
    sensor_tasks,
    sensor_work,
)
from fusion_sfdia.common.run_statistics import Estimate, bootstrap_over_runs, mean_over_runs, share
from fusion_sfdia.detectors.adaptive_thresholds.adaptive_observer import Rates, adaptive_rate
from fusion_sfdia.models.marine_engine.published import K22_GAINS
from fusion_sfdia.report.content import ResultTable, Summary
from fusion_sfdia.report.results import Published, Row
from fusion_sfdia.report.scenario_sentences import pick, span
from fusion_sfdia.study.experiments.scenario import Arrays, Scenario, Settings

NAME, FAULT = "engine/virtual-sensors", "three-faults"


def sensor_rows(found: dict[str, Arrays], duration: float) -> list[Row]:
    """The metrics of each variant and inversion, by module of a faulty sensor, and of the neighbouring modules."""
    rows: list[Row] = []
    for kind, a in found.items():
        detector = DETECTORS[0] if kind == "alone" else DETECTOR
        at = partial(row, NAME, detector, FAULT, condition="" if kind == "alone" else kind)
        if kind not in INVERSIONS:
            fired = np.isfinite(a["first"])
            rows += [at(n, "fired_share", share(fired[:, j])) for j, n in enumerate(NAMES)]
            wrong = np.delete(fired, [NAMES.index(n) for n in SIZED], axis=-1).any(axis=-1)
            rows.append(at("healthy sensors", "fired_share", share(wrong)))
        for i, n in enumerate(SIZED if kind != "alone" else ()):
            at_n = partial(at, n)
            if kind in INVERSIONS:
                rows += [at_n("fault_interval_percent", mean(100 * a["width"][:, i]))]
                rows += [at_n("interval_coverage", mean(a["inside"][:, i], a["isolated"][:, i]))]
                continue
            delay = a["first"][:, NAMES.index(n)] - FAULTS[i].onset
            error = Published(MAPE[i], f"{V22}, from {SINCE[i]:g} s on")
            rows += [
                at_n("fault_mape_percent", mean(a["mape"][:, i]), stated(error, duration)),
                at_n("isolation_delay", mean(delay), stated(DELAYED, duration) if n == "M(2,3)" else None),
                at_n("interval_coverage", mean(a["inside"][:, i], a["isolated"][:, i])),
                at_n("fault_interval_percent", mean(100 * a["width"][:, i])),
                at_n("empty_interval_share", share(np.isnan(a["width"][:, i]))),
                at_n("rmse", root(a["square"][:, i])),
                at_n("rmse_unaccommodated", root(a["square_faulty"][:, i])),
            ]
            if n == "M(2,3)":
                rows.append(at_n("identification_time", median(a["settled"][:, i]), stated(IDENTIFIED[n], duration)))
            if n == "M(3,1)" and "learning_rates" in VARIANTS[kind]:
                rows.append(
                    at_n(
                        "identification_time",
                        median(np.where(np.isnan(a["rise"][:, i]), np.inf, a["rise"][:, i])),
                        stated(IDENTIFIED[n], duration),
                    )
                )
    modules = engine(0.03, "K22").structure.modules
    assert modules is not None
    for (variable, gain), rate in zip(K22_GAINS.items(), modules.rates, strict=True):
        speed = adaptive_rate(Rates(float(rate), gain, LEARNING_RATES[variable]))
        rows.append(row(NAME, DETECTOR, "none", modules.names[variable], "adaptive_rate", Estimate(speed, np.nan, np.nan, 0)))
    return rows


def stated(published: Published, duration: float) -> Published | None:
    """The number of the paper beside runs as long as its own."""
    return published if duration == DURATION else None


def mean(values: Array, counts: Array | None = None) -> Estimate:
    """Over runs (B,), of those with a number."""
    known = np.isfinite(values)
    return mean_over_runs(np.where(known, values, 0.0), known * (np.ones(values.shape) if counts is None else counts))


def median(times: Array) -> Estimate:
    """Over runs (B,), inf for those without an end."""
    return bootstrap_over_runs(lambda runs: np.median(times[runs], axis=-1), times.size)


def root(squares: Array) -> Estimate:
    """Root of the mean over runs (B,)."""
    return bootstrap_over_runs(lambda runs: np.sqrt(squares[runs].mean(axis=-1)), squares.size)


def sensor_summary(settings: Settings, results: Results) -> Summary:
    """Sizes and intervals of the faults, compared with V22, and which modules fire with and without reconstructed readings."""
    found = by_kind(results)
    rows = sensor_rows(found, settings["duration"])
    known = [v for v in VARIANTS if v in found]
    table = ResultTable(
        "Mean absolute percentage error of the fault's size, percent",
        ("module", *known, "paper"),
        tuple((n, *(value_of(rows, "fault_mape_percent", n, v) for v in known), f"{MAPE[i]:g}") for i, n in enumerate(SIZED)),
        f"From {', '.join(f'{s:g} s ({n})' for s, n in zip(SINCE, SIZED, strict=True))} on.",
    )
    figures = virtual_sensor_figures(found, settings["duration"])
    return Summary(sampled(rows, settings["sampling"]), figures, [table], highlights(rows), remarks(rows, settings))


def value_of(rows: list[Row], metric: str, module: str, kind: str) -> str:
    """The value of a module in a variant, as text."""
    return span(r.value for r in pick(rows, metric=metric, quantity=module, condition=kind))


def false_alarms(rows: list[Row], kind: str = "") -> str:
    """The modules of healthy sensors that fire in any run, with the share of runs; kind: a variant, or empty for none."""
    fired = {r.quantity: r.value for r in pick(rows, metric="fired_share", condition=kind) if r.value > 0}
    names = [(n, fired[n]) for n in NAMES if n not in SIZED and n in fired]
    return ", ".join(f"{n} {value:.0%}" for n, value in names) or "none"


def highlights(rows: list[Row]) -> list[str]:
    """The size of the torque's fault, and the modules of healthy sensors."""
    return [
        "M(2,3) estimates the size of its fault with an error of "
        f"{value_of(rows, 'fault_mape_percent', 'M(2,3)', INTERSECTED)} % with intervals intersected over time, "
        f"{value_of(rows, 'fault_mape_percent', 'M(2,3)', PRINTED)} % from each sample alone (paper {MAPE[0]:g} %)",
        f"Modules of healthy sensors that fire, without reconstructed readings: {false_alarms(rows)}; with them: "
        f"{false_alarms(rows, INTERSECTED)}",
    ]


def remarks(rows: list[Row], settings: Settings) -> list[str]:
    """Our numbers compared with the paper's."""
    modules = engine(settings["noise"], "K22").structure.modules
    assert modules is not None
    rates = {r.quantity: r.value for r in pick(rows, metric="adaptive_rate")}
    half = 100 * settings["noise"] * modules.nominal["T_charge"] / 2 / FAULTS[2].magnitude
    holds = pick(rows, metric="interval_coverage")
    lost = ", ".join(f"{r.quantity}, {r.condition} {r.value:.3%}" for r in holds if r.value < 1)
    wrong = [f"{v} {value_of(rows, 'fired_share', 'healthy sensors', v)}" for v in VARIANTS]
    widths = [f"{value_of(rows, 'fault_interval_percent', n, i)} % ({n}, {i})" for n in SIZED for i in INVERSIONS]
    fastest = "; ".join(f"{n} {r:.2g} 1/s, {np.log(1 / REMAINS) / r:.3g} s" for n, r in rates.items())
    of = partial(value_of, rows)
    inverted = [
        f"Widths of the final intervals over the fault in {settings['inversion_seeds']} short runs, by corners and by set "
        f"inversion: {', '.join(widths)}."
    ]
    return [
        "V22 prints no intersection over time, but draws an interval that narrows. With it the last interval of M(2,3) is "
        f"{of('fault_interval_percent', 'M(2,3)', INTERSECTED)} % of the fault wide, without it "
        f"{of('fault_interval_percent', 'M(2,3)', PRINTED)} %.",
        f"M(2,3) is isolated {of('isolation_delay', 'M(2,3)', INTERSECTED)} s after the onset (paper almost {DELAYED.value:g} "
        f"s), and from {of('identification_time', 'M(2,3)', INTERSECTED)} s after that on its error stays below the paper's "
        f"{WITHIN:.2%} (median; paper within {IDENTIFIED['M(2,3)'].value:g} s).",
        "By the middle of its interval, where V22 has the adaptive observer, M(3,1) has an error of "
        f"{of('fault_mape_percent', 'M(3,1)', GUARANTEED)} %, that of the observer is "
        f"{of('fault_mape_percent', 'M(3,1)', INTERSECTED)} % (paper {MAPE[1]:g} %). Only the interval is guaranteed, "
        f"{of('fault_interval_percent', 'M(3,1)', GUARANTEED)} % of the fault wide at the end.",
        f"Adaptive observers approach the fault at the rate Gamma (1 + Omega)^2, to {1 - REMAINS:.0%} of it within: {fastest}. "
        f"Of M(3,1) the paper states about {IDENTIFIED['M(3,1)'].value:g} s; measured "
        f"{of('identification_time', 'M(3,1)', INTERSECTED)} s.",
        "M(4,2) compares one reading with a constant: a single sample leaves an error of half the noise bound on average, "
        f"{half:.3g} % of the fault, measured {of('fault_mape_percent', 'M(4,2)', PRINTED)} %, paper {MAPE[2]:g} %; "
        f"intersected {of('fault_mape_percent', 'M(4,2)', INTERSECTED)} %.",
        f"Samples whose interval contains the fault, where not all: {lost or 'no module'}.",
        f"Runs in which a healthy sensor is isolated: {', '.join(wrong)}; without reconstructed readings its module fires in "
        f"{value_of(rows, 'fired_share', 'healthy sensors', '')} of them.",
        *(inverted if pick(rows, quantity="M(2,3)", condition=INVERSIONS[1]) else []),
    ]


SCENARIO = Scenario(
    name=NAME,
    title="Virtual sensors on a marine engine",
    about="Offsets of 5 kN m of the torque sensor and 50 kPa of the receiver's pressure sensor at 10 s, and of 100 K of the "
    "charge air's temperature sensor at 20 s, at full load with 3 % noise (Kougiatsos and Reppa 2022, Figs. 3 and 4): their "
    "estimated sizes, and false alarms of the modules that read these sensors.",
    settings={
        "noise": 0.03,
        "duration": DURATION,
        "sampling": SAMPLING,
        "variants": tuple(VARIANTS),
        "inversion_seeds": 2,
    },
    seeds=3,
    full_seeds=100,
    tasks=sensor_tasks,
    work=sensor_work,
    summarise=sensor_summary,
    full={"inversion_seeds": 10},
    bounds={"inversion_seeds": (0, 1000)},
    papers=("virtual2022",),
)
