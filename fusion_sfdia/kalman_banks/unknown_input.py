"""Detector: a filter decoupled from errors of the plant's inputs, whose leave-one-out innovations name faulty sensors.

The input may err by any d, anew in each step: x = step(x_before, u + d) + w. With G = d x / d u, F = d y / d u, and the joint
Gaussian of state and readings (P, S, C) for d = 0, the minimum-variance estimate that no d can bias (Kitanidis 1987; Gillijns
and De Moor 2007, with the input estimate d = (F' S^-1 F)^-1 F' S^-1 (y - E y)) is the limit, for a variance V of d without
bound, of

    P + G V G',    S + F V F',    C + G V F'.

V is diagonal here, so large that an input would move the readings by DECOUPLED standard deviations of their noise in a step: of
its error 1 / DECOUPLED^2 remains, about as much as rounding. An input that moves no reading within a step cannot be decoupled,
nor one whose effect the present readings show with less than the share SEEN of the information of all: it counts as known then.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.batch_detector import Moment
from fusion_sfdia.core.detector import NotApplicableError
from fusion_sfdia.core.equation import COMPLEX_STEP
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.filters.estimators import Prior
from fusion_sfdia.filters.gaussian import Joint
from fusion_sfdia.kalman_banks.sequential_bank import SequentialBank

Array = NDArray[Any]

DECOUPLED = 1e4  # the square, 1e8, lies midway between 1 and 1 / eps: what remains of d and what rounding does are alike
SEEN = 0.01  # an input that fewer readings show would have to be estimated ten times less accurately than by all


@dataclass(frozen=True)
class UnknownInputFilter(SequentialBank):
    """Leave-one-out tests on what no error of an input can move, see SequentialBank; one sample unless it has a rule.

    NotApplicableError for a plant without an input that moves a reading within a step from x0.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        plant = self.plant
        _, effect = input_jacobians(plant, 0.0, plant.dt, plant.x0[None], plant.input_at(0.0)[None])
        if not np.any(effect):
            raise NotApplicableError(
                f"plant {plant.name!r} has no input that moves a reading within a step; nothing can be decoupled: use a "
                "detector that takes its inputs as known"
            )

    def _joint(self, now: Moment, before: Array, prior: Prior, u: Array, usable: Array) -> Joint:
        joint = super()._joint(now, before, prior, u, usable)
        moved, effect = input_jacobians(self.plant, now.last, now.t, before, u)
        shown = effect**2 / self.plant.sensor_cov[:, None]
        information = np.sum(shown, axis=-2)
        seen = (information > 0) & (np.sum(shown * usable[..., None], axis=-2) > SEEN * information)
        deviation = np.where(seen, DECOUPLED / np.sqrt(np.where(seen, information, 1.0)), 0.0)
        g, f = moved * deviation[..., None, :], effect * deviation[..., None, :]
        g_t, f_t = np.swapaxes(g, -1, -2), np.swapaxes(f, -1, -2)
        return joint._replace(P=joint.P + g @ g_t, S=joint.S + f @ f_t, C=joint.C + g @ f_t)


def input_jacobians(plant: Plant, last: float, t: float, x: Array, u: Array) -> tuple[Array, Array]:
    """G (..., n, m) of a step over [last, t] from states x (..., n) under inputs u (..., m), F (..., N, m) of its readings; 0
    where the model has no number.
    """
    count = u.shape[-1]
    start = np.broadcast_to(plant.guard(x)[0][..., None, :], (*x.shape[:-1], count, x.shape[-1]))
    perturbed = u[..., None, :] + 1j * COMPLEX_STEP * np.eye(count)
    after = plant.step(last, start, perturbed, t - last)
    effect = plant.output(t, after, perturbed)
    sound = np.all(np.isfinite(effect), axis=(-2, -1)) & np.all(np.isfinite(after), axis=(-2, -1))
    g, f = (np.where(sound[..., None, None], np.swapaxes(a.imag, -1, -2) / COMPLEX_STEP, 0.0) for a in (after, effect))
    return g, f
