"""A log checked before it is diagnosed: how it was read, and which units look wrong."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from fusion_sfdia.logs.loaded_log import LoadedLog
from fusion_sfdia.logs.log_map import LogMap
from fusion_sfdia.logs.reading import load_log
from fusion_sfdia.logs.regular_sensors import Regularities, regularities
from fusion_sfdia.logs.suspects import suspected_units
from fusion_sfdia.plant.plant import Plant

CHECKED = ("input unit suspected", "unit suspected", "repeat", "resolution", "period")  # kinds of findings of `checked`


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
