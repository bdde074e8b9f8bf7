"""A plant whose states include what it does not know: z = (x, theta, delta, xi).

    x+ = f(x, u + delta; theta) + V xi + w,    theta+ = theta + omega,    delta+ = delta,    xi+ = phi xi + eta
    y  = h(x, u + delta; theta) + W xi + v

with parameters theta, constant errors delta of inputs and disturbances xi. It is a plant like any other.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from fusion_sfdia.core.covariance import dense
from fusion_sfdia.core.equation import complex_step_holds, complex_step_jacobian, difference_jacobian
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.core.plant_groups import Structure
from fusion_sfdia.core.signals import Signal
from fusion_sfdia.core.uncertainty import HOUR, Uncertainty

Array = NDArray[Any]

FARTHEST = 6.0  # standard deviations from the nominal value: limits of the added states, beyond which secants do not hold


def error_of(name: str) -> str:
    """The name of the added state for the error of an input."""
    return f"error of {name}"


def augment(plant: Plant) -> Plant:
    """Return the plant with its parameters, errors of inputs and disturbances as states; itself where it states none.

    The states of the plant come first, then parameters, errors of inputs and disturbances, in the order of its uncertainty.
    A frozen one has no variance. ValueError for an input or a direction that does not fit the plant.
    """
    known = plant.uncertainty
    if not known.stated:
        return plant
    model = _Augmented(plant)
    _require_fit(plant, known)
    frozen = [p.treatment == "frozen" for p in known.parameters]
    start = [0.0 if off else p.sd**2 for p, off in zip(known.parameters, frozen, strict=True)]
    walk = [0.0 if off else p.rate**2 * plant.dt / HOUR for p, off in zip(known.parameters, frozen, strict=True)]
    added = [
        Signal(p.name, p.unit, p.nominal, p.nominal - FARTHEST * p.sd, p.nominal + FARTHEST * p.sd) for p in known.parameters
    ]
    for signal in plant.inputs:
        if (sd := known.inputs.get(signal.name)) is not None:
            added.append(Signal(error_of(signal.name), signal.unit, 0.0, -FARTHEST * sd, FARTHEST * sd))
            start.append(sd**2)
            walk.append(0.0)
    for d in known.disturbances:
        added.append(Signal(d.name, "1", 0.0, -FARTHEST * d.sd, FARTHEST * d.sd))
        start.append(0.0 if d.treatment == "frozen" else d.sd**2)
        walk.append(0.0 if d.treatment == "frozen" else d.sd**2 * (1.0 - np.exp(-2 * plant.dt / d.time_constant)))
    considered = tuple(p.name for p in (*known.parameters, *known.disturbances) if p.treatment == "considered")
    bound = plant.process_bound
    jacobians = replace(plant.numerics, step_jacobian=model.step_jacobian, output_jacobian=model.output_jacobian)
    finer = plant.truth.finer
    return replace(
        plant,
        states=(*plant.states, *added),
        step=model.step,
        output=model.output,
        x0=np.concatenate([plant.x0, [s.nominal for s in added]]),
        initial_cov=_initial(plant, np.array(start)),
        process_cov=_joined(plant.process_cov, np.array(walk)),
        process_bound=None if bound is None else np.concatenate([np.broadcast_to(bound, plant.x0.shape), np.zeros(len(added))]),
        numerics=jacobians,
        truth=replace(
            plant.truth, finer=None if finer is None else partial(_finer, finer, np.array([s.nominal for s in added]))
        ),
        structure=Structure(),
        uncertainty=Uncertainty(considered=considered),
    )


@dataclass(frozen=True, eq=False)
class _Augmented:
    """The functions of an augmented plant."""

    plant: Plant

    @cached_property
    def counts(self) -> tuple[int, int, int]:
        """States, parameters, errors of inputs."""
        known = self.plant.uncertainty
        return len(self.plant.states), len(known.parameters), len(known.inputs)

    @cached_property
    def erring(self) -> Array:
        """Which input each error belongs to, as rows of a selection (errors, m)."""
        names = [s.name for s in self.plant.inputs]
        rows = [i for i, name in enumerate(names) if name in self.plant.uncertainty.inputs]
        return np.eye(len(names))[rows]

    @cached_property
    def directions(self) -> tuple[Array, Array, Array]:
        """V (n, d), W (N, d) and the time constants (d,) of the disturbances."""
        known = self.plant.uncertainty.disturbances
        n, count = len(self.plant.states), len(self.plant.sensors)
        v = np.stack([d.state for d in known], axis=-1) if known else np.zeros((n, 0))
        w = np.stack([d.reading for d in known], axis=-1) if known else np.zeros((count, 0))
        return v, w, np.array([d.time_constant for d in known])

    def split(self, z: Array, u: Array) -> tuple[Array, Array, Array, Array]:
        """The state x (..., n), the input that acts (..., m), theta (..., p) and xi (..., d)."""
        n, p, m = self.counts
        delta = z[..., n + p : n + p + m]
        acting = u if m == 0 else u + delta @ self.erring
        return z[..., :n], acting, z[..., n : n + p], z[..., n + p + m :]

    def step(self, t_start: float, z: Array, u: Array, dt: float) -> Array:
        x, acting, theta, xi = self.split(z, u)
        known = self.plant.uncertainty
        ahead = known.step(t_start, x, acting, dt, theta) if known.step else self.plant.step(t_start, x, acting, dt)
        v, _, tau = self.directions
        n = x.shape[-1]
        later = z[..., n:]
        if xi.shape[-1]:
            ahead = ahead + xi @ v.T * (dt / self.plant.dt)
            later = np.concatenate([z[..., n : z.shape[-1] - tau.size], xi * np.exp(-dt / tau)], axis=-1)
        batch = np.broadcast_shapes(ahead.shape[:-1], later.shape[:-1])
        return np.concatenate([np.broadcast_to(a, (*batch, a.shape[-1])) for a in (ahead, later)], axis=-1)

    def output(self, t: float, z: Array, u: Array) -> Array:
        x, acting, theta, xi = self.split(z, u)
        known = self.plant.uncertainty
        y = known.output(t, x, acting, theta) if known.output else self.plant.output(t, x, acting)
        return y + xi @ self.directions[1].T if xi.shape[-1] else y

    def step_jacobian(self, t_start: float, z: Array, u: Array, dt: float) -> Array:
        """Return d step / d z; that with respect to x is taken at the nominal parameters."""
        x, acting, theta, _ = self.split(z, u)
        n, p, m = self.counts
        v, _, tau = self.directions
        found = np.zeros((*z.shape[:-1], z.shape[-1], z.shape[-1]))
        found[..., :n, :n] = self.plant.step_jacobian_at(t_start, x, acting, dt)
        if p:
            known = self.plant.uncertainty
            if known.step_sensitivity is not None:
                found[..., :n, n : n + p] = known.step_sensitivity(t_start, x, acting, dt, theta)
            else:
                found[..., :n, n : n + p] = self._by_theta(
                    lambda c: known.step(t_start, x[..., None, :], acting[..., None, :], dt, c),
                    theta,
                    0,  # type: ignore[misc]
                )
        if m:
            by_input = self._by_input(lambda w: self.plant.step(t_start, _over(x, w), w, dt), acting, 0)
            found[..., :n, n + p : n + p + m] = by_input @ self.erring.T
        found[..., :n, n + p + m :] = v * (dt / self.plant.dt)
        decay = np.concatenate([np.ones(p + m), np.exp(-dt / tau)])
        np.einsum("...ii->...i", found)[..., n:] = decay
        return found

    def output_jacobian(self, t: float, z: Array, u: Array) -> Array:
        """Return d output / d z; that with respect to x is taken at the nominal parameters."""
        x, acting, theta, _ = self.split(z, u)
        n, p, m = self.counts
        found = np.zeros((*z.shape[:-1], len(self.plant.sensors), z.shape[-1]))
        found[..., :n] = self.plant.output_jacobian_at(t, x, acting)
        if p:
            known = self.plant.uncertainty
            if known.output_sensitivity is not None:
                found[..., n : n + p] = known.output_sensitivity(t, x, acting, theta)
            else:
                found[..., n : n + p] = self._by_theta(
                    lambda c: known.output(t, x[..., None, :], acting[..., None, :], c),
                    theta,
                    1,  # type: ignore[misc]
                )
        if m:
            by_input = self._by_input(lambda w: self.plant.output(t, _over(x, w), w), acting, 1)
            found[..., n + p : n + p + m] = by_input @ self.erring.T
        found[..., n + p + m :] = self.directions[1]
        return found

    def _by_theta(self, function: Any, theta: Array, which: int) -> Array:
        if self._theta_complex[which]:
            return complex_step_jacobian(function, theta)
        return difference_jacobian(function, theta, np.array([p.sd for p in self.plant.uncertainty.parameters]))

    def _by_input(self, function: Any, u: Array, which: int) -> Array:
        if self._input_complex[which]:
            return complex_step_jacobian(function, u)
        return difference_jacobian(function, u, self._input_scale)

    @cached_property
    def _input_scale(self) -> Array:
        known = self.plant.uncertainty.inputs
        return np.array([known.get(s.name, max(abs(s.nominal), 1.0)) for s in self.plant.inputs])

    @cached_property
    def _theta_complex(self) -> tuple[bool, bool]:
        """Whether the complex step with respect to theta holds for step and output, at points about the nominal values."""
        known, plant = self.plant.uncertainty, self.plant
        sd = np.array([p.sd for p in known.parameters])
        points = np.array([p.nominal for p in known.parameters]) + sd * _points(sd.size)
        x, u = np.broadcast_to(plant.x0, (len(points), plant.x0.size)), plant.input_at(0.0)
        assert known.step is not None and known.output is not None
        return (
            complex_step_holds(lambda c: known.step(0.0, x, u, plant.dt, c), points, sd),  # type: ignore[misc]
            complex_step_holds(lambda c: known.output(0.0, x, u, c), points, sd),  # type: ignore[misc]
        )

    @cached_property
    def _input_complex(self) -> tuple[bool, bool]:
        plant = self.plant
        points = plant.input_at(0.0) + self._input_scale * 0.1 * _points(len(plant.inputs))
        x = np.broadcast_to(plant.x0, (len(points), plant.x0.size))
        return (
            complex_step_holds(lambda u: plant.step(0.0, x, u, plant.dt), points, self._input_scale),
            complex_step_holds(lambda u: plant.output(0.0, x, u), points, self._input_scale),
        )


def _over(x: Array, perturbed: Array) -> Array:
    return np.broadcast_to(x[..., None, :], (*perturbed.shape[:-1], x.shape[-1]))


def _points(size: int) -> Array:
    return np.random.default_rng(0).uniform(-0.5, 0.5, (4, size))


def _joined(cov: Array, variances: Array) -> Array:
    return np.concatenate([cov, variances]) if cov.ndim == 1 else block_diag(cov, np.diag(variances))


def _initial(plant: Plant, variances: Array) -> Array:
    """Covariance of the initial augmented state: x0 follows the parameters where their sensitivity is stated."""
    sensitivity = plant.uncertainty.initial_sensitivity
    if sensitivity is None:
        return _joined(plant.initial_cov, variances)
    n, p = sensitivity.shape
    found = block_diag(dense(plant.initial_cov), np.diag(variances))
    by_theta = np.concatenate([sensitivity * variances[:p], np.diag(variances)[:, :p]])
    found[:, n : n + p] = by_theta
    found[n : n + p, :] = by_theta.T
    found[:n, :n] += (sensitivity * variances[:p]) @ sensitivity.T
    return found


def _finer(finer: Any, nominal: Array) -> tuple[Plant, Any]:
    model, to_states = finer()
    return model, partial(_with, to_states, nominal)


def _with(to_states: Any, nominal: Array, x: Array) -> Array:
    found = to_states(x)
    return np.concatenate([found, np.broadcast_to(nominal, (*found.shape[:-1], nominal.size))], axis=-1)


def _require_fit(plant: Plant, known: Uncertainty) -> None:
    inputs = [s.name for s in plant.inputs]
    if unknown := [name for name in known.inputs if name not in inputs]:
        raise ValueError(f"plant {plant.name!r} has no input {', '.join(unknown)}; its inputs: {', '.join(inputs) or 'none'}")
    for d in known.disturbances:
        if d.state.shape != plant.x0.shape or d.reading.shape != (len(plant.sensors),):
            raise ValueError(
                f"disturbance {d.name!r} has directions of shapes {d.state.shape} and {d.reading.shape}; expected "
                f"{plant.x0.shape} for the states and {(len(plant.sensors),)} for the readings of plant {plant.name!r}"
            )
