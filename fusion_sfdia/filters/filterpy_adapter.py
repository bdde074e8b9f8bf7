"""From a filterpy filter to a plant: any detector then runs on the user's own model and settings.

filterpy's functions take one state at a time, so the plant loops over a batch. Jacobians that are not given are central
differences. A model written as a `Physics` or `Plant` of array functions is many times faster.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from filterpy.kalman import (
    EnsembleKalmanFilter,
    ExtendedKalmanFilter,
    JulierSigmaPoints,
    KalmanFilter,
    MerweScaledSigmaPoints,
    UnscentedKalmanFilter,
)
from numpy.typing import NDArray

from fusion_sfdia.derivatives.equation import difference_jacobian
from fusion_sfdia.filters.ukf import SigmaPoints
from fusion_sfdia.plant.linear import constant, linear_plant
from fusion_sfdia.plant.plant import Numerics, Plant
from fusion_sfdia.plant.signals import Sensor, Signal

Array = NDArray[Any]
One = Callable[[Array], Array]  # of one state (n,)


def plant_from_filterpy(
    source: KalmanFilter | ExtendedKalmanFilter | UnscentedKalmanFilter | EnsembleKalmanFilter,
    *,
    dt: float | None = None,
    sensors: Sequence[str] | None = None,
    states: Sequence[str] | None = None,
    h: One | None = None,
    h_jacobian: One | None = None,
    f_jacobian: One | None = None,
) -> Plant:
    """Return the plant of a filterpy filter in its present state: its model, x, P, Q and R (diagonal).

    Parameters
    ----------
    source : KalmanFilter, ExtendedKalmanFilter, UnscentedKalmanFilter or EnsembleKalmanFilter
        Of filterpy.
    dt : float, optional
        The step in s; an unscented or ensemble filter knows its own, for the others it is 1 unless given, and fixed.
    sensors : sequence of str, optional
        Names, z0, z1, ... unless given.
    states : sequence of str, optional
        Names, x0, x1, ... unless given.
    h : callable, optional
        What an ExtendedKalmanFilter takes in `update` as Hx; it is required then, and is called with a state of the shape of
        source.x.
    h_jacobian : callable, optional
        What it takes as HJacobian.
    f_jacobian : callable, optional
        That of an overridden predict_x, or of fx.

    Returns
    -------
    Plant
        With the same model.

    Raises
    ------
    ValueError
        For what a plant cannot carry: correlated readings, fading memory, cross-correlated noise, custom means or residuals.

    Examples
    --------
    >>> import numpy as np
    >>> from filterpy.kalman import KalmanFilter
    >>> from fusion_sfdia.plants import plant_from_filterpy
    >>> own = KalmanFilter(dim_x=1, dim_z=2)
    >>> own.F, own.H, own.R = np.array([[0.97]]), np.ones((2, 1)), np.diag([1e-4, 1e-4])
    >>> plant_from_filterpy(own, dt=60.0, sensors=["gauge_1", "gauge_2"]).sensor_names
    ('gauge_1', 'gauge_2')
    """
    n, shape = np.size(source.x), np.shape(source.x)
    states = list(states or (f"x{i}" for i in range(n)))
    noise = np.asarray(source.R, dtype=float)
    if np.any(noise != np.diag(np.diagonal(noise))):
        raise ValueError("R is not diagonal; sensors err independently: whiten the readings (multiply z and h by R^-1/2) first")
    sensors = list(sensors or (f"z{i}" for i in range(len(noise))))
    if len(sensors) != len(noise) or len(states) != n:
        raise ValueError(
            f"{len(sensors)} sensor and {len(states)} state names; the filter has {len(noise)} readings, {n} states"
        )
    signals = [Signal(s) for s in states]
    instruments = [Sensor(s, s, sigma=float(np.sqrt(v))) for s, v in zip(sensors, np.diagonal(noise), strict=True)]
    moments: dict[str, Any] = {
        "x0": np.array(source.x, dtype=float).reshape(-1),
        "initial_cov": np.array(source.P, dtype=float),
        "process_cov": np.array(source.Q, dtype=float),
    }
    name = f"filterpy {type(source).__name__}"
    if isinstance(source, KalmanFilter):
        matrix, inputs = _linear(source)
        step_size = 1.0 if dt is None else dt
        F, H = np.array(source.F, dtype=float), np.array(source.H, dtype=float)
        return linear_plant(
            name, F, H, instruments, dt=step_size, input_matrix=matrix, states=signals, inputs=inputs, **moments
        )
    model = _extended(source, h, dt) if isinstance(source, ExtendedKalmanFilter) else _timed(source, dt)
    largest = np.maximum(np.diagonal(moments["initial_cov"]), np.diagonal(moments["process_cov"]))
    scale = np.sqrt(np.where(largest > 0, largest, 1.0))
    of_state = None if h_jacobian is None else partial(_shaped, h_jacobian, shape)
    functions = _OneByOne(model, f_jacobian or model.f_jacobian, of_state, len(sensors), scale)
    return Plant(
        name=name,
        states=tuple(signals),
        sensors=tuple(instruments),
        inputs=model.inputs,
        step=functions.step,
        output=functions.output,
        dt=model.dt,
        numerics=Numerics(
            functions.step_jacobian, functions.output_jacobian, fixed_dt=isinstance(source, ExtendedKalmanFilter)
        ),
        **moments,
    )


class _Model(NamedTuple):
    """Functions of one state (n,): f(x, u, dt), h(x), and the Jacobian of f where known."""

    f: Callable[[Array, Array, float], Array]
    h: One
    dt: float
    inputs: tuple[Signal, ...] = ()
    f_jacobian: One | None = None


@dataclass(frozen=True, eq=False)
class _OneByOne:
    """The functions of a plant from those of one state (n,), with central differences where no Jacobian is given."""

    model: _Model
    f_jacobian: One | None
    h_jacobian: One | None
    sensors: int
    scale: Array  # (n,)

    def step(self, t_start: float, x: Array, u: Array, dt: float) -> Array:
        return _over_batch(lambda p, v: self.model.f(p, v, dt), self.scale.shape, x, u)

    def output(self, t: float, x: Array, u: Array) -> Array:
        return _over_batch(self.model.h, (self.sensors,), x)

    def step_jacobian(self, t_start: float, x: Array, u: Array, dt: float) -> Array:
        if self.f_jacobian is not None:
            return _over_batch(self.f_jacobian, (self.scale.size, self.scale.size), x)
        return difference_jacobian(lambda p: self.step(t_start, p, np.expand_dims(u, -2), dt), x, self.scale)

    def output_jacobian(self, t: float, x: Array, u: Array) -> Array:
        if self.h_jacobian is not None:
            return _over_batch(self.h_jacobian, (self.sensors, self.scale.size), x)
        return difference_jacobian(lambda p: self.output(t, p, u), x, self.scale)


def _shaped(function: One, shape: tuple[int, ...], x: Array) -> Array:
    """A function of a state (n,), from one that takes a state in the filter's shape."""
    return function(x.reshape(shape))


