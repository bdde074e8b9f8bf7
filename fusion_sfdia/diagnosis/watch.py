"""The diagnosis of readings as they arrive: `Watch` takes one row after another and returns what each decides."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from datetime import datetime
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import floats, number, require_names, whole
from fusion_sfdia.common.clock import Clock
from fusion_sfdia.common.errors import warn, warn_renamed
from fusion_sfdia.detectors.detector import Decision, Detector
from fusion_sfdia.detectors.state import State
from fusion_sfdia.detectors.storage import (
    SavedArrays,
    fingerprint,
    of_another_detector,
    read_arrays,
    require_detector,
    state_arrays,
    state_of,
    write_arrays,
)
from fusion_sfdia.detectors.verdicts import Conclusion, Verdict, conclusion_of
from fusion_sfdia.diagnosis.alarms import Alarms
from fusion_sfdia.diagnosis.changes import KEPT, Change
from fusion_sfdia.diagnosis.device_health import DeviceHealth, sensor_health
from fusion_sfdia.diagnosis.row_order import InOrder, WatchRow
from fusion_sfdia.diagnosis.second_look import Seen
from fusion_sfdia.diagnosis.slow_sensors import SlowSensors
from fusion_sfdia.diagnosis.watch_findings import Findings
from fusion_sfdia.plant.border import possible
from fusion_sfdia.plant.gaps import MOST_BRIDGES, lead_in, longest_step, steps_over
from fusion_sfdia.plant.model_errors import RAISED, ModelError, described, require_model

Array = NDArray[Any]

VERSION = 6  # of the file in which a watch is saved
ANEW = "name another file, or remove it to begin anew"
OF_INPUTS = ("u", "given", "known_at")


class OtherDetectorError(ValueError):
    """A saved watch of another detector or plant."""


class WatchWarning(UserWarning):
    """A row that a Watch did not take.

    Examples
    --------
    >>> import warnings
    >>> from fusion_sfdia import detector
    >>> with warnings.catch_warnings(record=True) as caught:
    ...     warnings.simplefilter("always")
    ...     rows = detector("kf-chi2", "two-tanks").stream().update(0.0, [1.0, 2.0], [0.001])  # two readings of four sensors
    >>> rows, caught[0].category.__name__
    ((), 'WatchWarning')
    """


class Sample(NamedTuple):
    """A row that was taken, with the inputs used, its Decision, and what it changes.

    Attributes
    ----------
    t : float
        Time in s.
    y : array (N,)
        Readings as they were judged, NaN where missing.
    u : array (m,)
        The inputs used.
    decision : Decision
        Of the detector; where the model failed every number of it is NaN.
    changes : tuple of Change
        What the row decides.
    conclusion : Conclusion
        The verdict with its reason, blind where nothing was judged; of a row in which all readings are repeats of slow sensors,
        that of the row before.
    device_health : tuple of DeviceHealth
        The state of each sensor by NAMUR NE 107.

    Examples
    --------
    >>> from fusion_sfdia import Watch, simulate
    >>> from fusion_sfdia.detectors import CentralFilter
    >>> from fusion_sfdia.plants import two_tanks
    >>> plant = two_tanks()
    >>> recording = simulate(plant, 3, seeds=[1])
    >>> watch = Watch(CentralFilter(plant, false_alarm=1e-6))
    >>> for t, y, u in zip(recording.t, recording.y[:, 0], recording.u):
    ...     for sample in watch.update(t, y, u):
    ...         print(sample.t, sample.verdict, len(sample.changes))
    5.0 healthy 0
    10.0 healthy 0
    15.0 healthy 0
    """

    t: float
    y: Array
    u: Array
    decision: Decision
    changes: tuple[Change, ...]
    conclusion: Conclusion
    device_health: tuple[DeviceHealth, ...]

    @property
    def verdict(self) -> Verdict:
        """The verdict on this row."""
        return self.conclusion.verdict


def _warn(remark: str) -> None:
    warn(remark, WatchWarning)


class Watch:
    """A detector over rows that arrive one after another, in constant memory; the isolated samples are those of `diagnose`.

    Steps, clocks, gaps, repeats, silent and frozen sensors, kinds and sizes are those of `diagnose`; of the last 585 samples,
    which are kept. Only a whole log shows what differs: a unit that looks wrong, and the noise or the period of a sensor whose
    coarse steps or jumps the plant does not state. Of these the former is judged as it is, and the latter are said to
    `refused`, as is a late sensor, once in 585 samples and by `last`. What is known beforehand counts from the first row:
    Watch(judged.detector, unread=judged.unread) with judged = `prepared(detector, check_log(...))` of an earlier log.

    Parameters
    ----------
    detector : Detector
        To be stepped.
    gap : int, default 3
        Samples without a verdict after which an event closes.
    hold : float, default 0
        Seconds for which an input that is missing, or beyond the limits of its signal, keeps its last value.
    nominal_inputs : bool, default False
        Whether the plant's usual value is taken instead.
    at_sample : bool, default False
        Whether the inputs of a row act from then on, as measured ones do, or acted until then, as in a Log.
    longest_gap : float, optional
        Seconds over which the detector predicts without readings, in steps of dt; default 10 000 dt.
    reorder : float, default 0
        Seconds for which rows are held, so that those that come in another order are put in order; every row is diagnosed that
        much later.
    keep_last : bool, default False
        Whether of held rows with one time the last counts, in place of the first.
    kinds : bool, default True
        Whether faults are named and the model is tested, see `SecondLook`.
    repeats : bool, default False
        Whether readings that repeat the one before are judged as they are.
    unknown_inputs : bool, default False
        Whether a missing input stays so, for a detector that takes it.
    unread : iterable of str, default ()
        Sensors whose readings are not used and whose silence is no event, since they are absent or in a unit that looks wrong.
    refused : callable, optional
        Called with a line for each row or run of rows that is not taken; by default a WatchWarning.

    Raises
    ------
    ValueError
        For settings that do not fit, and for unread sensors that the plant does not have.

    Notes
    -----
    Rows that are not as expected never end a watch:

    - A row whose numbers do not fit, or without an input, is not taken.
    - A row with the time of another is a duplicate: the first counts, since what is diagnosed cannot be taken back; see
      keep_last. One line for the number of a run of them.
    - A row earlier than the last one diagnosed, late, out of order or after a clock was set back, is not taken, one line for
      the first and one for the number of them. Directly after `load` such rows are in the state already: no line.
    - The first row waits for the next one. A row that is ahead of the others by more than five times their usual distance, at
      least dt, waits until three rows, itself among them, have times from its own on; rows that go on as before are diagnosed
      meanwhile, and show that its clock was wrong: it is not taken. After a pause of more than longest_gap the detector starts
      anew, a "reset", and what stood is closed.
    - Readings that only repeat the one before, of a sensor that brings a new one every few rows, are missing: `SlowSensors`.
    - Where the estimate diverges, or the model raises an error or gives anything but numbers, the detector starts anew with the
      next row, a "reset".

    Where nothing can be judged, for want of readings or of a model that gives numbers, the verdict of a sample is "blind". A
    change "blind" states the reason, at once where the model fails, after `gap` samples where readings are missing; a change
    "sees again" follows after `gap` samples that were judged.

    Examples
    --------
    >>> from fusion_sfdia import Watch, simulate
    >>> from fusion_sfdia.detectors import CentralFilter
    >>> from fusion_sfdia.plants import two_tanks
    >>> plant = two_tanks()
    >>> recording = simulate(plant, 40, seeds=[1])
    >>> watch = Watch(CentralFilter(plant, false_alarm=1e-6))
    >>> y = recording.y[:, 0] + 0.2 * (recording.t > 100)[:, None] * [1.0, 0.0, 0.0, 0.0]  # a bias of l1
    >>> for change in watch.events(zip(recording.t, y, recording.u)):
    ...     print(change.what, change.t, change.event.hypothesis)
    opened 105.0 l1
    """

    def __init__(
        self,
        detector: Detector,
        *,
        gap: int = 3,
        hold: float = 0.0,
        nominal_inputs: bool = False,
        at_sample: bool = False,
        longest_gap: float | None = None,
        reorder: float = 0.0,
        keep_last: bool = False,
        kinds: bool = True,
        repeats: bool = False,
        unknown_inputs: bool = False,
        unread: Iterable[str] = (),
        refused: Callable[[str], None] = _warn,
    ) -> None:
        require_detector(detector)
        self.detector, self.refused = detector, refused
        self.judge: Detector | None = None  # the detector on the clock of the rows, which the first one states
        self.hold, self.nominal_inputs, self.at_sample = number("hold", hold), nominal_inputs, at_sample
        self.longest_step = longest_step(detector.plant)
        self.longest_gap = MOST_BRIDGES * detector.plant.dt if longest_gap is None else number("longest_gap", longest_gap)
        for what, seconds in (("hold", self.hold), ("longest_gap", self.longest_gap), ("reorder", reorder)):
            if not 0 <= seconds < np.inf:
                raise ValueError(f"{what} is {seconds}; expected a finite number of seconds, at least 0")
        if not whole("gap", gap, least=1) < KEPT:
            raise ValueError(f"gap is {gap} samples; expected fewer than the {KEPT} that are kept")
        self.unread = {*unread}  # a source of rows adds the sensors that it does not have
        require_names("unread:", self.unread, detector.plant.sensor_names)
        self.findings = Findings(detector, int(gap), kinds, refused, self.unread)
        self.alarms = Alarms()
        self.slow = None if repeats else SlowSensors(detector.plant, refused)
        self.unknown_inputs = unknown_inputs
        self.clock = Clock()
        self.state: State | None = None
        self.t: float | None = None  # of the last row diagnosed, in s; after `load`, rows after it are to be given again
        self.u = self.given = np.empty(0)  # the inputs that acted until then, and those of its row
        self.limits = tuple(np.array([getattr(s, which) for s in detector.plant.inputs]) for which in ("low", "high"))
        self.known_at = np.full(len(detector.plant.inputs), -np.inf)  # time of the last value of each input
        self.lost = False  # whether the estimate of the last row had diverged
        self.failing: type[BaseException] | None = None  # the error of the model in the last row
        self.x = detector.plant.x0  # the last estimate
        self.concluded = Conclusion(Verdict.BLIND, "no row was judged yet")
        self.order = InOrder(number("reorder", reorder), self.longest_gap, refused, keep_last, detector.plant.dt)

    def events(self, rows: Iterable[tuple[float | datetime, Any, Any]]) -> Iterator[Change]:
        """What rows (t, y, u) decide, each as soon as its row is taken.

        Parameters
        ----------
        rows : iterable of tuple
            t, y (N,) and u (m,) of one row after another, see `update`.

        Yields
        ------
        Change
            In the order of the rows.
        """
        for row in rows:
            for sample in self.update(*row):
                yield from sample.changes

    def update(self, t: float | datetime, y: Any, u: Any = ()) -> tuple[Sample, ...]:
        """Diagnose the readings y (N,) at t, NaN where missing, with the inputs u (m,).

        Parameters
        ----------
        t : float or datetime
            In seconds, or all rows as time stamps, which become seconds since the first.
        y : array (N,)
            Readings in the units of the sensors.
        u : array (m,), default ()
            Inputs, see `at_sample`.

        Returns
        -------
        tuple of Sample
            The rows diagnosed: this one, none where it is not taken or waits, more where others waited for it.
        """
        try:
            row = self._row(t, y, u)
        except (TypeError, ValueError) as error:
            self.refused(f"row at {t}: {error}; it is not taken")
            return ()
        return self._in_turn(self.order.push(row, self.t, self.clock))

    def finish(self) -> tuple[Sample, ...]:
        """Diagnose the rows that are held for their order, at the end of the input; what comes later is late.

        Returns
        -------
        tuple of Sample
            The rows diagnosed.
        """
        return self._in_turn(self.order.remaining(self.t, self.clock))

    def take(self, t: float | datetime, y: Any, u: Any = ()) -> tuple[Sample, ...]:
        """The former name of `update`.

        Parameters
        ----------
        t : float or datetime
            As of `update`.
        y : array (N,)
            As of `update`.
        u : array (m,), default ()
            As of `update`.

        Returns
        -------
        tuple of Sample
            As of `update`.
        """
        warn_renamed("Watch.take", "Watch.update")
        return self.update(t, y, u)

    def rest(self) -> tuple[Sample, ...]:
        """The former name of `finish`.

        Returns
        -------
        tuple of Sample
            As of `finish`.
        """
        warn_renamed("Watch.rest", "Watch.finish")
        return self.finish()

    def last(self) -> list[Change]:
        """What the second look would report if no row came any more; the watch stays as it is.

        Returns
        -------
        list of Change
            Empty where there is nothing to add.
        """
        alarms = Alarms.of(str(self.alarms))
        return [] if self.t is None else [alarms.with_alarm(change) for change in self.findings.last(self.t, self.clock)]

    def _in_turn(self, rows: list[tuple[WatchRow, float]]) -> tuple[Sample, ...]:
        return tuple(sample for row, ahead in rows for sample in self._diagnosed(row, ahead))

    def _row(self, t: float | datetime, y: Any, u: Any) -> WatchRow:
        """The row as numbers; ValueError or TypeError where they do not fit."""
        plant, start = self.detector.plant, self.clock.start
        y, u = floats("y", y), floats("u", u)
        for what, values, count in (("readings", y, len(plant.sensors)), ("inputs", u, len(plant.inputs))):
            if values.shape != (count,):
                raise ValueError(f"{what} of shape {values.shape}; expected ({count},), NaN where missing")
        begun = self.t is not None or bool(self.order.waiting or self.order.held)
        if begun and isinstance(t, datetime) != (start is not None):
            raise ValueError("give the time as in the rows before, in seconds or as a time stamp")
        if isinstance(t, datetime):
            seconds = 0.0 if start is None else self.clock.seconds(t)
            self.clock = Clock(start or t)
        elif not np.isfinite(seconds := number("t", t)):
            raise ValueError("its time is not finite")
        return WatchRow(seconds, np.where(np.isinf(y) | np.isin(plant.sensor_names, [*self.unread]), np.nan, y), u)

    def _diagnosed(self, row: WatchRow, ahead: float = np.inf) -> tuple[Sample, ...]:
        """Step to a row; ahead: seconds from it to the next one, where that is known."""
        pause = np.inf if self.t is None else row.t - self.t
        too_long = self.t is not None and pause > self.longest_gap
        fresh = self.state is None or too_long
        begins = row.t - lead_in(self.detector.plant, min(pause, ahead)) if fresh else np.nan
        try:
            if not fresh:
                self._require_step(row.t)
            given, known_at = self._inputs(row)
        except ValueError as error:
            self.refused(f"row at {self.clock.at(row.t)}: {error}; it is not taken")
            return ()
        u = self.given if self.at_sample and self.t is not None else given
        read = np.isfinite(row.y).any()
        came = possible(self.detector.plant, row.y)
        row = row if self.slow is None else row._replace(y=self.slow.take(row.y))
        changes = self.findings.reset(row.t, f"no rows for {pause:g} s", self.clock) if too_long else []
        try:
            state, decision, steps = self._stepped(row, u, begins)
            failing, failure = None, ""
        except RAISED as error:
            state, decision, steps = None, self._no_decision(), []
            failing, failure = type(error), f"the model failed: {described(error)}"
        if failing is not None:
            changes += self._failed(row.t, failure) if failing is not self.failing else []
        else:
            seen = Seen(row.t, came, u, decision, begins, tuple(steps), np.isnan(row.y) & np.isfinite(came))
            changes += self.findings.after(seen, decision, self.clock)
            if decision.diverged and not self.lost:
                changes += self.findings.reset(row.t, "the estimate diverged", self.clock)
        if failure:
            self.concluded = Conclusion(Verdict.BLIND, failure)
        elif decision.diverged or not read or np.isfinite(row.y).any():  # else all are repeats, and the verdict stands
            self.concluded = conclusion_of(decision, row.y, self.detector.process_hypotheses)
        changes += self.findings.sight(row.t, self.concluded, at_once=bool(decision.diverged))
        self.lost, self.failing, self.t = bool(decision.diverged), failing, row.t
        self.state = None if self.lost else state
        if np.all(np.isfinite(decision.estimate)) and decision.estimate.shape == self.x.shape:
            self.x = decision.estimate
        self.u, self.given, self.known_at = u, given, known_at
        with_alarms = tuple(map(self.alarms.with_alarm, changes))
        recent = (d for _, d in reversed(self.findings.changes.recent))
        standing, tested = self.alarms.standing, () if failing else self.detector.process_hypotheses
        health = sensor_health(self.detector.plant, decision, self.concluded, recent, standing, tested)
        return (Sample(row.t, row.y, u, decision, with_alarms, self.concluded, health),)

    def _stepped(self, row: WatchRow, u: Array, begins: float) -> tuple[State, Decision, list[tuple[float, Array]]]:
        """The state and the Decision after a row, and times and inputs of the steps before it; any error of the model.

        begins: the time at which the detector starts anew, NaN where it goes on.
        """
        detector = self.judge = self.judge or self.detector.dated(self.clock.start)
        plant, state, steps = detector.plant, self.state, []
        require_model(plant, row.t - plant.dt, row.t, self.x, u)
        if np.isfinite(begins) or state is None:
            state = detector.init((), begins)
        elif self.t is not None:
            steps = steps_over(plant, self.longest_step, (self.t, self.u), (row.t, u))
            for t, between in steps:
                state, _ = detector.step(state, t, np.full(len(plant.sensors), np.nan), between)
        state, decision = detector.step(state, row.t, row.y, u)
        if np.iscomplexobj(decision.residual) or np.iscomplexobj(decision.estimate):
            raise ModelError("it gives complex numbers")
        return state, decision, steps

    def _require_step(self, t: float) -> None:
        """Raise ValueError where a plant that holds for steps of one length cannot reach t from the last row."""
        plant = self.detector.plant
        if self.t is not None and plant.numerics.fixed_dt:
            plant.check_dt((t - self.t) / max(1, round((t - self.t) / plant.dt)))

    def _failed(self, t: float, failure: str) -> list[Change]:
        """What changes with the first, at t, of rows for which the model fails with one kind of error: a remark and a reset."""
        self.refused(f"row at {self.clock.at(t)}: {failure}; there is no verdict until the model works again")
        return self.findings.reset(t, failure, self.clock)

    def _no_decision(self) -> Decision:
        """A Decision of which every number is NaN."""
        plant, false = self.detector.plant, np.zeros((), bool)
        of_sensors, count = np.full(len(plant.sensors), np.nan), len(self.detector.hypotheses)
        return Decision(
            estimate=np.full(len(plant.states), np.nan),
            reconstruction=of_sensors,
            residual=of_sensors,
            threshold=of_sensors,
            isolated=np.zeros(count, bool),
            fault_size=np.full(count, np.nan),
            diverged=np.ones((), bool),
            guarded=false,
            nis=np.array(np.nan),
        )

    def _inputs(self, row: WatchRow) -> tuple[Array, Array]:
        """The inputs of a row, those that are missing or beyond their limits held, or the plant's usual ones, and the time of
        the last value of each; ValueError where one is neither.
        """
        plant, (low, high) = self.detector.plant, self.limits
        read = (row.u >= low) & (row.u <= high) & np.isfinite(row.u)
        known_at = np.where(read, row.t, self.known_at)
        if read.all() or self.unknown_inputs:
            return row.u, known_at
        if self.nominal_inputs:
            before = row.t - plant.dt if self.t is None else max(row.t - plant.dt, self.t)
            return np.where(read, row.u, plant.input_at(before)), known_at
        unknown = row.t - known_at > self.hold
        if not unknown.any():
            return np.where(read, row.u, self.given), known_at
        value, s = next((v, s) for v, s, bad in zip(row.u, plant.inputs, unknown, strict=True) if bad)
        came = f"is {value:g} {s.unit}, beyond {s.low:g} to {s.high:g}" if np.isfinite(value) else "is missing"
        raise ValueError(f"input {s.name} {came}, and its last value is held for {self.hold:g} s only")

    @cached_property
    def identity(self) -> str:
        """The fingerprint of the detector and its plant, by which a saved watch is matched."""
        return fingerprint(self.detector)

    def save(self, path: str | Path) -> None:
        """Write the state of this watch to a file, whole or not at all, from which `load` goes on with the same bits.

        Rows that wait or are held are not in it: they are to be given again. Before the first row nothing is written.

        Parameters
        ----------
        path : str or Path
            The file.
        """
        if self.t is None:
            return
        own = {"t": np.array(self.t), "u": self.u, "given": self.given, "known_at": self.known_at, "lost": np.array(self.lost)}
        own["clock"] = np.array("" if self.clock.start is None else self.clock.start.isoformat())
        own |= {"verdict": np.array(str(self.concluded.verdict)), "reason": np.array(self.concluded.reason)}
        own |= {"alarms": np.array(str(self.alarms)), "version": np.array(VERSION), "fingerprint": np.array(self.identity)}
        state = {} if self.state is None else state_arrays(self.state, self.identity)
        parts = {
            "watch": own,
            "changes": self.findings.arrays(),
            "slow": {} if self.slow is None else self.slow.arrays(),
            "state": state,
        }
        write_arrays(Path(path), {f"{part}/{name}": value for part, named in parts.items() for name, value in named.items()})

    @classmethod
    def load(cls, path: str | Path, detector: Detector, **settings: Any) -> Watch:
        """The watch that was saved, with the same detector and settings.

        Given all rows after `t` again, or all rows from the start, it goes on as if it had never stopped: what it decided
        after the save it decides again, with the same ids.

        Parameters
        ----------
        path : str or Path
            The file that `save` wrote.
        detector : Detector
            That of the saved watch.
        **settings
            Those of the saved watch, see `Watch`.

        Returns
        -------
        Watch
            As it was when it was saved.

        Raises
        ------
        ValueError
            For another file, version, detector or plant.
        """
        found = cls(detector, **settings)
        parts: dict[str, dict[str, Array]] = {"watch": {}, "changes": {}, "slow": {}, "state": {}}
        try:
            for name, value in read_arrays(Path(path)).items():
                part, _, rest = name.partition("/")
                if part not in parts:
                    raise ValueError(f"{name!r} is not known")
                parts[part][rest] = value
            own = SavedArrays(parts["watch"])
            version = own.take("version", "i") if "version" in own.arrays else 1
            if version != VERSION:
                raise ValueError(f"it is of version {version} of this file, and this package reads version {VERSION}")
        except ValueError as error:
            raise ValueError(f"{path} is not the saved state of a watch ({error}); {ANEW}") from error
        try:
            if str(own.take("fingerprint", "U")) != found.identity:
                raise OtherDetectorError(of_another_detector(path, detector))
            found._restore(own, parts["changes"], parts["slow"])
        except OtherDetectorError:
            raise
        except Exception as error:  # what has a valid digest may still hold anything
            raise ValueError(f"{path} is not the saved state of a watch ({error}); {ANEW}") from error
        found.state = None if not parts["state"] else state_of(path, detector, parts["state"])
        return found

    def _restore(self, own: SavedArrays, changes: dict[str, Array], slow: dict[str, Array]) -> None:
        """Take over what `save` wrote; ValueError where it does not fit the detector."""
        m = len(self.detector.plant.inputs)
        self.clock = Clock(datetime.fromisoformat(text) if (text := str(own.take("clock", "U"))) else None)
        self.t, self.u, self.given, self.known_at = float(own.take("t", "f")), *(own.take(n, "f", m) for n in OF_INPUTS)
        self.lost = bool(own.take("lost", "b"))
        known = self.unknown_inputs or (np.isfinite(self.u).all() and np.isfinite(self.given).all())
        if not (np.isfinite(self.t) and known):
            raise ValueError("'t', 'u' or 'given' is not finite")
        if np.isnan(self.known_at).any() or (self.known_at > self.t).any():
            raise ValueError("'known_at' is not a time before the last row")
        self.concluded = Conclusion(Verdict(str(own.take("verdict", "U"))), str(own.take("reason", "U")))
        self.alarms = Alarms.of(str(own.take("alarms", "U")))
        own.end()
        self.order.loaded = self.t
        self.findings.restore(changes)
        if unknown := slow.keys() - ({} if self.slow is None else self.slow.arrays()).keys():
            raise ValueError(f"{unknown} of slow sensors is not known")
        if self.slow is not None:
            self.slow.restore(slow)
