"""`inspect`: what can be diagnosed with a plant, before any fault."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from typing import Any, TypeVar

import numpy as np

from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.kalman_banks.identifiability import CONFOUNDED, IdentifiabilityResult, identifiability
from fusion_sfdia.learning.inspection.cost import cost, of_cost, of_waiting, waiting
from fusion_sfdia.learning.inspection.detectability import DETECTORS, GROWTH, Tried, promised, tried
from fusion_sfdia.learning.inspection.healthy import feedthrough, of_feedthrough, of_healthy, on_healthy
from fusion_sfdia.learning.inspection.inspection import Inspection
from fusion_sfdia.learning.inspection.observability import observability, of_readings
from fusion_sfdia.learning.inspection.plant_findings import MISTAKE, REMARK, PlantFinding, mistakes, not_analytic
from fusion_sfdia.learning.inspection.stepping import of_start, of_step, stepping
from fusion_sfdia.learning.inspection.structure import of_structure, structural
from fusion_sfdia.learning.inspection.turns import beyond_a_turn, of_turns, turns
from fusion_sfdia.logs.log_forms import as_log
from fusion_sfdia.plant.log import one_run
from fusion_sfdia.plant.plant import Plant

T = TypeVar("T")
SMALL, MIDDLE = 16, 80  # sensors: up to SMALL all are simulated with all detectors, up to MIDDLE four with the fast ones
FAST = ("loo-glr", "chebyshev", "pca")
LATE = 0.1  # share of healthy samples in which a detector isolates a sensor, above which its results mean little


def inspect(
    plant: Any,
    healthy: Any = None,
    *,
    detectors: Sequence[Any] | None = None,
    sensors: Sequence[str] | None = None,
    simulated: bool = True,
    tuned: registry.NamedDetector | None = None,
    each: Callable[[Sequence[Any]], Iterable[Any]] = iter,
) -> Inspection:
    """Examine a plant: mistakes in its model, its step, observability and redundancy, and which sensor faults are found by
    which detector, from what size and after how long, by theory and in simulated runs.

    With mistakes nothing further is examined: results would be those of another plant.

    Parameters
    ----------
    plant : Plant, str or callable
        As in `registry.find_plant`.
    healthy : Log, Recording, frame or tuple, optional
        Readings of the real plant in order, as `as_log` takes them.
    detectors : sequence, optional
        Those of the simulated runs, by default one of each school.
    sensors : sequence of str, optional
        Those with a fault. Up to 16 sensors all are tried, up to 80 four with the fast detectors, of more none, unless they are
        named.
    simulated : bool, default True
        False leaves the runs out.
    tuned : NamedDetector, optional
        A detector with thresholds for the real plant, which is tried first, in place of the one that is registered by its name,
        and judged on `healthy`.
    each : callable, default iter
        Wraps the detectors of the runs, to show progress.

    Returns
    -------
    Inspection
        str(...) of it is the report.

    Raises
    ------
    ValueError
        For unknown names, and for data that do not fit.

    Examples
    --------
    >>> from fusion_sfdia import inspect
    >>> found = inspect("two-tanks", simulated=False)
    >>> found.mistakes, found.kept_out
    ((), ())
    """
    found = registry.plant(plant)
    chosen = _sensors(found) if sensors is None else tuple(sensors)
    for name in chosen:
        found.sensor_index(name)
    wrong = tuple(mistakes(found))
    if wrong:
        return Inspection(found, (*_unstable(found), *wrong))
    log = None if healthy is None else one_run(as_log(found, healthy))
    remarks: list[PlantFinding] = [*of_start(found), *not_analytic(found), *of_turns(turns(found)), *beyond_a_turn(found)]
    step = stepping(found)
    remarks += of_step(found, step)
    remarks += of_cost(found, cost(found))
    remarks += of_waiting(found, waiting(found, log))
    readings = _attempt(partial(observability, found), "observability", remarks)
    remarks += [] if readings is None else of_readings(found, readings)
    theory, promise = None, None
    if len(found.sensors) <= MIDDLE:
        theory = _attempt(partial(identifiability, found, GROWTH), "theory", remarks)
        promise = None if theory is None else _attempt(partial(promised, found, theory), "promises", remarks)
        remarks += [] if theory is None else of_theory(theory)
    pattern = structural(found)
    remarks += of_structure(pattern)
    runs: tuple[Tried, ...] = ()
    if simulated and chosen:
        usual = DETECTORS if len(found.sensors) <= SMALL else FAST
        entries = [registry.find_detector(what) for what in (usual if detectors is None else detectors)]
        entries = entries if tuned is None else [tuned, *(entry for entry in entries if entry.name != tuned.name)]
        runs = _attempt(partial(tried, found, each(entries), chosen), "simulation", remarks) or ()
        remarks += of_runs(runs, 0 if readings is None else readings.redundancy.faults)
    of_log = None if log is None else on_healthy(found, log, tuned or registry.find_detector(DETECTORS[0]))
    remarks += [] if of_log is None else of_healthy(found, of_log)
    remarks += [] if log is None else of_feedthrough(found, feedthrough(found, log))
    findings = sorted(remarks, key=lambda f: f.kind != MISTAKE)
    return Inspection(found, tuple(findings), _derivatives(found), step, readings, theory, promise, runs, pattern, of_log)


def _unstable(plant: Plant) -> Iterator[PlantFinding]:
    """That the step is unstable, which may be the cause of other mistakes."""
    try:
        step = stepping(plant)
    except Exception:  # whatever a wrong model raises is among its mistakes
        return
    yield from (f for f in of_step(plant, step) if f.kind == MISTAKE)


def _attempt(examine: Callable[[], T], about: str, remarks: list[PlantFinding]) -> T | None:
    """The result, or None with a remark where the plant has no numbers for it."""
    try:
        return examine()
    except (ArithmeticError, np.linalg.LinAlgError) as error:
        remarks.append(PlantFinding(REMARK, about, f"not examined: {error}"))
        return None


def _sensors(plant: Plant) -> tuple[str, ...]:
    """The sensors whose faults are simulated: all, or the first of each of four quantities, or none."""
    if len(plant.sensors) <= SMALL:
        return plant.sensor_names
    if len(plant.sensors) > MIDDLE:
        return ()
    return tuple(plant.sensor_names[members[len(members) // 2]] for members in list(plant.quantities.values())[:4])


def _derivatives(plant: Plant) -> tuple[str, str]:
    given = plant.numerics.step_jacobian, plant.numerics.output_jacobian
    step, output = (
        "given by the plant" if jacobian is not None else "complex step, exact" if holds else "differences"
        for jacobian, holds in zip(given, plant._complex_step_holds, strict=True)
    )
    return step, output


def of_theory(theory: IdentifiabilityResult) -> Iterator[PlantFinding]:
    """Sensors whose fault looks like an error of the model, or like the fault of another sensor."""
    for text in theory.warnings:
        about, _, what = text.partition(": ")
        yield PlantFinding(REMARK, about, what)
    between = np.abs(theory.between) - np.eye(len(theory.sensors))
    for i, j in zip(*np.nonzero(np.triu(between > CONFOUNDED)), strict=True):
        yield PlantFinding(
            REMARK,
            f"{theory.sensors[i]}, {theory.sensors[j]}",
            f"a bias of one looks like a bias of the other (rho {theory.between[i, j]:+.2f}): that they disagree is seen, "
            "which one is wrong hardly; a third reading of the quantity decides",
        )


def of_runs(runs: tuple[Tried, ...], faults: int) -> Iterator[PlantFinding]:
    """False alarms, fewer sensors at once than the `faults` that the plant allows, and sensors that were not used again."""
    for of in runs:
        if 0 < of.most_faults < faults:
            yield PlantFinding(
                REMARK,
                of.detector,
                f"isolates at most {of.most_faults} sensor{'s' * (of.most_faults != 1)} at once, where the plant allows "
                f"{faults}: of more faults it misses some, or names others; use another one where faults come together",
            )
        if of.healthy > LATE:
            yield PlantFinding(
                REMARK,
                of.detector,
                f"isolates a sensor in {of.healthy:.0%} of the healthy samples of simulated runs: its results mean little; "
                "use another one",
            )
    kept = {name: [of.detector for of in runs if name in of.kept_out] for of in runs for name in of.kept_out}
    for by in dict.fromkeys(map(tuple, kept.values())):
        names = [name for name, those in kept.items() if tuple(those) == by]
        yield PlantFinding(
            REMARK,
            ", ".join(names) if len(names) < 5 else f"{len(names)} sensors",
            f"once isolated, not used again by {', '.join(by)} although the fault is over: after a repair call "
            "state = detector.readmit(state, sensor)",
        )
