"""A log checked before it is diagnosed: how it was read, and which units look wrong."""

from __future__ import annotations

from collections.abc import Iterator
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
        unit = "" if sensor.unit == "1" else f" {sensor.unit}"
        text = f"{sensor.name} {best.text}: usually {parts[0]:.4g}{unit}, the model predicts {e:.4g}; state its unit in a map"
        found.append(Finding("unit suspected", sensor.name, with_reading.size, text))
    return found


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
    unit = "" if signal.unit == "1" else f" {signal.unit}"
    text = (
        f"input {signal.name} {best.text}: usually {np.median(u[u != 0]):.4g}{unit}, its nominal value is {signal.nominal:.4g}"
    )
    return Finding(
        "input unit suspected", signal.name, u.size, f"{text}, and the readings contradict it; state its unit in a map"
    )


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
