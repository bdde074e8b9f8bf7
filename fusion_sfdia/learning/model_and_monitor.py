"""Detector: a commissioned model and a monitor beside it, of a log with more channels than the model has sensors.

The model (`frozen_model`) judges its own sensors, the monitor (`monitor`) all channels of the log, those of which the model
predicts nothing, the further ones, among them. Each is at its own share of the stated rate; in each row there is one verdict:

- a sensor is named that both name, or that one names and the other one does not speak against: it raises no alarm, or has that
  sensor among its suspects, of the model's suspects only where the process is none of them; of a further channel only the
  monitor can speak;
- what the monitor names alone, by less than `CLEAR` times its limit, is a suspect for the first `BRIEF` rows: it may be so by
  chance;
- two that each only one of them can judge, and names, are two faults; otherwise, where they name different sensors, these are
  suspects;
- a sensor that one names, while the other says "process" or suspects others, is a suspect beside these;
- what the model names stands where the monitor says "outside", since a model extrapolates; what the monitor names is a suspect
  where the model does;
- where neither names a sensor, what both suspect is suspected, or, where that is nothing, what either does; a suspect of one
  and the process of the other are suspects together, unless the monitor holds that the process may be it;
- process: what the model says of it, else what the monitor does; "outside" where nothing else is said;
- sensors that stopped are named, a stopped recorder alone is reported, and readings that never moved when healthy are reported
  beside all else, as the monitor does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import datetime
from functools import cached_property, partial
from itertools import count
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import require_unique
from fusion_sfdia.detectors.detector import Claims, Decision, ProcessHypothesis, chosen, stack
from fusion_sfdia.detectors.state import State
from fusion_sfdia.learning.frozen_model.frozen_bank import FrozenBank, shares_of_right
from fusion_sfdia.learning.monitor.channels import deviations
from fusion_sfdia.learning.monitor.live_monitor import LiveMonitor
from fusion_sfdia.learning.monitor.row_verdicts import BRIEF, CLEAR, DROPOUT, FREEZE
from fusion_sfdia.plant.plant import OutputFunction, Plant, StepFunction, Structure, Truth
from fusion_sfdia.plant.signals import Sensor, Signal

Array = NDArray[Any]


def with_further(plant: Plant, further: tuple[Signal, ...], sigma: Array | None = None) -> Plant:
    """The plant with further channels of its log as sensors behind its own, of which the model predicts nothing; sigma: the
    deviation of their readings when healthy. ValueError for a name that a sensor, an input or another one has.
    """
    if not further:
        return plant
    require_unique(
        f"sensors, inputs and further channels of plant {plant.name!r}",
        [*plant.sensor_names, *(s.name for s in plant.inputs), *(s.name for s in further)],
    )
    deviation = np.ones(len(further)) if sigma is None else sigma
    sensors = (Sensor(s.name, "", s.unit, sigma=float(v)) for s, v in zip(further, deviation, strict=True))
    jacobian = plant.jacobians[1]
    wider = None if jacobian is None else partial(_padded, jacobian, len(further), -2)
    return replace(
        plant,
        sensors=(*plant.sensors, *sensors),
        output=partial(_padded, plant.output, len(further), -1),
        numerics=replace(plant.numerics, output_jacobian=wider),
        truth=Truth(plant.truth.operation),
        structure=Structure(),
        uncertainty=replace(plant.uncertainty, disturbances=()),
    )


def _padded(function: OutputFunction | StepFunction, more: int, axis: int, *arguments: Any) -> Array:
    """What a function of readings gives, with zeros for so many more."""
    found = np.asarray(function(*arguments))
    shape = list(found.shape)
    shape[axis] = more
    return np.concatenate([found, np.zeros(shape, found.dtype)], axis=axis)


class BothMemory(NamedTuple):
    """The states of the model's detector and of the monitor, and for how many rows this has named each sensor (N,)."""

    model: State
    monitor: State
    held: Array


class Said(NamedTuple):
    """What one of the two says in a row, of all sensors and process hypotheses (H,): the sensors that it names; what of the
    process holds, but for operation and recordings that no healthy log has; what it suspects; which sensors it can judge.
    Whether operation is outside what it has learnt, and whether the process is among its suspects.
    """

    named: Array
    process: Array
    suspect: Array
    judges: Array
    outside: bool
    perhaps_process: bool


