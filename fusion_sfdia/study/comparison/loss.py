"""The loss of a detector: missed faults, false isolation and delay, with a right and with a wrong model, in one number.

    loss = (1 - w) mean over kinds of (m missed + f false + d late) + w mean over mismatch cases of (m missed + f false)

missed: share of the faulty sensors' samples at which the faulty one is not isolated; false: share of the samples at which a
healthy sensor is isolated; late: share of a fault's samples before the first alarm. Kinds of conditions with the right model:
faults of sensors; process faults, where an alarm is right and isolating a sensor is wrong; missing readings. Mismatch cases
count half healthy and half with a bias, so that a fault missed there weighs half; an alarm there may come from the model, so
no delay is counted. The weights are settings, `COSTS`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.study.comparison.cell import ComparisonCell
from fusion_sfdia.study.comparison.protocol import HEALTHY, PROCESS
from fusion_sfdia.study.experiments.scenario import Settings

Array = NDArray[Any]

MISSED, DELAY = "faulty sensor not isolated", "time to the first alarm"
FALSE, FALSE_IF_WRONG = "healthy sensor isolated, right model", "healthy sensor isolated, wrong model"
PARTS = (MISSED, FALSE, FALSE_IF_WRONG, DELAY)
WRONG_MODEL = "a wrong model"  # the group of the mismatch cases, which share noise and sensor


def loss_parts(cell: ComparisonCell, settings: Settings) -> dict[str, Array]:
    """The parts of the loss, each (C,) over the clusters of `ranking`: its mean is what the part adds."""
    groups: dict[str, list[int]] = {}
    for j in np.flatnonzero(cell["threshold"] == 0).tolist():
        if (kind := WRONG_MODEL if cell["mismatch"][j] else cell.kind(j)) != HEALTHY:
            groups.setdefault(kind, []).append(j)
    wrong = (settings["wrong_model_share"] if len(groups) > 1 else 1.0) if WRONG_MODEL in groups else 0.0
    usual = len(groups) - (WRONG_MODEL in groups)
    found: dict[str, list[Array]] = {part: [] for part in PARTS}
    for kind, rows in groups.items():
        share = wrong if kind == WRONG_MODEL else (1 - wrong) / usual
        for part, values in _of_rows(cell, kind, rows, settings).items():
            found[part].append(len(groups) * share * values.mean(axis=0))
    return {part: np.concatenate([*values, np.empty(0)]) for part, values in found.items()}


def _of_rows(cell: ComparisonCell, kind: str, rows: list[int], settings: Settings) -> Mapping[str, Array]:
    """The parts (J, S) of the conditions of a kind."""
    samples, faulty = cell["samples"][rows], cell["faulty"][rows]
    false = settings["false_isolation_cost"] * cell["falsely_isolated"][rows] / samples
    if kind == WRONG_MODEL:
        parts = {FALSE_IF_WRONG: false}
    else:
        parts = {FALSE: false}
        if kind != "dropout":
            parts[DELAY] = settings["delay_cost"] * np.minimum(cell["first"][rows], samples) / samples
    if kind not in (PROCESS, "dropout"):
        unseen = np.divide(faulty - cell["right"][rows], faulty, out=np.zeros(faulty.shape), where=faulty > 0)
        parts[MISSED] = settings["missed_cost"] * unseen
    return {part: parts.get(part, np.zeros(samples.shape)) for part in PARTS}


def loss(cell: ComparisonCell, settings: Settings) -> Array:
    """The loss (C,) by cluster."""
    return np.asarray(sum(loss_parts(cell, settings).values()))


def cheaper_elsewhere(cells: Mapping[str, ComparisonCell], settings: Settings, name: str) -> dict[str, tuple[float, float]]:
    """At which shares of wrong models, from and to, other detectors than `name` have the least loss.

    Over the share a loss is a straight line, so the least of all changes at crossings, which are found exactly.
    """
    if not any(cell.mismatches for cell in cells.values()):
        return {}
    ends = {d: [float(loss(c, {**settings, "wrong_model_share": w}).mean()) for w in (0.0, 1.0)] for d, c in cells.items()}
    at, here = 0.0, min(ends, key=lambda d: (ends[d][0], ends[d][1], d != name))
    found = {}
    while True:
        right, wrong = ends[here]
        crossings = {
            d: (r - right) / (r - right + wrong - w) for d, (r, w) in ends.items() if r - right + wrong - w > 0 and wrong > w
        }
        following = min(((x, ends[d][1], d != name, d) for d, x in crossings.items() if x >= at), default=(1.0, 0.0, False, ""))
        if here != name and following[0] > at:
            found[here] = (at, following[0])
        if not following[3]:
            return found
        at, *_, here = following
