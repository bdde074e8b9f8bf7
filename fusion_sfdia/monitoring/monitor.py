"""Monitoring without a model: what is learnt from healthy logs, and the diagnosis of another log with that."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.clock import Clock
from fusion_sfdia.core.gaps import bridged
from fusion_sfdia.core.log import Log
from fusion_sfdia.core.rate import Rate
from fusion_sfdia.core.signals import Signal
from fusion_sfdia.evaluation.diagnose import SECONDS, Diagnosis, decided, diagnose_run
from fusion_sfdia.evaluation.events import Event, events_of, median, spans
from fusion_sfdia.evaluation.sensor_events import with_stretch
from fusion_sfdia.identification.choice import Candidate, ModelChoice, choose_model
from fusion_sfdia.identification.runs import groups_of, runs_of
from fusion_sfdia.monitoring.calibration import Calibration, calibrate
from fusion_sfdia.monitoring.channels import UNEXPLAINED, Channel, channels_of, frozen
from fusion_sfdia.monitoring.methods import Methods

Array = NDArray[Any]

BESIDE = ("predictors", "pls", "limits", "dynamic pca")  # beside the bank, whose diagnosis is that of the monitor
GAP = 3  # samples between events of one sensor that are one
FALSE_ALARM = 1e-2  # of samples: some hundred healthy samples set no lower one


@dataclass(frozen=True, eq=False)
class Monitored:
    """What a monitor finds in a log.

    diagnosis: of the bank on the identified model, with the frozen sensors. beside: the diagnoses of the other methods by name.
    frozen: sensors that repeat one reading longer than they did when healthy. moved: sensors that never moved when healthy, and
    do. log: as it was judged, on equal steps, with the sensors of the model. rate: share of held-out healthy samples that was
    in alarm with the bank.
    """

    diagnosis: Diagnosis
    beside: Mapping[str, Diagnosis]
    frozen: tuple[Event, ...]
    moved: tuple[Event, ...]
    missing: tuple[str, ...]
    log: Log
    rate: float

    @property
    def expected(self) -> str:
        """How many samples would be in alarm without a fault, in words; "" where there is no event."""
        count = len(self.log.t)
        return (
            f"without a fault some {self.rate * count:.2g} of these {count} samples would be in alarm, as of held-out healthy "
            "ones: the shortest events may be such, --false-alarm sets their rate"
            if self.diagnosis.events
            else ""
        )

    def __str__(self) -> str:
        lines = [str(self.diagnosis), *([f"  {self.expected}"] if self.expected else [])]
        lines += [
            f"  {e.hypothesis} moved {e.when(self.diagnosis.clock)}, by {e.size:.4g} {e.unit}; never when healthy"
            for e in self.moved
        ]
        lines += [f"  {name} has no reading: dead or not recorded" for name in self.missing]
        for name, found in self.beside.items():
            share = float(np.mean(found.decisions.alarm))
            lines.append(f"beside, {name}: {found.verdict}; in alarm in {share:.1%} of the samples")
        return "\n".join(lines)

    def table(self) -> tuple[tuple[str, ...], list[tuple[Any, ...]]]:
        """Names of columns and a row for each event of all methods."""
        kinds = [("bank", self.diagnosis.events), ("frozen", self.frozen), ("moved", self.moved)]
        kinds += [(name, found.events) for name, found in self.beside.items()]
        header = ("method", "sensor", "start_s", "end_s", "size", "unit", "open")
        return header, [(kind, e.hypothesis, e.start, e.end, e.size, e.unit, e.open) for kind, events in kinds for e in events]


@dataclass(frozen=True, eq=False)
class Monitor:
    """What was learnt from healthy logs; `learn_monitor` makes it.

    choice: the identified model. methods: the bank and what stands beside it, with their thresholds and the rates of false
    alarms that were counted on held-out logs. failed: methods that could not be fitted, and why. still: sensors that never
    moved, and their reading.
    """

    sensors: tuple[Signal, ...]
    inputs: tuple[Signal, ...]
    choice: ModelChoice
    methods: Mapping[str, Calibration]
    failed: Mapping[str, str]
    channels: tuple[Channel, ...]
    still: Mapping[str, float]

    def __str__(self) -> str:
        lines = [str(self.choice), "false alarms, with model and thresholds from other healthy logs:"]
        lines += [f"  {name}: {found}" for name, found in self.methods.items()]
        lines += [f"  {name}: left out, {why}" for name, why in self.failed.items()]
        lines += ["channels:", *(f"  {c}" for c in self.channels)]
        lines += [
            f"  {name}: never moved when healthy, always {value:.6g}; any other reading is reported, nothing else can be"
            for name, value in self.still.items()
        ]
        return "\n".join(lines)

    @property
    def unexplained(self) -> tuple[str, ...]:
        """The sensors that no other channel explains."""
        return tuple(c.name for c in self.channels if c.explained < UNEXPLAINED)

    def diagnose(self, log: Log, clock: Clock = SECONDS) -> Monitored:
        """Diagnose a log of all sensors and inputs: t (K,), y (K, N), u (K, m), NaN where missing.

        Times are moved to equal steps, of readings within one step the last is taken. An input that is missing keeps its last
        value. clock: of the times in the result. DiagnosisWarning as of `diagnose_run`, of the bank alone.
        """
        names = [s.name for s in self.sensors]
        t, y, u = on_grid(log, self.choice.plant.dt, [s.nominal for s in self.choice.plant.inputs])
        if y.shape[1] != len(names) or u.shape[1] != len(self.inputs):
            raise ValueError(
                f"y {y.shape}, u {u.shape} do not fit {len(names)} sensors and {len(self.inputs)} inputs; give those of the "
                "healthy logs"
            )
        moving = [i for i, name in enumerate(names) if name not in self.still]
        judged = Log(t, y[:, moving], u)
        found = {"bank": diagnose_run(self.methods["bank"].detector, judged, clock=clock)}
        others = {name: c.detector for name, c in self.methods.items() if name != "bank"}
        found |= {name: beside(detector, judged, clock) for name, detector in others.items()}
        fixed = frozen(self.channels, [self.sensors[i] for i in moving], t, judged.y)
        moved = [e for name, value in self.still.items() for e in self._moved(names.index(name), value, t, y)]
        missing = [name for name, column in zip(names, y.T, strict=True) if not np.isfinite(column).any()]
        bank = with_frozen(found.pop("bank"), fixed)
        return Monitored(bank, found, tuple(fixed), tuple(moved), tuple(missing), judged, self.methods["bank"].rate)

    def _moved(self, i: int, value: float, t: Array, y: Array) -> list[Event]:
        signal, off = self.sensors[i], y[:, i] - value
        return [
            Event(signal.name, float(t[a]), float(t[b]), median(off[a : b + 1]), signal.unit, b == len(t) - 1)
            for a, b in spans(np.isfinite(off) & (off != 0), GAP)
        ]


def with_frozen(found: Diagnosis, frozen: Sequence[Event]) -> Diagnosis:
    """A diagnosis in which each frozen stretch of a sensor is one event, with those of the detector that it explains."""
    events = list(found.events)
    for e in frozen:
        own = [o for o in events if o.kind == "sensor" and o.hypothesis == e.hypothesis]
        a, b = np.searchsorted(found.t, (e.start, e.end)).tolist()
        events = [o for o in events if o not in own] + with_stretch(own, "freeze", found.t, a, b, e.hypothesis, e.unit)
    return replace(found, events=tuple(sorted(events, key=lambda e: (e.kind == "sensor", e.start, e.hypothesis))))


def beside(detector: Any, log: Log, clock: Clock) -> Diagnosis:
    """The events of a detector over a log, without the second look of `diagnose_run`, which takes a model of the readings."""
    decisions = decided(detector, bridged(detector.plant, log)[0], iter)
    return Diagnosis(events_of(detector, log.t, decisions, GAP), decisions, log.t, clock=clock)


def learn_monitor(
    sensors: Sequence[Signal],
    healthy: Sequence[Log],
    *,
    inputs: Sequence[Signal] = (),
    false_alarm: float | str = FALSE_ALARM,
    beside: Sequence[str] = BESIDE,
    candidates: Sequence[Candidate] | None = None,
    folds: int = 4,
    name: str = "identified plant",
) -> Monitor:
    """Learn from healthy logs, t (K,), y (K, N) with NaN where missing, u (K, m), how a plant behaves.

    A model is identified (`choose_model`, whose candidates and folds these are), and thresholds of a `LeaveOneOutBank` on it
    and of the methods `beside` are set for the rate `false_alarm` of samples in alarm, a share or such as "1/day", nested over
    logs (`calibrate`). A sensor that never moves is accepted and reported.

    ValueError for logs that do not fit or are too short for a model or the rate.
    """
    stated = Rate.of(false_alarm)
    sensors, inputs = tuple(sensors), tuple(inputs)
    choice = choose_model(name, sensors, healthy, inputs=inputs, candidates=candidates, folds=folds)
    rate = stated.per_sample(choice.plant.dt)
    moves = [s.name not in choice.still for s in sensors]
    moving = [s for s, m in zip(sensors, moves, strict=True) if m]
    runs = runs_of(moving, inputs, [Log(t, y[:, moves], u) for t, y, u in healthy])
    groups = groups_of(runs, folds)[1]
    methods = Methods(choice, moving, inputs, rate)
    if unknown := [n for n in beside if n not in methods.fits]:
        raise ValueError(f"beside has {', '.join(map(repr, unknown))}; known: {', '.join([*methods.fits][1:])}")
    found, failed = {"bank": calibrate(methods.bank, groups, rate)}, {}
    for other in beside:
        try:
            found[other] = calibrate(methods.fits[other], groups, rate)
        except ValueError as error:
            failed[other] = str(error)
    readings = {s.name: np.concatenate([y[:, i] for _, y, _ in healthy]) for i, s in enumerate(sensors)}
    still = {n: float(np.nanmedian(readings[n])) for n in choice.still}
    return Monitor(sensors, inputs, choice, found, failed, channels_of(moving, runs, groups), still)


def on_grid(log: Log, dt: float, nominal: Sequence[float]) -> Log:
    """A log with its times moved to the nearest multiple of dt (s) after the first; of several samples at one the last.

    A missing input keeps its last value, before the first its nominal one.
    """
    t, y, u = log
    if not np.isfinite(t).all() or not np.all(np.diff(t) > 0):
        raise ValueError("the times of the log do not rise; sort the rows and drop duplicates")
    steps = np.round((t - t[0]) / dt).astype(int)
    last = np.append(np.diff(steps) > 0, True)
    u = np.concatenate([np.asarray(nominal, float).reshape(1, -1), u[last]])
    seen = np.maximum.accumulate(np.where(np.isfinite(u), np.arange(len(u))[:, None], 0), axis=0)
    return Log(t[0] + dt * steps[last], y[last], np.take_along_axis(u, seen, axis=0)[1:])
