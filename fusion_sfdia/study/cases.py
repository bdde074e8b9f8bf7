"""What a comparison tries on one plant beside generic sensor faults, as data that stands beside the plant.

A plant's folder has a module `comparison` whose CASES is a `ComparisonCases`; a plant in a single file has CASES in that file.
A plant without them is compared without them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.diagnosis.faults import Fault
from fusion_sfdia.diagnosis.simulate import Recording, simulate
from fusion_sfdia.plant.plant import Finer, Plant
from fusion_sfdia.report.results import Published

Array = NDArray[Any]

USUAL_SETTLE = 100  # samples


class MismatchCase(NamedTuple):
    """Healthy readings that the detectors' model does not predict: of another plant, or in another operation.

    Attributes
    ----------
    name : str
        Of the case.
    why : str
        What happens to real plants, and why by so much.
    truth : callable or None
        truth(): the plant that makes the readings, in its operation; None for the usual one.
    inputs : callable or None
        inputs(t, start): the inputs (m,) that act from t (s) on, if readings are judged from `start` (s) on; None for the usual
        ones.
    log : callable or None
        log(): the plant that made a healthy log, where it is not that of the readings.
    unseen : bool
        No setting of any detector was chosen with this case in view; the comparison leaves it to the scenario `robustness`.

    Examples
    --------
    See `ComparisonCases`.
    """

    name: str
    why: str
    truth: Callable[[], Plant] | None = None
    inputs: Callable[[float, float], Array] | None = None
    log: Callable[[], Plant] | None = None
    unseen: bool = False


class ProcessFaultCase(NamedTuple):
    """A fault of the process, not of a sensor.

    Attributes
    ----------
    name : str
        Of the case.
    why : str
        What happens to real plants.
    truth : callable or None
        truth(onset): the plant that fails at `onset` (s), in its operation.
    lost : tuple of float (m,) or None
        Instead of it, factors by which the acting inputs differ from the known ones from the onset on.
    named : tuple of str
        What a right verdict may name, parameters, inputs or states of the plant; several where they are physically the same.

    Examples
    --------
    See `ComparisonCases`.
    """

    name: str
    why: str
    truth: Callable[[float], Plant] | None = None
    lost: tuple[float, ...] | None = None
    named: tuple[str, ...] = ()


class PaperFault(NamedTuple):
    """A sensor fault of a paper.

    Attributes
    ----------
    name : str
        Of the fault.
    about : str
        A description in a line.
    make : callable
        make(plant, sensor, seed, onset, length in s) -> Fault.
    sensor : str or None
        The one it is of, None for any.

    Examples
    --------
    See `ComparisonCases`.
    """

    name: str
    about: str
    make: Callable[[Plant, str, int, float, float], Fault]
    sensor: str | None = None


class PublishedDelay(NamedTuple):
    """A detection delay as a paper takes it.

    until: the alarm that ends it: "first" of any residual, "own" of a residual of the faulty sensor, or "confirmed", the third
    in a row. quantity and condition: the names of its row in metrics.csv. value: the delay in s.
    """

    until: str
    quantity: str
    condition: str
    value: Published


def _none_published(*names: str) -> None:
    """Nothing is published of anything."""


@dataclass(frozen=True)
class ComparisonCases:
    """The cases of one plant; without arguments none.

    Parameters
    ----------
    operation : callable, optional
        operation(t): the inputs (m,) that act from t (s) on in the comparison; None for the plant's own operation.
    mismatch : tuple of MismatchCase, default ()
        Healthy readings that the model does not predict.
    process_faults : tuple of ProcessFaultCase, default ()
        Faults of the process.
    paper_faults : tuple of PaperFault, default ()
        Sensor faults of papers.
    published_accuracy : callable, optional
        published_accuracy(detector, fault, quantity): share of the faults of a quantity that are judged right; None where no
        paper states it.
    published_delay : callable, optional
        published_delay(detector, fault): delay of the detection; None where no paper states it.
    settle : int, default 100
        Samples that a filter needs to forget how it began, until its rate of false alarms is steady.
    other_operation : callable, optional
        other_operation(t, start): the inputs of an operation that no healthy log of the usual one shows, see
        MismatchCase.inputs.

    Examples
    --------
    >>> from functools import partial
    >>> from fusion_sfdia import Fault
    >>> from fusion_sfdia.faults import ComparisonCases, MismatchCase, PaperFault, ProcessFaultCase
    >>> from fusion_sfdia.plants import two_tanks
    >>> def half_a_metre(plant, sensor, seed, onset, length):
    ...     return Fault(sensor, "bias", onset, length, 0.5)
    >>> cases = ComparisonCases(
    ...     mismatch=(MismatchCase("outlets -5 %", "deposits narrow an outlet", partial(two_tanks, outlet=0.95)),),
    ...     process_faults=(ProcessFaultCase("pump -10 %", "a worn pump", lost=(0.9,), named=("inflow",)),),
    ...     paper_faults=(PaperFault("half a metre", "a bias of 0.5 m", half_a_metre, sensor="l1"),),
    ... )
    >>> [case.name for case in (*cases.mismatch, *cases.process_faults, *cases.paper_faults)]
    ['outlets -5 %', 'pump -10 %', 'half a metre']
    """

    operation: Callable[[float], Array] | None = None
    mismatch: tuple[MismatchCase, ...] = ()
    process_faults: tuple[ProcessFaultCase, ...] = ()
    paper_faults: tuple[PaperFault, ...] = ()
    published_accuracy: Callable[[str, str, str], Published | None] = _none_published
    published_delay: Callable[[str, str], PublishedDelay | None] = _none_published
    settle: int = USUAL_SETTLE
    other_operation: Callable[[float, float], Array] | None = None

    def __post_init__(self) -> None:
        names = [c.name for c in self.mismatch] + [c.name for c in self.process_faults] + [c.name for c in self.paper_faults]
        if twice := [name for name in dict.fromkeys(names) if names.count(name) > 1]:
            raise ValueError(f"cases of a plant named {', '.join(twice)} stand twice; expected each name once")
        if self.settle < 1:
            raise ValueError(f"settle is {self.settle}; expected at least 1 sample")


def in_operation(plant: Plant, operation: Callable[[float], Array] | None) -> Plant:
    """The plant, and its high-fidelity model, in another operation; None for its own."""
    if operation is None:
        return plant
    finer = plant.truth.finer and partial(_finer_in_operation, plant.truth.finer, operation)
    return replace(plant, truth=replace(plant.truth, operation=operation, finer=finer))


def _finer_in_operation(finer: Finer, operation: Callable[[float], Array]) -> tuple[Plant, Callable[[Array], Array]]:
    plant, to_states = finer()
    return replace(plant, truth=replace(plant.truth, operation=operation)), to_states


def case_readings(
    of: Plant,
    steps: int,
    seeds: Sequence[int],
    *,
    truth: Plant | None = None,
    inputs: Callable[[float], Array] | None = None,
    lost: tuple[float, tuple[float, ...]] | None = None,
) -> Recording:
    """Readings from the high-fidelity model of a truth (None: of the plant) under inputs (None: those of its operation).

    lost: from a time (s) on the acting inputs are the known ones times these factors.
    """
    model = in_operation(of if truth is None else truth, inputs)
    if lost is not None and model.truth.feedback is not None:
        raise ValueError(f"plant {model.name!r} has controllers, which would act on what is lost; give its fault a truth")
    finest, to_states = (model, None) if model.truth.finer is None else model.truth.finer()
    finest = replace(finest, sensors=of.sensors)  # whose noise may be a share of what they usually read
    run = partial(
        simulate, of, steps, seeds, truth=finest, to_states=to_states, process_noise=of.truth.disturbed or model.truth.disturbed
    )
    if lost is None:
        return run()
    t = np.arange(steps) * of.dt
    known = np.array([model.input_at(float(s)) for s in t])
    acting = np.where((t >= lost[0] - 1e-6 * of.dt)[:, None], known * np.asarray(lost[1]), known)
    return replace(run(inputs=acting), u=known)
