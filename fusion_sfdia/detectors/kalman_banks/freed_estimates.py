"""What an accepted explanation changes in the estimate: its prediction is moved, and its covariance grows."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.detectors.kalman_banks.competition import Accepted, Evidence
from fusion_sfdia.detectors.kalman_banks.leave_one_out import value_at
from fusion_sfdia.detectors.kalman_banks.likelihood_window import Best, Weighed, absorbed
from fusion_sfdia.detectors.kalman_banks.standing import DOUBT
from fusion_sfdia.filters.estimators import GaussianState, Prior

Array = NDArray[Any]


class Tested(NamedTuple):
    """Both windows with the present readings, and their best onsets."""

    recent: Weighed
    slow: Weighed
    best_recent: Best
    best_slow: Best


def moved(prior: Prior, tested: Tested, evidence: Evidence, by_windows: Accepted, freed: Array) -> Prior:
    """The prior without what a sensor (where `freed`) or an accepted difference of the process has done to the estimate.

    Its covariance grows by that of the size; that of a difference of the process by a part of its square, too.
    """
    x, p = prior.core
    count = evidence.sensor.shape[-1]
    far_process = np.zeros(evidence.process.shape, bool)
    far_process[..., : evidence.slow_process.shape[-1]] = evidence.slow_process
    for index, where, far, first, doubt in (
        (by_windows.sensor, freed, evidence.slow_sensor, 0, 0.0),
        (by_windows.process, by_windows.is_process, far_process, count, DOUBT),
    ):
        if not np.any(where):
            continue
        slow = value_at(far, index)
        column = index + first
        near = absorbed(tested.recent, tested.best_recent, column)
        size, information = (value_at(v, column) for v in (tested.best_recent.size, tested.best_recent.information))
        if np.any(slow):
            column = np.minimum(column, tested.best_slow.size.shape[-1] - 1)
            near = np.where(slow[..., None], absorbed(tested.slow, tested.best_slow, column), near)
            size = np.where(slow, value_at(tested.best_slow.size, column), size)
            information = np.where(slow, value_at(tested.best_slow.information, column), information)
        change = np.where(where[..., None], near, 0.0)
        x = x - change * size[..., None]
        p = p + change[..., :, None] * (change * (1.0 / information + doubt * size**2)[..., None])[..., None, :]
    return prior._replace(core=GaussianState(x, p))


def with_alternatives(prior: Prior, tested: Tested, weight: Array) -> Prior:
    """The prior with the covariance of alternatives to the accepted process hypothesis, of that weight (..., P)."""
    if not np.any(weight):
        return prior
    best, eta = tested.best_recent, tested.recent.eta
    count = best.slot.shape[-1] - weight.shape[-1]
    slot = best.slot[..., None, None, count:]
    effect = (
        np.take_along_axis(eta[..., count:], slot, axis=-3)[..., 0, :, :]
        * (best.size[..., count:] * np.sqrt(weight))[..., None, :]
    )
    x, p = prior.core
    return prior._replace(core=GaussianState(x, p + effect @ np.swapaxes(effect, -1, -2)))


def with_prior_unknowns(prior: Prior, sd: Array) -> Prior:
    """The prior with the augmented states as uncertain as at first, sd (p,), and independent of the plant's own states."""
    x, p = prior.core
    n, wider = x.shape[-1] - sd.size, np.array(p)
    frozen = np.einsum("...ii->...i", p)[..., n:] == 0
    wider[..., n:, :] = 0.0
    wider[..., :, n:] = 0.0
    np.einsum("...ii->...i", wider)[..., n:] = np.where(frozen, 0.0, sd**2)
    return prior._replace(core=GaussianState(x, wider))
