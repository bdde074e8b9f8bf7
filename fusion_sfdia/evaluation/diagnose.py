"""From a log of readings to a table of events, with any detector."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, fields
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.detector import Decision, Detector, MissingPackageError, ProcessHypothesis, run
from fusion_sfdia.core.log import Log, one_run
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.core.redundancy import redundancy
from fusion_sfdia.evaluation.events import Event, events_of, verdict

Array = NDArray[Any]

MOST_BRIDGES = 10_000  # steps in gaps, in addition to ten for each reading: a day's outage in steps of 10 s


@dataclass(frozen=True, repr=False)
class Diagnosis:
    """Events, and the Decisions (time first) behind them with the times (K,).

    In order of their start; of a detector that tests the process, too (`process_hypotheses`), its verdicts on the process
    come first, then what it cannot tell apart, then the sensors.
    """

    events: tuple[Event, ...]
    decisions: Decision
    t: Array
    process_hypotheses: tuple[ProcessHypothesis, ...] = ()

    @property
    def verdict(self) -> str:
        """What the events say together: "process or model: ...", "cannot tell: ... or ...", "sensor ...", "no fault"."""
        found = verdict(self.events, self.t)
        if np.any(lost := self.decisions.diverged):
            return f"{found} until {self.t[np.argmax(lost)]:g} s, where the estimate diverged"
        return found

    def __str__(self) -> str:
        return "\n".join([self.verdict, *(f"  {event}" for event in self.events)])

    def __repr__(self) -> str:
        count = len(self.events)
        return f"<Diagnosis of {len(self.t)} readings, {count} event{'s' * (count != 1)}: {self.verdict}>"

    def frame(self) -> Any:
        """The events as a pandas DataFrame, a column for each of events.csv; MissingPackageError without pandas."""
        try:
            pandas: Any = import_module("pandas")
        except ModuleNotFoundError as error:
            raise MissingPackageError("a frame needs pandas, which is not installed; install it, or use events") from error
        header, rows = self.table()
        return pandas.DataFrame(rows, columns=header)

    def table(self) -> tuple[tuple[str, ...], list[tuple[Any, ...]]]:
        """Names of columns and a row for each event; kind, sd and nominal only where the process is tested."""
        if not self.process_hypotheses:
            rows = [(e.hypothesis, e.start, e.end, e.size, e.unit, e.open) for e in self.events]
            return ("sensor", "start_s", "end_s", "size", "unit", "open"), rows
        spread = [(getattr(e, "sd", np.nan), getattr(e, "nominal", np.nan)) for e in self.events]
        return (
            ("kind", "hypothesis", "start_s", "end_s", "size", "sd", "unit", "nominal", "open"),
            [
                (e.kind, e.hypothesis, e.start, e.end, e.size, sd, e.unit, nominal, e.open)
                for e, (sd, nominal) in zip(self.events, spread, strict=True)
            ],
        )


class DiagnosisWarning(UserWarning):
    """A limit of a diagnosis that its table of events does not show."""


def diagnose_run(detector: Detector, log: Log, *, gap: int = 3) -> Diagnosis:
    """Run a detector over a Log of one run, NaN where a reading is missing, and collect what it isolates into events, of a
    detector that tests the process, too, also what it accepts and what it cannot tell apart.

    Events of one hypothesis less than `gap` samples apart are one. Where two times are further apart than the largest step
    of the plant, the detector steps by dt through the gap without readings, under inputs interpolated between those before
    and after. ValueError where shapes or times do not fit, or there are several runs. DiagnosisWarning where the estimate
    diverged or was moved back into the limits of the model, where a sensor was never read, where readings or inputs are
    absurd, where more sensors would be isolated than the detector allows, and where it has no thresholds and cannot raise an
    alarm.
    """
    t, y, u = one_run(log)
    first = float(t[0]) - (
        detector.plant.dt if len(t) < 2 or detector.plant.numerics.fixed_dt else min(detector.plant.dt, float(t[1] - t[0]))
    )
    own, times, readings, inputs = _bridged(detector.plant, first, t, y, u)
    _, decisions = run(detector, detector.init((), first), times, readings, inputs)
    decisions = Decision(**{f.name: v[own] for f in fields(Decision) if (v := getattr(decisions, f.name)) is not None})
    _warn(detector, t, y, u, decisions)
    return Diagnosis(events_of(detector, t, decisions, gap), decisions, t, getattr(detector, "process_hypotheses", ()))


def _bridged(plant: Plant, first: float, t: Array, y: Array, u: Array) -> tuple[Array, Array, Array, Array]:
    """The positions of the samples among times, readings and inputs in which steps of dt without readings fill long gaps.

    A gap is long where the plant cannot step over it at once.
    """
    gaps = np.diff(t, prepend=first)
    with np.errstate(invalid="ignore"):
        long = (gaps > (plant.dt if plant.numerics.fixed_dt else plant.numerics.max_dt) * (1 + 1e-9)) & np.isfinite(gaps)
        parts = np.where(long, np.ceil(gaps / plant.dt * (1 - 1e-9)), 1)
    if np.sum(parts) > MOST_BRIDGES + 10 * t.size:
        raise ValueError(
            f"{t.size} readings take {np.sum(parts):.5g} steps of {plant.dt:g} s, as they are up to {np.max(gaps):g} s apart; "
            "give times in seconds, or split the log at long gaps"
        )
    for k, step in enumerate(gaps / parts):
        try:
            plant.check_dt(float(step))
        except ValueError as error:
            raise ValueError(f"reading {k + 1}, {t[k]:.10g} s, is {gaps[k]:.10g} s after the one before: {error}") from error
    last, which = np.cumsum(parts.astype(int)) - 1, np.repeat(np.arange(t.size), parts.astype(int))
    ahead = last[which] - np.arange(which.size)  # steps of the gap that are still to come
    times = t[which] - ahead * (gaps / parts)[which]
    between = (ahead / parts[which])[:, None]  # 0 at a reading
    inputs = u[which] * (1 - between) + np.concatenate([u[:1], u[:-1]])[which] * between
    return last, times, np.where(between == 0, y[which], np.nan), inputs


def _warn(detector: Detector, t: Array, y: Array, u: Array, decisions: Decision) -> None:
    """Warn of what the events do not show."""
    remarks = []
    silent = [s.name for s, none in zip(detector.plant.sensors, np.all(np.isnan(y), axis=0), strict=True) if none]
    if silent:
        some = ", ".join(silent[:8]) + (f" and {len(silent) - 8} more" if len(silent) > 8 else "")
        whole = ": the diagnosis is only the model's prediction" if len(silent) == y.shape[1] else ""
        remarks.append(f"no readings of {some}{whole}; fill their columns to have them tested")
    thresholds = decisions.threshold[np.isfinite(decisions.residual)]
    if thresholds.size and np.all(np.isinf(thresholds)):
        remarks.append(
            f"{type(detector).__name__} cannot raise an alarm: its thresholds are infinite; set them with "
            "fit_thresholds(healthy)"
        )
    for values, absurd, signals, fate in (
        (y, decisions.absurd, detector.plant.sensors, "taken as missing"),
        (u, decisions.absurd_input, detector.plant.inputs, "replaced by the plant's usual input"),
    ):
        for i in np.flatnonzero(np.any(absurd, axis=0)) if absurd.shape == values.shape else ():
            where = np.flatnonzero(absurd[:, i])
            remarks.append(
                f"{signals[i].name}: {where.size} of {t.size} values are impossible, the first {values[where[0], i]:g} "
                f"{signals[i].unit} at {t[where[0]]:g} s; {fate}: leave such cells empty, or check units"
            )
    if np.any(decisions.capped):
        most, of = getattr(detector, "most_faults", "too many"), len(detector.plant.sensors)
        why = redundancy(detector.plant).reason if getattr(detector, "max_faults", None) is None else "as max_faults states"
        remarks.append(
            f"more sensors would be isolated in {np.sum(decisions.capped)} of {t.size} samples, first at "
            f"{t[np.argmax(decisions.capped)]:g} s, but {most} of {of} are excluded already, all that the detector "
            f"allows ({why}): check the model, or pass max_faults"
        )
    for flags, what, cure in (
        (decisions.guarded, "left the limits of the model and was moved back", "check units, inputs and parameters"),
        (decisions.diverged, "diverged and is not valid", "check units, inputs and parameters, or cut the log before"),
    ):
        if np.any(flags):
            first = f"{np.sum(flags)} of {t.size} samples, first at {t[np.argmax(flags)]:g} s"
            remarks.append(f"the estimate {what} in {first}; {cure}")
    for remark in remarks:
        warnings.warn(remark, DiagnosisWarning, stacklevel=4)  # the caller of diagnose
