"""From a log of readings to a table of events, with any detector."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from fusion_sfdia.common.clock import Clock
from fusion_sfdia.common.errors import MissingPackageError, warn
from fusion_sfdia.common.html import as_html
from fusion_sfdia.detectors.detector import Decision, Detector, ProcessHypothesis, chosen, joined, place, room_for, stack
from fusion_sfdia.detectors.verdicts import ALL_FAR, NO_THRESHOLDS, TOO_MANY, Conclusion, Verdict, far_off, judged, undecidable
from fusion_sfdia.diagnosis.absent import beyond_resolution, repeats
from fusion_sfdia.diagnosis.events import (
    LASTING,
    NO_FAULT,
    Event,
    ProcessEvent,
    UndecidedEvent,
    answered,
    continued,
    events_of,
    follow_ups,
    open_questions,
    sensors_instead,
    spans,
    throughout,
    verdict,
)
from fusion_sfdia.diagnosis.hindsight import Residuals, hindsight, left_out
from fusion_sfdia.diagnosis.model_health import Health, health_of
from fusion_sfdia.diagnosis.sensor_events import alarm_rate_of, explained
from fusion_sfdia.diagnosis.sentences import Wording, by_importance, counted, kind_of, sentence, wordings
from fusion_sfdia.plant.gaps import Gap, Track, bridged
from fusion_sfdia.plant.log import Log, one_run
from fusion_sfdia.plant.model_errors import RAISED, failed
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

SECONDS = Clock()
MOST_GAPS = 5  # lines
BLOCK = 1000  # Decisions, which take ten times as much memory one by one as in arrays


@dataclass(frozen=True, repr=False)
class Diagnosis:
    """Events, and the Decisions (time first) behind them with the times (K,).

    The events are in order of their start; of a detector that tests the process, too (`process_hypotheses`), its verdicts on
    the process come first, then what it cannot tell apart, then the sensors.

    Attributes
    ----------
    events : tuple of Event
        What was found.
    decisions : Decision
        With arrays (K, ...), time first.
    t : array (K,)
        Times of the readings in s.
    process_hypotheses : tuple of ProcessHypothesis
        Those of the detector, in the order of `Decision.process`.
    clock : Clock
        Wall-clock times of the log.
    gaps : tuple of Gap
        Stretches without a row that the model was stepped through, or after which it started anew.
    health : Health or None
        Whether the model fits; None where a Diagnosis was built without it.
    after : Residuals or None
        The residuals behind the health and behind kinds and sizes; None where a Diagnosis was built without them.
    limit : str
        That fewer than half of the sensors can be isolated at once, and why; "" elsewhere.
    of_log : tuple of str
        What was found in the log that looks like a fault and is none, in words.
    suspects : tuple of str
        Sensors that were not judged, since their unit looks wrong.
    words : mapping of str to Wording
        How people call each hypothesis, by its name.

    Examples
    --------
    >>> from fusion_sfdia import Diagnosis, Fault, Log, diagnose, simulate
    >>> from fusion_sfdia.faults import apply_faults
    >>> from fusion_sfdia.plants import two_tanks
    >>> plant = two_tanks()
    >>> healthy = simulate(plant, 100, seeds=[1])
    >>> readings = apply_faults(plant, healthy.t, healthy.y, [Fault("l1", "bias", onset=300.0, magnitude=0.08)])
    >>> found: Diagnosis = diagnose("loo-glr", Log(healthy.t, readings.y[:, 0], healthy.u), plant=plant)
    >>> found.state, [event.hypothesis for event in found.events]
    (<Verdict.SENSOR: 'sensor'>, ['l1'])
    """

    events: tuple[Event, ...]
    decisions: Decision
    t: Array
    process_hypotheses: tuple[ProcessHypothesis, ...] = ()
    clock: Clock = SECONDS
    gaps: tuple[Gap, ...] = ()
    health: Health | None = None
    after: Residuals | None = None
    limit: str = ""
    of_log: tuple[str, ...] = ()
    suspects: tuple[str, ...] = ()
    words: Mapping[str, Wording] = field(default_factory=dict)

    @property
    def state(self) -> Verdict:
        """The verdict on the whole log in one word, for programs: that of the first of `findings`, unless most of the log was
        not judged, or all readings are far from the model; a log that was not judged is blind, never healthy.
        """
        return self._conclusion.verdict

    @property
    def _conclusion(self) -> Conclusion:
        """The same with the reason where nothing is named."""
        d, t, standing = self.decisions, self.t, self.standing
        unsupported = far_off(d) | d.capped
        seen, named = judged(d), np.any(d.isolated, axis=-1)
        if not np.any(seen) and not np.any(d.diverged):
            return Conclusion(Verdict.BLIND, "no reading could be compared with the model")
        if np.sum(unsupported) > max(np.sum(named) / 2, LASTING - 1):
            return Conclusion(Verdict.UNDECIDED, ALL_FAR if np.all(far_off(d)[unsupported]) else TOO_MANY)
        if standing:
            first = kind_of(standing[0]).verdict
            return Conclusion(first, "no healthy log has such readings" if first is Verdict.OUTSIDE else "")
        if np.any(d.diverged):
            when = self.clock.at(float(t[np.argmax(d.diverged)]))
            return Conclusion(Verdict.BLIND, f"the estimate diverged, or the model gave no finite value, at {when}")
        if 2 * np.sum(seen) < t.size:
            count = f"{t.size - np.sum(seen)} of {t.size} samples"
            return Conclusion(Verdict.BLIND, f"in {count} no reading could be compared with the model")
        if np.all(undecidable(d)[seen]):
            return Conclusion(Verdict.UNDECIDED, NO_THRESHOLDS)
        if 2 * np.sum(np.any(d.absurd_input, axis=-1) if np.ndim(d.absurd_input) else d.absurd_input) > t.size:
            return Conclusion(Verdict.OUTSIDE, "an input is beyond the limits of its signal in most samples")
        if self.suspects:
            return Conclusion(Verdict.UNDECIDED, f"the unit of {', '.join(self.suspects)} looks wrong")
        return Conclusion(Verdict.HEALTHY)

    @property
    def verdict(self) -> str:
        """What the events say together: "sensor ...", "process or model: ...", "cannot tell: ... or ...", "perhaps ...", or
        "no fault"; without events, "no verdict: ..." or "cannot tell: ..." with the reason where nothing could be concluded.
        """
        found, concluded = verdict(self.events, self.t), self._conclusion
        if found == NO_FAULT and concluded.verdict is not Verdict.HEALTHY:
            return concluded.text
        if self.suspects:
            found += f"; not judged: {', '.join(self.suspects)}, whose unit looks wrong"
        if concluded.verdict is Verdict.BLIND:
            return f"{concluded.text}; {found}"
        if np.any(lost := self.decisions.diverged):
            return f"{found} until {self.clock.at(float(self.t[np.argmax(lost)]))}, where the estimate diverged"
        return found

    @property
    def headline(self) -> str:
        """What was found, in a few words for people: "1 faulty sensor, 1 change of the process"; without findings "no fault",
        or why there is no verdict.
        """
        if not (found := counted(self.standing)):
            return self.verdict
        concluded = self._conclusion
        parts = [found, concluded.text if concluded.verdict is Verdict.BLIND or concluded.reason else ""]
        parts += [f"not judged: {', '.join(self.suspects)}, whose unit looks wrong"] if self.suspects else []
        return "; ".join(part for part in parts if part)

    @property
    def findings(self) -> list[Event]:
        """The events, the most important first, see `by_importance`, without what is `answered`."""
        return by_importance([e for e in self.events if not answered(e, self.events)], self.passing)

    @property
    def standing(self) -> list[Event]:
        """The findings without what is `passing`: those that decide."""
        passing = set(map(id, self.passing))
        return by_importance([e for e in self.events if id(e) not in passing])

    @cached_property
    def passing(self) -> list[Event]:
        """The alarms that were decided, or ended, before they said anything, and changes of the process in whose place sensors
        were named: no part of the verdict.
        """
        stand = set(map(id, open_questions(self.events, self.t)))

        def passes(e: Event) -> bool:
            return id(e) not in stand if isinstance(e, UndecidedEvent) else bool(sensors_instead(e, self.events, self.t))

        return [e for e in self.events if passes(e)]

    def sentence(self, event: Event) -> str:
        """An event in a sentence for people, and what to do, see `sentences`.

        Parameters
        ----------
        event : Event
            One of `events`.

        Returns
        -------
        str
            With the times of `clock`.
        """
        after = () if event.open else follow_ups(event, self.events, self.t)
        return sentence(event, self.words, self.clock, ended=self._seen_to_end(event), after=after)

    def _seen_to_end(self, event: Event) -> bool:
        """Whether the rows after a closed event were judged: no gap after which the detector starts anew, no divergence."""
        after, diverged = int(np.searchsorted(self.t, event.end, side="right")), self.decisions.diverged
        lost = np.ndim(diverged) > 0 and after < self.t.size and bool(diverged[after])
        return not lost and not any(gap.reset and gap.start <= event.end < gap.end for gap in self.gaps)

    @property
    def is_explained_by_the_process(self) -> bool:
        """Whether readings do not fit the model, and a change of the process was found, which may be why."""
        suspect = self.health is not None and self.health.suspect
        return suspect and any(kind_of(e).verdict is Verdict.PROCESS for e in self.standing)

    @property
    def caution(self) -> str:
        """What a model that may not fit means for the findings, in a sentence; "" where it fits."""
        if self.health is None:
            return ""
        if self.is_explained_by_the_process:
            return "If the plant was in order at that time, the model is wrong: tune it to a log without a fault."
        if self.health.suspect:
            return (
                "The model does not fit these readings, so that findings may be its errors: tune it to a log without a fault."
            )
        if not self.health.tested:
            return "Too few healthy readings to tell whether the model fits."
        return "The model states more noise than there is: small faults may be missed." if self.health.cautious else ""

    @property
    def remarks(self) -> list[str]:
        """What limits the detector, where that is less than half of the sensors, the sensors that were off already before the
        log, and its first gaps, a line each.
        """
        lines = [*([self.limit] if self.limit else []), *self.of_log]
        lines += [
            f"{name} is off throughout, since before the log: check its unit and the inputs first"
            for name in dict.fromkeys(throughout(self.events, self.t))
        ]
        lines += [
            f"gap from {self.clock.at(g.start)} to {self.clock.at(g.end)}: "
            + ("too long to predict across, the diagnosis starts anew after it" if g.reset else f"predicted in {g.steps} steps")
            for g in self.gaps[:MOST_GAPS]
        ]
        more = len(self.gaps) - MOST_GAPS
        return lines if more < 1 else [*lines, f"and {more} more gaps"]

    def __str__(self) -> str:
        return "\n".join([self.verdict, *(f"  {event.summary(self.clock)}" for event in self.findings)])

    def __repr__(self) -> str:
        count = len(self.events)
        return f"<{type(self).__name__} of {len(self.t)} readings, {count} event{'s' * (count != 1)}: {self.verdict}>"

    def _repr_html_(self) -> str:
        rows = [(kind_of(e).word, self.sentence(e)) for e in self.standing]
        return as_html(self.headline, self.caution, ("kind", "finding"), rows)

    def frame(self) -> Any:
        """The events as a pandas DataFrame, a column for each of events.csv.

        Returns
        -------
        pandas.DataFrame
            A row for each event. start, end: time stamps with the log's zone, or durations where the log has seconds alone.

        Raises
        ------
        MissingPackageError
            Without pandas.
        """
        try:
            pandas: Any = import_module("pandas")
        except ModuleNotFoundError as error:
            raise MissingPackageError("a frame needs pandas, which is not installed; install it, or use events") from error
        header, rows = self.table()
        found, start = pandas.DataFrame(rows, columns=header), self.clock.start
        for name in ("start", "end"):
            t = pandas.to_timedelta(found[f"{name}_s"].astype(float), unit="s")
            if start is not None and start.tzinfo is not None:  # in UTC, since the zone's clock may have changed in between
                t = (pandas.Timestamp(start).tz_convert("UTC") + t).dt.tz_convert(start.tzinfo)
            found[name] = t if start is None or start.tzinfo is not None else pandas.Timestamp(start) + t
        return found

    def table(self) -> tuple[tuple[str, ...], list[tuple[Any, ...]]]:
        """Names of columns, the same for every detector, and a row for each event; sd and nominal are NaN of what has none.

        Returns
        -------
        columns : tuple of str
            The names.
        rows : list of tuple
            As long as the names, one for each of `events`.
        """
        added = ("fault", "start", "end", "size_low", "size_high", "size_sigma", "confidence", "alternatives")
        more = [
            (
                " or ".join([e.fault, *e.fault_alternatives]),
                self.clock.at(e.start),
                self.clock.at(e.end),
                *(e.low, e.high, e.sigmas, e.confidence),
                " or ".join(e.alternatives),
            )
            for e in self.events
        ]
        spread = [(getattr(e, "sd", np.nan), getattr(e, "nominal", np.nan)) for e in self.events]
        return (
            ("kind", "hypothesis", "start_s", "end_s", "size", "sd", "unit", "nominal", "open", *added),
            [
                (e.kind, e.hypothesis, e.start, e.end, e.size, sd, e.unit, nominal, e.open, *rest)
                for e, (sd, nominal), rest in zip(self.events, spread, more, strict=True)
            ],
        )


class DiagnosisWarning(UserWarning):
    """A limit of a diagnosis that its table of events does not show."""


def diagnose_run(
    detector: Detector,
    log: Log,
    *,
    gap: int = 3,
    clock: Clock = SECONDS,
    each: Callable[[Sequence[int]], Iterable[int]] = iter,
    unread: Collection[str] = (),
    decisions: Decision | None = None,
) -> Diagnosis:
    """Run a detector over a Log of one run, NaN where a reading is missing, and collect what it isolates into events, of a
    detector that tests the process, too, also what it accepts and what it cannot tell apart.

    Events of one hypothesis less than `gap` samples apart are one. Where two times are further apart than the largest step
    of the plant, the detector steps by dt through the gap without readings, under inputs interpolated between those before
    and after; where that takes too many steps it starts anew (see `plant.gaps`). A second look without the isolated readings
    gives kind and size of the faults and whether the model fits. clock: of the times in the result. each: wraps the steps of
    both passes, to show progress. unread: sensors that the log is known not to have; that they are silent is no event.
    decisions: those of `decided` on the log, where they are known.

    ValueError where shapes or times do not fit, or there are several runs. DiagnosisWarning where the estimate diverged or was
    moved back into the limits of the model, where it starts anew, where a sensor was never read, where readings or inputs are
    absurd, where more sensors would be isolated than the detector allows, and where it has no thresholds and cannot raise an
    alarm.
    """
    log = one_run(log)
    track, gaps = bridged(detector.plant, log)
    if decisions is None:
        with threadpool_limits(1):  # of linear algebra: matrices are small, threads would wait for each other
            decisions = decided(detector, track, each, clock)
    t, y, u = log
    y = present(y, decisions)
    frozen = repeats(y)
    out = left_out(decisions.isolated[:, : y.shape[1]])
    for i, stretches in enumerate(frozen):
        for a, b in stretches:
            out[a : b + 1, i] = True
    if y is not log.y:
        track = track._replace(y=track.y.copy())
        track.y[track.own] = y
    if decisions.absurd_input.shape == u.shape and np.any(decisions.absurd_input):
        track, own = track._replace(u=track.u.copy()), np.flatnonzero(track.own)
        for k in np.flatnonzero(np.any(decisions.absurd_input, axis=1)):
            track.u[own[k]] = np.where(decisions.absurd_input[k], detector.plant.input_at(float(t[k])), u[k])
    with threadpool_limits(1):
        try:
            look = hindsight(model_of(detector), track, out, each)
        except RAISED as error:
            raise failed(detector.plant, "in the second look", error) from error
    starts = np.flatnonzero(np.isfinite(track.begins[track.own]))
    health, after = health_of(detector.plant, look, starts, alarm_rate_of(detector), ()), look.residuals
    with np.errstate(invalid="ignore", divide="ignore"):
        frozen = beyond_resolution(frozen, after.error / after.sd, detector.plant.sensor_resolution)
    del look, track, out  # of a long log as much memory as its readings, twice
    events = explained(detector, t, y, decisions, events_of(detector, t, decisions, gap), after, frozen)
    events = continued([e for e in events if e.kind != "sensor" or e.hypothesis not in unread], t)
    _warn(detector, log, decisions, gaps, clock, unread)
    health = health._replace(remarks=against_the_model(events, decisions, t, clock))
    return Diagnosis(
        events,
        decisions,
        t,
        detector.process_hypotheses,
        clock,
        gaps,
        health,
        after,
        _limit(detector),
        words=wordings(detector),
    )


def model_of(detector: Detector) -> Plant:
    """The plant whose state the filter of a detector estimates; its plant, where it has no filter."""
    return detector.filter_model or detector.plant


def present(y: Array, decisions: Decision) -> Array:
    """The readings (K, N) without absurd ones; the same array where there is none."""
    return np.where(decisions.absurd, np.nan, y) if np.any(decisions.absurd) else y


def _limit(detector: Detector) -> str:
    """In words how many sensors can be isolated at once, where that is less than half of them; else ""."""
    most, count = detector.most_faults, len(detector.plant.sensors)
    return f"at most {most} of {count} sensors can be isolated at once: {detector.why_no_more()}" if most < count // 2 else ""


def decided(
    detector: Detector, track: Track, each: Callable[[Sequence[int]], Iterable[int]], clock: Clock = SECONDS
) -> Decision:
    """The Decisions at the samples of a log; a detector that has `steps` takes all of a run at once.

    The readings of a track may be of a batch of runs (S, B, N) with the same times, its inputs then (S, B, m); see
    `detectors.detector.of_run`.
    """
    batch = track.y.shape[1:-1]
    if not batch and (whole := _at_once(detector, track)) is not None:
        return whole if track.own.all() else chosen(whole, track.own)
    state, whole, count, found = None, None, 0, []
    for s in each(range(track.t.size)):
        if state is None or np.isfinite(track.begins[s]):
            state = detector.init(batch, float(track.begins[s]))
        try:
            state, decision = detector.step(state, float(track.t[s]), track.y[s], track.u[s])
        except RAISED as error:
            raise failed(detector.plant, f"at {clock.at(float(track.t[s]))}", error) from error
        if track.own[s]:
            found.append(replace(decision, covariance=None))
        if len(found) == BLOCK or (s == track.t.size - 1 and found):
            block = stack(found)
            whole = room_for(block, int(np.sum(track.own))) if whole is None else whole
            place(block, whole, count)
            count, found = count + len(found), []
    assert whole is not None
    return whole


def _at_once(detector: Detector, track: Track) -> Decision | None:
    """The Decisions at all samples of a track of one run, None where the detector has to be stepped."""
    starts, runs = np.flatnonzero(np.isfinite(track.begins)), []
    for a, b in zip(starts, [*starts[1:], track.t.size], strict=True):
        try:
            found = detector.steps(detector.init((), float(track.begins[a])), track.t[a:b], track.y[a:b], track.u[a:b])
        except RAISED as error:
            raise failed(detector.plant, "in this log", error) from error
        if found is None:
            return None
        runs.append(found[1])
    return runs[0] if len(runs) == 1 else joined(runs)


def against_the_model(events: Sequence[Event], decisions: Decision, t: Array, clock: Clock) -> tuple[str, ...]:
    """What else than innovations speaks against the model."""
    found = [e.difference for e in events if isinstance(e, ProcessEvent) and e.open]
    if np.any(decisions.diverged):
        found.append(f"the estimate diverged at {clock.at(float(t[np.argmax(decisions.diverged)]))}")
    if any(b - a >= LASTING - 1 for a, b in spans(decisions.capped, 1)):  # shorter ones may be noise
        found.append(f"more sensors disagree with it than can be isolated in {np.sum(decisions.capped)} of {t.size} samples")
    return tuple(found)


def _warn(
    detector: Detector, log: Log, decisions: Decision, gaps: Sequence[Gap], clock: Clock, unread: Collection[str]
) -> None:
    """Warn of what the events do not show."""
    (t, y, u), remarks = log, []

    def first(flags: Array) -> str:
        return clock.at(float(t[np.argmax(flags)]))

    for g in gaps:
        if g.reset:
            remarks.append(
                f"no row for {g.end - g.start:g} s before {clock.at(g.end)}, {g.steps:.4g} steps of the model: the estimate "
                "starts anew from the initial state; check that times are in seconds"
            )
    none = np.all(np.isnan(y), axis=0)
    silent = [name for name, empty in zip(detector.plant.sensor_names, none, strict=True) if empty and name not in unread]
    if silent:
        some = ", ".join(silent[:8]) + (f" and {len(silent) - 8} more" if len(silent) > 8 else "")
        whole = ": the diagnosis is only the model's prediction" if none.all() else ""
        remarks.append(f"no readings of {some}{whole}; fill their columns to have them tested")
    known = np.isfinite(decisions.residual)
    if known.any() and np.all(np.isinf(decisions.threshold), where=known):
        remarks.append(
            f"{type(detector).__name__} cannot raise an alarm in these {t.size} rows: its thresholds are still infinite, as "
            "they are during start-up; give it more rows, or set thresholds with fit_thresholds(healthy)"
        )
    for values, absurd, signals, fate in (
        (y, decisions.absurd, detector.plant.sensors, "taken as missing"),
        (u, decisions.absurd_input, detector.plant.inputs, "replaced by the plant's usual input"),
    ):
        for i in np.flatnonzero(np.any(absurd, axis=0)) if absurd.shape == values.shape else ():
            where = np.flatnonzero(absurd[:, i])
            remarks.append(
                f"{signals[i].name}: {where.size} of {t.size} values are impossible, the first {values[where[0], i]:g} "
                f"{signals[i].unit} at {first(absurd[:, i])}; {fate}: leave such cells empty, or check units"
            )
    if np.any(decisions.capped):
        most, of = detector.most_faults, len(detector.plant.sensors)
        remarks.append(
            f"more sensors would be isolated in {np.sum(decisions.capped)} of {t.size} samples, first at "
            f"{first(decisions.capped)}, but {most:g} of {of} are excluded already, all that the detector "
            f"allows ({detector.why_no_more()}): check the model, or pass max_faults"
        )
    for flags, what, cure in (
        (decisions.guarded, "left the limits of the model and was moved back", "check units, inputs and parameters"),
        (decisions.diverged, "diverged and is not valid", "check units, inputs and parameters, or cut the log before"),
    ):
        if np.any(flags):
            remarks.append(f"the estimate {what} in {np.sum(flags)} of {t.size} samples, first at {first(flags)}; {cure}")
    for remark in remarks:
        warn(remark, DiagnosisWarning)
