"""What a comparison shows, in sentences filled from its numbers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from fusion_sfdia.benchmarks.comparison_figures import Cells, of_plant
from fusion_sfdia.benchmarks.comparison_numbers import Cell
from fusion_sfdia.benchmarks.comparison_protocol import HEALTHY
from fusion_sfdia.benchmarks.comparison_ranking import Standing
from fusion_sfdia.benchmarks.comparison_tables import EVERY, Standings, glance, sizes, troubled
from fusion_sfdia.benchmarks.findings import span
from fusion_sfdia.benchmarks.scenario import Settings


def highlights(settings: Settings, cells: Cells, standings: Standings) -> list[str]:
    """The findings for the top of the report."""
    return [*leaders(settings, cells, standings), *broken_claims(cells), *blamers(cells), *prices(cells)]


def leaders(settings: Settings, cells: Cells, standings: Standings) -> list[str]:
    """Which detectors nothing beats beyond chance, by plant; those that find or name little of what is large are told."""
    _, large = sizes(settings)
    flaws = {
        key: "which names none" for key, cell in cells.items() if not cell["named"][cell.rows_of(*cell.graded(large))].any()
    }
    flaws |= {key: "which finds little" for key, share in seen(cells, settings).items() if share < 0.5}
    found = []
    for plant, criteria in standings.items():
        of = {d: flaw for (p, d), flaw in flaws.items() if plant in (p, EVERY)}
        said = [f"{criterion}: {first(criteria[criterion], of)}" for criterion in criteria]
        found.append(f"Not beaten beyond chance on {plant}: {'; '.join(said)}.")
    return found


def first(standings: Mapping[str, Standing], flaws: Mapping[str, str]) -> str:
    """The detectors of rank 1, or that all are; who finds little or names none exonerates everyone."""
    best = [f"{name} ({flaws[name]})" if name in flaws else name for name, s in standings.items() if s.rank == 1]
    return "no difference between any" if len(best) == len(standings) > 1 else ", ".join(best)


def broken_claims(cells: Cells) -> list[str]:
    """Which detectors alarm more often at their own threshold than they claim."""
    claimed = [cell for cell in cells.values() if np.isfinite(cell["claim"])]
    broken = [cell for cell in claimed if cell.nominal.low > float(cell["claim"])]
    told = "; ".join(
        f"{c.detector} on {c.plant} {span([c.nominal.value])} (claims {span([float(c['claim'])])})" for c in broken
    )
    kept = len(claimed) - len(broken)
    if not claimed:
        return []
    more = f" More than claimed, beyond the interval: {told}." if broken else ""
    return [
        f"False alarms at their own thresholds are within the claim in {kept} of {len(claimed)} cells that claim a rate.{more}"
    ]


def blamers(cells: Cells) -> list[str]:
    """Who blames healthy sensors where the plant departs from its model, and who does not, by plant."""
    found = []
    for plant in dict.fromkeys(p for p, _ in cells):
        shares = {d: troubled(c) for d, c in of_plant(cells, plant).items() if c.truths}
        if shares:
            found.append(
                f"Healthy samples at which a sensor is blamed under the worst departure, {plant}: "
                + "; ".join(f"{d} {shares[d]:.0%}" for d in sorted(shares, key=lambda d: shares[d]))
                + "."
            )
    return found


def prices(cells: Cells) -> list[str]:
    """What a step costs."""
    times: dict[str, list[float]] = {}
    for (_, detector), cell in cells.items():
        times.setdefault(detector, []).append(cell.step_seconds * 1e3)
    order = sorted(times, key=lambda d: max(times[d]))
    return [f"Processor time of a step in ms: {'; '.join(f'{d} {span(times[d])}' for d in order)}."] if times else []


def seen(cells: Cells, settings: Settings) -> dict[tuple[str, str], float]:
    """Share of the runs with a large fault that raise an alarm."""
    _, large = sizes(settings)
    return {key: cell.detected(cell.rows_of(*cell.graded(large))).value for key, cell in cells.items() if cell.graded(large)}


def missed(cells: Cells, settings: Settings) -> list[str]:
    """Cells that miss most of the large faults, which no average should hide."""
    _, large = sizes(settings)
    told = [f"{d} on {p} {v:.0%}" for (p, d), v in seen(cells, settings).items() if v < 0.5]
    return [f"Less than half of the runs with a fault of {large:g} sigma raise an alarm: {'; '.join(told)}."] if told else []


def remarks(settings: Settings, cells: Cells) -> list[str]:
    """How to read the numbers."""
    rate, samples = settings["false_alarm"], settings["calibration_seeds"] * settings["calibration_steps"]
    measured = span(cell.matched.value for cell in cells.values())
    scales = span(cell.scale for cell in cells.values())
    return [
        f"Every detector's thresholds are multiplied by one number ({scales}) so that {rate:g} of healthy samples alarm: the "
        f"order statistic of {samples} samples of other seeds, of which {rate * samples:.3g} may exceed it. On the healthy "
        f"trunks of the runs {measured} do. A fault lasts {settings['window']} samples, in which "
        f"{1 - (1 - rate) ** settings['window']:.1%} of runs would have an alarm by chance.",
        "Receiver operating characteristics are those of silent detectors, which accuse and replace nothing; all else is of "
        "deployed ones. Several faults at once, replayed and negated readings are among the runs that rank detectors.",
        "Readings come from the finer twin of a plant where it has one; the power network is run in closed loop, and alone has "
        "process noise. What learns from healthy recordings (limits, pca, the fusing banks) learns from those of the model by "
        "its usual inputs, without the network's controllers, whose angles drift.",
        *missed(cells, settings),
        *broken_down(cells),
    ]


def broken_down(cells: Cells) -> list[str]:
    """Detectors whose estimator broke down."""
    shares = {key: float(cell["diverged"].mean()) for key, cell in cells.items()}
    told = [f"{d} on {p} {v:.1%}" for (p, d), v in shares.items() if v > 0]
    return [f"Runs in which the estimator broke down: {'; '.join(told)}."] if told else []


def overview_caption(settings: Settings, cells: Cells) -> str:
    """Spans of the numbers of the matrix."""
    told = [f"{title} {span(number(cell) for cell in cells.values())}" for title, number in glance(settings).items()]
    return f"At the common rate of false alarms; grey: cannot run. From least to most: {'; '.join(told)}."


def areas(cells: Mapping[str, Cell], conditions: Sequence[str]) -> str:
    """Areas under the curves."""
    return " ".join(
        f"Area under the curve, {name.replace('-', ' ')}: "
        + "; ".join(f"{d} {c.areas[name].value:.3f}" for d, c in cells.items())
        + "."
        for name in conditions
    )


def extremes(values: Mapping[str, float]) -> str:
    """The least and the largest by name."""
    known = {k: v for k, v in values.items() if np.isfinite(v)}
    if not known:
        return "none is known"
    low, high = min(known, key=lambda k: known[k]), max(known, key=lambda k: known[k])
    return f"from {span([known[low]])} ({low}) to {span([known[high]])} ({high})"


def others_told(cells: Mapping[str, Cell], names: Sequence[str]) -> str:
    """Least and largest blame of healthy sensors by condition."""
    return "; ".join(f"{n} {extremes({d: c.blame(c.rows_of(n)).value for d, c in cells.items()})}" for n in names)


def healthy_alarms(cells: Iterable[Cell], truth: str) -> dict[str, float]:
    """Share of healthy samples with an alarm under a departure, by detector."""
    return {c.detector: c.alarms(c.rows_of(HEALTHY, truth=truth)).value for c in cells}
