"""Between values of a bridge, each with its own time stamp, and a watch: rows from values."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime, timedelta
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.live.watch import Watch

Array = NDArray[Any]


class Value(NamedTuple):
    """A reading or input, NaN where it is bad, with the time of its source."""

    number: float
    stamp: datetime | None


class Values:
    """Rows of a watch from the latest values of sensors and inputs.

    stale: seconds by which the stamp of a value may be before the newest one; an older one is missing (None: it counts, as
    sources that report changes alone do not renew it).
    """

    def __init__(self, watch: Watch, stale: float | None) -> None:
        self.watch, self.plant = watch, watch.detector.plant
        self.stale = np.inf if stale is None else stale
        self.names = (*self.plant.sensor_names, *(s.name for s in self.plant.inputs))
        self.newest: datetime | None = None  # of the last row

    def row(self, values: Mapping[str, Value]) -> tuple[datetime, Array, Array] | None:
        """The time stamp, y (N,) and u (m,), of which the newest value states the time; None where none is newer than the
        row before.
        """
        known = [v.stamp for v in values.values() if v.stamp is not None]
        if not known or (self.newest is not None and max(known) <= self.newest):
            return None
        self.newest = newest = max(known)
        numbers = np.full(len(self.names), np.nan)
        for i, name in enumerate(self.names):
            value = values.get(name)
            if value is not None and value.stamp is not None and (newest - value.stamp).total_seconds() <= self.stale:
                numbers[i] = value.number
        count = len(self.plant.sensors)
        return self.on_grid(newest), numbers[:count], numbers[count:]

    def on_grid(self, stamp: datetime) -> datetime:
        """The stamp, of a plant that holds for steps of dt only the nearest one a number of steps after the first."""
        start, dt = self.watch.clock.start or stamp, self.plant.dt
        if not self.plant.numerics.fixed_dt:
            return stamp
        return start + timedelta(seconds=round((stamp - start).total_seconds() / dt) * dt)


def real(value: Any) -> float:
    """A number as a float, anything else as missing."""
    return float(value) if isinstance(value, int | float | np.number) and np.isfinite(value) else np.nan
