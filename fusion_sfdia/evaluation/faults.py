"""Sensor faults: what they are, how they change readings, and files that list them.

A fault of a sensor is active at the samples onset <= t < onset + length. Kinds and their equations, y the healthy
reading and s(t) the seconds since onset: see FAULT_KINDS. How random faults are drawn: fault_draws.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Sequence
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.arguments import floats
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.core.random_streams import stream

Array = NDArray[Any]
Randomness = int | Sequence[int] | np.random.Generator | None

FAULT_KINDS = {
    "bias": "y + b",
    "drift": "y + b min((s + dt) / rise, 1): rises over `rise` seconds, then holds b until the fault ends",
    "scale": "b y",
    "noise": "y + b e, e standard normal",
    "spikes": "y + b or y - b, at each sample with `probability`, else y",
    "freeze": "the last reading before the onset; not found by its mean until the signal has moved by several sigma",
    "dropout": "missing (NaN), at each sample with `probability`",
    "replay": "the readings of the `period` seconds before the onset, again and again: an attack that hides what happens",
}
WITHOUT_MAGNITUDE = ("freeze", "dropout", "replay")
RANDOM = ("noise", "spikes", "dropout")


@dataclass(frozen=True)
class Fault:
    """A fault of one sensor from `onset` for `length` seconds (inf: to the end).

    magnitude: b, in the sensor's unit (a factor for scale). relative: b is that many times the absolute value of the
    noise-free signal at the first faulty sample, so that its sign is the error's; where readings stand for the signal and
    that one is missing, of the last known reading before it, or else of the first known one after it. rise: seconds in
    which a drift reaches b (None: its whole length). probability: of spikes and dropouts at each sample. period: seconds of
    readings that a replay repeats (None: its whole length), or as many as there are.

    Shaheen 2024, sec. IV-B: a bias of M samples has length = M dt; a drift that reaches b in M samples and holds it for
    K has rise = M dt, length = (M + K) dt. Its printed ranges (0 <= k - m <= M) are M + 1 samples and overlap, with a
    drift of b (M + 1)/M at k - m = M; M is called the number of samples, so 0 <= k - m < M stands here.
    """

    sensor: str
    kind: str
    onset: float
    length: float = np.inf
    magnitude: float = 0.0
    relative: bool = False
    rise: float | None = None
    probability: float = 1.0
    period: float | None = None

    def __post_init__(self) -> None:
        who = f"{self.kind} of sensor {self.sensor!r}"
        if not isinstance(self.kind, str) or self.kind not in FAULT_KINDS:
            raise ValueError(f"sensor {self.sensor!r}: unknown fault kind {self.kind!r}; known: {', '.join(FAULT_KINDS)}")
        for what in (
            "onset",
            "length",
            "magnitude",
            "probability",
            *(w for w in ("rise", "period") if getattr(self, w) is not None),
        ):
            if isinstance(value := getattr(self, what), bool) or not isinstance(value, int | float | np.integer | np.floating):
                raise ValueError(f"{who}: {what} is {value!r}; expected a number")
            try:
                object.__setattr__(self, what, float(value))
            except OverflowError as error:
                raise ValueError(f"{who}: {what} is too large; expected a number below 1e308") from error
            if what in ("onset", "magnitude") and not np.isfinite(getattr(self, what)):
                raise ValueError(f"{who}: {what} is {value}; expected a finite number")
        if not isinstance(self.relative, bool):
            raise ValueError(f"{who}: relative is {self.relative!r}; expected true or false")
        if not self.length > 0:
            raise ValueError(f"{who}: length is {self.length}; expected a positive number of seconds")
        if self.kind in WITHOUT_MAGNITUDE and (self.magnitude != 0 or self.relative):
            raise ValueError(f"{who}: a {self.kind} has no magnitude; leave magnitude and relative out")
        if self.kind not in WITHOUT_MAGNITUDE and self.magnitude == 0 and self.kind != "scale":
            raise ValueError(f"{who}: magnitude is 0, which is no fault; give one that is not 0")
        if self.kind == "scale" and self.relative:
            raise ValueError(f"{who}: a scale is a factor already; leave relative out")
        if self.kind in ("noise", "spikes") and self.magnitude < 0:
            raise ValueError(f"{who}: magnitude is {self.magnitude}; expected a positive size")
        if self.rise is not None and (self.kind != "drift" or not 0 < self.rise < np.inf):
            raise ValueError(f"{who}: rise is {self.rise}; it belongs to a drift and is a positive number of seconds")
        if self.kind == "drift" and self.rise is None and np.isinf(self.length):
            raise ValueError(f"{who}: neither rise nor length is given; expected the seconds in which it reaches its magnitude")
        if self.period is not None and (self.kind != "replay" or not 0 < self.period < np.inf):
            raise ValueError(f"{who}: period is {self.period}; it belongs to a replay and is a positive number of seconds")
        if self.kind == "replay" and self.period is None and np.isinf(self.length):
            raise ValueError(f"{who}: neither period nor length is given; expected the seconds of readings that it repeats")
        if not 0 < self.probability <= 1 or (self.probability != 1 and self.kind not in ("spikes", "dropout")):
            raise ValueError(f"{who}: probability is {self.probability}; expected in (0, 1], and only for spikes and dropouts")


class FaultedReadings(NamedTuple):
    """Readings y (K, ..., N) with faults in them, active (K, ..., N) where a fault acts, size = y minus the healthy ones."""

    y: Array
    active: Array
    size: Array


def apply(
    plant: Plant,
    t: Array,
    y: Array,
    faults: Sequence[Fault] | Sequence[Sequence[Fault]],
    rng: Randomness = None,
    *,
    signal: Array | None = None,
) -> FaultedReadings:
    """Return the healthy readings y (K, ..., N) at t (K,) with faults in them.

    faults: one list for the whole batch, or one for each of its elements in C order; several on one sensor act in order.
    signal: (K, ..., N) noise-free readings, to which `relative` refers; None takes y for it.
    rng: for the kinds that are random: a generator, a seed, or a seed for each element of the batch (then an element's
    readings do not depend on the others). Raises ValueError for shapes that do not fit, an unknown sensor, a fault that
    covers no sample, randomness without rng.
    """
    t, y = floats("t", t), floats("y", y)
    count = len(plant.sensors)
    if t.ndim != 1 or y.shape[:1] != t.shape or y.shape[-1:] != (count,) or y.ndim < 2:
        raise ValueError(f"t {t.shape} and y {y.shape} do not fit; expected (K,) and (K, ..., {count}), a column a sensor")
    if signal is not None and np.shape(signal) != y.shape:
        raise ValueError(f"signal has shape {np.shape(signal)}; expected that of y, {y.shape}")
    healthy = y.reshape(t.size, -1, count)
    reference = healthy if signal is None else np.asarray(signal, dtype=float).reshape(healthy.shape)
    runs = healthy.shape[1]
    lists = _per_run(faults, runs)
    if not isinstance(rng, int | np.integer | np.random.Generator | None) and len(rng) != runs:
        raise ValueError(f"{len(rng)} seeds for {runs} elements of the batch; give one seed each, or one generator")
    faulty, active = healthy.copy(), np.zeros(healthy.shape, bool)
    for b, own in enumerate(lists):
        for j, fault in enumerate(own):
            i = plant.sensor_index(fault.sensor)
            rows = _rows(fault, t, plant.dt)
            value = _amplitude(fault, reference[:, b, i], rows[0]) if fault.relative else 1.0
            generator = _generator(rng, fault, b, j)
            column = faulty[:, b, i]
            with np.errstate(over="ignore"):
                column[rows] = _BEHAVIOUR[fault.kind](fault, fault.magnitude * value, column, rows, t, plant.dt, generator)
            if np.any(np.isinf(column[rows])):
                raise ValueError(
                    f"{fault.kind} of sensor {fault.sensor!r} by {fault.magnitude:g} is no finite reading; lessen it"
                )
            active[rows, b, i] = True
    return FaultedReadings(faulty.reshape(y.shape), active.reshape(y.shape), (faulty - healthy).reshape(y.shape))


def _amplitude(fault: Fault, column: Array, onset: int) -> float:
    """|signal| at the onset, at the last known sample before it where it is missing there, else at the first known one."""
    if not (known := np.flatnonzero(np.isfinite(column))).size:
        raise ValueError(
            f"{fault.kind} of sensor {fault.sensor!r} is relative to a sensor that was never read; pass signal, or an absolute "
            "magnitude"
        )
    last = int(np.searchsorted(known, onset, side="right")) - 1
    return float(abs(column[known[max(0, last)]]))


def _per_run(faults: Sequence[Fault] | Sequence[Sequence[Fault]], runs: int) -> list[list[Fault]]:
    common = [f for f in faults if isinstance(f, Fault)]
    if len(common) == len(faults):
        return [common] * runs
    lists = [list(own) for own in faults if not isinstance(own, Fault)]
    if common or len(lists) != runs:
        raise ValueError(f"{len(faults)} lists of faults for {runs} elements of the batch; give one list for all, or one each")
    return lists


def _rows(fault: Fault, t: Array, dt: float) -> Array:
    """Indices of the samples onset <= t < onset + length; a sample on an edge up to rounding is on that edge."""
    rounding = 1e-6 * dt + 8 * np.spacing(np.max(np.abs(t), initial=0.0))
    rows = np.flatnonzero((t > fault.onset - rounding) & (t < fault.onset + fault.length - rounding))
    if not rows.size:
        span = f"{t[0]:g} to {t[-1]:g} s" if t.size else "no samples"
        raise ValueError(
            f"{fault.kind} of sensor {fault.sensor!r} from {fault.onset:g} s for {fault.length:g} s covers no sample of "
            f"{span}; move its onset or lengthen it"
        )
    return rows


def _generator(rng: Randomness, fault: Fault, run: int, position: int) -> np.random.Generator | None:
    if isinstance(rng, np.random.Generator):
        return rng
    if rng is not None:
        seed, place = (rng, run) if isinstance(rng, int | np.integer) else (rng[run], 0)
        return stream(seed, "fault readings", place, position)
    if fault.kind in RANDOM and not (fault.kind == "dropout" and fault.probability == 1):
        raise ValueError(f"{fault.kind} of sensor {fault.sensor!r} is random; pass rng, a generator or a seed")
    return None


Behaviour = Callable[[Fault, float, Array, Array, Array, float, Any], Array]


def _drift(fault: Fault, b: float, column: Array, rows: Array, t: Array, dt: float, rng: Any) -> Array:
    rise = fault.length if fault.rise is None else fault.rise
    return column[rows] + b * np.clip((t[rows] - fault.onset + dt) / rise, 0.0, 1.0)


def _freeze(fault: Fault, b: float, column: Array, rows: Array, t: Array, dt: float, rng: Any) -> Array:
    known = np.flatnonzero(np.isfinite(column[: rows[0]]))
    return np.full(rows.size, column[known[-1]] if known.size else column[rows[0]], dtype=float)


def _spikes(fault: Fault, b: float, column: Array, rows: Array, t: Array, dt: float, rng: Any) -> Array:
    hit = rng.random(rows.size) < fault.probability
    sign = np.where(rng.random(rows.size) < 0.5, -1.0, 1.0)
    return np.asarray(column[rows] + b * sign * hit)


def _dropout(fault: Fault, b: float, column: Array, rows: Array, t: Array, dt: float, rng: Any) -> Array:
    missing = np.ones(rows.size, bool) if fault.probability == 1 else rng.random(rows.size) < fault.probability
    return np.asarray(np.where(missing, np.nan, column[rows]))


def _replay(fault: Fault, b: float, column: Array, rows: Array, t: Array, dt: float, rng: Any) -> Array:
    samples = max(1, round((fault.length if fault.period is None else fault.period) / dt))
    recorded = column[max(0, rows[0] - samples) : rows[0]]
    return np.resize(recorded if recorded.size else column[rows[0]], rows.size)


_BEHAVIOUR: dict[str, Behaviour] = {
    "bias": lambda fault, b, column, rows, t, dt, rng: column[rows] + b,
    "drift": _drift,
    "scale": lambda fault, b, column, rows, t, dt, rng: column[rows] * b,
    "noise": lambda fault, b, column, rows, t, dt, rng: column[rows] + b * rng.standard_normal(rows.size),
    "spikes": _spikes,
    "freeze": _freeze,
    "dropout": _dropout,
    "replay": _replay,
}


def load_faults(path: str | Path, plant: Plant) -> list[Fault]:
    """Read the [[fault]] tables of a TOML file; their keys are the fields of Fault.

    Raises ValueError naming the file and the entry where it is no TOML, is empty, or has unknown keys, sensors or kinds.
    """
    expected = ', e.g. [[fault]] with sensor = "' + plant.sensor_names[0] + '", kind = "bias", onset = 60.0, magnitude = 0.1'
    try:
        document = tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path} is not a TOML file ({error}); write [[fault]] tables{expected}") from error
    unknown = sorted(set(document) - {"fault"})
    entries = document.get("fault", [])
    if unknown or not isinstance(entries, list) or not entries or not all(isinstance(e, dict) for e in entries):
        what = f"unknown entries {', '.join(unknown)}" if unknown else "no [[fault]] tables"
        raise ValueError(f"{path} holds {what}; write [[fault]] tables{expected}")
    return [_entry(f"{path}, fault {number}", entry, plant) for number, entry in enumerate(entries, start=1)]


def _entry(where: str, entry: dict[str, Any], plant: Plant) -> Fault:
    known = [f.name for f in fields(Fault)]
    missing = [f.name for f in fields(Fault) if f.default is MISSING and f.name not in entry]
    unknown = sorted(set(entry) - set(known))
    if unknown or missing:
        what = f"unknown key {', '.join(unknown)}" if unknown else f"no {', '.join(missing)}"
        raise ValueError(f"{where}: {what}; the keys are {', '.join(known)}")
    try:
        plant.sensor_index(entry["sensor"])
        return Fault(**entry)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from error
