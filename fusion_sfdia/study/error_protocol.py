"""The cases of an audit: which errors of readings, starts, model errors and causes, and the trial that a seed makes of each.

Every case is judged from the first row on, with the thresholds that the detector has. Causes begin after a third of the rows
and last a third, so that a repair is seen, too; nothing else is chosen.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.covariance import diagonal
from fusion_sfdia.common.random_streams import stream
from fusion_sfdia.diagnosis.fault_effects import apply_faults
from fusion_sfdia.diagnosis.faults import Fault
from fusion_sfdia.diagnosis.simulate import Recording, simulate
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.study.cases import ComparisonCases, MismatchCase, ProcessFaultCase, case_readings
from fusion_sfdia.study.errors import READING_ERRORS, ReadingError
from fusion_sfdia.study.truths import Variation, declared, varied

Array = NDArray[Any]

STEPS = 300  # rows of a trial
CORNER = 2.0  # standard deviations
CHANGE = 4.0  # standard deviations of a declared unknown: a process fault
UNDECLARED = 0.05  # relative error of the rate of a state's equation
AS_STATED = READING_ERRORS[0]
GROUPS = ("readings", "start", "model", "cause")
OF_PLANT = "plant"  # group of the cases that stand beside a plant


@dataclass(frozen=True)
class Case:
    """An error or a cause: group and name, in words, and what differs from a healthy plant that is as stated.

    readings: how the readings err. start: "nominal", "sampled" from the initial covariance, or at a "corner", `CORNER` standard
    deviations of each state away. off: how many declared unknowns are `CORNER` standard deviations off throughout (-1: all).
    undeclared: relative error of the rate of one state. sensors: kind and size (sigma) of the fault of each sensor that fails.
    process: the profile of a change of one declared unknown by `CHANGE` standard deviations, "" for none. stated: a mismatch
    case or a process fault that stands beside the plant, which then gives the truth; a process fault lasts to the end. lead:
    rows by which the process changes before the sensors' faults.
    """

    group: str
    name: str
    about: str
    readings: ReadingError = AS_STATED
    start: str = "nominal"
    off: int = 0
    undeclared: float = 0.0
    sensors: tuple[tuple[str, float], ...] = ()
    process: str = ""
    lead: int = 0
    stated: MismatchCase | ProcessFaultCase | None = None

    @property
    def model_is_off(self) -> bool:
        """Whether the model differs from the truth throughout, so that a verdict on the process is as right as none."""
        return bool(self.off or self.undeclared) or isinstance(self.stated, MismatchCase)


BIAS = (("bias", 10.0),)
SLOW_NOISE = next(e for e in READING_ERRORS if e.name == "ar-0.8")
CASES = (
    *(Case("readings", e.name, e.about, readings=e) for e in READING_ERRORS),
    Case("start", "start-sampled", "states drawn from the stated initial covariance", start="sampled"),
    Case("start", "start-at-corner", "each state 2 standard deviations from the stated start", start="corner"),
    Case("model", "one-unknown-off", "a declared unknown 2 standard deviations off", off=1),
    Case("model", "two-unknowns-off", "two declared unknowns 2 standard deviations off", off=2),
    Case("model", "all-unknowns-off", "all declared unknowns 2 standard deviations off", off=-1),
    Case("model", "undeclared-5-percent", "the rate of a state 5 % off, which is not declared", undeclared=UNDECLARED),
    Case("cause", "bias-3", "bias of 3 sigma", sensors=(("bias", 3.0),)),
    Case("cause", "bias-10", "bias of 10 sigma", sensors=BIAS),
    Case("cause", "bias-30", "bias of 30 sigma", sensors=(("bias", 30.0),)),
    Case("cause", "drift-10", "drift to 10 sigma", sensors=(("drift", 10.0),)),
    Case("cause", "two-biases", "two sensors with a bias of 10 sigma", sensors=BIAS * 2),
    Case("cause", "bias-under-ar-0.8", "bias of 10 sigma, autoregressive noise", SLOW_NOISE, sensors=BIAS),
    *(Case("cause", f"process-{p}", f"a declared unknown changes: {p}", process=p) for p in ("pulse", "step", "ramp")),
    *(Case("cause", f"process-then-bias-{k}", f"a step of a declared unknown, a bias of 10 sigma {k} rows later", sensors=BIAS,
           process="step", lead=k) for k in (0, 5, 30)),
)  # fmt: skip


def stated_cases(cases: ComparisonCases) -> tuple[Case, ...]:
    """What stands beside a plant as cases of the group `OF_PLANT`: its mismatch without a fault, and its process faults."""
    return (
        *(Case(OF_PLANT, f"mismatch: {c.name}", f"mismatch: {c.why}", stated=c) for c in cases.mismatch),
        *(Case(OF_PLANT, f"process fault: {c.name}", f"process fault: {c.why}", stated=c) for c in cases.process_faults),
    )


class ErrorTrial(NamedTuple):
    """A log, and the truth: faulty (K, N), whether the process differs by a fault of it (K,)."""

    log: Log
    faulty: Array
    process: Array


def cases_for(plant: Plant, groups: Sequence[str] = GROUPS) -> tuple[Case, ...]:
    """The cases that a plant can have: those about declared unknowns where it declares any, two sensors where it has three."""
    unknowns = len(declared(plant))
    return tuple(
        c
        for c in CASES
        if c.group in groups
        and not ((c.off or c.process) and not unknowns)
        and c.off <= unknowns
        and not (len(c.sensors) == 2 and len(plant.sensors) < 3)
    )


def trial(
    plant: Plant, case: Case, seed: int, steps: int = STEPS, begin: int | None = None, last: int | None = None
) -> ErrorTrial:
    """The readings of a case on a plant; the same for the same seed. ArithmeticError where the truth leaves its limits.

    begin: rows before the faults of sensors; last: rows that causes last; a third of the steps each unless stated.
    They come from the high-fidelity model of the plant, where it has one, unless parameters, equations or the start differ:
    these are of the plant itself. Process noise acts where the plant states that it acts on the real one (`Truth.disturbed`).
    """
    rng = stream(seed, "study", case.name)
    begin, last = (steps // 3 if rows is None else rows for rows in (begin, last))
    changes_at, length = begin - case.lead, last * plant.dt
    unknowns = declared(plant)
    order = [unknowns[int(j)] for j in rng.permutation(len(unknowns))]
    off = order if case.off < 0 else order[: case.off]
    variations = [Variation(u.name, _signed(rng, CORNER * u.sd)) for u in off]
    if case.process:
        size = _signed(rng, CHANGE * order[0].change)
        variations.append(Variation(order[0].name, size, case.process, changes_at * plant.dt, length))
    rates = np.ones(len(plant.states))
    rates[rng.integers(rates.size)] += _signed(rng, case.undeclared)
    truth: Plant | str = "finer"
    if variations or case.undeclared:
        truth = varied(plant, variations, rates)
    elif case.start != "nominal":
        truth = "model"
    if case.stated is None:
        start = rest_of(truth) if case.start == "rest" and isinstance(truth, Plant) else _start(rng, plant, case.start)
        made = simulate(plant, steps, [seed], truth=truth, process_noise=plant.truth.disturbed, start=start)
    else:
        made = _stated(plant, case.stated, steps, seed, changes_at)
    signal, t = made.signal[:, 0], made.t
    y = case.readings.reading(rng, plant, signal, case.readings.noise(rng, signal.shape))
    faults = [
        Fault(plant.sensor_names[i], kind, float(t[begin]), length, _signed(rng, size * plant.sensor_sigma[i]))
        for i, (kind, size) in zip(rng.permutation(len(plant.sensors))[: len(case.sensors)], case.sensors, strict=True)
    ]
    found = apply_faults(plant, t, y, faults, rng)
    changes = [v for v in variations if v.profile != "constant"]
    process = np.array([any(v.at(k - plant.dt, plant.dt) != 0 for v in changes) for k in t.tolist()])
    if isinstance(case.stated, ProcessFaultCase):
        process |= t > float(t[changes_at]) - plant.dt / 2
    return ErrorTrial(Log(t, found.y, made.u_of_runs[:, 0]), found.active, process)


def _stated(plant: Plant, case: MismatchCase | ProcessFaultCase, steps: int, seed: int, onset: int) -> Recording:
    """The recording of a case that stands beside the plant: mismatch from the first row on, a process fault from a row on."""
    if isinstance(case, MismatchCase):
        inputs = None if case.inputs is None else partial(_inputs_from_start, case.inputs)
        return case_readings(plant, steps, [seed], truth=None if case.truth is None else case.truth(), inputs=inputs)
    begin = (onset - 1e-6) * plant.dt  # with the last healthy reading, but for rounding
    truth = None if case.truth is None else case.truth(begin)
    return case_readings(plant, steps, [seed], truth=truth, lost=None if case.lost is None else (begin, case.lost))


def _inputs_from_start(inputs: Callable[[float, float], Array], t: float) -> Array:
    return inputs(t, 0.0)


def _signed(rng: np.random.Generator, size: float) -> float:
    return float(size * rng.choice([-1.0, 1.0]))


def rest_of(plant: Plant, tolerance: float = 1e-9, most: int = 20_000) -> Array:
    """The states (n,) to which a plant comes from x0 under the input of its start; after `most` steps those that it has."""
    x, u = plant.x0[None], plant.input_at(0.0)[None]
    for _ in range(most):
        before, x = x, plant.step(0.0, x, u, plant.dt)
        if np.all(np.abs(x - before) <= tolerance * np.sqrt(diagonal(plant.initial_cov))):
            break
    return np.asarray(x[0])


def _start(rng: np.random.Generator, plant: Plant, start: str) -> str | Array:
    """Where the truth starts: as `simulate` names it, or each state `CORNER` standard deviations from x0."""
    if start != "corner":
        return start
    spread = np.sqrt(diagonal(plant.initial_cov))
    return plant.guard(plant.x0 + CORNER * spread * rng.choice([-1.0, 1.0], spread.size))[0]
