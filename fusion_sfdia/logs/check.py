"""A log checked before it is diagnosed: how it was read, and which units look wrong."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.logs.loaded_log import Finding, LoadedLog
from fusion_sfdia.logs.log_map import LogMap
from fusion_sfdia.logs.mix_ups import BETTER, MixUp, input_mix_up, mix_up
from fusion_sfdia.logs.reading import load_log
from fusion_sfdia.logs.regular_sensors import Regularities, regularities
from fusion_sfdia.plant.gaps import steps_in
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.model_errors import RAISED
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Signal

CHECKED = ("input unit suspected", "unit suspected", "repeat", "resolution", "period")  # kinds of findings of `checked`
Array = NDArray[Any]

ROWS, STEPS, PARTS = 500, 2000, 4  # at the beginning of a log that are predicted, and steps of the model for them
SELDOM = 0.002  # share of healthy readings, those furthest out
LEAST_FACTOR = 50.0  # by which a reading is off, to be a mix-up of units and not another operation, where there is no model
CLEAR = 10.0  # standard deviations of a sensor: a smaller prediction tells nothing about a unit


def check_log(
    source: Any,
    plant: Plant,
    log_map: LogMap | str | Path | None = None,
    *,
    absent_sensors: bool = False,
    other_columns: bool = False,
    nominal_inputs: bool = False,
) -> LoadedLog:
    """Read a log as `load_log` does, and add to its findings the sensors whose unit looks wrong, see `suspected_units`.

    Parameters
    ----------
    source : str, Path or frame
        As of `load_log`.
    plant : Plant
        As of `load_log`.
    log_map : LogMap, str or Path, optional
        As of `load_log`.
    absent_sensors, other_columns, nominal_inputs : bool, default False
        As of `load_log`.

    Returns
    -------
    LoadedLog
        Whose `suspects` are these sensors.

    Raises
    ------
    ValueError
        As `load_log` raises it.

    Examples
    --------
    >>> import pandas as pd
    >>> from fusion_sfdia import simulate
    >>> from fusion_sfdia.logs import check_log
    >>> from fusion_sfdia.plants import two_tanks
    >>> plant = two_tanks()
    >>> recording = simulate(plant, 50, seeds=[1])
    >>> frame = pd.DataFrame({"time": recording.t, "inflow": recording.u[:, 0]})
    >>> frame[list(plant.sensor_names)] = recording.y[:, 0] * [100.0, 1.0, 1.0, 1.0]  # l1 in cm
    >>> check_log(frame, plant).suspects
    ('l1',)
    """
    return checked(
        plant,
        load_log(
            source,
            plant,
            log_map,
            absent_sensors=absent_sensors,
            other_columns=other_columns,
            nominal_inputs=nominal_inputs,
        ),
    )


def checked(plant: Plant, found: LoadedLog) -> LoadedLog:
    """A log that has been read with the findings on units, and on sensors that are slow, coarse or cyclic; itself where it has
    been checked already.
    """
    if found.checked:
        return found
    regular = regularities(plant, found.log)
    more = (*suspected_units(regular.of(plant), found.log), *regular.findings(plant))
    return found._replace(findings=(*found.findings, *more), checked=True)


def without_suspects(plant: Plant, found: LoadedLog, regular: Regularities | None = None) -> LoadedLog:
    """The log with the readings missing whose unit is suspected wrong, and those that only repeat the one before, since a new
    one comes every few rows: what they show is no fault of the sensor. regular: the `regularities` of the log, where known.
    """
    log = (regular or regularities(plant, found.log)).without_repeats(found.log)
    if found.suspects:
        y = log.y.copy()
        y[:, np.isin(plant.sensor_names, found.suspects)] = np.nan
        log = log._replace(y=y)
    return found if log is found.log else found._replace(log=log)


def suspected_units(plant: Plant, log: Log) -> list[Finding]:
    """Findings on the inputs and sensors that differ from the model's over the whole log as by a usual mix-up of units.

    Of inputs see `suspected_inputs`. The first readings are compared with what the model predicts from x0 under the inputs of
    the log, suspected ones as they should be, see `mix_up`; what explains them has to hold, to half of the prediction and
    better than the readings as they are, in each of PARTS parts of the log. Sensors that never move, which are dead, and
    cyclic ones are not suspected. Nor are those whose prediction is within CLEAR standard deviations of 0,
    which fit any factor.
    """
    mixed = suspected_inputs(plant, log)
    found = [_of_input(plant.inputs[j], log.u[:, j], best) for j, best in mixed.items()]
    log = _corrected(log, mixed)
    predicted = _predicted(plant, log)
    if predicted is None:
        try:
            nominal = np.asarray(plant.output(float(log.t[0]), plant.x0, plant.input_at(float(log.t[0]))), dtype=float)
        except RAISED:
            return found
        predicted = np.tile(nominal, (max(min(ROWS, log.t.size), PARTS), 1))
    cyclic = () if plant.cyclic_sensors is None else plant.cyclic_sensors.at
    for i, sensor in enumerate(plant.sensors):
        readings = log.y[:, i]
        with_reading = np.flatnonzero(np.isfinite(readings))
        begin = with_reading[with_reading < len(predicted)]
        if begin.size < PARTS or np.ptp(readings[with_reading]) == 0 or i in cyclic:
            continue
        e = float(np.median(predicted[begin, i]))
        if not abs(e) > CLEAR * sensor.noise_sigma:
            continue
        best = mix_up(readings[begin], predicted[begin, i], sensor.unit, sensor.noise_sigma)
        parts = [float(np.median(readings[part])) for part in np.array_split(with_reading, PARTS)]
        if best is None or any(abs(best(p) - e) > min(0.5 * abs(e - best.zero), abs(p - e)) for p in parts):
            continue
        usual = _usual(parts[0], sensor.unit)
        text = f"{sensor.name} {best.text}: usually {usual}, the model predicts {e:.4g}; state its unit in a map"
        found.append(Finding("unit suspected", sensor.name, with_reading.size, text))
    return found


def unlike_healthy(sensors: Sequence[Signal], healthy: Sequence[Log], log: Log) -> list[Finding]:
    """Findings on the sensors whose readings a mix-up of units brings to those of healthy logs, where there is no model.

    Nine tenths of a sensor's readings are outside all but SELDOM of the healthy ones, and the mix-up, see `mix_up`, brings
    their quantiles to those of these, and their median in each of PARTS parts of the log into the range of these, or to within
    their spread of it.
    What a bias or another operation explains as well is not suspected: factors below LEAST_FACTOR, and a mix-up that does not
    bring the movement from row to row to the healthy one.
    """
    found, healthy_readings = [], np.concatenate([one.y for one in healthy])
    for i, sensor in enumerate(sensors):
        known, own = (y[np.isfinite(y[:, i]), i] for y in (healthy_readings, log.y))
        if known.size < PARTS or own.size < PARTS or np.ptp(known) == 0 or np.ptp(own) == 0:
            continue
        low, high = np.quantile(known, (SELDOM / 2, 1 - SELDOM / 2))
        if np.mean((own >= low) & (own <= high)) > 0.1:
            continue
        spread, shares = float(np.std(known)), np.linspace(0.05, 0.95, 19)
        unit = "" if sensor.unit == "1" else sensor.unit
        best = mix_up(np.quantile(own, shares), np.quantile(known, shares), unit, spread / 2)
        if best is None or (not best.offset and 1 / LEAST_FACTOR < abs(best.factor) < LEAST_FACTOR):
            continue
        off = np.log(_movement(own) / _movement(known))
        if abs(off + np.log(abs(best.factor))) > abs(off):
            continue
        parts = [float(best(np.median(part))) for part in np.array_split(own, PARTS)]
        if not all(low - spread <= p <= high + spread for p in parts):
            continue
        usual, healthy_usual = (_usual(values, unit) for values in (own, known))
        cure = "state its unit in a map" if unit else "convert it, or state the units of both logs"
        text = f"{sensor.name} {best.text}: usually {usual}, in the healthy logs {healthy_usual}; {cure}"
        found.append(Finding("unit suspected", sensor.name, own.size, text))
    return found


def _movement(values: Array) -> float:
    """How much values (K,), which are not all equal, change from one to the next."""
    return float(np.mean(np.abs(np.diff(values))))


def suspected_inputs(plant: Plant, log: Log) -> dict[int, MixUp]:
    """The inputs, by position, whose values differ from their nominal one as by a usual mix-up of units, see `input_mix_up`.

    An input may be far from its nominal value, off or throttled, for a whole log: then the readings follow it. It is suspected
    where they contradict it: their differences from the prediction, in standard deviations and 1 more, are together, as a
    product over the sensors, BETTER times smaller with the mix-up undone than without.
    """
    candidates = {j: m for j, s in enumerate(plant.inputs) if (m := input_mix_up(log.u[:, j], s)) is not None}
    if not candidates:
        return {}
    undone = _misfit(plant, _corrected(log, candidates))
    as_they_are = {j: _misfit(plant, _corrected(log, {i: m for i, m in candidates.items() if i != j})) for j in candidates}
    return {j: m for j, m in candidates.items() if undone + np.log(BETTER) < as_they_are[j]}


def _misfit(plant: Plant, log: Log) -> float:
    """Sum over the sensors of the logarithm of 1 + the usual difference from the prediction, in standard deviations."""
    if (predicted := _predicted(plant, log)) is None:
        return np.inf
    off = np.abs(log.y[: len(predicted)] - predicted) / plant.sensor_sigma
    return float(sum(np.log1p(np.median(one[np.isfinite(one)])) for one in off.T if np.isfinite(one).any()))


def _corrected(log: Log, mixed: dict[int, MixUp]) -> Log:
    u = log.u.copy()
    for j, best in mixed.items():
        u[:, j] = best(u[:, j])
    return log._replace(u=u)


def _of_input(signal: Signal, u: Array, best: MixUp) -> Finding:
    usual, nominal = _usual(u[u != 0], signal.unit), f"{signal.nominal:.4g}"
    text = f"input {signal.name} {best.text}: usually {usual}, its nominal value is {nominal}"
    return Finding(
        "input unit suspected", signal.name, u.size, f"{text}, and the readings contradict it; state its unit in a map"
    )


def _usual(values: Any, unit: str) -> str:
    """The median of values, with their unit."""
    return f"{np.median(values):.4g}" + ("" if unit in ("", "1") else f" {unit}")


def _predicted(plant: Plant, log: Log) -> Array | None:
    """Readings (K', N) that the model predicts for the first rows, from x0 under the inputs of the log; None where it fails."""
    try:
        with np.errstate(all="ignore"):
            found = np.array(list(_predictions(plant, log)), dtype=float)
    except RAISED:
        return None
    return found if len(found) >= PARTS and np.isfinite(found).all() else None


def _predictions(plant: Plant, log: Log) -> Iterator[Array]:
    rows = min(ROWS, log.t.size)
    gaps = np.diff(log.t[:rows], prepend=log.t[0] - plant.dt)
    parts = np.maximum(steps_in(gaps, plant.dt), 1)
    x = plant.x0
    with_jacobian, _ = plant.with_jacobians  # which a filter needs, too: nothing else is compiled
    for k in range(int(np.searchsorted(np.cumsum(parts), STEPS, side="right"))):
        dt = plant.dt if plant.numerics.fixed_dt else float(gaps[k] / parts[k])
        for j in range(int(parts[k])):
            t_start = float(log.t[k] - (parts[k] - j) * dt)
            ahead = with_jacobian(t_start, x, log.u[k], dt)[0] if with_jacobian else plant.step(t_start, x, log.u[k], dt)
            x = plant.guard(ahead)[0]
        yield plant.output(float(log.t[k]), x, log.u[k])
