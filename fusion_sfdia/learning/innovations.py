"""The extended Kalman filter over a healthy log, sample by sample, with what its likelihood needs.

What may be learnt is held at its value while the filter runs; how the innovations depend on it follows from sensitivities, as
in the separated bias filter (Friedland 1969, Treatment of bias in recursive filtering).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.covariance import diagonal
from fusion_sfdia.filters.estimators import Extended, GaussianState, Prior, step_stream
from fusion_sfdia.filters.gaussian import Joint, half_inverse
from fusion_sfdia.plant.augment import augment
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

STEADY = 100  # samples until the gain is taken as steady
FORGOTTEN = 0.05  # share of an error of the first estimate that is left after settling


@dataclass(frozen=True, eq=False)
class InnovationStep:
    """One step of the filter, of each run (B, ...).

    x (B, n): the estimate after the readings. tangent F (B, n, n), readout H (B, N, n), half U (B, N, N) with U U' = S^-1, zero
    for readings that are missing, gain_half C U (B, n, N). normal (B, N): the innovation in independent units, U' d. used
    (B, N). log_likelihood (B,) of the readings. The others follow from these, where they are asked for.
    """

    x: Array
    tangent: Array
    readout: Array
    half: Array
    gain_half: Array
    normal: Array
    used: Array
    log_likelihood: Array

    @cached_property
    def whitened(self) -> Array:
        """S^-1 d (B, N)."""
        return np.asarray((self.half @ self.normal[..., None])[..., 0])

    @cached_property
    def inverse(self) -> Array:
        """S^-1 (B, N, N)."""
        return np.asarray(self.half @ np.swapaxes(self.half, -1, -2))

    @cached_property
    def gain(self) -> Array:
        """K (B, n, N)."""
        return np.asarray(self.gain_half @ np.swapaxes(self.half, -1, -2))

    @cached_property
    def closed(self) -> Array:
        """I - K H (B, n, n)."""
        return np.asarray(np.eye(self.x.shape[-1]) - self.gain @ self.readout)

    @property
    def single(self) -> Array:
        """The error of each reading (B, N) predicted from all others, over its standard deviation; NaN where missing."""
        precision = np.sum(self.half**2, axis=-1)
        return np.where(self.used, self.whitened / np.sqrt(np.where(self.used, precision, 1.0)), np.nan)


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


def until(log: Log, use: Array) -> Log:
    """The log up to the last sample that is used (K,)."""
    last = int(np.flatnonzero(use)[-1]) + 1
    return Log(log.t[:last], log.y[:last], log.u[:last])


class InnovationUpdate(NamedTuple):
    """One update of the filter: prior and joint Gaussian, readings y (B, N) on the turn of what is expected, used (B, N), U and
    C U as in `InnovationStep`, normal U' d (B, N), and the state after it.
    """

    prior: Prior
    joint: Joint
    y: Array
    used: Array
    half: Array
    normal: Array
    gain_half: Array
    after: GaussianState


def updated(model: Plant, core: GaussianState, t_start: float, dt: float, y: Array, u: Array) -> InnovationUpdate:
    """The extended filter over [t_start, t_start + dt] and its update by y (B, N), NaN where missing, under u (B, m)."""
    filter_, rng = Extended(), step_stream(0, 0)  # it draws nothing
    prior = filter_.predict(model, core, t_start, u, dt, rng)
    joint = filter_.joint(model, prior, t_start + dt, u)
    y = model.near(y, joint.y)
    used = np.isfinite(y)
    half = half_inverse(joint.S, used)
    normal = (np.swapaxes(half, -1, -2) @ np.where(used, y - joint.y, 0.0)[..., None])[..., 0]
    gain_half = joint.C @ half
    x = joint.x + (gain_half @ normal[..., None])[..., 0]
    p = joint.P - gain_half @ np.swapaxes(gain_half, -1, -2)
    floor = 4 * np.finfo(float).eps * sum(joint.C.shape[-2:])
    np.einsum("...ii->...i", p)[...] += floor * np.diagonal(joint.P, axis1=-2, axis2=-1)
    return InnovationUpdate(prior, joint, y, used, half, normal, gain_half, GaussianState(x, p))


def filtered(model: Plant, log: Log) -> Iterator[InnovationStep]:
    """Yield the samples of a filter on the plant, started at its x0, over a log of runs: t (K,), y (K, B, N), u (K, B, m).

    ValueError where the model gives no finite value.
    """
    core = Extended().start(model, log.y.shape[1:-1], step_stream(0, 0))  # it draws nothing
    before = float(log.t[0]) - model.dt
    for t, y, u in zip(log.t.tolist(), log.y, log.u, strict=True):
        model.check_dt(t - before)
        prior, joint, _, used, half, normal, gain_half, core = updated(model, core, before, t - before, y, u)
        x = core.x
        if not np.all(np.isfinite(x)):
            where = "the healthy log" if log.y.shape[1] == 1 else f"one of the {log.y.shape[1]} stretches of the healthy log"
            raise ValueError(
                f"the filter on plant {model.name!r} diverges {t - float(log.t[0]):g} s after the beginning of {where}; check "
                "its inputs and units, and that it starts near the plant's x0"
            )
        assert prior.tangent is not None and joint.H is not None
        readout = np.broadcast_to(joint.H, np.swapaxes(joint.C, -1, -2).shape)
        scale = np.where(used, np.diagonal(half, axis1=-2, axis2=-1), 1.0)
        log_likelihood = np.sum(np.log(scale) - used * np.log(2 * np.pi) / 2 - normal**2 / 2, axis=-1)
        yield InnovationStep(x, prior.tangent, readout, half, gain_half, normal, used, log_likelihood)
        before = t


def settling(model: Plant, log: Log) -> int:
    """The number of samples after which the filter has forgotten its first estimate, from its steady gain.

    An error of the estimate is multiplied by (I - K H) F in each step, in the end by the largest eigenvalue of that product.
    """
    *_, last = filtered(model, Log(*(a[:STEADY] for a in log)))
    moving = diagonal(model.process_cov) + diagonal(model.initial_cov) > 0
    loop = (last.closed @ last.tangent)[..., moving, :][..., moving]
    slowest = np.max(np.abs(np.linalg.eigvals(loop)))
    return int(np.ceil(np.log(FORGOTTEN) / np.log(slowest))) if slowest < 1 else len(log.t)
