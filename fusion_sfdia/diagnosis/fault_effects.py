"""Effects of sensor faults on readings: the equations of FAULT_KINDS."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import floats
from fusion_sfdia.common.random_streams import stream
from fusion_sfdia.diagnosis.faults import Fault
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]
Randomness = int | Sequence[int] | np.random.Generator | None

RANDOM = ("noise", "spikes", "dropout")


class FaultedReadings(NamedTuple):
    """Readings y (K, ..., N) with faults in them, active (K, ..., N) where a fault acts, size = y minus the healthy ones."""

    y: Array
    active: Array
    size: Array


def apply_faults(
    plant: Plant,
    t: Array,
    y: Array,
    faults: Sequence[Fault] | Sequence[Sequence[Fault]],
    rng: Randomness = None,
    *,
    signal: Array | None = None,
) -> FaultedReadings:
    """Return the healthy readings y (K, ..., N) at t (K,) with faults in them.

    Parameters
    ----------
    plant : Plant
        Whose sensors fail.
    t : array (K,)
        Times of the readings in s.
    y : array (K, ..., N)
        Healthy readings.
    faults : sequence of Fault, or of sequences of Fault
        One list for the whole batch, or one for each of its elements in C order; several on one sensor act in order.
    rng : Generator, int or sequence of int, optional
        For the kinds that are random: a generator, a seed, or a seed for each element of the batch (then an element's readings
        do not depend on the others).
    signal : array (K, ..., N), optional
        Noise-free readings, to which `relative` refers; None takes y for it.

    Returns
    -------
    FaultedReadings
        y with the faults, active (K, ..., N) where a fault acts, and size, y minus the healthy readings.

    Raises
    ------
    ValueError
        For shapes that do not fit, an unknown sensor, a fault that covers no sample, randomness without rng.

    Examples
    --------
    >>> from fusion_sfdia import Fault, simulate
    >>> from fusion_sfdia.faults import apply_faults
    >>> from fusion_sfdia.plants import two_tanks
    >>> plant = two_tanks()
    >>> healthy = simulate(plant, 40, seeds=[1])
    >>> readings = apply_faults(plant, healthy.t, healthy.y, [Fault("l1", "bias", onset=100.0, length=50.0, magnitude=0.05)])
    >>> readings.active.sum(axis=0)  # faulty samples of each sensor, of one run
    array([[10,  0,  0,  0]])
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
                    f"{fault.kind} of sensor {fault.sensor!r} by {fault.magnitude:g} is no finite reading; reduce it"
                )
            active[rows, b, i] = True
    return FaultedReadings(faulty.reshape(y.shape), active.reshape(y.shape), (faulty - healthy).reshape(y.shape))


def magnitude_of(plant: Plant, fault: Fault, t: Array, signal: Array) -> float:
    """The magnitude of a fault in its sensor's unit (a factor for scale), in a run of noise-free readings (K, N) at t."""
    if not fault.relative:
        return fault.magnitude
    first = _rows(fault, t, plant.dt)[0]
    return fault.magnitude * _amplitude(fault, signal[:, plant.sensor_index(fault.sensor)], first)


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
