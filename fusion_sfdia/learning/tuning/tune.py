"""From healthy readings to a tuned plant and detector, with thresholds for a stated rate of false alarms.

The log is cut in two halves. What was learnt from one predicts the other, and the scores on these predictions set the
thresholds, so that no threshold is set on readings from which the model was learnt. The plant of the file is then learnt from
the whole log.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia import __version__
from fusion_sfdia.common.clock import Clock, posix, within
from fusion_sfdia.common.errors import NotApplicableError
from fusion_sfdia.common.rate import Rate, lasting
from fusion_sfdia.common.steps import Each, in_silence
from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.detector import Detector
from fusion_sfdia.detectors.silent import require_scale, silent, silent_scores
from fusion_sfdia.learning.commissioning.commission import Commissioning, as_runs
from fusion_sfdia.learning.commissioning.parameters import moved
from fusion_sfdia.learning.commissioning.refusals import require_moving
from fusion_sfdia.learning.model_and_monitor import with_further
from fusion_sfdia.learning.monitor.monitor import Monitor
from fusion_sfdia.learning.tuning.frozen import tuned_frozen
from fusion_sfdia.learning.tuning.stationary import require_no_drift, require_stationary
from fusion_sfdia.learning.tuning.tail import AlarmCount, Threshold, counted, shortest, threshold, threshold_figures
from fusion_sfdia.learning.tuning.tuned import (
    Tuned,
    acting_plant,
    learnt_plant,
    learnt_tables,
    plant_table,
    scaled,
    settings_digest,
)
from fusion_sfdia.learning.tuning.words import remarks
from fusion_sfdia.plant.gaps import LONG, stated_step, stretches
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Signal

Array = NDArray[Any]

LEARNT_ON = 40  # samples above its limits from which a detector that learns sets them itself, before they are scaled
FALSE_ALARM = Rate(1e-3)  # that of registered detectors
EVEN = 0.01  # of dt: times of runs side by side may differ by so much
LEAST = 40  # samples of a run
SIZES = 3.0, 10.0  # sigma
AHEAD = 60  # samples in which it is to be detected
ONSETS = 3
RUNS = 240  # at most, of all sensors, onsets and signs together


class HealthySource(NamedTuple):
    """Where healthy readings come from: a file, and the clock of its times."""

    name: str
    clock: Clock = Clock()


def tune(
    plant: Plant | str,
    *healthy: Any,
    false_alarm: str | float | Rate = "1/day",
    detector: str = registry.COMMISSIONED,
    further: Sequence[Signal | str] = (),
    strict: bool = False,
    sources: Sequence[HealthySource] = (),
    made: str = "",
    each: Each = in_silence,
) -> Tuned:
    """Tune a plant and a detector on healthy readings of the real plant.

    Parameters
    ----------
    plant : Plant or str
        The model.
    *healthy : Log, Recording, frame or tuple
        Logs, each as `as_log` takes it in one argument, of one run or several.
    false_alarm : str, float or Rate, default "1/day"
        Samples in alarm, such as "1/day" or 1e-3 (per sample), see `Rate`.
    detector : str, default "frozen-model"
        A registered name, or a reference such as "mine.py:MyDetector". One that commissions the plant by itself,
        "frozen-model", leaves readings that are not healthy out, and lists them (`quality`).
    further : sequence of Signal or str, default ()
        Channels of the logs of which the model predicts nothing, behind its sensors in y, or the titles of their columns in a
        frame; of "frozen-model" alone. A monitor learns these and the sensors, and the tuned detector gives one verdict by the
        model and by the monitor, each at half of the rate.
    strict : bool, default False
        Such readings raise ValueError, as they do for all other detectors.
    sources : sequence of HealthySource, default ()
        Where each log comes from, for the file alone.
    made : str, default ""
        The date, for the file alone.
    each : callable, optional
        Wraps the steps of each pass over the readings, with what it is, to show progress; of "frozen-model" alone.

    Returns
    -------
    Tuned
        Noise of the sensors, thresholds and what else was set.

    Raises
    ------
    ValueError
        With the reason, for readings that cannot carry it: too short for the plant or the rate, a fault among them, not
        stationary.
    NotApplicableError
        Where the detector does not apply to the plant.

    Examples
    --------
    >>> from fusion_sfdia import simulate, tune
    >>> from fusion_sfdia.plants import two_tanks
    >>> healthy = simulate(two_tanks(), 400, seeds=[1], process_noise=True)
    >>> tuned = tune("two-tanks", healthy, false_alarm=0.02, detector="limits")
    >>> tuned.detector_name
    'limits'
    """
    plant, rate, entry = registry.plant(plant), Rate.of(false_alarm), registry.find_detector(detector)
    channels = tuple(s if isinstance(s, Signal) else Signal(s) for s in further)
    if channels and not entry.commissions:
        raise ValueError(
            f"further channels are judged beside {registry.COMMISSIONED!r}, not {entry.name!r}; leave detector, or further, out"
        )
    whole = with_further(plant, channels)
    logs = [_runs(as_runs(whole, (one,))) for one in healthy]
    origin = list(sources) or [HealthySource(f"readings {i + 1}") for i in range(len(logs))]
    apart, moments = [run for runs in logs for run in runs], _moments(logs, origin)
    if entry.commissions:
        log, times, of = as_even_runs(plant, [run._replace(y=run.y[:, : len(plant.sensors)]) for run in apart])
        each_rate = Rate(rate.count / 2, rate.per) if channels else rate
        frozen = tuned_frozen(plant, log, partial(_at, times, of, moments), each_rate, strict, each)
        per_sample = rate.per_sample(float(np.median(np.diff(log.t))))
        used = {"name": entry.name, "threshold_scale": frozen.detector.threshold_scale, "false_alarm": str(rate)}
        document = {"plant": plant_table(plant), "detector": used | {"per_sample": per_sample}, **frozen.tables}
        built, monitor, quality = replace(frozen.detector, commissioned=_end(origin, logs)), None, frozen.quality
        if channels:
            monitor = _monitor(whole, logs, origin, per_sample / 2, each)
            document |= {"further": {s.name: {"unit": s.unit} for s in channels}}
            quality = _with_monitor(quality, monitor)
        return Tuned(document | _provenance(origin, logs, made) | {"quality": quality}, built, entry, monitor)
    for run, moment in zip(apart, moments, strict=True):
        require_moving(plant, as_runs(plant, (run,)), partial(_at, run.t[:, None], (0,), [moment]))
    log, times, of = as_even_runs(plant, apart)
    at = partial(_at, times, of, moments)
    dt = float(np.median(np.diff(log.t)))
    per_sample = rate.per_sample(dt)
    _require_enough(log, 0, rate, dt)
    found = Commissioning.of(plant, log, false_alarm=None, at=at)
    _require_enough(log, found.settle, rate, dt)
    at_the_mean = plant if found.parameters is None else moved(plant, found.parameters)
    sigma = np.minimum(plant.sensor_sigma, found.plant.sensor_sigma)
    require_no_drift(at_the_mean, log, found.settle, sigma, at)
    first, second = (fit.single[found.settle :] for fit in found.fits)
    settled, middle = partial(_at, times[found.settle :], of, moments), found.middle - found.settle
    require_stationary(found.plant, (first, second), log.u[found.settle :], middle, settled)

    build = partial(_build, entry, per_sample, (len(log.t) - found.settle) // 2 * log.y.shape[1])
    parts = _held_out_scores(found, log, build)
    limit = threshold(parts, per_sample)
    if not 0 < limit.scale < np.inf:
        raise NotApplicableError(
            f"the score of {entry.name} on healthy readings is {limit.scale:g} where it should alarm: no threshold "
            "has that rate"
        )
    scale = limit.scale  # extrapolated, below the detector's own thresholds only as far as the log surely shows
    if not limit.counted:
        scale = max(scale, min(limit.high, 1.0))
    across = [threshold([part], per_sample).scale for part in parts[::-1]]

    tables = {"plant": plant_table(plant)} | learnt_tables(plant, found)
    final = build(acting_plant(learnt_plant(tables, plant), entry), log.rows(slice(found.settle, None)))
    digest = {} if entry.learns else {"digest": settings_digest(final)}
    final = scaled(final, scale, per_sample)
    late = delays(final, log, found.settle)
    for i, row in enumerate(tables["sensors"].values()):
        row |= {f"delay_{size:g}": float(late.delay[s, i]) for s, size in enumerate(late.sizes)}
    used = {"name": entry.name, "threshold_scale": scale, "false_alarm": str(rate), "per_sample": per_sample} | digest
    quality = _quality(found, log, limit, counted(parts, across), late, rate, dt)
    document = {"plant": tables["plant"], "detector": used, **{k: v for k, v in tables.items() if k != "plant"}}
    return Tuned(document | _provenance(origin, logs, made) | {"quality": quality}, final if entry.learns else None, entry)


def _monitor(
    plant: Plant, logs: Sequence[Sequence[Log]], origin: Sequence[HealthySource], per_sample: float, each: Each
) -> Monitor:
    """The monitor of all sensors of a plant, with these rows in alarm; logs: the runs of each source."""
    of = [source for source, runs in zip(origin, logs, strict=True) for _ in runs]
    sensors, runs = [Signal(s.name, s.unit) for s in plant.sensors], [run for runs in logs for run in runs]
    return Monitor.of_logs(
        sensors, runs, inputs=plant.inputs, false_alarm=per_sample, names=[s.name for s in of], clocks=[s.clock for s in of],
        each=each,
    )  # fmt: skip


def _with_monitor(quality: dict[str, Any], monitor: Monitor) -> dict[str, Any]:
    """The figures of quality with those of the monitor, and its remarks."""
    channels, remarks = monitor.channels, list(monitor.remarks)
    remarks += [f"left out: {name}, {why}" for name, why in channels.left_out.items()]
    remarks += [f"{name} never moved when healthy; any other reading is reported" for name in channels.still]
    figures = dict(zip(("rate", "low", "high"), map(float, monitor.learnt.limits.rate), strict=True))
    return quality | {"monitor": figures, "remarks": [*quality["remarks"], *(f"monitor: {one}" for one in remarks)]}


def _provenance(origin: Sequence[HealthySource], logs: Sequence[Sequence[Log]], made: str) -> dict[str, Any]:
    """From which logs, by which version, and when."""
    healthy = [
        {
            "file": s.name,
            "rows": sum(len(r.t) for r in runs),
            "from": s.clock.at(float(runs[0].t[0])),
            "to": s.clock.at(float(runs[0].t[-1])),
        }
        for s, runs in zip(origin, logs, strict=True)
    ]
    return {"healthy": healthy, "made": {"version": __version__, "date": made}}


def _end(origin: Sequence[HealthySource], logs: Sequence[Sequence[Log]]) -> float | None:
    """When the last of the logs ended, in s since 1970; None where their clocks do not say."""
    ends = [s.clock.moment(float(run.t[-1])) for s, runs in zip(origin, logs, strict=True) for run in runs]
    known = [posix(end) for end in ends if end is not None]
    return max(known) if len(known) == len(ends) else None


def _runs(log: Log) -> list[Log]:
    """Each run of a log by itself: y (K, N), u (K, m)."""
    return [Log(log.t, log.y[:, i], log.u[:, i]) for i in range(log.y.shape[1])]


def _moments(logs: Sequence[Sequence[Log]], sources: Sequence[HealthySource]) -> list[Callable[[float], str]]:
    """For each run what puts a time (s) in words: on its clock, with the run and the log where there are several."""
    found: list[Callable[[float], str]] = []
    for source, runs in zip(sources, logs, strict=True):
        for i in range(len(runs)):
            which = f" of run {i}" * (len(runs) > 1) + f" of {source.name}" * (len(logs) > 1)
            found.append(partial(_moment, source.clock, which))
    return found


def _moment(clock: Clock, which: str, t: float) -> str:
    return clock.at(t) + which


def _at(times: Array, of: Sequence[int], moments: Sequence[Callable[[float], str]], k: int, b: int) -> str:
    """The time of sample k of run b in words; times (K, B), of: which of the moments each run has."""
    return moments[of[b]](float(times[k, b]))


def _require_enough(log: Log, settle: int, rate: Rate, dt: float) -> None:
    """Raise ValueError where there are too few samples after settling for the rate."""
    steps, runs = log.y.shape[:2]
    least, left = shortest(rate.per_sample(dt)), runs * max(steps - settle, 0)
    if left < least:
        raise ValueError(
            f"the healthy log is too short for {rate} (one sample in {rate.samples(dt):.4g}): {left} samples "
            f"({lasting(left * dt)}) after the filter has settled, expected at least {least} ({lasting(least * dt)}); the "
            f"shortest log is {least // runs + settle} samples long, {lasting((least // runs + settle) * dt)}"
            f"{f', in {runs} runs' if runs > 1 else ''}: give a longer one, or a higher rate"
        )


def _build(entry: registry.NamedDetector, rate: float, samples: int, plant: Plant, healthy: Log) -> Any:
    """The detector with usual settings; one that learns has learnt from these readings."""
    if not entry.learns:
        built: Any = registry.detector(entry, plant)
    else:
        built = entry.build(plant, healthy=healthy, false_alarm=min(max(rate, LEARNT_ON / samples), 0.2))
        if built.plant is not plant:
            raise NotApplicableError(
                f"detector {entry.name} builds its own version of plant {plant.name!r}, which a tuned file cannot hold; choose "
                "another detector"
            )
    require_scale(entry.name, built)
    return built


def _held_out_scores(found: Commissioning, log: Log, build: Any) -> list[Array]:
    """The scores (K, B) of the first and of the second half, by a detector that has learnt from the other."""
    ends = [(found.settle, found.middle), (found.middle, len(log.t))]
    parts = []
    for own, learnt, plant in zip(ends, ends[::-1], found.halves[::-1], strict=True):
        detector = build(acting_plant(plant, build.args[0]), log.rows(slice(*learnt)))
        state, scores = silent_scores(silent(detector), *log.rows(slice(own[1])))
        if np.any(state.diverged):
            raise ValueError(
                f"the estimate of {build.args[0].name} diverges on the healthy log; check inputs, units and parameters of the "
                "plant"
            )
        parts.append(np.nan_to_num(scores[own[0] :]))
    return parts


def _quality(
    found: Commissioning, log: Log, limit: Threshold, count: AlarmCount, late: Delays, rate: Rate, dt: float
) -> dict[str, Any]:
    """Figures of quality by name, as plain numbers."""
    steps, runs = log.y.shape[:2]
    figures: dict[str, Any] = {
        "samples": runs * (steps - found.settle),
        "runs": runs,
        "settle": found.settle,
        "learnt": list(found.kept),
        "nis_before": found.before.nis,
        "nis": found.after.nis,
        "coloured_before": found.before.coloured,
        "coloured": found.after.coloured,
        **threshold_figures(limit, count, rate, dt),
        "delays": f"simulated: biases added to these readings, {late.onsets} onsets a sensor, within {late.within:g} s",
    }
    for s, size in enumerate(late.sizes):
        figures[f"delay_{size:g}"] = {
            "median": float(np.median(late.delay[s])),
            "worst": float(np.max(late.delay[s])),
            "found": float(np.mean(late.detected_share[s])),
        }
    figures["remarks"] = remarks(found, figures, limit, rate)
    return figures


def on_stretch(plant: Plant, log: Log, between: str, detector: Any, clock: Clock = Clock()) -> Tuned:  # noqa: B008
    """Tune on the readings between two times of a log of one run, FROM..TO, see `within`; ValueError as `tune` raises it."""
    inside = within(log.t, between, clock)
    part = log.rows(inside)
    return tune(
        plant, part, false_alarm=FALSE_ALARM, detector=detector, sources=[HealthySource(f"the stretch {between}", clock)]
    )


class EvenRuns(NamedTuple):
    """A log of runs, the times (K, B) at which they were recorded, and of which of the logs each is (B,)."""

    log: Log
    times: Array
    of: tuple[int, ...]


def as_even_runs(plant: Plant, logs: Sequence[Log]) -> EvenRuns:
    """The logs of one run each, cut at long gaps, as one Log of runs of the length at which most samples are used.

    The runs take the times of the first: a model's dependence on the time of day is lost. Unevenly sampled stretches cannot
    stand side by side; the longest is then used alone. ValueError where no stretch is long enough.
    """
    whole = [(i, part) for i, log in enumerate(logs) for part in _without_gaps(plant, log) if len(part.t) >= LEAST]
    if not whole:
        raise ValueError(
            f"no stretch of {LEAST} samples without a gap of more than {LONG} in the healthy logs: give longer logs"
        )
    alone, longest = max(whole, key=lambda part: len(part[1].t))
    even = [(i, p) for i, p in whole if np.max(np.abs(np.diff(p.t) - plant.dt)) <= EVEN * plant.dt]
    lengths = [len(p.t) for _, p in even]
    if len(whole) == 1 or sum(lengths) <= len(longest.t):
        return EvenRuns(Log(longest.t, longest.y[:, None], longest.u[:, None]), longest.t[:, None], (alone,))
    length = max(sorted(set(lengths)), key=lambda n: sum(k // n * (n - LEAST) for k in lengths))
    cut = [slice(i * length, (i + 1) * length) for i in range(max(lengths) // length)]
    runs = [(i, p.rows(s)) for i, p in even for s in cut[: len(p.t) // length]]
    t, y, u = (np.stack([run[j] for _, run in runs], axis=1) for j in range(3))
    return EvenRuns(Log(t[:, 0], y, u), t, tuple(i for i, _ in runs))


def _without_gaps(plant: Plant, log: Log) -> list[Log]:
    """The stretches between long gaps, with rows as far apart as the log's usually are, or, where the plant steps over less, as
    its dt.
    """
    if len(log.t) < 2:
        return [log]
    usual = float(np.median(np.diff(log.t)))
    return stretches(log, usual if usual <= stated_step(plant) * (1 + 1e-9) else plant.dt)


class Delays(NamedTuple):
    """For each size (S) and sensor (N): the median delay (s), inf where less than half are detected, and the share detected.

    onsets: faults behind each. within: the time (s) in which they are to be detected.
    """

    sizes: tuple[float, ...]
    delay: Array
    detected_share: Array
    onsets: int
    within: float


def delays(detector: Detector, log: Log, warm_up: int, sizes: tuple[float, ...] = SIZES, sigma: Array | None = None) -> Delays:
    """Add a bias of each sensor to healthy readings of runs, y (K, B, N), and count until that sensor is isolated.

    Of a detector that does not isolate, until its own residual exceeds its threshold. The delay of a fault that is found in its
    first sample is 0. The detector starts `warm_up` samples before the onset; the onsets are spread over the log, with
    alternating signs. Readings that control the plant are taken as they were: the loop does not act on the bias.
    """
    plant = detector.plant
    sigma = plant.sensor_sigma if sigma is None else sigma
    steps, runs, count = log.y.shape
    ahead = min(AHEAD, max((steps - warm_up) // 2, 1))
    onsets = max(1, min(ONSETS, RUNS // (count * len(sizes))))
    first = np.linspace(warm_up, steps - ahead, onsets).astype(int)
    size = np.repeat(sizes, count)
    sensor = np.tile(np.arange(count), len(sizes))
    delay = np.full((onsets, size.size), np.inf)
    for j, onset in enumerate(first):
        part, run = slice(onset - warm_up, onset + ahead), j % runs
        y = np.repeat(log.y[part, run][:, None], size.size, axis=1)
        y[warm_up:, np.arange(size.size), sensor] += (-1) ** j * size * sigma[sensor]
        delay[j] = _first(detector, Log(log.t[part], y, log.u[part, run]), warm_up, sensor)
    shape = (onsets, len(sizes), count)
    with np.errstate(invalid="ignore"):
        middle = np.median(delay.reshape(shape), axis=0)
    found = np.mean(np.isfinite(delay).reshape(shape), axis=0)
    return Delays(tuple(sizes), np.where(found >= 0.5, middle, np.inf) * plant.dt, found, onsets, ahead * plant.dt)


def _first(detector: Detector, log: Log, warm_up: int, sensor: Array) -> Array:
    """The sample after warm_up at which each run (B,) names its sensor, inf where it does not."""
    state = detector.init(log.y.shape[1:-1], float(log.t[0]) - detector.plant.dt)
    found, each = np.full(sensor.size, np.inf), np.arange(sensor.size)
    for k, (t, y, u) in enumerate(zip(log.t.tolist(), log.y, log.u, strict=True)):
        state, decision = detector.step(state, t, y, u)
        if k >= warm_up:
            named = decision.isolated[each, sensor] | (decision.scores[each, sensor] > 1)
            found = np.where(named & np.isinf(found), float(k - warm_up), found)
            if np.all(np.isfinite(found)):
                break
    return found
