"""A linear plant with its noise from a healthy recording: canonical variates, then expectation maximisation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import number, shown, whole
from fusion_sfdia.learning.identification.choice import ModelChoice
from fusion_sfdia.learning.identification.healthy_runs import scaled
from fusion_sfdia.learning.identification.linear_gaussian import filtered, fitted, plant_of, smoothed
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Signal

Array = NDArray[Any]

SAMPLES_PER_STATE = 10  # least length of a recording
WARM_UP = 10  # samples after the start of a recording that no likelihood is judged on


def identify(
    name: str,
    sensors: Sequence[Signal],
    healthy: Log | list[Log],
    *,
    inputs: Sequence[Signal] = (),
    order: int | Sequence[int] = (2, 4, 8, 12, 16),
    folds: int = 4,
    ridge: float = 5.0,
    iterations: int = 60,
) -> Plant:
    """Return a linear plant x+ = A x + B u + c + w, y = C x + d + v of one healthy recording, w and v independent.

    Parameters
    ----------
    name : str
        Of the plant.
    sensors : sequence of Signal (N,)
        Name and unit of each column of y.
    healthy : Log or list of Log
        y (K, N), u (K, m). Times are equally spaced; a missing reading is NaN. u acts until the reading of its row; where a
        controller computes it from that very reading, give the row before, or the model predicts the reading's noise from it. A
        list of logs, which may have gaps, is identified by `ModelChoice.of`, with its candidates: order, ridge and iterations
        are of one recording. A sensor that never moves is then not in the plant.
    inputs : sequence of Signal (m,), default ()
        Name and unit of each column of u; nominal inputs are their means.
    order : int or sequence of int, default (2, 4, 8, 12, 16)
        Number of states; of several, that with the largest likelihood of `folds` stretches of the recording, each left out of
        its identification in turn. The readings left out also scale Q and R, so that their normalised innovation squared is 1:
        residuals of the recording itself are too small.
    folds : int, default 4
        Stretches.
    ridge : float, default 5
        Samples' worth of a prior of zero of A and B; with inputs that feed readings back, a model without it is often unstable.
    iterations : int, default 60
        Of the expectation maximisation.

    Returns
    -------
    Plant
        Its states are values without noise of some readings, now or some steps ahead, in the readings' units: rows of the
        observability matrix by a QR decomposition with pivots. initial_cov is the covariance of the states over the recording.

    Raises
    ------
    ValueError
        For recordings that do not fit the names, are too short, have gaps, or have a signal that never moves.

    Notes
    -----
    Subspace identification gives innovations e with x+ = A x + K e, y = C x + e, whose noises K e and e are correlated. Here
    its A, B, C only start the expectation maximisation of a model whose Q is full and whose R is diagonal, so that a Kalman
    filter on the plant is the one whose likelihood was maximised. Missing readings need no replacement.

    Examples
    --------
    >>> from fusion_sfdia import Log, Signal, simulate
    >>> from fusion_sfdia.learning import identify
    >>> from fusion_sfdia.plants import two_tanks
    >>> rig = two_tanks(swing=0.2)
    >>> recording = simulate(rig, 200, seeds=[4])
    >>> log = Log(recording.t, recording.y[:, 0], recording.u)
    >>> plant = identify("by data", rig.sensors, log, inputs=[Signal("inflow", "m3/s")], order=2, iterations=5)
    >>> len(plant.states), plant.sensor_names
    (2, ('l1', 'l2', 'q12', 'q2'))
    """
    if isinstance(healthy, list):
        return ModelChoice.of(name, sensors, healthy, inputs=inputs, folds=folds).plant
    readings = scaled(sensors, inputs, healthy)
    y, u = readings.y, readings.u
    orders = [order] if isinstance(order, int) else list(order)
    if not orders:
        raise ValueError("order is empty; expected a number of states, or several to choose from")
    for n in orders:
        if not whole("order", n, least=1) * SAMPLES_PER_STATE <= len(y):
            raise ValueError(f"{len(y)} samples for {n} states; expected at least {SAMPLES_PER_STATE} a state: record more")
    whole("iterations", iterations, least=1)
    whole("folds", folds, least=2)
    if not 0 <= number("ridge", ridge) < np.inf:
        raise ValueError(f"ridge is {shown(ridge)}; expected a number of samples of at least 0")
    judged = {n: _left_out(y, u, n, folds, ridge, iterations) for n in orders}
    best = max(judged, key=lambda n: judged[n][0])
    model, scale = fitted(y, u, best, ridge, iterations), judged[best][1]
    states = smoothed(model, y, u)
    start = states.x[1:].T @ states.x[1:] / len(y) + states.P[1:].mean(axis=0)
    return plant_of(name, model._replace(Q=scale * model.Q, r=scale * model.r, P0=start), readings, sensors, inputs)


def _left_out(y: Array, u: Array, order: int, folds: int, ridge: float, iterations: int) -> tuple[float, float]:
    """The mean log-likelihood of samples that were left out, and their normalised innovation squared per reading.

    The readings of a stretch are missing where its model is identified.
    """
    judged = np.arange(len(y)) >= WARM_UP
    stretches = np.array_split(np.flatnonzero(judged), folds)
    without = np.stack([y] * folds)
    for fold, stretch in zip(without, stretches, strict=True):
        fold[stretch] = np.nan
    found = filtered(fitted(without, u, order, ridge, iterations), y, u)
    log_likelihood, chi_square = (
        sum(values[fold, stretch].sum() for fold, stretch in enumerate(stretches))
        for values in (found.log_likelihood, found.chi_square)
    )
    return float(log_likelihood / judged.sum()), float(chi_square / np.isfinite(y[judged]).sum())
