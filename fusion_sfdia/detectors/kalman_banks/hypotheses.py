"""Competing explanations of one set of innovations: faults of sensors, and differences of the plant from its model.

On the augmented state z = (x, theta, delta, xi) of `augment`, with transition matrix F, see `likelihood_window` for C and D:

    bias of sensor i                D = e_i                                  ramp of sensor i           D = age e_i
    jump of augmented state j       C = F e_j at the onset                   drift of it                C = F e_j in each step
    error of state equation j       C = phi_1(F) e_j / phi_1(F)_jj in each step

An error of a state equation is a rate that acts within dt: phi_1(F) = int_0^1 F^s ds. Errors at the end of a step, C = e_j,
would be the same as biases where a state is read and is forgotten within dt. Biases, jumps and errors of equations are sought
in the recent past, ramps and drifts in the far past, at onsets `SLOW_STEP` samples apart.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.covariance import diagonal
from fusion_sfdia.detectors.detector import ProcessHypothesis
from fusion_sfdia.detectors.kalman_banks.likelihood_window import Effect
from fusion_sfdia.detectors.kalman_banks.window_kernels import SPARSE
from fusion_sfdia.plant.augment import augment
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.uncertainty import equation_of

Array = NDArray[Any]

SLOW_STEP = 4  # samples between the onsets of ramps and drifts
SENSOR_SIZE = 20.0  # standard deviation of a bias, and of a ramp by now, before any reading, over the noise of the sensor
PARAMETER_SIZE = 10.0  # of a jump or drift, over the prior standard deviation: a fault is larger than what is usual
EQUATION_SIZE = 10.0  # of an error of an equation, over the standard deviation of its process noise
UNNAMED = 6.0  # evidence that an error of an equation needs beyond that of a cause with a name: odds of 1 to 20
NODES = 16  # of the quadrature of phi_1


def phi_1(F: Array) -> Array:
    """Return int_0^1 F^s ds (..., n, n), by the inverse of int_0^1 (I + s (F - I))^-1 ds = log(F) (F - I)^-1.

    The integral by Gauss-Legendre quadrature, a Pade approximant of the logarithm (Higham 2008, sec. 11.4); it exists for an
    eigenvalue of 0, too.
    """
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    eye = np.eye(F.shape[-1])
    total = sum(w / 2 * np.linalg.inv(eye + (s + 1) / 2 * (F - eye)) for s, w in zip(nodes, weights, strict=True))
    return np.asarray(np.linalg.inv(total))


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """What may differ from the model of a plant with N sensors, n states, and p augmented ones.

    The recent past has the columns (bias N, jump p, equation n), the far past (ramp N, drift p).
    usual (..., m): input at which the effects of errors of equations are taken, where the members of a batch differ by it; None
    for the plant's usual input.
    """

    plant: Plant
    usual: Array | None = None

    @cached_property
    def model(self) -> Plant:
        """The augmented plant."""
        return augment(self.plant)

    @cached_property
    def process(self) -> tuple[ProcessHypothesis, ...]:
        """The hypotheses about the plant: augmented states, then equations of states."""
        known = self.plant.uncertainty
        kinds = ("parameter",) * len(known.parameters) + ("input",) * len(known.inputs)
        kinds += ("disturbance",) * len(known.disturbances)
        added = self.model.states[len(self.plant.states) :]
        return (
            *(ProcessHypothesis(s.name, s.unit, kind, s.nominal) for s, kind in zip(added, kinds, strict=True)),
            *(ProcessHypothesis(equation_of(s.name), s.unit, "state", np.nan) for s in self.plant.states),
        )

    @cached_property
    def added(self) -> int:
        """The number p of augmented states."""
        return len(self.model.states) - len(self.plant.states)

    @cached_property
    def leading(self) -> int:
        """The number n of the plant's own states where few of them depend on each augmented one, else all: see `weigh`."""
        model, n = self.model, len(self.plant.states)
        u = model.input_at(0.0) if self.usual is None else self.usual
        by_added = model.step_jacobian_at(0.0, model.x0, u, model.dt)[..., :n, n:]
        return n if np.count_nonzero(by_added) <= SPARSE * by_added.size else len(model.states)

    @cached_property
    def sd(self) -> Array:
        """Prior standard deviation of the augmented states (p,)."""
        return np.array([s.initial_sigma for s in self.model.states[len(self.plant.states) :]])

    @cached_property
    def changes(self) -> Array:
        """Standard deviation from which the size of a change of the augmented states is judged (p,)."""
        known = self.plant.uncertainty.changes
        names = [s.name for s in self.model.states[len(self.plant.states) :]]
        return np.array([known.get(name, sd) for name, sd in zip(names, self.sd, strict=True)])

    @cached_property
    def equation_sd(self) -> Array:
        """Standard deviation of the process noise of each state in one nominal dt (n,), a tenth of its scale where it is 0."""
        variance = np.broadcast_to(diagonal(self.plant.process_cov), (len(self.plant.states),))
        return np.where(variance > 0, np.sqrt(variance), 0.1 * self.plant.state_scale)

    @cached_property
    def handicap(self) -> Array:
        """Evidence that each process hypothesis needs beyond that of others (P,)."""
        return np.repeat([0.0, UNNAMED], [self.added, len(self.plant.states)])

    @cached_property
    def rates(self) -> Array:
        """The change of the states (..., n, n) by a rate that acts within dt, columns over their own state; at x0."""
        plant = self.plant
        u = plant.input_at(0.0) if self.usual is None else self.usual
        phi = phi_1(plant.step_jacobian_at(0.0, plant.x0, u, plant.dt))
        own = np.diagonal(phi, axis1=-2, axis2=-1)[..., None, :]
        return np.asarray(phi / np.where(np.abs(own) > np.sqrt(np.finfo(float).eps), own, 1.0))

    @cached_property
    def recent_sizes(self) -> Array:
        """Standard deviations of the sizes in the recent past before any reading (N + p + n,)."""
        sensors = SENSOR_SIZE * self.plant.sensor_sigma
        return np.concatenate([sensors, PARAMETER_SIZE * self.changes, EQUATION_SIZE * self.equation_sd])

    def slow_sizes(self, age: Array) -> Array:
        """The same in the far past, per sample, for onsets of that age (..., L): (..., L, N + p)."""
        by_now = self.recent_sizes[: len(self.plant.sensors) + self.added]
        return np.asarray(by_now / np.maximum(age, 1.0)[..., None])

    def recent(self, tangent: Array, slots: int) -> Effect:
        """Effects of the hypotheses of the recent past; tangent F (..., z, z) of the step just taken."""
        n, p = len(self.plant.states), self.added
        if not p:
            return Effect(np.ones(slots), self.rates)
        change = np.zeros((*tangent.shape[:-1], p + n))
        change[..., :p] = tangent[..., n:]
        change[..., :n, p:] = self.rates
        return Effect(np.ones(slots), change, p)

    def slow(self, tangent: Array, age: Array) -> Effect:
        """Effects of the hypotheses of the far past, of onsets of that age (..., L)."""
        return Effect(age, tangent[..., len(self.plant.states) :], ramp=True)
