"""What the report of a comparison opens with: for each plant a sentence to act on, and what the number of seeds decides."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fusion_sfdia.study.comparison.cell import ComparisonCell
from fusion_sfdia.study.comparison.figures import Cells, of_plant
from fusion_sfdia.study.comparison.metric_rows import exact_isolation, under_mismatch, under_process_faults
from fusion_sfdia.study.comparison.protocol import sizes
from fusion_sfdia.study.comparison.ranking import RankedDetector
from fusion_sfdia.study.comparison.result_tables import EVERY, NOT_TRIED, Standings, robustness
from fusion_sfdia.study.experiments.scenario import Settings

MOST_EQUALS = 4  # detectors that are no worse beyond chance, by name
RARELY = 0.01  # of samples: what is less needs no advice


def opening(settings: Settings, cells: Cells, standings: Standings) -> list[str]:
    """A sentence a plant, and what is decided."""
    plants = dict.fromkeys(plant for plant, _ in cells)
    advice = [advised(settings, of_plant(cells, plant), standings.get(plant, {}).get("isolation", {})) for plant in plants]
    return [line for line in (*advice, decided(standings)) if line]


def advised(settings: Settings, cells: Mapping[str, ComparisonCell], isolation: Mapping[str, RankedDetector]) -> str:
    """Which detector to take on a plant, what it does where the model is wrong, and which does better there.

    Of those that nothing beats beyond chance in isolation the one with the largest share of exact isolation; where no two
    differ, the two with the largest shares. Empty where none isolates a faulty sensor, or where no such fault is among the
    conditions.
    """
    exact = {d: exact_isolation(settings, cell) for d, cell in cells.items()}
    best = [d for d in exact if d not in isolation or isolation[d].rank == 1]
    name = max(best, key=lambda d: np.nan_to_num(exact[d].value))
    if not exact[name].value > 0:
        return ""
    cell, (_, large) = cells[name], sizes(settings)
    others = [d for d in best if d != name]
    named = f" (as good: {', '.join(others)})" if 0 < len(others) <= MOST_EQUALS else ""
    share = f"exactly the faulty sensor in {percent(exact[name].value)}"
    if len(isolation) > 1 and all(standing.rank == 1 for standing in isolation.values()):
        second = max(others, key=lambda d: np.nan_to_num(exact[d].value))
        advice = [
            f"{cell.plant}: no detector isolates significantly better than another; {name} and {second} have the highest "
            f"values: under a fault of {large:g} sigma they isolate {share} and {percent(exact[second].value)} of the samples."
        ]
    else:
        advice = [
            f"{cell.plant}: use {name}: no other detector isolates better{named}; under a fault of {large:g} sigma it isolates "
            f"{share} of the samples."
        ]
    if not any(c.mismatches for c in cells.values()):
        advice.append(f"{NOT_TRIED.capitalize()}.")
    mismatch, process = under_mismatch(cell), under_process_faults(cell)
    if mismatch.share.value > RARELY:
        advice.append(
            f"With a wrong model ({mismatch.case}) {name} isolates a healthy sensor in {percent(mismatch.share.value)} of "
            "the samples"
        )
        robust = max(cells, key=lambda d: np.nan_to_num(robustness(settings, cells[d])))
        less = under_mismatch(cells[robust]).share.value
        better = robust != name and less < mismatch.share.value / 2
        advice[-1] += f"; {robust} in {percent(less)}, and the faulty one in {percent(exact[robust].value)}." if better else "."
    if process.share.value > RARELY:
        advice.append(
            f"It attributes a process fault ({process.case}) to a sensor in {percent(process.share.value)} of the samples."
        )
    return " ".join(advice)


def decided(standings: Standings) -> str:
    """How many pairs of detectors differ beyond chance on each plant: a rank counts those that are better."""
    told = []
    for plant, criteria in standings.items():
        if plant != EVERY and (found := criteria.get("isolation", {})):
            pairs = len(found) * (len(found) - 1) // 2
            counts = [sum(s.rank - 1 for s in criteria.get(c, {}).values()) for c in ("detection", "isolation")]
            told.append(f"{plant} {counts[0]} and {counts[1]} of {pairs}")
    return f"Pairs of detectors that differ significantly, in detection and in isolation: {'; '.join(told)}." if told else ""


def percent(share: float) -> str:
    """A share for people: without decimals, "under 1 %" for what would round to none."""
    return "under 1 %" if 0 < share < 0.005 else f"{100 * share:.0f} %"
