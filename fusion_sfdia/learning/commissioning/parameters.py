"""Declared parameters and errors of inputs, estimated from a healthy log.

The innovations of a filter with fixed values depend on an error e of these values by N = H eps,

    eps <- F (I - K H) eps,    d = N e + innovation of the right values

(Friedland 1969), so that g = sum N' S^-1 d and I = sum N' S^-1 N give the posterior of a prior N(0, C): mean (I + C^-1)^-1 g,
covariance (I + C^-1)^-1, that of the Kalman filter and smoother of the augmented plant. A nonlinear plant is built anew there
(Gauss-Newton).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from fusion_sfdia.learning.commissioning.corrections import ConstantCorrection, at_values, with_offset
from fusion_sfdia.learning.innovations import filtered, held, until
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.uncertainty import error_of

Array = NDArray[Any]

STEPS = 5  # of Gauss and Newton
CLOSE = 0.5  # posterior standard deviations: a step below this ends them; what it leaves is of second order
FARTHEST = 4.0  # prior standard deviations


class ParameterEstimate(NamedTuple):
    """Values (p,) of parameters, then errors of inputs, with standard deviation sd (p,) and prior_sd (p,), in their units.

    cov (p, p): posterior covariance, of one value for the whole log. between (p,): standard deviation of the value between
    stretches, beyond what noise explains. sd^2 is the sum of both variances, at most prior_sd^2.
    """

    names: tuple[str, ...]
    value: Array
    sd: Array
    prior: Array
    prior_sd: Array
    cov: Array
    between: Array


def estimated(plant: Plant, log: Log, use: Array, stretch: Array) -> ParameterEstimate:
    """Estimate what the plant declares from the samples use (K,) of a log of runs, in stretches numbered by stretch (K,)."""
    where = free(plant)
    names, prior, prior_sd = declared(plant)
    value, tau = prior, np.zeros(prior.size)
    for _ in range(STEPS):
        g, info = _scores(at(plant, value, prior_sd), log, use, stretch, prior_sd)
        g, info = g[:, where], info[:, where[:, None], where]
        cov = np.linalg.inv(np.sum(info, axis=0) + np.eye(where.size))
        change = cov @ (np.sum(g, axis=0) - tau[where])
        tau[where] = np.clip(tau[where] + change, -FARTHEST, FARTHEST)
        value = _within(plant, prior + prior_sd * tau)
        if np.all(np.abs(change) < CLOSE * np.sqrt(np.diagonal(cov))):
            break
    between = np.minimum(_between(g - info @ change, info), 1.0)
    sd = prior_sd[where] * np.sqrt(np.minimum(np.diagonal(cov) + between, 1.0))
    scale = prior_sd[where]
    chosen = tuple(names[i] for i in where)
    return ParameterEstimate(
        chosen, value[where], sd, prior[where], scale, cov * np.outer(scale, scale), scale * np.sqrt(between)
    )


def moved(plant: Plant, found: ParameterEstimate) -> Plant:
    """The plant with what was estimated; later changes are judged by what was declared."""
    where, (names, value, prior_sd) = free(plant), declared(plant)
    changes = dict(zip(names, prior_sd.tolist(), strict=True)) | dict(plant.uncertainty.changes)
    sd = prior_sd.copy()
    value[where], sd[where] = found.value, found.sd
    there = at(plant, value, sd)
    return replace(there, uncertainty=replace(there.uncertainty, changes=changes))


def free(plant: Plant) -> Array:
    """Positions of what is estimated: all but frozen parameters."""
    known = plant.uncertainty
    return np.flatnonzero([p.treatment != "frozen" for p in known.parameters] + [True] * len(known.inputs))


def declared(plant: Plant) -> tuple[tuple[str, ...], Array, Array]:
    """Names, values and standard deviations of the parameters, then of the errors of inputs, in the order of the inputs."""
    known = plant.uncertainty
    errors = [s.name for s in plant.inputs if s.name in known.inputs]
    names = (*(p.name for p in known.parameters), *(error_of(name) for name in errors))
    value = np.concatenate([known.nominal, np.zeros(len(errors))])
    return names, value, np.concatenate([known.sd, [known.inputs[name] for name in errors]])


def _within(plant: Plant, value: Array) -> Array:
    """Values within the limits of the parameters."""
    parameters, errors = plant.uncertainty.parameters, [np.inf] * len(plant.uncertainty.inputs)
    return np.clip(value, [p.low for p in parameters] + [-e for e in errors], [p.high for p in parameters] + errors)


def at(plant: Plant, value: Array, sd: Array) -> Plant:
    """The plant at these values of its parameters and errors of inputs, with these standard deviations."""
    known = plant.uncertainty
    p = len(known.parameters)
    errors = [s.name for s in plant.inputs if s.name in known.inputs]
    there = at_values(plant, value[:p], sd[:p]) if p else plant
    if not errors:
        return there
    shift = np.array([value[p + errors.index(s.name)] if s.name in errors else 0.0 for s in plant.inputs])
    there = with_offset(there, ConstantCorrection(shift, np.zeros(len(plant.states)), np.zeros(len(plant.sensors)), plant.dt))
    inputs = dict(zip(errors, sd[p:].tolist(), strict=True))
    return replace(there, uncertainty=replace(there.uncertainty, inputs=inputs))


def _scores(plant: Plant, log: Log, use: Array, stretch: Array, scale: Array) -> tuple[Array, Array]:
    """Return g (S, p) and I (S, p, p) of each stretch of each run, for errors in units of scale (p,)."""
    model, n, p = held(plant), len(plant.states), scale.size
    runs, size = log.y.shape[1], model.x0.size
    start = np.zeros((size, p))
    start[n : n + p] = np.diag(scale)
    eps = np.broadcast_to(start, (runs, size, p))
    count = int(stretch.max()) + 1
    g, info = np.zeros((count, runs, p)), np.zeros((count, runs, p, p))
    for k, now in enumerate(filtered(model, until(log, use))):
        eps = now.tangent @ eps
        if use[k]:
            effect = now.readout @ eps
            g[stretch[k]] += (np.swapaxes(effect, -1, -2) @ now.whitened[..., None])[..., 0]
            info[stretch[k]] += np.swapaxes(effect, -1, -2) @ now.inverse @ effect
        eps = now.closed @ eps
    return g.reshape(-1, p), info.reshape(-1, p, p)


def _between(g: Array, info: Array) -> Array:
    """Variances (p,) of the values between stretches, from scores g (S, p) at the estimate and information I (S, p, p).

    E[g_j^2] = I_jj + sum_i I_ji^2 variance_i in each stretch: solved for variances of at least 0 (moment estimate of
    DerSimonian and Laird 1986, Meta-analysis in clinical trials), each stretch in units of its own noise.
    """
    diagonal = np.diagonal(info, axis1=-2, axis2=-1)
    weight = 1.0 / np.maximum(np.mean(diagonal, axis=0), np.finfo(float).tiny)
    rows = np.sum(info**2, axis=0) * weight[:, None]
    excess = np.sum(g**2 - diagonal, axis=0) * weight
    found, _ = nnls(rows, np.maximum(excess, 0.0))
    return np.asarray(found)
