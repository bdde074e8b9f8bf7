"""Recorded readings of a plant."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import some
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Signal

Array = NDArray[Any]

TIME = Signal("time", "s")


class Log(NamedTuple):
    """Times t (K,) in s, readings y (K, ..., N) with NaN where missing, inputs u (K, ..., m) that acted until t.

    Attributes
    ----------
    t : array (K,)
        Times of the readings in s.
    y : array (K, ..., N)
        Readings in the units of the sensors, NaN where missing.
    u : array (K, ..., m)
        Inputs that acted until t.

    Examples
    --------
    >>> import numpy as np
    >>> from fusion_sfdia import Log
    >>> log = Log(t=np.array([0.0, 5.0]), y=np.array([[1.0, np.nan], [1.1, 0.9]]), u=np.zeros((2, 1)))
    >>> log._replace(y=log.y * 100).y[1]
    array([110.,  90.])
    """

    t: Array
    y: Array
    u: Array

    def rows(self, which: slice | Array) -> Log:
        """The log of some of its rows.

        Parameters
        ----------
        which : slice or array
            The rows: a slice, which copies nothing, their positions, or for each row whether it is one of them.

        Returns
        -------
        Log
            Of these rows.
        """
        return Log(self.t[which], self.y[which], self.u[which])


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
                f"the readings are of the {what} {some(given)}; expected those of plant {plant.name!r}, {some(own)}"
            )


def usual_inputs(plant: Plant, t: Array) -> Array:
    """Return the plant's operation (K, m) at the reading before each t, or dt before it where that is later."""
    before = np.maximum(t - plant.dt, np.concatenate([t[:1] - plant.dt, t[:-1]]))
    return np.array([plant.input_at(float(s)) for s in before], dtype=float).reshape(t.size, len(plant.inputs))
