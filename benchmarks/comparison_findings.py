"""What a comparison shows, in sentences filled from its numbers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from fusion_sfdia.benchmarks.comparison_figures import Cells, of_plant
from fusion_sfdia.benchmarks.comparison_measures import exactly, names_most, seen, sizes, under_departures, under_plant_faults
from fusion_sfdia.benchmarks.comparison_numbers import Cell
from fusion_sfdia.benchmarks.comparison_protocol import HEALTHY
from fusion_sfdia.benchmarks.comparison_ranking import Standing
from fusion_sfdia.benchmarks.comparison_tables import EVERY, Standings
from fusion_sfdia.benchmarks.findings import span
from fusion_sfdia.benchmarks.scenario import Settings
from fusion_sfdia.core.order_statistics import exceedance_rank

RARELY = 0.01  # of samples: what is less is not told, or as hardly any


def highlights(settings: Settings, cells: Cells, standings: Standings) -> list[str]:
    """The findings for the top of the report."""
    plants = dict.fromkeys(p for p, _ in cells)
    found = [leaders(settings, EVERY, list(cells.values()), standings[EVERY])] if EVERY in standings else []
    verdicts = [line for plant in plants for line in verdict(settings, of_plant(cells, plant))]
    return [*found, *verdicts, *broken_claims(list(cells.values()))]


def verdict(settings: Settings, cells: Mapping[str, Cell]) -> list[str]:
    """Who names most on a plant, and what that one does where the plant is not as believed."""
    if (name := names_most(settings, cells)) is None:
        return []
    cell, (_, large) = cells[name], sizes(settings)
    departure, fault = under_departures(cell), under_plant_faults(cell)
    said = [f"{b.share.value:.0%} under {b.where}" for b in (departure, fault) if np.isfinite(b.share.value)]
    wrong = f"; it blames a healthy one in {' and in '.join(said)}" if said else ""
    return [
        f"{cell.plant}: {name} names exactly the faulty sensor most often, at {large:g} sigma in "
        f"{exactly(settings, cell).value:.0%} of the samples{wrong}."
    ]


def plant_findings(settings: Settings, cells: Mapping[str, Cell], criteria: Mapping[str, Mapping[str, Standing]]) -> list[str]:
    """What is to be said of one plant."""
    plant, known = next(iter(cells.values())).plant, list(cells.values())
    return [
        *([leaders(settings, plant, known, criteria)] if criteria else []),
        *missed(settings, known),
        *blamers(plant, cells),
        *broken_claims(known),
        *restless(known),
        *broken_down(known),
    ]


def leaders(settings: Settings, plant: str, cells: Sequence[Cell], criteria: Mapping[str, Mapping[str, Standing]]) -> str:
    """Which detectors nothing beats beyond chance on a plant; those that find or name little of what is large are told."""
    _, large = sizes(settings)
    flaws: dict[str, dict[str, list[str]]] = {}
    for cell in cells:
        rows = cell.rows_of(*cell.graded(large))
        names_none = rows.size > 0 and not cell["named"][rows].any()
        if flaw := "finds little" if seen(settings, cell) < 0.5 else "names none" if names_none else "":
            flaws.setdefault(cell.detector, {}).setdefault(flaw, []).append(cell.plant)
    counted = len({cell.plant for cell in cells})
    told = {
        d: "which " + " and ".join(f if len(on) == counted else f"{f} on {', '.join(on)}" for f, on in found.items())
        for d, found in flaws.items()
    }
    nameless = {d for d, found in flaws.items() if len(found.get("names none", ())) == counted}
    said = []
    for criterion, found in criteria.items():
        if any(s.mean.n for s in found.values()):
            aside = nameless if criterion == "exoneration" else set()
            said.append(f"{criterion}{', of those that name any' if aside else ''}: {first(found, told, aside)}")
    return f"Not beaten beyond chance on {plant}: {'; '.join(said)}."


def first(standings: Mapping[str, Standing], flaws: Mapping[str, str], nameless: set[str]) -> str:
    """The detectors of the best rank, or that all are; who names none at all exonerates everyone, and is left out."""
    ranks = {name: s.rank for name, s in standings.items() if name not in nameless} or {n: s.rank for n, s in standings.items()}
    best = [f"{name} ({flaws[name]})" if name in flaws else name for name, rank in ranks.items() if rank == min(ranks.values())]
    return "no difference between any" if len(best) == len(ranks) > 1 else ", ".join(best)


def broken_claims(cells: Sequence[Cell]) -> list[str]:
    """Which detectors alarm more often at their own threshold than they claim."""
    claimed = [cell for cell in cells if np.isfinite(cell["claim"])]
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


def restless(cells: Sequence[Cell]) -> list[str]:
    """Which detectors alarm on healthy readings in spite of the common threshold: where alarms last, or runs differ."""
    often = [c for c in cells if c.deployed.value > RARELY]
    told = [f"{c.detector} {c.deployed.value:.1%} ({c.matched.value:.2%} before anything is accused)" for c in often]
    return [f"Healthy samples with an alarm as deployed: {'; '.join(told)}; the others {RARELY:.0%} at most."] if told else []


def blamers(plant: str, cells: Mapping[str, Cell]) -> list[str]:
    """Who blames healthy sensors where the plant departs from its model or fails itself, and who does not."""
    found = []
    for under, worst in (("worst departure", under_departures), ("worst fault of the plant", under_plant_faults)):
        shares = {d: v for d, c in cells.items() if np.isfinite(v := worst(c).share.value)}
        told = {
            "in most samples": [f"{d} {v:.0%}" for d, v in shares.items() if v > 0.5],
            "in some": [f"{d} {v:.0%}" for d, v in shares.items() if RARELY < v <= 0.5],
            "in 1 % of them at most": [d for d, v in shares.items() if v <= RARELY],
        }
        said = "; ".join(f"{how}: {', '.join(names)}" for how, names in told.items() if names)
        found += [f"Who blames a healthy sensor under the {under} of {plant}, {said}."] if shares else []
    return found


def missed(settings: Settings, cells: Sequence[Cell]) -> list[str]:
    """Cells that miss most of the large faults, which no average should hide."""
    _, large = sizes(settings)
    told = [f"{c.detector} {seen(settings, c):.0%}" for c in cells if seen(settings, c) < 0.5]
    return [f"Less than half of the runs with a fault of {large:g} sigma raise an alarm: {'; '.join(told)}."] if told else []


def remarks(settings: Settings, cells: Cells) -> list[str]:
    """How to read the numbers."""
    rate, samples = settings["false_alarm"], settings["calibration_seeds"] * settings["calibration_steps"]
    spent = max(samples - exceedance_rank(samples, rate), 0)
    measured = span(cell.matched.value for cell in cells.values())
    deployed = span(cell.deployed.value for cell in cells.values())
    chance = span(cell.chance for cell in cells.values())
    scales = span(cell.scale for cell in cells.values())
    return [
        f"Every detector's thresholds are multiplied by one number ({scales}) so that {rate:g} of healthy samples alarm: the "
        f"order statistic of {samples} samples of other seeds that {spent} of them exceed. On the healthy trunks of the runs "
        f"{measured} do, as long as nothing has been accused; as deployed, where some alarms last, {deployed} have an alarm. A "
        f"fault lasts {settings['window']} samples; {chance} of healthy windows as long have one by chance.",
        "Receiver operating characteristics are those of silent detectors, which accuse and replace nothing; all else is of "
        "deployed ones, which have not alarmed yet when a fault begins. All faults of sensors are among the runs that rank "
        "detectors.",
        "Readings come from the finer twin of a plant where it has one, and else from its model, so that a simulation alone "
        "foretells them exactly: see how detectors stand where the plant is not as believed. A plant with controllers is run "
        "in closed loop. What learns from healthy recordings learns from such runs of the model.",
    ]


def left_out(cells: Cells, whole: Cells) -> list[str]:
    """Which cells are not ranked."""
    told = [f"{detector} on {plant}" for plant, detector in cells if (plant, detector) not in whole]
    return [f"Left out of the ranks, since a piece of their work failed: {', '.join(told)}."] if told else []


def absent(settings: Settings, cells: Cells, reasons: Mapping[tuple[str, str], str]) -> list[str]:
    """Plants on which no detector ran, and why."""
    there = {plant for plant, _ in cells}
    told = {plant: "; ".join(dict.fromkeys(of_plant(reasons, plant).values())) for plant in settings["plants"]}
    return [f"No detector ran on {p}: {why.rstrip('.') or 'all work failed'}." for p, why in told.items() if p not in there]


def broken_down(cells: Sequence[Cell]) -> list[str]:
    """Detectors whose estimator broke down."""
    told = [f"{c.detector} {share:.1%}" for c in cells if (share := float(c["diverged"].mean())) > 0]
    return [f"Runs in which the estimator broke down: {'; '.join(told)}."] if told else []


def overview_caption(settings: Settings, cells: Cells) -> str:
    """What to see."""
    best = {plant: names_most(settings, of_plant(cells, plant)) for plant, _ in cells}
    told = "; ".join(f"{plant}: {name}" for plant, name in best.items() if name is not None)
    return (
        "At the common rate of false alarms. Blue: more is better; orange: less is; grey: cannot run; what spans decades is "
        f"coloured by them. Read a detector along its row: who names most ({told or 'unknown'}) need not be who blames least."
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
