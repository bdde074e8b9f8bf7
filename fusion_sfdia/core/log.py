"""Recorded readings in all accepted forms: a Log or Recording, a pandas frame, or arrays."""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.arguments import floats, require_unique, shown
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.core.signals import Sensor, Signal

Array = NDArray[Any]

TIME = Signal("time", "s")


class Log(NamedTuple):
    """Times t (K,) in s, readings y (K, ..., N) with NaN where missing, inputs u (K, ..., m) that acted until t."""

    t: Array
    y: Array
    u: Array


def as_log(
    plant: Plant,
    *data: Any,
    absent_sensors: bool = False,
    other_columns: bool = False,
    nominal_inputs: bool = False,
) -> Log:
    """Return recorded readings of a plant as a Log.

    data: t (K,), y (K, ..., N), u (K, ..., m) as three arguments or one tuple, a Log, or a Recording, the names of whose
    sensors and inputs must be the plant's; or a pandas frame with a column for each sensor and input, as `read_log` has
    them. Its times are in a column `time`, in an index of that name, or in an index of time stamps or durations. Times are
    in seconds. Only a frame may have time stamps (datetime64, with or without a time zone), which become seconds since its
    first row, which then is at 0 s, and durations (timedelta64), which become seconds.
    absent_sensors, other_columns, nominal_inputs: of a frame, as in `read_log`. ValueError for anything else, for shapes
    that do not fit, for no reading at all, for inputs of a frame beyond their limits, and for time stamps in an array, which
    could be read as nanoseconds.
    """
    if len(data) == 1 and type(data[0]).__module__.split(".")[0] == "pandas" and hasattr(data[0], "columns"):
        t, y, u = _of_frame(plant, data[0], absent_sensors, other_columns, nominal_inputs)
    elif len(data) == 1 and all(hasattr(data[0], what) for what in ("t", "y", "u")):
        require_same_names(plant, data[0])
        t, y, u = data[0].t, data[0].y, data[0].u
    else:
        given = data[0] if len(data) == 1 and isinstance(data[0], tuple | list) else data
        if len(given) != 3:
            came = shown(given[0]) if len(given) == 1 else f"{len(given)} arguments"
            raise ValueError(
                f"the readings are {came}; expected t, y and u, a Log, a Recording as simulate returns it, or a frame with "
                f"the columns time, {_some([*plant.sensor_names, *(s.name for s in plant.inputs)])}"
            )
        t, y, u = given
    t, y, u = floats("t", t), floats("y", y), floats("u", u)
    if t.ndim != 1 or y.ndim < 2 or u.ndim < 2 or y.shape[:1] != t.shape or u.shape[:1] != t.shape:
        raise ValueError(
            f"t {t.shape}, y {y.shape}, u {u.shape} do not fit; expected (K,), (K, ..., sensors), (K, ..., inputs)"
        )
    if not t.size:
        raise ValueError("there are no readings: t is empty; pass at least one time")
    return Log(t, y, u)


def one_run(log: Log) -> Log:
    """Return a Log of one run, y (K, N) and u (K, m), of a Log of one or of a batch of one; ValueError for several runs."""
    t, y, u = log
    if y.ndim > 2 or u.ndim > 2:
        runs = max(int(np.prod(a.shape[1:-1])) for a in (y, u))
        if runs != 1:
            raise ValueError(
                f"y has shape {y.shape}, u {u.shape}: {runs} runs side by side, where one is expected; pass one of them, "
                "Log(t, y[:, i], u[:, i]), or step all of them with run"
            )
        y, u = (a.reshape(len(t), a.shape[-1]) for a in (y, u))
    return Log(t, y, u)


def require_same_names(plant: Plant, data: Any) -> None:
    """Raise ValueError where data states sensors or inputs, as a Recording does, and they are not the plant's."""
    for what, own in (("sensors", plant.sensor_names), ("inputs", tuple(s.name for s in plant.inputs))):
        if (given := getattr(data, what, own)) != own:
            raise ValueError(
                f"the readings are of the {what} {_some(given)}; expected those of plant {plant.name!r}, {_some(own)}"
            )


def usual_inputs(where: str, plant: Plant, t: Array, columns: dict[str, int], stacklevel: int) -> Array:
    """Return the plant's operation (K, m) at the reading before each t, or dt before it where that is later.

    A UserWarning, at that level of the stack, names the inputs without a column, for which the operation is used.
    """
    before = np.maximum(t - plant.dt, np.concatenate([t[:1] - plant.dt, t[:-1]]))
    if assumed := [s.name for s in plant.inputs if s.name not in columns]:
        source = "the nominal values" if plant.truth.operation is None else "the usual inputs"
        warnings.warn(
            f"{where}: no column for the inputs {_some(assumed)}; {source} of plant {plant.name!r} are used instead",
            stacklevel=stacklevel,
        )
    return np.array([plant.input_at(float(s)) for s in before], dtype=float).reshape(t.size, len(plant.inputs))


def require_within_limits(where: str, plant: Plant, signal: Signal, values: Array, rows: Sequence[int]) -> None:
    """Raise ValueError, which names the row, for a value (K,) of an input beyond its limits; rows: the number of each."""
    for k in np.flatnonzero((values < signal.low) | (values > signal.high))[:1]:
        raise ValueError(
            f"{where}, row {rows[k]}, column {signal.name}: {values[k]:g} {signal.unit}; plant {plant.name!r} holds "
            f"from {signal.low:g} to {signal.high:g} {signal.unit}; correct the input or convert its unit"
        )


