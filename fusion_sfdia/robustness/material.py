"""Readings of `robustness`: healthy trunks of every truth, the conditions that branch off them, and healthy logs."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.comparison.branches import Run, branch
from fusion_sfdia.comparison.protocol import PROCESS
from fusion_sfdia.comparison.recordings import mismatched, simulated
from fusion_sfdia.comparison.records import BranchReadings
from fusion_sfdia.comparison.subjects import ComparedPlant, cases_of, plant_of
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.evaluation.cases import MismatchCase, ProcessFaultCase
from fusion_sfdia.evaluation.simulate import Recording
from fusion_sfdia.experiments.scenario import Task
from fusion_sfdia.robustness.protocol import FIRST_LOG, LOG_RUNS, LONG, Condition, conditions, log_steps, settle_of

Array = NDArray[Any]


class Branched(NamedTuple):
    """The readings of a condition from the onset on: t (L,), and of the first S seeds (L, S, ...)."""

    condition: Condition
    t: Array
    readings: BranchReadings


class Truth(NamedTuple):
    """What happens in one world: its mismatch case ("" for the right model), readings before the onset, and after it.

    t (settle,), y (settle, S, N), u (settle, S, m).
    """

    mismatch: str
    t: Array
    y: Array
    u: Array
    branches: tuple[Branched, ...]


@lru_cache(maxsize=2)
def material(of: ComparedPlant, key: str) -> tuple[Truth, ...]:
    """Every truth of a plant for a task (JSON), the right model first: the same for all variants in one operation."""
    task, cases = json.loads(key), cases_of(of)
    found = conditions(task, cases)
    return tuple(truth(of, task, [c for c in found if c.mismatch == name]) for name in dict.fromkeys(c.mismatch for c in found))


def truth(of: ComparedPlant, task: Task, members: Sequence[Condition]) -> Truth:
    """The trunk of a truth and its branches."""
    settle, seeds, window = settle_of(cases_of(of)), tuple(task["seeds"]), int(task["window"])
    trunk = healthy_readings(of, task, members[0].mismatch, settle + max(c.length for c in members))
    branches = []
    for c in members:
        source = failing(of, task, c) if c.fault.kind == PROCESS else trunk
        count = len(seeds) if c.length <= LONG else -(-len(seeds) // 2)
        runs = [Run(c.fault, b, settle, c.length) for b in range(count)]
        parts = [branch(plant_of(of), source, run.b, run, window) for run in runs]
        readings = BranchReadings(*(np.stack(fields, axis=1) for fields in zip(*parts, strict=True)))
        branches.append(Branched(c, trunk.t[settle : settle + c.length], readings))
    return Truth(members[0].mismatch, trunk.t[:settle], trunk.y[:settle], trunk.u_of_runs[:settle], tuple(branches))


def healthy_readings(of: ComparedPlant, task: Task, mismatch: str, steps: int) -> Recording:
    """Healthy readings of the right model or of a mismatch case, in the operation of the task."""
    cases, start = cases_of(of), settle_of(cases_of(of)) * plant_of(of).dt
    case = next((c for c in cases.mismatch if c.name == mismatch), MismatchCase("", ""))
    if task["other_operation"] and case.inputs is None:
        case = case._replace(inputs=cases.other_operation)
    return mismatched(of, case, steps, task["seeds"], start)


def failing(of: ComparedPlant, task: Task, condition: Condition) -> Recording:
    """Readings of a plant with a process fault from the onset on, in the operation of the task."""
    cases, plant, fault = cases_of(of), plant_of(of), condition.fault.case
    assert isinstance(fault, ProcessFaultCase)
    settle = settle_of(cases)
    begin = (settle - 1e-6) * plant.dt  # with the last healthy reading, but for rounding
    inputs = partial(_from_start, cases.other_operation, settle * plant.dt) if task["other_operation"] else None
    truth = None if fault.truth is None else fault.truth(begin)
    lost = None if fault.lost is None else (begin, fault.lost)
    return simulated(of, settle + condition.length, task["seeds"], truth=truth, inputs=inputs, lost=lost)


def _from_start(inputs: Any, start: float, t: float) -> Array:
    return np.asarray(inputs(t, start))


@lru_cache(maxsize=16)
def healthy_log(of: ComparedPlant, mismatch: str) -> Recording:
    """A healthy log of the real plant in the usual operation: LOG_RUNS runs; see `log_steps` and `logged`."""
    make, seeds = logged(of, mismatch), tuple(range(FIRST_LOG, FIRST_LOG + LOG_RUNS))
    truth = None if make is None else make()
    return simulated(of, log_steps(cases_of(of)), seeds, truth=truth, inputs=plant_of(of).input_at)


def logged(of: ComparedPlant, mismatch: str) -> Callable[[], Plant] | None:
    """What makes the plant of the healthy log of a mismatch case; None where that is the usual plant."""
    case = next((c for c in cases_of(of).mismatch if c.name == mismatch), MismatchCase("", ""))
    return case.truth if case.log is None else case.log