@dataclass(frozen=True, eq=False)
class ModelAndMonitor(Claims):
    """The detector of a commissioned model and the live monitor of its sensors and of further channels. One run at a time.

    The sensors of the monitor begin with those of the model, and its inputs are those of the model.
    """

    model: FrozenBank
    monitor: LiveMonitor

    @cached_property
    def plant(self) -> Plant:
        """The plant of the model with the further channels as sensors."""
        own, sensors = len(self.model.plant.sensors), self.monitor.channels.sensors
        return with_further(self.model.plant, sensors[own:], deviations(self.monitor.channels)[own : len(sensors)])

    @property
    def hypotheses(self) -> tuple[str, ...]:
        return self.plant.sensor_names

    @cached_property
    def process_hypotheses(self) -> tuple[ProcessHypothesis, ...]:
        """Those of the model, and those of the monitor but for operation outside its logs, which is the model's."""
        return (*self.model.process_hypotheses, *(h for h in self.monitor.process_hypotheses if h.kind != "outside"))

    @property
    def filter_model(self) -> Plant:
        return self.model.filter_model

    @property
    def fitted_rate(self) -> float:
        """That of the model and that of the monitor together."""
        return float((self.model.fitted_rate or 0.0) + self.monitor.learnt.limits.rate[0])

    def dated(self, start: datetime | None) -> Self:
        return replace(self, model=self.model.dated(start))

    def init(self, batch: tuple[int, ...] = (), t: float = 0.0, seed: int = 0) -> State:
        """Before the first row; ValueError for a batch."""
        monitor = self.monitor.init(batch, t, seed)  # refuses a batch
        model = self.model.init(batch, t, seed)
        return model._replace(memory=BothMemory(model, monitor, np.zeros(len(self.hypotheses))))

    def step(self, state: State, t: float, y: Array, u: Array) -> tuple[State, Decision]:
        """Judge the readings y (N,) at t (s) with the inputs u (m,); a row without any is none for the monitor."""
        own, memory = len(self.model.plant.sensors), state.memory
        model, by_model = self.model.step(memory.model, t, y[..., :own], u)
        monitor, by_monitor = memory.monitor, None
        if np.isfinite(y).any():
            monitor, by_monitor = self.monitor.step(monitor, t, y, u)
        held, decision = self._together(memory.held, y, by_model, by_monitor)
        return model._replace(memory=BothMemory(model, monitor, held)), decision

    def steps(self, state: State, t: Array, y: Array, u: Array) -> tuple[State, Decision] | None:
        """Judge rows at t (K,), the monitor at once; None where it cannot."""
        own, memory, read = len(self.model.plant.sensors), state.memory, np.any(np.isfinite(y), axis=-1)
        monitor, by_monitor = memory.monitor, None
        if read.any():
            if (found := self.monitor.steps(monitor, t[read], y[read], u[read])) is None:
                return None
            monitor, by_monitor = found
        model, held, decisions, row = memory.model, memory.held, list[Decision](), iter(range(t.size))
        for k, has in enumerate(np.atleast_1d(read).tolist()):
            model, by_model = self.model.step(model, float(t[k]), y[k, :own], u[k])
            its = chosen(by_monitor, next(row)) if by_monitor is not None and has else None
            held, decision = self._together(held, y[k], replace(by_model, covariance=None), its)
            decisions.append(decision)
        return model._replace(memory=BothMemory(model, monitor, held)), stack(decisions)

    @cached_property
    def _places(self) -> tuple[Array, Array]:
        """The place of each sensor and process hypothesis of the model, and of the monitor, among all."""
        sensors, own, known = len(self.hypotheses), len(self.model.hypotheses), self.model.process_hypotheses
        outside, others = sensors + [h.kind for h in known].index("outside"), count(sensors + len(known))
        of_monitor = [outside if h.kind == "outside" else next(others) for h in self.monitor.process_hypotheses]
        of_model = np.concatenate([np.arange(own), sensors + np.arange(len(known))])
        return of_model, np.concatenate([np.arange(sensors), of_monitor])

    @cached_property
    def _kinds(self) -> dict[str, Array]:
        """Which of all sensors and process hypotheses (H,) are of each kind."""
        kinds = np.array(["sensor"] * len(self.hypotheses) + [h.kind for h in self.process_hypotheses])
        return {kind: kinds == kind for kind in ("sensor", "together", "outside", "recorder", "still")}

    @cached_property
    def _judges(self) -> tuple[Array, Array]:
        """Which of all (H,) the model can judge, and which the monitor."""
        every = np.arange(len(self.hypotheses) + len(self.process_hypotheses))
        return every < len(self.model.plant.sensors), np.isin(every, self.monitor.channels.used) & self._kinds["sensor"]

    def _spread(self, decision: Decision, places: Array) -> tuple[Array, Array, Array, Array]:
        """Of all sensors and process hypotheses (H,) what holds in one run, with size and sd, and what is suspected."""
        assert decision.process is not None and decision.process_size is not None
        assert decision.process_sd is not None and decision.suspect is not None
        every = self._kinds["sensor"].size
        held, suspect, size, sd = np.zeros(every, bool), np.zeros(every, bool), np.full(every, np.nan), np.full(every, np.nan)
        held[places] = np.concatenate([decision.isolated, decision.process])
        size[places] = np.concatenate([decision.fault_size, decision.process_size])
        sd[places] = np.concatenate([np.full(decision.isolated.size, np.nan), decision.process_sd])
        suspect[places] = decision.suspect
        return held, size, sd, suspect

    def _said(self, held: Array, suspect: Array, judges: Array, perhaps: Array) -> Said:
        kinds = self._kinds
        other = kinds["sensor"] | kinds["outside"] | kinds["recorder"] | kinds["still"]
        outside = bool((held & kinds["outside"]).any())
        return Said(held & kinds["sensor"], held & ~other, suspect, judges, outside, bool(perhaps.any()))

    def _together(self, rows: Array, y: Array, by_model: Decision, by_monitor: Decision | None) -> tuple[Array, Decision]:
        """The Decision on readings y (N,) of that of the model and that of the monitor, None where it judged none, which has
        named each sensor for so many rows before (N,); and for how many with this one.
        """
        sensors, own, kinds = y.size, by_model.isolated.size, self._kinds
        held, size, sd, suspect = self._spread(by_model, self._places[0])
        residual, threshold, reconstruction = np.full(sensors, np.nan), np.full(sensors, np.nan), y.copy()
        residual[:own], threshold[:own], reconstruction[:own] = by_model.residual, by_model.threshold, by_model.reconstruction
        shown_by = np.zeros(sensors, np.int64)
        if by_monitor is not None:
            assert by_monitor.shown_by is not None
            its_held, its_size, its_sd, its_suspect = self._spread(by_monitor, self._places[1])
            stops = np.zeros(held.size, bool)
            stops[:sensors] = by_monitor.isolated & np.isin(by_monitor.shown_by, (FREEZE, DROPOUT))
            model = self._said(held & ~stops, suspect, self._judges[0], suspect & ~kinds["sensor"])
            rows = np.where(by_monitor.isolated, rows + 1, 0.0)
            brief = np.zeros(held.size, bool)
            brief[:sensors] = (rows > 0) & (rows <= BRIEF) & (by_monitor.scores < CLEAR)
            brief &= ~(held | stops)
            its_suspect = its_suspect | brief
            monitor = self._said(its_held & ~stops & ~brief, its_suspect, self._judges[1], its_suspect & kinds["together"])
            by_it = its_held & ~model.named & ~model.process
            held, suspect = merged(model, monitor, kinds["outside"])
            held = held | stops
            if (recorder := its_held & kinds["recorder"]).any():
                held, suspect = recorder, np.zeros_like(held)
            held = held | (its_held & kinds["still"])
            size, sd = np.where(by_it, its_size, size), np.where(by_it, its_sd, sd)
            residual[own:], threshold[own:] = by_monitor.residual[own:], by_monitor.threshold[own:]
            its = (held & by_it)[:sensors]
            shown_by[its], reconstruction[its] = by_monitor.shown_by[its], by_monitor.reconstruction[its]
        return rows, replace(
            by_model,
            reconstruction=reconstruction,
            residual=residual,
            threshold=threshold,
            isolated=held[:sensors],
            fault_size=np.where(held, size, np.nan)[:sensors],
            absurd=np.concatenate([by_model.absurd, np.zeros(sensors - own, bool)]),
            process=held[sensors:],
            process_size=np.where(held, size, np.nan)[sensors:],
            process_sd=np.where(held, sd, np.nan)[sensors:],
            suspect=suspect,
            probability=shares_of_right(held | suspect),
            shown_by=shown_by,
        )