def find_columns(where: str, header: Sequence[str], plant: Plant, absent: bool, other: bool, nominal: bool) -> dict[str, int]:
    """Return the position of each name's column in a header; ValueError for a header that does not fit the plant.

    absent, other, nominal: whether sensors without a column, columns of nothing and inputs without a column are accepted.
    """
    named: tuple[Signal | Sensor, ...] = (TIME, *plant.sensors, *plant.inputs)
    require_unique(f"columns of a log of plant {plant.name!r}", [c.name for c in named])
    units = {c.name: c.unit for c in named}
    found: dict[str, int] = {}
    unknown = []
    for i, title in enumerate(header):
        name, unit = _title(title)
        if name not in units:
            unknown.append(name)
            continue
        if name in found:
            raise ValueError(f"{where}: the column {name!r} occurs twice; keep one")
        if unit is not None and unit != units[name]:
            raise ValueError(
                f"{where}: column {name!r} is in {shown(unit)}, plant {plant.name!r} has it in {units[name]!r}; convert "
                "the column, or read with the plant in that unit (Plant.in_units)"
            )
        found[name] = i
    lacking = [n for n in (TIME.name, *plant.sensor_names) if n not in found]
    if TIME.name in lacking and len(header) == 1 and (mark := re.search("[;\t|]", header[0])):
        raise ValueError(f"{where}: cells are separated by {mark[0]!r}; expected commas, and decimal points")
    if TIME.name in lacking:
        raise ValueError(f"{where}: no column 'time' among {_some(header)}; give the column of the times (s) that name")
    if lacking and not absent:
        raise ValueError(
            f"{where}: no column for the sensors {_some(lacking)} of plant {plant.name!r}; add them (empty where not read), "
            "or take them as missing with --absent-sensors (absent_sensors=True)"
        )
    if len(lacking) == len(plant.sensors):
        raise ValueError(f"{where}: no column of any sensor of plant {plant.name!r}; sensors: {_some(plant.sensor_names)}")
    if (unset := [s.name for s in plant.inputs if s.name not in found]) and not nominal:
        raise ValueError(
            f"{where}: no column for the inputs {_some(unset)} of plant {plant.name!r}; add them, or assume the plant's usual "
            "inputs with --nominal-inputs (nominal_inputs=True)"
        )
    if unknown and not other:
        raise ValueError(
            f"{where}: the columns {_some(unknown)} are no sensors or inputs of plant {plant.name!r}; rename or remove them, "
            "or ignore them with --other-columns (other_columns=True)"
        )
    return found


def _of_frame(plant: Plant, frame: Any, absent: bool, other: bool, nominal: bool) -> Log:
    """The columns of a pandas frame by name, the times from its column `time` or else from its index."""
    where, header = "the frame", [str(title) for title in frame.columns]
    has_times = TIME.name in (_title(title)[0] for title in header)
    as_index = not has_times and (frame.index.dtype.kind in "mM" or frame.index.name == TIME.name)
    if not has_times and not as_index:
        raise ValueError(
            f"{where}: no column 'time' among {_some(header)}, and its index has the name {frame.index.name!r}; give the "
            "column of the times (s) that name, or the index: frame.rename_axis('time')"
        )
    columns = find_columns(where, [*header, *([TIME.name] if as_index else [])], plant, absent, other, nominal)
    t = _seconds(where, frame.index if as_index else frame.iloc[:, columns[TIME.name]])

    def values(name: str) -> Array:
        return _numbers(where, name, frame.iloc[:, columns[name]])

    y = np.full((t.size, len(plant.sensors)), np.nan)
    for i, name in enumerate(plant.sensor_names):
        if name in columns:
            y[:, i] = values(name)
    u = usual_inputs(where, plant, t, columns, stacklevel=4)
    for i, signal in enumerate(plant.inputs):
        if signal.name in columns:
            u[:, i] = values(signal.name)
            require_within_limits(where, plant, signal, u[:, i], range(1, t.size + 1))
    return Log(t, y, u)


def _seconds(where: str, column: Any) -> Array:
    """Return the times of a pandas column or index (K,) in s: time stamps since the first, durations as they are."""
    if (kind := column.dtype.kind) not in "mM":
        return _numbers(where, TIME.name, column)
    stamps = np.asarray(column, dtype="datetime64[ns]" if kind == "M" else "timedelta64[ns]")  # in UTC
    if np.any(np.isnat(stamps)):
        raise ValueError(f"{where}, column {TIME.name}: row {np.argmax(np.isnat(stamps)) + 1} has no time; drop such rows")
    return np.asarray((stamps - stamps[:1] if kind == "M" else stamps) / np.timedelta64(1, "s"))


def _numbers(where: str, name: str, column: Any) -> Array:
    """Return a pandas column or index of numbers (K,) as floats, NaN where missing; ValueError for any other type."""
    if column.dtype.kind not in "biuf":
        raise ValueError(
            f"{where}, column {name}: its type is {column.dtype}; expected numbers, NaN where missing: convert it with "
            f"pandas.{'to_datetime' if name == TIME.name else 'to_numeric'}"
        )
    return np.asarray(column.to_numpy(dtype=float, na_value=np.nan))


def _some(names: Sequence[str]) -> str:
    """The first names, each cut to a length that a line can hold."""
    shown = ", ".join(repr(n if len(n) <= 20 else f"{n[:20]}...") for n in names[:8])
    return f"{shown} and {len(names) - 8} more" if len(names) > 8 else shown


def _title(title: str) -> tuple[str, str | None]:
    match = re.fullmatch(r"\s*(.*?)\s*(?:\[([^\[\]]*)\])?\s*", title, flags=re.DOTALL)
    name, unit = match.groups() if match else (title, None)
    return name, None if unit is None else unit.strip()
