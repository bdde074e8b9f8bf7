"""An area of the power network as a plant by itself; ties and constants are inputs, so that a batch may have any areas."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.models.power_network import equations
from fusion_sfdia.models.power_network.equations import STATES
from fusion_sfdia.models.power_network.model import NOISE_VARIANCE, NetworkModel
from fusion_sfdia.models.power_network.parameters import DYNAMIC
from fusion_sfdia.models.power_network.unknown import DROOP, INERTIA, LOAD, REFERENCE, SPREAD
from fusion_sfdia.plant.linear import constant, picked
from fusion_sfdia.plant.local_areas import LocalAreas
from fusion_sfdia.plant.plant import Numerics, Plant, Truth
from fusion_sfdia.plant.signals import Sensor, Signal
from fusion_sfdia.plant.uncertainty import Parameter, Uncertainty, by_states_alone

Array = NDArray[Any]

UNIT = {"theta": "rad", "omega": "rad/s", "p_m": "1", "p_v": "1"}


def local_areas(model: NetworkModel) -> LocalAreas:
    """The areas of a network, each as a plant by itself; ValueError for a model that is not discretised area by area."""
    if model.discretisation != "area-by-area":
        raise ValueError(f"the network is discretised {model.discretisation!r}; areas by themselves need 'area-by-area'")
    usual = np.median(model.constants, axis=0), float(np.median(model.parameters.slope))
    build = partial(area_plant, constants=usual[0], slope=usual[1], dt=model.dt, process_cov=model.process_cov)
    return LocalAreas(model.network, model.side_slope, model.constants, build)


def area_plant(degree: int, *, constants: Array, slope: float, dt: float, process_cov: Array) -> Plant:
    """Return an area with `degree` neighbours, in the layout of `LocalAreas`.

    constants (5,), slope: nominal values of the inputs that state them. dt (s). process_cov (4,): variances in dt. What is not
    known of the area is that of `unknown`; slopes, inertia and droop relative to their inputs.
    """
    at, sides = _Area(degree, dt), range(degree)
    sigma = np.sqrt(NOISE_VARIANCE)
    readers = [f"{{neighbour[{k}]}}" for k in sides]
    readout = np.concatenate([np.eye(4), np.tile(np.eye(1, 4), (degree, 1))])
    relative = [
        *((f"slope_{{area}}-{reader}", "slope") for reader in readers),
        ("inertia_{area}", "inertia"),
        ("droop_{area}", "droop"),
    ]
    return Plant(
        name=f"area of degree {degree}",
        states=tuple(Signal(f"{s}_{{area}}", UNIT[s]) for s in STATES),
        inputs=(
            Signal("reference_{area}"),
            Signal("load_{area}"),
            Signal("error of power from outside"),
            *(Signal(f"theta_{reader}", "rad") for reader in readers),
            *(Signal(f"slope {k}", nominal=slope) for k in sides),
            *(Signal(what, nominal=float(v)) for what, v in zip(DYNAMIC, constants, strict=True)),
        ),
        sensors=(
            *(Sensor(f"{s}_{{area}}", f"{s}_{{area}}", UNIT[s], sigma=float(v)) for s, v in zip(STATES, sigma, strict=True)),
            *(Sensor(f"theta_{{area}}@{reader}", "theta_{area}", "rad", sigma=float(sigma[0])) for reader in readers),
        ),
        step=at.usual_step,
        output=partial(picked, np.concatenate([np.arange(4), np.zeros(degree, int)])),
        dt=dt,
        x0=np.zeros(4),
        initial_cov=np.array(NOISE_VARIANCE),
        process_cov=process_cov,
        numerics=Numerics(at.usual_step_jacobian, partial(constant, readout), fixed_dt=True),
        truth=Truth(disturbed=True),
        uncertainty=Uncertainty(
            tuple(
                Parameter(name, "1", 1.0, SPREAD[kind][0], SPREAD[kind][1], source=SPREAD[kind][2], low=np.finfo(float).tiny)
                for name, kind in relative
            ),
            at.step,
            None,
            at.step_jacobian,
            partial(_readout, readout),
            inputs={"reference_{area}": REFERENCE, "load_{area}": LOAD},
        ),
    )


def _readout(readout: Array, t: float, x: Array, u: Array, theta: Array) -> Array:
    return by_states_alone(readout, u, theta)


@dataclass(frozen=True, eq=False)
class _Area:
    """The functions of an area with d neighbours at theta (..., d + 2): slopes, inertia and droop over those of the inputs."""

    degree: int
    dt: float

    def angles(self, u: Array) -> Array:
        """The neighbours' angles (..., d)."""
        return u[..., 3 : 3 + self.degree]

    def split(self, u: Array, theta: Array) -> tuple[Array, Array]:
        """Slopes (..., d) and constants (..., 5)."""
        d = self.degree
        side = u[..., 3 + d : 3 + 2 * d] * theta[..., :d]
        constants = np.empty((*side.shape[:-1], 5))
        constants[...] = u[..., 3 + 2 * d :]
        constants[..., INERTIA] *= theta[..., d]
        constants[..., DROOP] *= theta[..., d + 1]
        return side, constants

    def known(self, x: Array, u: Array, side: Array) -> Array:
        """[x, P_ref, sum_j P_ij theta_j - P_L] (..., 6), on which the rows of the area act."""
        v = np.empty((*np.broadcast_shapes(x.shape[:-1], side.shape[:-1]), 6), np.result_type(x, u, float))
        v[..., :4], v[..., 4] = x, u[..., 0]
        v[..., 5] = np.sum(side * self.angles(u), axis=-1) - u[..., 1]
        return v

    def step(self, t_start: float, x: Array, u: Array, dt: float, theta: Array) -> Array:
        side, constants = self.split(u, theta)
        rows = equations.rows_of(np.sum(side, axis=-1), constants, self.dt)[..., 0, :, :]
        return np.asarray((rows @ self.known(x, u, side)[..., None])[..., 0])

    def step_jacobian(self, t_start: float, x: Array, u: Array, dt: float, theta: Array) -> Array:
        """Columns: 4 states, 8 + 2 d inputs, d + 2 parameters."""
        d = self.degree
        side, constants = self.split(u, theta)
        stiffness = np.sum(side, axis=-1)
        v = self.known(x, u, side)
        held = equations.rows_of(stiffness, constants, self.dt, range(6))
        rows, slopes = held[..., 0, :, :], held[..., 1:, :, :]
        by_stiffness, *by_constants = np.moveaxis((slopes @ v[..., None, :, None])[..., 0], -2, 0)
        by_side = by_stiffness[..., None, :] + rows[..., None, :, 5] * self.angles(u)[..., None]
        found = np.empty((*v.shape[:-1], 4, 14 + 3 * d))
        found[..., :5] = rows[..., :5]
        found[..., 5], found[..., 6] = -rows[..., 5], 0.0
        found[..., 7 : 7 + d] = rows[..., 5, None] * side[..., None, :]
        found[..., 7 + d : 7 + 2 * d] = np.swapaxes(by_side * theta[..., :d, None], -1, -2)
        found[..., 7 + 2 * d : 12 + 2 * d] = np.stack(by_constants, axis=-1)
        found[..., 7 + 2 * d + INERTIA] *= theta[..., d, None]
        found[..., 7 + 2 * d + DROOP] *= theta[..., d + 1, None]
        found[..., 12 + 2 * d : 12 + 3 * d] = np.swapaxes(by_side * u[..., 3 + d : 3 + 2 * d, None], -1, -2)
        found[..., 12 + 3 * d] = by_constants[INERTIA] * u[..., 3 + 2 * d + INERTIA, None]
        found[..., 13 + 3 * d] = by_constants[DROOP] * u[..., 3 + 2 * d + DROOP, None]
        return found

    @property
    def usual(self) -> Array:
        return np.ones(self.degree + 2)

    def usual_step(self, t_start: float, x: Array, u: Array, dt: float) -> Array:
        return self.step(t_start, x, u, dt, self.usual)

    def usual_step_jacobian(self, t_start: float, x: Array, u: Array, dt: float) -> Array:
        side, constants = self.split(u, self.usual)
        return equations.rows_of(np.sum(side, axis=-1), constants, self.dt)[..., 0, :, :4]
