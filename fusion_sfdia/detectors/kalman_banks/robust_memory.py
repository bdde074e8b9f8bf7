"""What `RobustBank` carries from sample to sample, and how well its accepted explanation fits."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.detectors.exclusion import Exclusion, none_excluded
from fusion_sfdia.detectors.kalman_banks.bank_kernels import contiguous, mean_of_others
from fusion_sfdia.detectors.kalman_banks.fresh_look import Look, no_look
from fusion_sfdia.detectors.kalman_banks.hypotheses import Hypotheses
from fusion_sfdia.detectors.kalman_banks.leave_one_out import LeaveOneOut
from fusion_sfdia.detectors.kalman_banks.likelihood_window import OnsetGrid, Window, empty, restarted
from fusion_sfdia.detectors.kalman_banks.parameter_walk import Walk, no_walk
from fusion_sfdia.detectors.kalman_banks.quiet import Pairs, no_pairs
from fusion_sfdia.detectors.kalman_banks.reading_noise import ReadingNoise, nothing_shown
from fusion_sfdia.detectors.kalman_banks.since_start import RuledOut, nothing_ruled_out
from fusion_sfdia.detectors.kalman_banks.standing import Standing, nothing
from fusion_sfdia.detectors.kalman_banks.window_step import LastUpdate, no_update
from fusion_sfdia.filters.estimators import GaussianState

Array = NDArray[Any]

UNEXPLAINED = 1.5  # normalised innovation squared, beyond that of the worst sensor, that an explanation may leave
FADING = 1 / 16  # share of the present sample in its running mean


class RobustMemory(NamedTuple):
    """Estimate of the augmented state, sensors left out and for how many samples (..., N), windows, accepted hypotheses.

    led (..., N): samples in a row in which a sensor explained the readings better than the process, with the sign of its fault.
    usual (..., N): readings in a row that were as expected. proposed (..., P): the process hypothesis that the windows accept.
    since_far (...): samples since any reading was far off.
    nis (...): running mean of the normalised innovation squared without the worst sensor. steady: whether gains are at rest
    (nothing where they cannot be).
    """

    estimate: GaussianState
    exclusion: Exclusion
    out_for: Array
    led: Array
    usual: Array
    proposed: Array
    since_far: Array
    recent: Window
    slow: Window
    update: LastUpdate
    standing: Standing
    pairs: Pairs
    nis: Array
    noise: ReadingNoise
    walk: Walk
    look: Look
    ruled_out: RuledOut
    steady: Any  # Steady, or ()

    def restarted(self, estimate: GaussianState, where: Array) -> RobustMemory:
        """The memory with another estimate, and windows that restart in the runs `where` (...) holds."""
        recent, slow, update = (restarted(carried, where) for carried in (self.recent, self.slow, self.update))
        return self._replace(estimate=estimate, recent=recent, slow=slow, update=update)


def empty_memory(
    of: Hypotheses, estimate: GaussianState, batch: tuple[int, ...], grids: tuple[OnsetGrid, OnsetGrid], steady: Any
) -> RobustMemory:
    """The memory before any reading, of windows on these grids, the recent one first."""
    count, n, p, states = len(of.plant.sensors), len(of.plant.states), of.added, len(of.model.states)
    near, far = grids
    return RobustMemory(
        estimate,
        none_excluded(batch, count),
        np.zeros((*batch, count)),
        np.zeros((*batch, count)),
        np.zeros((*batch, count)),
        np.zeros((*batch, len(of.process)), bool),
        np.full(batch, np.inf),
        empty(batch, near, states, count + p + n),
        empty(batch, far, states, count + p),
        no_update(batch, states, count),
        nothing(batch, p, n),
        no_pairs(batch, count),
        np.ones(batch),
        nothing_shown(batch, count),
        no_walk(batch, p),
        no_look(estimate, batch, count, p),
        nothing_ruled_out(batch, count),
        steady,
    )


def faded(nis: Array, found: LeaveOneOut) -> Array:
    """The running mean nis (...) with a sample, without the sensor that explains most of it: another fault may begin there."""
    return np.asarray(nis + FADING * (mean_of_others(contiguous(found.chi_square), contiguous(found.used)) - nis))


def leaves_unexplained(nis: Array) -> Array:
    """Whether readings are farther from the prediction than an accepted explanation may leave them (...)."""
    return np.asarray(nis > UNEXPLAINED)
