"""A scaled linear model with terms of the inputs as a plant: x+ = A x + B z(u) + w, y = C x + D z(u) + v."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.learning.identification.healthy_runs import Runs
from fusion_sfdia.plant.linear import constant
from fusion_sfdia.plant.plant import Numerics, Plant
from fusion_sfdia.plant.signals import Sensor, Signal

Array = NDArray[Any]


class StateSpace(NamedTuple):
    """A (n, n), B (n, p), C (N, n), D (N, p), Q (n, n), r (N,), P0 (n, n) of scaled readings and the p terms of the inputs;
    names and sensors (n,) of the states: what each is, and the position of the sensor whose unit it has, -1 for none.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    Q: Array
    r: Array
    P0: Array
    names: tuple[str, ...]
    sensors: tuple[int, ...]


def terms(u: Array, mean: Array, sd: Array, quadratic: bool) -> Array:
    """z(u) (..., p): 1, the inputs scaled, and where `quadratic` their squares less 1: a gain that depends on the operation."""
    s = (u - mean) / sd
    return np.concatenate([np.ones((*s.shape[:-1], 1)), s, *([s**2 - 1] if quadratic else [])], axis=-1)


def _step(A: Array, B: Array, z: partial[Array], t_start: float, x: Array, u: Array, dt: float) -> Array:
    return np.asarray(x @ A.T + z(u) @ B.T)


def _output(C: Array, D: Array, offset: Array, z: partial[Array], t: float, x: Array, u: Array) -> Array:
    return np.asarray(x @ C.T + z(u) @ D.T + offset)


def plant_of_model(
    name: str, model: StateSpace, runs: Runs, sensors: Sequence[Signal], inputs: Sequence[Signal], quadratic: bool
) -> Plant:
    """The plant in the readings' units; states are deviations from the mean of the healthy readings."""
    A, B, C, D, Q, r, P0, names, of = model
    unit = np.array([runs.y_sd[i] if i >= 0 else 1.0 for i in of])
    z = partial(terms, mean=runs.u_mean, sd=runs.u_sd, quadratic=quadratic)
    F, H = unit[:, None] * A / unit, runs.y_sd[:, None] * C / unit
    both = np.outer(unit, unit)
    return Plant(
        name=name,
        states=tuple(Signal(what, sensors[i].unit if i >= 0 else "1") for what, i in zip(names, of, strict=True)),
        sensors=tuple(
            Sensor(s.name, s.name, s.unit, sigma=float(sigma)) for s, sigma in zip(sensors, runs.y_sd * np.sqrt(r), strict=True)
        ),
        step=partial(_step, F, unit[:, None] * B, z),
        output=partial(_output, H, runs.y_sd[:, None] * D, runs.y_mean, z),
        dt=runs.dt,
        inputs=tuple(replace(s, nominal=float(mean)) for s, mean in zip(inputs, runs.u_mean, strict=True)),
        x0=np.zeros(len(A)),
        initial_cov=both * P0,
        process_cov=both * Q,
        numerics=Numerics(partial(constant, F), partial(constant, H), fixed_dt=True),
    )


def pairwise_covariance(e: Array, shrink: float) -> Array:
    """The covariance (N, N) of errors e (K, N) with NaN where missing, from the samples that both sensors of a pair have.

    Shrunk to its diagonal: (1 - shrink) S + shrink diag(S); then the nearest whose eigenvalues are positive.
    """
    known = np.isfinite(e).astype(float)
    value = np.nan_to_num(e)
    S = value.T @ value / np.maximum(known.T @ known, 1)
    S = (1 - shrink) * S + shrink * np.diag(np.diag(S))
    return positive(S)


def positive(S: Array, least: float = 1e-6) -> Array:
    """The symmetric matrix with eigenvalues of its unit-diagonal form of at least `least`."""
    sd = np.sqrt(np.maximum(np.diag(S), 1e-12))
    values, vectors = np.linalg.eigh((S + S.T) / 2 / np.outer(sd, sd))
    fixed = (vectors * np.maximum(values, least)) @ vectors.T
    return np.asarray((fixed + fixed.T) / 2 * np.outer(sd, sd))
