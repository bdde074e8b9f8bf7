"""Recorded readings in all accepted forms, a Log or Recording, a frame, or arrays, as a Log."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import floats, shown, some
from fusion_sfdia.common.errors import warn
from fusion_sfdia.logs.frames import as_pandas, is_frame
from fusion_sfdia.logs.loaded_log import LoadedLog
from fusion_sfdia.logs.reading import load_log
from fusion_sfdia.plant.log import Log, require_same_names
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]


def as_log(
    plant: Plant,
    *data: Any,
    absent_sensors: bool = False,
    other_columns: bool = False,
    nominal_inputs: bool = False,
) -> Log:
    """Return recorded readings of a plant as a Log.

    Parameters
    ----------
    plant : Plant
        Whose sensors and inputs they are.
    *data : arrays, tuple, Log, Recording or frame
        t (K,), y (K, ..., N), u (K, ..., m) as three arguments or one tuple, a Log, what `load_log` gave, or a Recording,
        the names of whose sensors and inputs must be the plant's; or a frame of pandas, Polars or Arrow with a column for each
        sensor and input, as `load_log` has them. Its times are in a column `time`, in an index of that name, or in an index of
        time stamps or durations. Times are in seconds. Only a frame may have time stamps, which become seconds since its first
        row, which then is at 0 s, and durations (timedelta64), which become seconds. y and u may be frames with the names of
        sensors and inputs, in any order.
    absent_sensors, other_columns, nominal_inputs : bool, default False
        Of a frame, as in `load_log`.

    Returns
    -------
    Log
        In the units of the plant.

    Raises
    ------
    ValueError
        For anything else, for shapes that do not fit, for no reading at all, for inputs that are missing, for inputs of a frame
        beyond their limits, and for time stamps in an array, which could be read as nanoseconds.

    Examples
    --------
    >>> import numpy as np
    >>> from fusion_sfdia.logs import as_log
    >>> from fusion_sfdia.plants import two_tanks
    >>> as_log(two_tanks(), [5.0, 10.0], np.ones((2, 4)), np.full((2, 1), 1e-3)).y.shape
    (2, 4)
    """
    if len(data) == 1 and isinstance(data[0], LoadedLog):
        data = (data[0].log,)
    if len(data) == 1 and is_frame(data[0]):
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
                f"the columns time, {some([*plant.sensor_names, *(s.name for s in plant.inputs)])}"
            )
        t, y, u = given
        y, u = _by_name("y", y, plant.sensor_names), _by_name("u", u, [s.name for s in plant.inputs])
    t, y, u = floats("t", t), floats("y", y), floats("u", u)
    if t.ndim != 1 or y.ndim < 2 or u.ndim < 2 or y.shape[:1] != t.shape or u.shape[:1] != t.shape:
        raise ValueError(
            f"t {t.shape}, y {y.shape}, u {u.shape} do not fit; expected (K,), (K, ..., sensors), (K, ..., inputs)"
        )
    _require_known(plant, u)
    if t.size and 1e11 <= t[0] < 1e20:
        raise ValueError(f"t begins at {t[0]:.0f} s, which looks like milli-, micro- or nanoseconds since 1970; pass seconds")
    if not t.size:
        raise ValueError("there are no readings: t is empty; pass at least one time")
    return Log(t, y, u)


def _of_frame(plant: Plant, frame: Any, absent: bool, other: bool, nominal: bool) -> Log:
    """The columns of a pandas frame by name, the times from its column `time` or else from its index."""
    found = load_log(frame, plant, absent_sensors=absent, other_columns=other, nominal_inputs=nominal)
    for finding in found.findings:
        if finding.kind == "nominal inputs":
            warn(f"the frame: {finding.text}")
    return found.log


def _by_name(what: str, given: Any, names: Sequence[str]) -> Any:
    """A frame with the columns in the order of the names; anything else, also a frame with numbered columns, as it is.

    ValueError for a frame that has other columns.
    """
    given = as_pandas(given) if is_frame(given) else given
    columns = getattr(given, "columns", None)
    if columns is None or columns.dtype.kind in "iu":
        return given
    titles = [re.sub(r"\s*\[[^\[\]]*\]\s*$", "", str(title)).strip() for title in columns]
    if sorted(titles) != sorted(names):
        raise ValueError(f"{what} is a frame with the columns {some(titles)}; expected {some(names)}, in any order")
    return given.iloc[:, [titles.index(name) for name in names]]


def _require_known(plant: Plant, u: Array) -> None:
    """Raise ValueError, which names the row, for an input that is missing or infinite."""
    if u.shape[-1] == len(plant.inputs) and not np.isfinite(u).all():
        at = np.argwhere(~np.isfinite(u))[0]
        raise ValueError(
            f"u has {u[tuple(at)]} in row {at[0]} (the first is 0), input {plant.inputs[at[-1]].name!r}; an input must be "
            "known: give its value, hold the one before, or leave the row out"
        )