def merged(model: Said, monitor: Said, outside: Array) -> tuple[Array, Array]:
    """What both together hold, and what they suspect, of all sensors and process hypotheses (H,), as stated above; outside
    (H,): which of them is operation outside what was learnt.
    """
    none = np.zeros_like(outside)
    if model.named.any() and monitor.named.any():
        both, every = model.named & monitor.named, model.named | monitor.named
        alone = (model.named & ~monitor.judges) | (monitor.named & ~model.judges)
        held = both | alone if both.any() or not (every & ~alone).any() else none
        return held, every & ~held
    of_monitor = (monitor, model, model.outside, model.perhaps_process)
    for one, other, extrapolates, undecided in ((model, monitor, False, False), of_monitor):
        if one.named.any():
            against = other.process | other.suspect | (outside & extrapolates)
            differs = undecided or other.process.any() or (one.named & ~other.suspect).any()
            if not (against.any() and differs):
                return one.named, none
            return none, one.named | against
    process = model.process if model.process.any() else monitor.process
    suspect = model.suspect | monitor.suspect
    if suspect.any() and not (model.process.any() and monitor.perhaps_process):
        agreed = model.suspect & monitor.suspect
        return none, (agreed if agreed.any() else suspect) | process
    if not process.any() and (model.outside or monitor.outside):
        process = outside
    return process, none
