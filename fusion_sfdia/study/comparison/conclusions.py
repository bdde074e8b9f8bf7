"""What a comparison shows, in sentences filled from its numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from fusion_sfdia.report.scenario_sentences import span
from fusion_sfdia.study.comparison.cell import Cells, ComparisonCell, of_plant
from fusion_sfdia.study.comparison.loss import cheaper_elsewhere
from fusion_sfdia.study.comparison.metric_rows import (
    detected_share,
    exact_isolation,
    under_mismatch,
    under_process_faults,
)
from fusion_sfdia.study.comparison.protocol import length_name, sizes, stated_error
from fusion_sfdia.study.comparison.ranking import LOSS, RankedDetector
from fusion_sfdia.study.comparison.recordings import stated_distance
from fusion_sfdia.study.comparison.result_tables import EVERY, NOT_TRIED, Standings
from fusion_sfdia.study.experiments.scenario import Settings

MOST_LISTED = 9  # detectors by name in a sentence
RARELY = 0.01  # of samples: what is less is not reported
MOST_EQUALS = 4  # detectors that are no worse beyond chance, by name
AUDIT = (
    "These are faults in the noise that a plant states. What other noise, starts, model errors and causes do to a detector, "
    "live from the first row, fusion-sfdia audit tries on any plant."
)


def findings(settings: Settings, cells: Cells) -> list[str]:
    """What is found over all plants."""
    return [*shortest(settings, cells), *broken_claims(list(cells.values()))]


def shortest(settings: Settings, cells: Cells) -> list[str]:
    """The detectors with the largest areas under the ROC for the shortest and the longest of the small biases."""
    if len(settings["lengths"]) < 2 or "bias" not in settings["faults"]:
        return []
    small, _ = sizes(settings)
    short, long = (length_name(small, n) for n in (min(settings["lengths"]), max(settings["lengths"])))
    lines = []
    for plant in dict.fromkeys(p for p, _ in cells):
        there = of_plant(cells, plant)
        first, last = (max(there, key=lambda d: there[d].areas[name].value) for name in (short, long))
        values = [f"{there[d].areas[name].value:.3f}" for d, name in ((first, short), (last, short), (last, long))]
        also = "" if first == last else f" ({last} {values[1]})"
        lines.append(f"{plant}: {first} {values[0]}{also}, {last} {values[2]}")
    return [
        f"A bias of {small:g} sigma of {min(settings['lengths'])} and of {max(settings['lengths'])} samples, largest areas "
        f"under the ROC: {'; '.join(lines)}."
    ]


def plant_findings(settings: Settings, cells: Mapping[str, ComparisonCell]) -> list[str]:
    """The findings on one plant."""
    plant, known = next(iter(cells.values())).plant, list(cells.values())
    return [
        *missed(settings, known),
        *false_isolations(plant, cells),
        *broken_claims(known),
        *excess_alarms(known),
        *divergences(known),
    ]


def broken_claims(cells: Sequence[ComparisonCell]) -> list[str]:
    """Which detectors are shown to alarm more often at their own threshold than they claim; repeated cells count once."""
    claimed = distinct([cell for cell in cells if np.isfinite(cell["claim"])])
    if not claimed:
        return []
    broken = [cell for cell in claimed if cell.nominal.low > float(cell["claim"])]
    which = "; ".join(
        f"{c.detector} on {c.plant} {span([c.nominal.value])} (claims {span([float(c['claim'])])})" for c in broken
    )
    every = sum(bool(np.isfinite(cell["claim"])) for cell in cells)
    repeated = f", {every - len(claimed)} more repeat another with the same scores" if every > len(claimed) else ""
    more = f" These exceed it: {which}." if broken else ""
    return [
        f"At its own thresholds, {len(claimed) - len(broken)} of {len(claimed)} pairs of plant and detector that claim a rate "
        f"of false alarms keep it within the interval{repeated}.{more}"
    ]


def distinct(cells: Sequence[ComparisonCell]) -> list[ComparisonCell]:
    """The cells without those that claim the same and score the same on healthy readings of the plant as an earlier one."""
    found: list[ComparisonCell] = []
    for cell in cells:
        same = (c for c in found if c.plant == cell.plant and float(c["claim"]) == float(cell["claim"]))
        if not any(np.allclose(c["trunk"], cell["trunk"], rtol=1e-6) for c in same):
            found.append(cell)
    return found


def excess_alarms(cells: Sequence[ComparisonCell]) -> list[str]:
    """Which detectors alarm on healthy readings in spite of the common threshold: where alarms last, or runs differ."""
    often = [c for c in cells if c.deployed.value > RARELY]
    which = [f"{c.detector} {c.deployed.value:.1%} ({c.matched.value:.2%} before anything is isolated)" for c in often]
    return [f"Healthy samples with an alarm as deployed: {'; '.join(which)}; the others {RARELY:.0%} at most."] if which else []


def false_isolations(plant: str, cells: Mapping[str, ComparisonCell]) -> list[str]:
    """Which detectors isolate healthy sensors under model mismatch and process faults, and which do not."""
    found = []
    for under, worst in (("mismatch case", under_mismatch), ("process fault", under_process_faults)):
        shares = {d: v for d, c in cells.items() if np.isfinite(v := worst(c).share.value)}
        groups = {
            "in most samples": [f"{d} {v:.0%}" for d, v in shares.items() if v > 0.5],
            "in some": [f"{d} {v:.0%}" for d, v in shares.items() if RARELY < v <= 0.5],
            "in 1 % of them at most": [d for d, v in shares.items() if v <= RARELY],
        }
        listed = "; ".join(f"{how}: {listing(names, len(shares))}" for how, names in groups.items() if names)
        found += [f"False isolation under the worst {under} of {plant}, {listed}."] if shares else []
    return found


def listing(names: Sequence[str], among: int) -> str:
    """Names, or how many they are where they are too many to read."""
    return ", ".join(names) if len(names) <= MOST_LISTED else f"{len(names)} of {among} detectors"


def missed(settings: Settings, cells: Sequence[ComparisonCell]) -> list[str]:
    """Cells that miss most of the large faults, which no average should hide."""
    _, large = sizes(settings)
    which = [f"{c.detector} {share:.0%}" for c in cells if (share := detected_share(settings, c)) < 0.5]
    return [f"Less than half of the runs with a fault of {large:g} sigma raise an alarm: {'; '.join(which)}."] if which else []


def remarks(settings: Settings, cells: Cells) -> list[str]:
    """How to read the numbers."""
    rate = settings["false_alarm"]
    counts = {cell.plant: cell["nominal_alarms"].size * int(cell["calibration_samples"]) for cell in cells.values()}
    aims = span(stated_error(settings, samples) for samples in counts.values())
    matched = span(cell.matched.value for cell in cells.values())
    deployed = span(cell.deployed.value for cell in cells.values())
    chance = span(cell.chance for cell in cells.values())
    scales = span(cell.scale for cell in cells.values())
    errors = span(cell.calibration_error for cell in cells.values())
    above = [c for c in cells.values() if c.matched.low > rate]
    which = "; ".join(f"{c.detector} on {c.plant} {span([c.matched.value])}" for c in above)
    return [
        f"Every detector's thresholds are multiplied by one number ({scales}) so that {rate:g} of healthy samples alarm: an "
        f"order statistic of {span(counts.values())} healthy samples of other seeds. Were they independent, the standard error "
        f"of the rate would be {aims} of it. They are not: by the differences between runs it is {errors} of it. "
        "Intervals of what depends on the threshold contain that.",
        f"Audit on fresh seeds: on the healthy trunks {matched} of the samples alarm as long as nothing has been isolated; "
        f"{f'shown to exceed {rate:g}: {which}' if which else f'no cell is shown to exceed {rate:g}'}. As deployed, where some "
        f"alarms last, {deployed} have an alarm. Of healthy windows of {settings['window']} samples, as long as most faults, "
        f"{chance} have one by chance.",
        "The order of the kinds of faults is drawn for each seed, so that each occurs in all phases of the operation; all "
        "sensors fail in turn. Ranks hold for the thresholds as they were set.",
        "Receiver operating characteristics are those of silent detectors, which isolate and replace nothing; all else is of "
        "deployed ones, which have not alarmed yet when a fault begins. All faults of sensors are among the runs that rank "
        "detectors.",
        f"Readings come from a truth that differs from the detectors' model by, at most, without noise: {truths(cells)}. Where "
        "it does not differ, a simulation alone predicts them exactly: see the results under model mismatch. A plant "
        "with controllers is run in closed loop. What learns from healthy recordings learns from runs of the same truth, of "
        "other seeds; the thresholds that the paper's banks start from are set on runs of the model.",
    ]


def truths(cells: Cells) -> str:
    """How far the truth is from the model, by plant."""
    return "; ".join(f"{plant.name} {stated_distance(plant)}" for plant in dict.fromkeys(c.subject for c in cells.values()))


def left_out(cells: Cells, whole: Cells) -> list[str]:
    """Which cells are not ranked."""
    which = [f"{detector} on {plant}" for plant, detector in cells if (plant, detector) not in whole]
    return [f"Left out of the ranks, since a piece of their work failed: {', '.join(which)}."] if which else []


def absent(settings: Settings, cells: Cells, reasons: Mapping[tuple[str, str], str]) -> list[str]:
    """Plants on which no detector ran, and why."""
    there = {plant for plant, _ in cells}
    which = {plant: "; ".join(dict.fromkeys(of_plant(reasons, plant).values())) for plant in settings["plants"]}
    return [f"No detector ran on {p}: {why.rstrip('.') or 'all work failed'}." for p, why in which.items() if p not in there]


def divergences(cells: Sequence[ComparisonCell]) -> list[str]:
    """Detectors whose estimator diverged."""
    which = [f"{c.detector} {share:.1%}" for c in cells if (share := float(c["diverged"].mean())) > 0]
    return [f"Runs in which the estimator diverged: {'; '.join(which)}."] if which else []


def opening(settings: Settings, cells: Cells, standings: Standings) -> list[str]:
    """A paragraph a plant, what the number of seeds decides, and what is not tried here."""
    plants = dict.fromkeys(plant for plant, _ in cells)
    advice = [advised(settings, of_plant(cells, p), standings[p][LOSS]) for p in plants if p in standings]
    said = [line for line in (*advice, decided(standings)) if line]
    return [*said, AUDIT] if said else []


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