def _predicted(own: ExtendedKalmanFilter, shape: tuple[int, ...], x: Array, u: Array, dt: float) -> Array:
    own.x = x.reshape(shape)
    own.predict_x(u.reshape(-1, *shape[1:]) if u.size else 0)
    return np.asarray(own.x)


def _without_input(fx: Callable[[Array, float], Array], x: Array, u: Array, dt: float) -> Array:
    return fx(x, dt)


def _linear(source: KalmanFilter) -> tuple[Array | None, tuple[Signal, ...]]:
    if source.alpha != 1.0:
        raise ValueError(f"alpha is {source.alpha}; a plant has no fading memory: set alpha = 1 and enlarge Q instead")
    if np.any(source.M):
        raise ValueError("M is not zero; a plant has no noise common to states and readings: include it in F and Q")
    return _inputs(source.B, np.size(source.x))


def _extended(source: ExtendedKalmanFilter, h: One | None, dt: float | None) -> _Model:
    if h is None:
        raise ValueError("an ExtendedKalmanFilter takes its measurement function in update; pass it as h=, and h_jacobian=")
    shape = np.shape(source.x)
    own = copy.deepcopy(source)  # predict_x changes its filter's x; the user's filter is not changed
    F = np.array(source.F, dtype=float)
    linear = type(source).predict_x is ExtendedKalmanFilter.predict_x
    return _Model(
        f=partial(_predicted, own, shape),
        h=partial(_shaped, h, shape),
        dt=1.0 if dt is None else dt,
        inputs=_inputs(source.B, np.size(source.x))[1],
        f_jacobian=partial(constant, F) if linear else None,
    )


def _timed(source: UnscentedKalmanFilter | EnsembleKalmanFilter, dt: float | None) -> _Model:
    if isinstance(source, UnscentedKalmanFilter):
        _require_plain(source)
    own = float(source._dt if isinstance(source, UnscentedKalmanFilter) else source.dt)
    if dt is not None and dt != own:
        raise ValueError(f"dt is {dt} s, the filter's is {own} s; leave it out")
    return _Model(f=partial(_without_input, source.fx), h=source.hx, dt=own)


def sigma_points(source: UnscentedKalmanFilter) -> SigmaPoints:
    """Return the settings of an UnscentedKalmanFilter's sigma points (Merwe's scaled or Julier's)."""
    points = source.points_fn
    if isinstance(points, MerweScaledSigmaPoints):
        return SigmaPoints(points.alpha, points.beta, points.kappa)
    if isinstance(points, JulierSigmaPoints):
        return SigmaPoints(1.0, 0.0, points.kappa)
    raise ValueError(f"no counterpart for {type(points).__name__}; use MerweScaledSigmaPoints or JulierSigmaPoints")


def _require_plain(source: UnscentedKalmanFilter) -> None:
    plain = {
        "x_mean_fn": source.x_mean is None,
        "z_mean_fn": source.z_mean is None,
        "residual_x": source.residual_x is np.subtract,
        "residual_z": source.residual_z is np.subtract,
        "state_add": source.state_add is np.add,
    }
    custom = [name for name, is_plain in plain.items() if not is_plain]
    if custom:
        raise ValueError(f"the filter has its own {', '.join(custom)}; a plant's states add and subtract as numbers do")


def _inputs(B: Any, n: int) -> tuple[Array | None, tuple[Signal, ...]]:
    """B as a matrix (n, m), None if the filter has no inputs, and the signals u0, u1, ..."""
    if B is None or np.ndim(B) == 0:
        return None, ()
    matrix = np.asarray(B, dtype=float).reshape(n, -1)
    return matrix, tuple(Signal(f"u{i}") for i in range(matrix.shape[1]))


def _over_batch(function: Callable[..., Array], shape: tuple[int, ...], x: Array, *others: Array) -> Array:
    """Call function on each state of x (..., n), and each of others (..., m); results (..., *shape)."""
    batch = np.broadcast_shapes(x.shape[:-1], *(o.shape[:-1] for o in others))
    arguments = [np.broadcast_to(a, (*batch, a.shape[-1])) for a in (x, *others)]
    out = np.empty((*batch, *shape))
    for index in np.ndindex(batch):
        out[index] = np.asarray(function(*(a[index].copy() for a in arguments)), dtype=float).reshape(shape)
    return out
