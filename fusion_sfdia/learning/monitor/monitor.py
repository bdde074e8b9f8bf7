"""Monitoring without a model: what is learnt from healthy logs, kept in one file, and the diagnosis of other logs with it."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.clock import Clock
from fusion_sfdia.common.rate import PERIODS, SAMPLE, Rate, lasting
from fusion_sfdia.common.steps import Each, in_silence
from fusion_sfdia.detectors.storage import read_arrays, write_arrays
from fusion_sfdia.diagnosis.events import with_unit
from fusion_sfdia.diagnosis.watch import Watch
from fusion_sfdia.learning.monitor.causes import OK
from fusion_sfdia.learning.monitor.channels import Channels, GridRows, learn_channels, pieces_of, usual_step
from fusion_sfdia.learning.monitor.held_out import JOINED, WITNESS, Asked, LearntLimits, learn
from fusion_sfdia.learning.monitor.live_monitor import AT_ONCE, LiveMonitor, Past, follow
from fusion_sfdia.learning.monitor.residuals import rows_of
from fusion_sfdia.learning.monitor.row_verdicts import SECONDS, Verdicts, diagnosed, joined_verdicts, plant_of
from fusion_sfdia.learning.monitor.saved import packed, unpacked
from fusion_sfdia.learning.monitor.stated_physics import learn_stated
from fusion_sfdia.learning.monitor.unmodelled_logs import load, signals_of
from fusion_sfdia.logs.check import unlike_healthy
from fusion_sfdia.logs.loaded_log import LoadedLog, counted
from fusion_sfdia.logs.log_map import PLAIN_MAP, LogMap, load_map
from fusion_sfdia.logs.physics import StatedPhysics
from fusion_sfdia.plant.gaps import LONG, SKIPPED
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Signal
from fusion_sfdia.report.result import Result

Array = NDArray[Any]

FALSE_ALARM = 0.01  # share of rows: some hundred healthy rows support no lower one
SUPPORTED = 4.0  # rows in alarm that the healthy rows would hold at the lowest rate that they can set
FOUND = 1.3  # standard deviations above its limit: a lasting bias of so much is found with a probability of 0.9
LEAST = 64  # healthy rows
CHANGED = 1.25  # factor of a limit that is worth a line
FEWEST, CLOSEST = 20, 0.1  # rows of a log from which on its step is judged, by this quantile of their distances
VERSION = 4
NAME, BASIS = "the monitor", "judged by healthy logs, without a model"


@dataclass(frozen=True, eq=False)
class Monitor:
    """What was learnt from healthy logs of one plant; `Monitor.fit` makes it.

    Attributes
    ----------
    channels : Channels
        Which columns are used, and how.
    dt : float
        Step of the grid in s.
    rate : Rate
        The stated share of rows in alarm, or number of alarms in a time.
    per_row : float
        The share of rows in alarm that the limits of single tests are for.
    learnt : LearntLimits
        The limits.
    healthy : tuple of (str, int, str, str)
        Of each log its name, its rows, and where it begins and ends, in words.
    logs : tuple of Log
        They, in rows of the grid.
    remarks : tuple of str
        What is to be known of what was learnt.
    physics : StatedPhysics
        What was stated of it.

    Examples
    --------
    >>> import numpy as np
    >>> from fusion_sfdia import Log, Monitor, Signal
    >>> def log(seed, rows=400):
    ...     rng = np.random.default_rng(seed)
    ...     y = np.sin(np.arange(rows) / 30)[:, None] * [1.0, 0.8, 0.5] + 0.02 * rng.standard_normal((rows, 3))
    ...     return Log(np.arange(rows) * 60.0, y, np.zeros((rows, 0)))
    >>> monitor = Monitor.of_logs([Signal("a"), Signal("b"), Signal("c")], [log(1), log(2), log(3)])
    >>> faulty = log(4)
    >>> faulty.y[200:, 0] += 0.5
    >>> found = monitor.diagnose(faulty)
    >>> found.state, found.events[0].hypothesis
    (<Verdict.SENSOR: 'sensor'>, 'b or c')
    """

    channels: Channels
    dt: float
    rate: Rate
    per_row: float
    learnt: LearntLimits
    healthy: tuple[tuple[str, int, str, str], ...]
    logs: tuple[Log, ...]
    remarks: tuple[str, ...] = field(default=())
    physics: StatedPhysics = field(default_factory=StatedPhysics)

    @classmethod
    def fit(
        cls,
        healthy: Any,
        *,
        inputs: Sequence[str] = (),
        ignore: Sequence[str] = (),
        log_map: LogMap | str | Path | None = None,
        false_alarm: float | str | Rate = FALSE_ALARM,
        same: Sequence[str] | Sequence[Sequence[str]] = (),
        drives: Mapping[str, str | Sequence[str]] | None = None,
        say: Callable[[Any, LoadedLog], object] = lambda source, log: None,
        each: Each = in_silence,
    ) -> Monitor:
        """Learn from healthy logs: a file or a pandas frame, or a sequence of them, each of one run.

        Parameters
        ----------
        healthy : file, frame or sequence of them
            The logs; columns that are no inputs, not ignored and not the time are sensors.
        inputs : sequence of str, default ()
            Titles of columns that act on the plant.
        ignore : sequence of str, default ()
            Titles of columns that are left out.
        log_map : LogMap, str or Path, optional
            How the logs are written, or the file that states it.
        false_alarm : float, str or Rate, default 0.01
            Share of rows in alarm, or alarms in a time, such as "1/week": runs of rows in alarm, less than 16 rows apart.
        same : sequence of str, or of such, default ()
            Sensors that measure one quantity, up to an offset and a gain, or several groups of such, beside those of the map.
        drives : mapping of str to str or sequence of str, optional
            Of inputs the sensors that move with them, beside those of the map.
        say : callable, optional
            Called with each source and its log as it was read.
        each : callable, optional
            Wraps the parts of the rows, with what is done, to show progress.

        Returns
        -------
        Monitor
            Which diagnoses logs of the same columns.

        Raises
        ------
        ValueError
            For files that cannot be read, for logs that do not fit or are too short, and where no channel can be learnt.
        """
        sources = list(healthy) if isinstance(healthy, list | tuple) else [healthy]
        if not sources:
            raise ValueError("there are no healthy logs; expected at least one")
        written = _map(log_map)
        sensors, signals = signals_of(sources[0], inputs, ignore, written)
        loaded = []
        for source in sources:
            loaded.append(load(source, sensors, signals, written))
            say(source, loaded[-1])
        names = list(map(_name, sources, range(1, len(sources) + 1)))
        physics = written.physics.beside(StatedPhysics(same, drives or {}))
        return cls.of_logs(
            sensors, [one.log for one in loaded], inputs=signals, false_alarm=false_alarm, names=names,
            clocks=[one.clock for one in loaded], each=each, same=physics.same, drives=physics.drives,
        )  # fmt: skip

    @classmethod
    def of_logs(
        cls,
        sensors: Sequence[Signal],
        healthy: Sequence[Log],
        *,
        inputs: Sequence[Signal] = (),
        false_alarm: float | str | Rate = FALSE_ALARM,
        dt: float | None = None,
        same: Sequence[str] | Sequence[Sequence[str]] = (),
        drives: Mapping[str, str | Sequence[str]] | None = None,
        names: Sequence[str] = (),
        clocks: Sequence[Clock] = (),
        each: Each = in_silence,
    ) -> Monitor:
        """Learn from healthy logs, each of one run: t (K,), y (K, N) and u (K, m), NaN where missing.

        Parameters
        ----------
        sensors : sequence of Signal (N,)
            Name and unit of each column of y.
        healthy : sequence of Log
            At least one.
        inputs : sequence of Signal (m,), default ()
            Name and unit of each column of u.
        false_alarm : float, str or Rate, default 0.01
            Share of rows in alarm, or alarms in a time, such as "1/day".
        dt : float, optional
            Step of the grid in s, None for that of the logs.
        same : sequence of str, or of such, default ()
            Sensors that measure one quantity, as for `fit`.
        drives : mapping of str to str or sequence of str, optional
            Of inputs the sensors that move with them.
        names : sequence of str, default ()
            Of the logs.
        clocks : sequence of Clock, default ()
            Of the logs, for their times in words.
        each : callable, optional
            As for `fit`.

        Returns
        -------
        Monitor
            Which diagnoses logs of the same sensors and inputs.

        Raises
        ------
        ValueError
            For logs that do not fit, that are too short, or of which no channel can be learnt, and for names that they lack.
        """
        if not healthy:
            raise ValueError("there are no healthy logs; expected at least one")
        for k, log in enumerate(healthy, start=1):
            if np.ndim(log.y) != 2 or log.y.shape[1] != len(sensors) or np.shape(log.u)[1:] != (len(inputs),):
                raise ValueError(
                    f"healthy log {k} has y of shape {np.shape(log.y)} and u of shape {np.shape(log.u)}; expected "
                    f"{len(sensors)} sensors and {len(inputs)} inputs, a row a time"
                )
        physics = StatedPhysics(same, drives or {})
        physics.require(sensors, inputs)
        dt = dt or usual_step(healthy)
        stated = Rate.of(false_alarm)
        logs = [pieces_of(log, dt) for log in healthy]
        rows = sum(len(p.t) for log in logs for p in log)
        if rows < LEAST:
            raise ValueError(f"the healthy logs have {rows} rows in steps of {dt:g} s; expected at least {LEAST}: record more")
        channels = learn_channels(sensors, inputs, logs)
        per_row = stated.per_sample(dt)
        least = SUPPORTED / rows
        pieces = [p for log in logs for p in log]
        of = [k for k, log in enumerate(logs) for _ in log]
        scaled = [rows_of(channels, p.v)[0] for p in pieces]
        learnt_physics, unused = learn_stated(physics, channels, [s.z for s in scaled], [p.v for p in pieces])
        asked = Asked(max(per_row, least), None if stated.per == SAMPLE else per_row * rows)
        learnt = learn(scaled, learnt_physics, asked, of, each)
        clocks = list(clocks) or [SECONDS] * len(healthy)
        named = list(names) or [f"healthy log {k}" for k in range(1, len(healthy) + 1)]
        origin = tuple(
            (name, len(log.t), clock.at(float(log.t[0])), clock.at(float(log.t[-1])))
            for name, log, clock in zip(named, healthy, clocks, strict=True)
        )
        moments = [
            (float(p.t[0]), len(p.t), clock, name) for name, log, clock in zip(named, logs, clocks, strict=True) for p in log
        ]
        gridded = tuple(_as_log([_there(p) for p in log], len(sensors)) for log in logs)
        found = cls(channels, dt, stated, max(per_row, least), learnt, origin, gridded, physics=physics)
        return replace(found, remarks=(*unused, *_remarks(found, rows, per_row, moments)))

    @property
    def plant(self) -> Plant:
        """The signals as a plant that does nothing, for reports; sigma: the deviation of the readings when healthy."""
        return plant_of(self.channels, self.dt)

    def _on_grid(self, log: Log) -> Log:
        """A log of one run with its rows as they are judged, y (K, N) and u (K, m), NaN where there is no reading."""
        return _as_log(pieces_of(self._fitting(log), self.dt), len(self.channels.sensors))

    def update(self, healthy: Any, *, log_map: LogMap | str | Path | None = None, each: Each = in_silence) -> Monitor:
        """A monitor that has learnt from later healthy logs as well, with what has changed among its remarks.

        Parameters
        ----------
        healthy : file, frame or sequence of them
            As for `fit`, of the same columns.
        log_map : LogMap, str or Path, optional
            How the logs are written, or the file that states it.
        each : callable, optional
            As for `fit`.

        Returns
        -------
        Monitor
            A new one; this one stays as it is.

        Raises
        ------
        ValueError
            For other columns, and for rows that are further apart.
        """
        sources = list(healthy) if isinstance(healthy, list | tuple) else [healthy]
        read = [source if isinstance(source, LoadedLog) else self.read(source, log_map) for source in sources]
        count = len(self.channels.sensors)
        later = [_as_log([_there(p) for p in pieces_of(self._fitting(one.log), self.dt)], count) for one in read]
        names = [*(name for name, *_ in self.healthy), *map(_name, sources, range(len(self.logs) + 1, 10**6))]
        sensors, inputs = self.channels.sensors, self.channels.inputs
        found = Monitor.of_logs(
            sensors, [*self.logs, *later], inputs=inputs, false_alarm=self.rate, dt=self.dt, names=names, each=each,
            same=self.physics.same, drives=self.physics.drives,
        )  # fmt: skip
        origin = tuple(
            (name, len(log.t), one.clock.at(float(log.t[0])), one.clock.at(float(log.t[-1])))
            for name, log, one in zip(names[len(self.logs) :], later, read, strict=True)
        )
        return replace(found, healthy=(*self.healthy, *origin), remarks=(*_changes(self, found, later, names), *found.remarks))

    def read(self, source: Any, log_map: LogMap | str | Path | None = None, *, absent_sensors: bool = False) -> LoadedLog:
        """Read a log, a file or a pandas frame, of the columns that were learnt.

        Parameters
        ----------
        source : file or frame
            The log.
        log_map : LogMap, str or Path, optional
            How it is written, or the file that states it.
        absent_sensors : bool, default False
            Whether sensors without a column are missing throughout.

        Returns
        -------
        LoadedLog
            As `diagnose` takes it.

        Raises
        ------
        ValueError
            Where a column is not there.
        """
        found = load(source, self.channels.sensors, self.channels.inputs, _map(log_map), absent_sensors=absent_sensors)
        return found._replace(findings=(*found.findings, *unlike_healthy(self.channels.sensors, self.logs, found.log)))

    def diagnose(
        self, log: Any, clock: Clock = SECONDS, *, log_map: LogMap | str | Path | None = None, each: Each = in_silence
    ) -> Result:
        """Diagnose a log of one run.

        Parameters
        ----------
        log : file, frame, LoadedLog or Log
            A file, a pandas frame, what `read` gave, or a Log, y (K, N) and u (K, m) of all sensors and inputs, NaN where
            missing.
        clock : Clock, optional
            Of a Log; by default its seconds.
        log_map : LogMap, str or Path, optional
            How a file is written, or the file that states it.
        each : callable, optional
            As for `fit`.

        Returns
        -------
        Result
            The events, the Decisions behind them and the readings, a row for each row of the grid.
        """
        source = Path(log).name if isinstance(log, str | Path) else "a log"
        if isinstance(log, Log):
            log = LoadedLog(log, clock, tuple(unlike_healthy(self.channels.sensors, self.logs, self._fitting(log))))
        elif not isinstance(log, LoadedLog):
            log = self.read(log, log_map)
        verdicts = self.judge(log.log, each)
        rows = sum(len(v.t) for v in verdicts)
        limits = self.learnt.limits
        expected = f"without a fault some {limits.rate[0] * rows:.2g} of these {rows} rows would be in alarm"
        if self.rate.per != SAMPLE:
            expected = f"without a fault some {limits.alarms[0] * rows:.2g} alarms would begin in these {rows} rows"
        misread = tuple(f.text for f in log.findings if f.kind == "unit suspected")
        found = diagnosed(self.channels, self.dt, verdicts, (*misread, self.promise, expected, *self.remarks), log.clock)
        known = tuple(e for e in found.events if not (e.fault == "dropout" and e.hypothesis in log.absent))
        found = replace(found, events=known)  # that a sensor is silent which the log is known not to have is no finding
        return Result.of(
            found, plant=self.plant, detector=NAME, log=self._on_grid(log.log), columns=log.columns, source=source, basis=BASIS,
            misread=misread,
        )  # fmt: skip

    def judge(self, log: Log, each: Each = in_silence) -> list[Verdicts]:
        """The verdicts on a log, of its pieces between gaps of more than 60 rows.

        Parameters
        ----------
        log : Log
            Of one run, with all sensors and inputs.
        each : callable, optional
            As for `fit`.

        Returns
        -------
        list of Verdicts
            One for each piece.
        """
        pieces = pieces_of(self._fitting(log), self.dt)
        found: list[list[Verdicts]] = [[] for _ in pieces]
        past = nothing = Past.none(self.channels, self.learnt)
        for i, k in each([(i, k) for i, piece in enumerate(pieces) for k in range(0, len(piece.t), AT_ONCE)], "diagnosing"):
            piece, rows = pieces[i], slice(k, k + AT_ONCE)
            verdicts, past = follow(self.channels, self.learnt, piece.t[rows], piece.v[rows], past if k else nothing)
            found[i].append(verdicts)
        return list(map(joined_verdicts, found))

    def stream(self, state: str | Path | None = None, **settings: Any) -> Watch:
        """The monitor over rows as they come: `Watch.update` decides as `diagnose` does on the rows so far.

        Parameters
        ----------
        state : str or Path, optional
            A file that `Watch.save` wrote, from which it goes on.
        **settings
            Further ones of `Watch`.

        Returns
        -------
        Watch
            Before its next row.
        """
        of_monitor = {"gap": JOINED, "kinds": False, "repeats": True, "unknown_inputs": True, "longest_gap": LONG * self.dt}
        if state is None:
            return Watch(self.live, **of_monitor | settings)
        return Watch.load(state, self.live, **of_monitor | settings)

    @property
    def live(self) -> LiveMonitor:
        """The monitor as a detector, which takes one row after another."""
        return LiveMonitor(self.channels, self.dt, self.learnt)

    def _fitting(self, log: Log) -> Log:
        t, y, u = log
        if np.ndim(y) != 2 or y.shape[1] != len(self.channels.sensors) or np.shape(u)[1:] != (len(self.channels.inputs),):
            raise ValueError(
                f"y {np.shape(y)}, u {np.shape(u)} do not fit {len(self.channels.sensors)} sensors and "
                f"{len(self.channels.inputs)} inputs; give those of the healthy logs"
            )
        if np.size(t) >= FEWEST and np.quantile(np.diff(t), CLOSEST) > SKIPPED * self.dt:
            raise ValueError(
                f"the log has a row every {np.median(np.diff(t)):g} s, and the monitor has learnt rows {self.dt:g} s apart; "
                "learn another one from healthy logs with these steps"
            )
        return Log(t, y, u)

    def smallest(self) -> dict[str, dict[int, float]]:
        """Of each sensor the smallest lasting bias that is found with a probability of 0.9, in its unit, by rows of window.

        Returns
        -------
        dict of str to dict of int to float
            By sensor, then by rows of the window.
        """
        limits = self.learnt.limits
        found: dict[str, dict[int, float]] = {}
        for i, name in enumerate(self.channels.names[: self.channels.count]):
            if np.isfinite(self.channels.floor[i]):
                continue
            found[name] = {
                t.scale: float((limits.limit[k, i] + FOUND * limits.deviation[k, i]) * self.channels.sd[i])
                for k, t in enumerate(limits.tests)
                if t.kind == "level" and np.isfinite(limits.limit[k, i])
            }
        return found

    @property
    def promise(self) -> str:
        """What is promised of the rows in alarm, and, where their number in a time was asked for, of alarms, in words."""
        trend = [n for n, t in zip(self.channels.names, self.learnt.limits.trend, strict=False) if t]
        if trend:
            return f"no rate of false alarms can be stated: {_and(trend)} drifted over the healthy logs; record longer ones"
        limits = self.learnt.limits
        mean, low, high = limits.rate
        rows = f"rows in alarm without a fault: {mean:.2g} ({low:.2g} to {high:.2g}) for a log like the healthy ones"
        if self.rate.per == SAMPLE:
            return rows
        mean, low, high = (count * PERIODS[self.rate.per] / self.dt for count in limits.alarms)
        return (
            f"alarms without a fault: {mean:.2g}/{self.rate.per} ({low:.2g} to {high:.2g}), each of one row or several; {rows}"
        )

    def __str__(self) -> str:
        count = sum(rows for _, rows, _, _ in self.healthy)
        used, n = self.channels.names, self.channels.count
        lines = [
            f"learnt from {count} healthy rows, {lasting(self.dt)} apart: {counted(n, 'sensor')}, "
            f"{counted(len(used) - n, 'input')}; windows of up "
            f"to {max(t.scale for t in self.learnt.limits.tests)} rows",
            self.promise,
            *str(self.physics).splitlines(),
            *self.remarks,
        ]
        every = (*self.channels.sensors, *self.channels.inputs)
        if kept := [f"{s.name} ({lasting(h * self.dt)})" for s, h in zip(every, self.channels.hold, strict=True) if h]:
            lines.append(f"written on change, a reading counts until the next one, at most so long: {', '.join(kept)}")
        lines += [
            f"{s.name}: has isolated outliers when healthy; the first two readings of a jump by more than "
            f"{with_unit(f'{far:.3g}', s.unit)} do not count"
            for s, far in zip(every, self.channels.far, strict=True)
            if np.isfinite(far)
        ]
        lines += [f"left out: {name}, {why}" for name, why in self.channels.left_out.items()]
        lines += [
            f"{name}: never moved when healthy, always {value:.6g}; any other reading is reported"
            for name, value in self.channels.still.items()
        ]
        units = {s.name: s.unit for s in self.channels.sensors}
        alone = (self.learnt.limits.explained < WITNESS) & (self.learnt.stated.group < 0)
        steps = np.isfinite(self.learnt.jumps.step)
        for i, (name, sizes) in enumerate(self.smallest().items()):
            if sizes:
                w = min(sizes, key=lambda k: sizes[k])
                size = with_unit(f"{sizes[w]:.3g}", units[name])
                lines.append(
                    f"{name}: a lasting bias of {size} is found within {lasting(w * self.dt)}"
                    + ("; no other channel measures it, so sensor and process cannot be told apart" if alone[i] else "")
                    + (" unless it steps in one row" if alone[i] and steps[i] else "")
                )
        return "\n".join(lines)

    def save(self, path: str | Path) -> None:
        """Write the monitor to one file; `Monitor.load` reads it.

        Parameters
        ----------
        path : str or Path
            The file.
        """
        arrays, learnt = packed(self.channels, self.learnt)
        about = {"version": VERSION, "dt": self.dt, "rate": str(self.rate), "per_row": self.per_row}
        text = json.dumps(
            {**about, "healthy": self.healthy, "remarks": self.remarks, "physics": asdict(self.physics), **learnt}
        )
        rows = {f"log {k} {what}": values for k, log in enumerate(self.logs) for what, values in log._asdict().items()}
        write_arrays(Path(path), {"monitor": np.array(text), **arrays, **rows}, compress=True)

    @classmethod
    def load(cls, path: str | Path) -> Monitor:
        """Read a monitor that `save` wrote.

        Parameters
        ----------
        path : str or Path
            The file.

        Returns
        -------
        Monitor
            As it was saved.

        Raises
        ------
        ValueError
            Which names the file, where it is none.
        """
        try:
            arrays = read_arrays(Path(path))
            about = json.loads(str(arrays.pop("monitor")))
            if about["version"] != VERSION:
                raise ValueError(f"it is of version {about['version']}, this package reads {VERSION}: learn it again")
            channels, learnt = unpacked(arrays, about)
            healthy = tuple((str(n), int(k), str(a), str(b)) for n, k, a, b in about["healthy"])
            rate, remarks = Rate.of(about["rate"]), tuple(map(str, about["remarks"]))
            logs = tuple(Log(*(arrays[f"log {k} {what}"] for what in Log._fields)) for k in range(len(healthy)))
            physics = StatedPhysics(**about["physics"])
            return cls(channels, float(about["dt"]), rate, float(about["per_row"]), learnt, healthy, logs, remarks, physics)
        except OSError as error:
            raise ValueError(f"{path} cannot be read: {error}") from error
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise ValueError(f"{path} is no monitor ({error}); write one with `monitor --save`, or Monitor.save") from error


def _name(source: Any, k: int) -> str:
    return Path(source).name if isinstance(source, str | Path) else f"healthy log {k}"


def _there(piece: GridRows) -> GridRows:
    """The rows of a piece that are in its log."""
    some = piece.rows >= 0
    return GridRows(piece.t[some], piece.v[some], piece.rows[some])


def _as_log(pieces: Sequence[GridRows], sensors: int) -> Log:
    values = np.concatenate([p.v for p in pieces])
    return Log(np.concatenate([p.t for p in pieces]), values[:, :sensors], values[:, sensors:])


def _changes(before: Monitor, now: Monitor, later: Sequence[Log], names: Sequence[str]) -> list[str]:
    """What later healthy logs have changed, in words."""
    lines = []
    for name, log in zip(names[len(before.logs) :], later, strict=True):
        share = float(np.mean(np.concatenate([v.causes.kind for v in before.judge(log)]) != OK))
        odd = share > 2 * before.learnt.limits.rate[2]
        lines.append(
            f"{name}: {share:.2g} of its rows were in alarm, or outside, before" + (": was it healthy?" if odd else "")
        )
    was, is_now = before.smallest(), now.smallest()
    for sensor in now.channels.sensors:
        a, b = (min(found.get(sensor.name, {}).values(), default=np.inf) for found in (was, is_now))
        if np.isfinite(b) and abs(np.log(b / a)) > np.log(CHANGED):
            lines.append(f"{sensor.name}: a lasting bias is found from {with_unit(f'{b:.3g}', sensor.unit)} on, before {a:.3g}")
    for name, why in now.channels.left_out.items():
        if name not in before.channels.left_out:
            lines.append(f"{name} is no longer used: {why}")
    lines += [f"{name} is used now" for name in before.channels.left_out if name not in now.channels.left_out]
    return lines


def _map(given: LogMap | str | Path | None) -> LogMap:
    return PLAIN_MAP if given is None else given if isinstance(given, LogMap) else load_map(given)


def _remarks(found: Monitor, rows: int, per_row: float, moments: Sequence[tuple[float, int, Clock, str]]) -> list[str]:
    """What the healthy logs cannot support."""
    lines = []
    if found.rate.per != SAMPLE:
        if per_row * rows < 1:
            lines.append(
                f"{lasting(rows * found.dt)} of healthy rows can promise 1 alarm in as long, not {found.rate}: record more"
            )
    elif per_row < found.per_row:
        lines.append(
            f"{rows} healthy rows set limits for {found.per_row:.2g} of the rows in alarm, not {per_row:.2g}: record more"
        )
    limits, names = found.learnt.limits, found.channels.names
    for one, what in ((limits.unlike, "differs from the rest"), (limits.wild, "is much wider than the rest")):
        worst: dict[tuple[int, int], float] = {}
        for u in one:
            worst[u.block, u.sensor] = max(worst.get((u.block, u.sensor), 0.0), u.factor)
        for (block, sensor), factor in sorted(worst.items(), key=lambda item: -item[1])[:3]:
            first, last = (int(found.learnt.edges[e]) for e in (block, block + 1))
            lines.append(
                f"{names[sensor]} {what} from {_when(moments, first, found.dt)} to {_when(moments, last - 1, found.dt)}, by a "
                f"factor of {factor:.2g}: was it healthy? If not, leave that time out, or give another log"
            )
    return lines


def _when(moments: Sequence[tuple[float, int, Clock, str]], row: int, dt: float) -> str:
    for start, count, clock, name in moments:
        if row < count:
            return clock.at(start + row * dt) + (f" of {name}" if len({m[3] for m in moments}) > 1 else "")
        row -= count
    start, count, clock, _ = moments[-1]
    return clock.at(start + (count - 1) * dt)


def _and(names: Sequence[str]) -> str:
    return ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")
