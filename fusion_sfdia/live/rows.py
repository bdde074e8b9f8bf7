"""Rows of text, CSV with a header or JSON lines, as the readings and inputs of a plant."""

from __future__ import annotations

import csv
import json
from datetime import datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.arguments import shown
from fusion_sfdia.core.log import TIME, find_columns
from fusion_sfdia.core.numerals import decimal
from fusion_sfdia.core.plant import Plant

Array = NDArray[Any]


class TextRows:
    """Reads one line after another; the first tells which form they have.

    CSV: the first line is the header, which names time, sensors and inputs as in `read_log`; a cell is empty where a value is
    missing. JSON: each line is an object with those names as keys, the first with all of them; null, or no key, is a missing
    value. The time is in seconds or a time stamp in ISO 8601 ("2026-03-01T14:20:05+01:00").
    absent_sensors, other_columns, nominal_inputs: as in `read_log`.
    """

    def __init__(
        self, plant: Plant, *, absent_sensors: bool = False, other_columns: bool = False, nominal_inputs: bool = False
    ) -> None:
        self.plant = plant
        self.accepted = absent_sensors, other_columns, nominal_inputs
        self.columns: dict[str, int] | None = None
        self.titles: list[str] = []
        self.is_json = False

    def row(self, line: str) -> tuple[float | datetime, Array, Array] | None:
        """The time, y (N,) and u (m,) of a line, NaN where missing; None of an empty line and of a header.

        ValueError for a first line that does not fit the plant, and for a line that is not like it.
        """
        if not line.strip():
            return None
        if self.columns is None:
            self.is_json = line.lstrip("\ufeff \t").startswith("{")
            self.titles = list(_object(line)) if self.is_json else _cells(line.lstrip("\ufeff"))
            self.columns = find_columns("the first line", self.titles, self.plant, *self.accepted)
            if not self.is_json:
                return None
        if not self.is_json and _cells(line) == self.titles:
            return None  # of a writer that began again
        values = self._values(line)
        numbers = [_number(name, values.get(name)) for name in (*self.plant.sensor_names, *(s.name for s in self.plant.inputs))]
        count = len(self.plant.sensors)
        return _time(values.get(TIME.name)), np.array(numbers[:count]), np.array(numbers[count:])

    def _values(self, line: str) -> dict[str, Any]:
        """The values of a line by the names of the plant."""
        assert self.columns is not None
        if self.is_json:
            found = _object(line)
            return {name: found.get(self.titles[i]) for name, i in self.columns.items()}
        cells = _cells(line)
        if len(cells) != len(self.titles):
            raise ValueError(f"{len(cells)} cells under a header of {len(self.titles)}; leave a missing value's cell empty")
        return {name: cells[i] for name, i in self.columns.items()}


def _object(line: str) -> dict[str, Any]:
    try:
        found = json.loads(line.lstrip("\ufeff"))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"not JSON ({error}): {shown(line.strip())}") from error
    if not isinstance(found, dict):
        raise ValueError(f"{shown(found)} is no JSON object; expected names and values")
    return found


def _cells(line: str) -> list[str]:
    try:
        return next(csv.reader([line.rstrip("\r\n")], strict=True))
    except csv.Error as error:
        raise ValueError(f"not CSV ({error}): {shown(line.strip())}") from error


def _number(name: str, value: Any) -> float:
    """A number, NaN for nothing; ValueError for anything else."""
    if value is None or (isinstance(value, str) and not value.strip()):
        return np.nan
    try:
        if isinstance(value, str):
            return decimal(value.strip())
        if isinstance(value, int | float) and not isinstance(value, bool):
            return float(value)
    except (ValueError, OverflowError):
        pass
    raise ValueError(f"{name} is {shown(value)}; expected a number, or nothing where the value is missing")


def _time(value: Any) -> float | datetime:
    try:
        return _number(TIME.name, value)
    except ValueError:
        try:
            return datetime.fromisoformat(value.strip())
        except (AttributeError, ValueError):
            raise ValueError(f"time is {shown(value)}; expected seconds, or a time stamp like 2026-03-01T14:20:05Z") from None
