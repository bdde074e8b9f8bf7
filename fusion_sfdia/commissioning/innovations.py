"""The extended Kalman filter over a healthy log, sample by sample, with what its likelihood needs.

What may be learnt is held at its value while the filter runs; how the innovations depend on it follows from sensitivities, as
in the separated bias filter (Friedland 1969, Treatment of bias in recursive filtering).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.augment import augment
from fusion_sfdia.core.covariance import diagonal
from fusion_sfdia.core.log import Log
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.core.uncertainty import Uncertainty
from fusion_sfdia.filters.estimators import Extended, GaussianState, step_stream
from fusion_sfdia.filters.gaussian import half_inverse

Array = NDArray[Any]

STEADY = 100  # samples until the gain is taken as steady
FORGOTTEN = 0.05  # share of an error of the first estimate that is left after settling


class Sample(NamedTuple):
    """One step of the filter, of each run (B, ...).

    x (B, n): the estimate after the readings. tangent F (B, n, n), readout H (B, N, n), gain K (B, n, N), closed I - K H.
    whitened u = S^-1 d (B, N) and inverse S^-1 (B, N, N), zero for readings that are missing. normal (B, N): the innovation
    in independent units, U' d with U U' = S^-1. used (B, N). log_likelihood (B,) of the readings.
    """

    x: Array
    tangent: Array
    readout: Array
    gain: Array
    closed: Array
    whitened: Array
    inverse: Array
    normal: Array
    used: Array
    log_likelihood: Array


def held(plant: Plant) -> Plant:
    """The augmented plant whose parameters and errors of inputs keep their value: without variance, without noise.

    Its disturbances are estimated.
    """
    known = plant.uncertainty
    frozen = tuple(replace(p, treatment="frozen") for p in known.parameters)
    model = augment(replace(plant, uncertainty=replace(known, parameters=frozen, at_rest=False)))
    n, p, m = len(plant.states), len(known.parameters), len(known.inputs)
    cov = model.initial_cov.copy()
    if cov.ndim == 1:
        cov[n + p : n + p + m] = 0.0
    else:
        cov[n + p : n + p + m] = cov[:, n + p : n + p + m] = 0.0
    return replace(model, initial_cov=cov)


def fixed(plant: Plant) -> Plant:
    """The plant at its nominal parameters, augmented by its disturbances alone."""
    return augment(replace(plant, uncertainty=Uncertainty(disturbances=plant.uncertainty.disturbances)))


def until(log: Log, use: Array) -> Log:
    """The log up to the last sample that is used (K,)."""
    last = int(np.flatnonzero(use)[-1]) + 1
    return Log(log.t[:last], log.y[:last], log.u[:last])


def filtered(model: Plant, log: Log) -> Iterator[Sample]:
    """Yield the samples of a filter on the plant, started at its x0, over a log of runs: t (K,), y (K, B, N), u (K, B, m).

    ValueError where the model gives no finite value.
    """
    filter_, rng = Extended(), step_stream(0, 0)  # it draws nothing
    core = filter_.start(model, log.y.shape[1:-1], rng)
    identity = np.eye(model.x0.size)
    before = float(log.t[0]) - model.dt
    for t, y, u in zip(log.t.tolist(), log.y, log.u, strict=True):
        model.check_dt(t - before)
        prior = filter_.predict(model, core, before, u, t - before, rng)
        joint = filter_.joint(model, prior, t, u)
        used = np.isfinite(y)
        half = half_inverse(joint.S, used)
        normal = (np.swapaxes(half, -1, -2) @ np.where(used, y - joint.y, 0.0)[..., None])[..., 0]
        gain_half = joint.C @ half
        x = joint.x + (gain_half @ normal[..., None])[..., 0]
        if not np.all(np.isfinite(x)):
            raise ValueError(
                f"the filter on plant {model.name!r} diverges at {t:g} s of the healthy log; check its inputs and "
                "units, and that it starts near the plant's x0"
            )
        p = joint.P - gain_half @ np.swapaxes(gain_half, -1, -2)
        floor = 4 * np.finfo(float).eps * sum(joint.C.shape[-2:])
        np.einsum("...ii->...i", p)[...] += floor * np.diagonal(joint.P, axis1=-2, axis2=-1)
        readout = np.broadcast_to(model.output_jacobian_at(t, prior.core.x, u), np.swapaxes(joint.C, -1, -2).shape)
        gain = gain_half @ np.swapaxes(half, -1, -2)
        scale = np.where(used, np.diagonal(half, axis1=-2, axis2=-1), 1.0)
        log_likelihood = np.sum(np.log(scale) - used * np.log(2 * np.pi) / 2 - normal**2 / 2, axis=-1)
        tangent = prior.tangent
        assert tangent is not None
        yield Sample(
            x, tangent, readout, gain, identity - gain @ readout, (half @ normal[..., None])[..., 0],
            half @ np.swapaxes(half, -1, -2), normal, used, log_likelihood,
        )  # fmt: skip
        core, before = GaussianState(x, p), t


def settling(model: Plant, log: Log) -> int:
    """The number of samples after which the filter has forgotten its first estimate, from its steady gain.

    An error of the estimate is multiplied by (I - K H) F in each step, in the end by the largest eigenvalue of that product.
    """
    *_, last = filtered(model, Log(*(a[:STEADY] for a in log)))
    moving = diagonal(model.process_cov) + diagonal(model.initial_cov) > 0
    loop = (last.closed @ last.tangent)[..., moving, :][..., moving]
    slowest = np.max(np.abs(np.linalg.eigvals(loop)))
    return int(np.ceil(np.log(FORGOTTEN) / np.log(slowest))) if slowest < 1 else len(log.t)
