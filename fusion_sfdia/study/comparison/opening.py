"""What the report of a comparison opens with: for each plant which detector costs least and where another is better."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fusion_sfdia.study.comparison.cell import ComparisonCell
from fusion_sfdia.study.comparison.figures import Cells, of_plant
from fusion_sfdia.study.comparison.loss import cheaper_elsewhere
from fusion_sfdia.study.comparison.metric_rows import exact_isolation, under_mismatch, under_process_faults
from fusion_sfdia.study.comparison.protocol import sizes
from fusion_sfdia.study.comparison.ranking import LOSS, RankedDetector
from fusion_sfdia.study.comparison.result_tables import EVERY, NOT_TRIED, Standings
from fusion_sfdia.study.experiments.scenario import Settings

MOST_EQUALS = 4  # detectors that are no worse beyond chance, by name
RARELY = 0.01  # of samples: what is less needs no advice


def opening(settings: Settings, cells: Cells, standings: Standings) -> list[str]:
    """A paragraph a plant, and what the number of seeds decides."""
    plants = dict.fromkeys(plant for plant, _ in cells)
    advice = [advised(settings, of_plant(cells, p), standings[p][LOSS]) for p in plants if p in standings]
    return [line for line in (*advice, decided(standings)) if line]


def advised(settings: Settings, cells: Mapping[str, ComparisonCell], ranked: Mapping[str, RankedDetector]) -> str:
    """Which detector costs least on a plant, where another does, and what it still gets wrong.

    Empty where no detector isolates a faulty sensor, or where no such fault is among the conditions.
    """
    exact = {d: exact_isolation(settings, cells[d]) for d in ranked}
    if not any(e.value > 0 for e in exact.values()):
        return ""
    name = min(ranked, key=lambda d: ranked[d].mean.value)
    cell, (_, large) = cells[name], sizes(settings)
    equals = [d for d in ranked if d != name and ranked[d].rank == 1]
    equal = f" (no worse beyond chance: {', '.join(equals)})" if 0 < len(equals) <= MOST_EQUALS else ""
    if 1 < len(ranked) == len(equals) + 1:
        equal = "; no other is worse beyond chance"
    advice = [f"{cell.plant}: {name} has the least loss, {ranked[name].mean.value:.2f}{equal}."]
    for other, (low, high) in cheaper_elsewhere({d: cells[d] for d in ranked}, settings, name).items():
        if low == 0:
            where = f"less than {100 * high:.3g} %"
        else:
            where = f"more than {100 * low:.3g} %" if high == 1 else f"between {100 * low:.3g} and {100 * high:.3g} %"
        advice.append(f"{other} would have the least if the model were wrong {where} of the time.")
    most = max(exact, key=lambda d: np.nan_to_num(exact[d].value))
    more = f"; most exact is {most}, {percent(exact[most].value)}" if exact[most].value > exact[name].value else ""
    advice.append(
        f"With the right model {name} isolates exactly the faulty sensor in {percent(exact[name].value)} of the samples of a "
        f"fault of {large:g} sigma{more}."
    )
    if not any(c.mismatches for c in cells.values()):
        advice.append(f"{NOT_TRIED.capitalize()}.")
    for what, (share, case) in (("model mismatch", under_mismatch(cell)), ("process fault", under_process_faults(cell))):
        if share.value > RARELY:
            advice.append(
                f"Under the worst {what} ({case}) {name} isolates a healthy sensor in {percent(share.value)} of the samples."
            )
    return " ".join(advice)


def decided(standings: Standings) -> str:
    """How many pairs of detectors differ in loss beyond chance on each plant: a rank counts those that are better."""
    counts = {plant: criteria[LOSS] for plant, criteria in standings.items() if plant != EVERY}
    pairs = [f"{p} {sum(s.rank - 1 for s in of.values())} of {len(of) * (len(of) - 1) // 2}" for p, of in counts.items()]
    return f"Pairs of detectors whose losses differ beyond chance: {'; '.join(pairs)}." if pairs else ""


def percent(share: float) -> str:
    """A share for people: without decimals, "under 1 %" for what would round to none."""
    return "under 1 %" if 0 < share < 0.005 else f"{100 * share:.0f} %"
