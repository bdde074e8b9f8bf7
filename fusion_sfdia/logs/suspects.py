"""Columns whose unit looks wrong: a usual mix-up of units brings their readings to what the model predicts."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.gaps import steps_in
from fusion_sfdia.core.log import Log
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.logs.conversion import conversion
from fusion_sfdia.logs.findings import Finding

Array = NDArray[Any]

ROWS, STEPS = 500, 2000  # at the beginning of a log that are predicted, and steps of the model for them
CLEAR = 10.0  # standard deviations of a sensor: a smaller prediction tells nothing about a unit
OFF, FITS, BETTER, PARTS = 0.15, 0.1, 5.0, 4
FACTORS = {10.0: "", 100.0: "percent for a fraction?", 1e3: "", 1e5: "", 1e6: "", 60.0: "per minute?", 3600.0: "per hour?"}
FACTORS |= {3.6: "", 180.0 / np.pi: "degrees for radians?", 30.0 / np.pi: "rpm for rad/s?", 14.5038: "psi for bar?"}
UNITS = ("degC", "degF", "barg", "psig", "bar", "psi", "kPa", "lb/h", "inch", "ft")  # tried where they convert to the plant's


PRESSURE_FACTORS = (1.0, 10.0, 0.1, 100.0, 0.01, 1e3, 1e-3, 1e5, 1e-5, 1e6, 1e-6, 14.5038, 1 / 14.5038)


class MixUp(NamedTuple):
    """A mix-up of units: the reading as it should be, factor * reading + offset, and what it looks like, in words.

    zero: the reading from which deviations count: of a gauge pressure, the atmosphere. usual: whether units of the quantity
    differ so; factors of times and angles, of a pressure, count where nothing else explains it.
    """

    factor: float
    offset: float
    text: str
    zero: float = 0.0
    usual: bool = True

    def __call__(self, y: Any) -> Any:
        return self.factor * y + self.offset


def suspected_units(plant: Plant, log: Log) -> list[Finding]:
    """Findings on the sensors whose readings differ from the model's over the whole log as by a usual mix-up of units.

    The first readings are compared with what the model predicts from x0 under the inputs of the log, see `mix_up`; what
    explains them has to hold, to half of the prediction and better than the readings as they are, in each of PARTS parts of the
    log. Sensors that never move are not suspected: they are dead. Nor are those whose prediction is within CLEAR standard
    deviations of 0, which fit any factor.
    """
    predicted = _predicted(plant, log)
    found = []
    for i, sensor in enumerate(plant.sensors):
        readings = log.y[:, i]
        with_reading = np.flatnonzero(np.isfinite(readings))
        begin = with_reading[with_reading < len(predicted)]
        if begin.size < PARTS or np.ptp(readings[with_reading]) == 0:
            continue
        e = float(np.median(predicted[begin, i]))
        if not abs(e) > CLEAR * sensor.noise_sigma:
            continue
        best = mix_up(readings[begin], predicted[begin, i], sensor.unit, sensor.noise_sigma)
        parts = [float(np.median(readings[part])) for part in np.array_split(with_reading, PARTS)]
        if best is None or any(abs(best(p) - e) > min(0.5 * abs(e - best.zero), abs(p - e)) for p in parts):
            continue
        unit = "" if sensor.unit == "1" else f" {sensor.unit}"
        text = f"{sensor.name} {best.text}: usually {parts[0]:.4g}{unit}, the model predicts {e:.4g}; state its unit in a map"
        found.append(Finding("unit suspected", sensor.name, with_reading.size, text))
    return found


def mix_up(y: Array, expected: Array | float, unit: str, noise: float = 0.0) -> MixUp | None:
    """Return the mix-up of units that explains values y (K,) where others are expected, in that unit; None where none does.

    With |e| the median of what is expected, and the error the median of the differences from it: where the error is above
    OFF |e|, the mix-up with the smallest explains y if that is within FITS |e| + noise, the standard deviation of a reading,
    and BETTER times smaller. Of a gauge pressure |e| is above the
    atmosphere, and to be more than OFF of the absolute one.
    """
    e = float(np.median(np.abs(expected)))

    def error(mixed: MixUp) -> float:
        return float(np.median(np.abs(mixed(y) - expected)))

    if not (as_it_is := error(MixUp(1.0, 0.0, ""))) > OFF * e or not np.isfinite(as_it_is):
        return None
    mix_ups = [(m, float(np.median(np.abs(expected - m.zero)))) for m in _mix_ups(unit)]
    explaining = [m for m, above in mix_ups if above > OFF * e and error(m) <= FITS * above + noise]
    best = min(explaining, key=lambda m: (not m.usual, error(m)), default=None)
    return best if best is not None and error(best) <= as_it_is / BETTER else None


def _mix_ups(unit: str) -> list[MixUp]:
    found, gauge = [], _gauge_mix_ups(unit)
    for factor, hint in FACTORS.items():
        about = f" ({hint})" if hint else ""
        usual = not gauge or factor in PRESSURE_FACTORS
        found.append(MixUp(1 / factor, 0.0, f"looks {factor:.6g} times too large{about}", usual=usual))
        found.append(MixUp(factor, 0.0, f"looks {factor:.6g} times too small", usual=usual))
    found.append(MixUp(-1.0, 0.0, "looks of the wrong sign"))
    for other in UNITS:
        try:
            factor, offset = conversion(other, unit)
        except ValueError:
            continue
        if (factor, offset) != (1.0, 0.0):
            found.append(MixUp(factor, offset, f"looks as if in {other}, not {unit}"))
        if offset:
            found.append(MixUp(1 / factor, -offset / factor, f"looks as if converted from {other} twice"))
    return [*found, *gauge]


def _gauge_mix_ups(unit: str) -> list[MixUp]:
    """Gauge and absolute pressure taken for each other, or the factor of a gauge pressure, which acts above the atmosphere."""
    try:
        absolute, gauge = conversion("Pa", unit).offset, conversion("Pa(g)", unit).offset
    except ValueError:
        return []
    found = []
    for is_gauge, taken_as_gauge in ((True, False), (False, True), (True, True)):
        kind, taken = (("an absolute", "a gauge")[g] for g in (is_gauge, taken_as_gauge))
        zero, taken_zero = ((absolute, gauge)[g] for g in (is_gauge, taken_as_gauge))
        for factor in PRESSURE_FACTORS:
            if factor == 1.0 and zero == taken_zero:
                continue
            text = f"looks as {kind} pressure, bar({'g' if is_gauge else 'a'}), taken for {taken} one"
            if is_gauge == taken_as_gauge:
                text = "looks as a gauge pressure"
            if factor != 1.0:
                text += f", {factor:.6g} times too small" if factor > 1 else f", {1 / factor:.6g} times too large"
            found.append(MixUp(factor, zero - factor * taken_zero, text, zero))
    return found


def _predicted(plant: Plant, log: Log) -> Array:
    """Readings (K', N) that the model predicts for the first rows, from x0 under the inputs of the log; without a model that
    holds there, those of its nominal operation.
    """
    rows = min(ROWS, log.t.size)
    nominal = np.asarray(plant.output(float(log.t[0]), plant.x0, plant.input_at(float(log.t[0]))), dtype=float)
    gaps = np.diff(log.t[:rows], prepend=log.t[0] - plant.dt)
    parts = np.maximum(steps_in(gaps, plant.dt), 1)
    rows = int(np.searchsorted(np.cumsum(parts), STEPS, side="right"))
    predicted, x = [], plant.x0
    with np.errstate(all="ignore"):
        for k in range(rows):
            dt = plant.dt if plant.numerics.fixed_dt else float(gaps[k] / parts[k])
            for j in range(int(parts[k])):
                t_start = float(log.t[k] - (parts[k] - j) * dt)
                try:
                    x = plant.guard(plant.step(t_start, x, log.u[k], dt))[0]
                except (ValueError, ArithmeticError):
                    return np.tile(nominal, (max(rows, PARTS), 1))
            predicted.append(plant.output(float(log.t[k]), x, log.u[k]))
    found = np.array(predicted, dtype=float)
    return found if rows >= PARTS and np.isfinite(found).all() else np.tile(nominal, (max(rows, PARTS), 1))
