"""Detector: a filter decoupled from errors of the plant's inputs, whose leave-one-out innovations isolate faulty sensors.

The input may have any error d, different in each step: x = step(x_before, u + d) + w. With G = d x / d u, F = d y / d u, and
the joint Gaussian of state and readings (P, S, C) for d = 0, the minimum-variance estimate that is unbiased for every d
(Kitanidis 1987; Gillijns and De Moor 2007, with the input estimate d = (F' S^-1 F)^-1 F' S^-1 (y - E y)) is the limit, for a
variance V of d without bound, of

    P + G V G',    S + F V F',    C + G V F'.

Here V is diagonal, and so large that an input changes the readings by DECOUPLED standard deviations of their noise in a step.
The share 1 / DECOUPLED^2 of the input error remains, about as much as rounding. An input that changes no reading within a step
cannot be decoupled, nor an input on which the present readings have less than the share SEEN of the information of all
readings. Such inputs count as known.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.alike import repeated, shared_again, single
from fusion_sfdia.common.errors import NotApplicableError
from fusion_sfdia.derivatives.equation import COMPLEX_STEP, complex_step_holds, difference_jacobian
from fusion_sfdia.detectors.batch_detector import TimeStep
from fusion_sfdia.detectors.kalman_banks.sequential_bank import SequentialBank
from fusion_sfdia.filters.estimators import Prior
from fusion_sfdia.filters.gaussian import Joint
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

DECOUPLED = 1e4  # the square, 1e8, is midway between 1 and 1 / eps: the remaining part of d is about as large as rounding
SEEN = 0.01  # below it an input would be estimated ten times less accurately than from all readings


@dataclass(frozen=True)
class UnknownInputFilter(SequentialBank):
    """Leave-one-out tests that are independent of errors of the inputs.

    Raises
    ------
    NotApplicableError
        For a plant without an input that moves a reading within a step from x0.

    Notes
    -----
    The settings are those of SequentialBank.

    Examples
    --------
    >>> from fusion_sfdia import run, simulate
    >>> from fusion_sfdia.detectors import UnknownInputFilter
    >>> from fusion_sfdia.plants import two_tanks
    >>> bank = UnknownInputFilter(two_tanks())
    >>> recording = simulate(bank.plant, 40, seeds=[1])
    >>> decisions = run(bank, bank.init(), recording.t, recording.y[:, 0], 2 * recording.u)[1]  # the inflow is misread
    >>> bool(decisions.isolated.any())
    False
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        plant = self.plant
        start = 0.0, plant.dt, plant.x0[None], plant.input_at(0.0)[None]
        if not plant.inputs or not np.any(self._input_jacobians(*start)[1]):
            raise NotApplicableError(
                f"plant {plant.name!r} has no input that moves a reading within a step; nothing can be decoupled: use a "
                "detector that assumes known inputs"
            )

    def _joint(self, now: TimeStep, before: Array, prior: Prior, u: Array, usable: Array) -> Joint:
        joint = super()._joint(now, before, prior, u, usable)
        moved, effect = self._input_jacobians(now.t_start, now.t, before, u)
        by_reading = effect**2 / self.plant.sensor_cov[:, None]
        information = np.sum(by_reading, axis=-2)
        seen = (information > 0) & (np.sum(by_reading * usable[..., None], axis=-2) > SEEN * information)
        deviation = np.where(seen, DECOUPLED / np.sqrt(np.where(seen, information, 1.0)), 0.0)
        g, f = (single(shared_again(a * deviation[..., None, :], joint.S)) for a in (moved, effect))
        g_t, f_t = np.swapaxes(g, -1, -2), np.swapaxes(f, -1, -2)
        P, S, C = (single(a) for a in (joint.P, joint.S, joint.C))
        more = {"P": P + g @ g_t, "S": S + f @ f_t, "C": C + g @ f_t}
        return joint._replace(**{k: repeated(a, joint.x) for k, a in more.items()}, repeated=None)

    def _input_jacobians(self, t_start: float, t: float, x: Array, u: Array) -> tuple[Array, Array]:
        return input_jacobians(self.plant, t_start, t, x, u, self._complex_step)

    @cached_property
    def _complex_step(self) -> bool:
        return complex_step_in_inputs(self.plant)


def input_jacobians(plant: Plant, t_start: float, t: float, x: Array, u: Array, exact: bool) -> tuple[Array, Array]:
    """Return G (..., n, m) of a step over [t_start, t] from states x (..., n) under inputs u (..., m), and F (..., N, m).

    Both are 0 where the model is not finite. exact: by the complex step; otherwise by central differences.
    """
    count = u.shape[-1]
    start = np.broadcast_to(plant.guard(x)[0][..., None, :], (*x.shape[:-1], count, x.shape[-1]))

    def stepped(inputs: Array) -> tuple[Array, Array]:
        after = plant.step(t_start, start, inputs, t - t_start)
        return after, plant.output(t, after, inputs)

    if exact:
        found = stepped(u[..., None, :] + 1j * COMPLEX_STEP * np.eye(count))
        g, f = (np.swapaxes(a.imag, -1, -2) / COMPLEX_STEP for a in found)
    else:
        found = stepped(u[..., None, :])
        both = difference_jacobian(lambda p: np.concatenate(stepped(p), axis=-1), u, input_scale(plant))
        g, f = both[..., : x.shape[-1], :], both[..., x.shape[-1] :, :]
    sound = np.all([np.all(np.isfinite(a), axis=(-2, -1)) for a in (*found, g, f)], axis=0)[..., None, None]
    return np.where(sound, g, 0.0), np.where(sound, f, 0.0)


def input_scale(plant: Plant) -> Array:
    """Return the magnitude of each input (m,): its nominal value or, if that is 0, its unit."""
    return np.array([abs(s.nominal) or 1.0 for s in plant.inputs])


def complex_step_in_inputs(plant: Plant) -> bool:
    """Return whether the complex step differentiates step and output by the inputs: not for abs, sign, interp and the like.

    It is checked for steps from x0, at inputs within a tenth of `input_scale` around the input at t = 0.
    """
    scale = 0.1 * input_scale(plant)
    u = plant.input_at(0.0) + scale * np.random.default_rng(0).uniform(-1.0, 1.0, (4, scale.size))
    x = np.broadcast_to(plant.x0, (4, plant.x0.size))

    def stepped(inputs: Array) -> Array:
        after = plant.step(0.0, x, inputs, plant.dt)
        return np.concatenate([after, plant.output(plant.dt, after, inputs)], axis=-1)

    return complex_step_holds(stepped, u, scale)
