"""Linear plants: steps and outputs by matrices, constant Jacobians, and an exact zero-order hold of inputs."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from fusion_sfdia.common.arguments import floats
from fusion_sfdia.plant.plant import FROM_STATES, Numerics, Plant
from fusion_sfdia.plant.signals import Sensor, Signal

Array = NDArray[Any]


def picked(picks: Array, t: float, x: Array, u: Array) -> Array:
    """The output of sensors that read states: x (..., n) at the positions picks (N,)."""
    return x[..., picks]


def constant(matrix: Array, *arguments: Any) -> Array:
    """A Jacobian that is the same everywhere."""
    return matrix


def _linear_step(f: Array, g: Array, offset: Array, t_start: float, x: Array, u: Array, dt: float) -> Array:
    return np.asarray(x @ f.T + u @ g.T + offset)


def _linear_output(h: Array, d: Array | None, offset: Array, t: float, x: Array, u: Array) -> Array:
    return np.asarray(x @ h.T + offset if d is None else x @ h.T + u @ d.T + offset)


def linear_plant(
    name: str,
    transition: Array,
    readout: Array,
    sensors: Sequence[Sensor],
    *,
    dt: float,
    x0: Array = FROM_STATES,
    initial_cov: Array = FROM_STATES,
    process_cov: Array = FROM_STATES,
    input_matrix: Array | None = None,
    offset: Array | None = None,
    feedthrough: Array | None = None,
    output_offset: Array | None = None,
    states: Sequence[Signal] | None = None,
    inputs: Sequence[Signal] = (),
) -> Plant:
    """Return the plant x+ = F x + G u + c, y = H x + D u + d with a fixed dt (s); G, c, D and d are 0 by default.

    For a model linearised about an operating point (x*, u*), c = f(x*, u*) - F x* - G u*, and d likewise. D multiplies the
    input that acted until the reading.

    Parameters
    ----------
    name : str
        Of the plant.
    transition : array (n, n)
        F.
    readout : array (N, n)
        H.
    sensors : sequence of Sensor (N,)
        With their noise.
    dt : float
        Time between readings in s.
    x0 : array (n,), optional
        Initial state, by default that of the signals of the states, as in `Plant`.
    initial_cov : array (n,) or (n, n), optional
        Covariance of x0, by default likewise.
    process_cov : array (n,) or (n, n), optional
        Covariance of the process noise of a step, by default likewise.
    input_matrix : array (n, m), optional
        G.
    offset : array (n,), optional
        c.
    feedthrough : array (N, m), optional
        D.
    output_offset : array (N,), optional
        d.
    states : sequence of Signal (n,), optional
        By default x0, x1, ...
    inputs : sequence of Signal (m,), default ()
        The signals of u.

    Returns
    -------
    Plant
        With F and H as its Jacobians.

    Raises
    ------
    ValueError
        For shapes that do not fit and entries that are not finite.

    Examples
    --------
    >>> import numpy as np
    >>> from fusion_sfdia import Sensor, linear_plant
    >>> gauges = [Sensor("gauge_1", "x0", sigma=0.01), Sensor("gauge_2", "x0", sigma=0.02)]
    >>> plant = linear_plant("tank", [[0.5]], [[1.0], [1.0]], gauges, dt=60.0, x0=[0.0], initial_cov=[4e-4], process_cov=[1e-6])
    >>> plant.step(0.0, np.array([0.5]), np.zeros(0), 60.0)
    array([0.25])
    """
    f, h = floats("transition", transition), floats("readout", readout)
    n = f.shape[0] if f.ndim else 0
    count, m = len(sensors), len(inputs)
    g, c, d, e = (
        np.zeros(shape) if a is None else floats(what, a)
        for what, a, shape in (
            ("input_matrix", input_matrix, (n, m)),
            ("offset", offset, (n,)),
            ("feedthrough", feedthrough, (count, m)),
            ("output_offset", output_offset, (count,)),
        )
    )
    if f.shape != (n, n) or h.shape != (count, n) or g.shape != (n, m):
        raise ValueError(f"F {f.shape}, G {g.shape}, H {h.shape} do not fit {n} states, {m} inputs and {count} sensors")
    if c.shape != (n,) or d.shape != (count, m) or e.shape != (count,):
        raise ValueError(
            f"offset {c.shape}, feedthrough {d.shape}, output_offset {e.shape} do not fit {n} states, {m} inputs and {count} "
            f"sensors; expected {(n,)}, {(count, m)}, {(count,)}"
        )
    if not all(np.all(np.isfinite(a)) for a in (f, g, h, c, d, e)):
        raise ValueError(f"F, G, H, D or an offset of plant {name!r} has entries that are not finite; give numbers")
    return Plant(
        name=name,
        states=tuple(states or (Signal(f"x{i}") for i in range(n))),
        inputs=tuple(inputs),
        sensors=tuple(sensors),
        step=partial(_linear_step, f, g, c),
        output=partial(_linear_output, h, None if feedthrough is None else d, e),
        dt=dt,
        x0=x0,
        initial_cov=initial_cov,
        process_cov=process_cov,
        numerics=Numerics(partial(constant, f), partial(constant, h), fixed_dt=True),
    )


def zero_order_hold(a: Array, b: Array, dt: float) -> tuple[Array, Array]:
    """Return F = exp(A dt) and G = integral of exp(A s) B over a step: the exact step of dx/dt = A x + B u with u held.

    A (n, n), B (n, m), dt in s; ValueError for other shapes or a dt that is not positive and finite.
    """
    if np.ndim(a) != 2 or np.ndim(b) != 2 or not a.shape[0] == a.shape[1] == b.shape[0]:
        raise ValueError(f"A {np.shape(a)} and B {np.shape(b)} do not fit; expected (n, n) and (n, m)")
    if not (np.isfinite(dt) and dt > 0):
        raise ValueError(f"dt is {dt} s; it must be positive and finite")
    n, m = b.shape
    both = expm(np.block([[a, b], [np.zeros((m, n + m))]]) * dt)
    return both[:n, :n], both[:n, n:]
