"""A plant whose states include what it does not know: z = (x, theta, delta, xi).

    x+ = f(x, u + delta; theta) + V xi + w,    theta+ = theta + omega,    delta+ = delta,    xi+ = phi xi + eta
    y  = h(x, u + delta; theta) + W xi + v

with parameters theta, constant errors delta of inputs and disturbances xi. It is a plant like any other.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from fusion_sfdia.common.covariance import dense, on_diagonal
from fusion_sfdia.derivatives.differentiable import Differentiable, with_jacobian
from fusion_sfdia.plant.plant import Finer, Numerics, OutputFunction, Plant, StepFunction, Structure
from fusion_sfdia.plant.signals import Signal
from fusion_sfdia.plant.uncertainty import HOUR, Disturbance, Parameter, Uncertainty, error_of

Array = NDArray[Any]

FARTHEST = 20.0  # standard deviations of a parameter from its nominal value: its limits where it states none


def augment(plant: Plant) -> Plant:
    """Return the plant with its parameters, errors of inputs and disturbances as states; itself where it states none.

    The states of the plant come first, then parameters, errors of inputs (in the order of the inputs) and disturbances. A
    frozen one has no variance; the initial_sigma of its signal is its standard deviation.

    Parameters
    ----------
    plant : Plant
        Which states its `uncertainty`.

    Returns
    -------
    Plant
        With these further states.

    Raises
    ------
    ValueError
        For an input or a direction that does not fit the plant.

    Notes
    -----
    A filter estimates what multiplies a state, such as a droop, without bias only where the process noise that the plant states
    acts: it takes the error of its own estimate of the state for a change of the state otherwise (Ljung 1979).

    Examples
    --------
    >>> from fusion_sfdia.plants import augment, two_tanks
    >>> [state.name for state in augment(two_tanks()).states]
    ['level_1', 'level_2', 'outlet_1', 'outlet_2', 'leak', 'error of inflow']
    """
    known = plant.uncertainty
    if not known.stated:
        return plant
    _require_fit(plant, known)
    unknown: list[Parameter | Disturbance] = [*known.parameters, *known.disturbances]
    considered = {*known.considered, *(v.name for v in unknown if v.treatment == "considered")}
    erring = [s for s in plant.inputs if s.name in known.inputs]
    larger = replace(plant, uncertainty=Uncertainty(), structure=Structure())
    if known.parameters or erring:
        errors = [Parameter(error_of(s.name), s.unit, sd=known.inputs[s.name]) for s in erring]
        added = [*(_added(p, plant.dt, FARTHEST) for p in known.parameters), *(_added(e, plant.dt, np.inf) for e in errors)]
        larger = _enlarged(larger, _Unknown(plant), added)
        if known.at_rest:
            larger = replace(larger, initial_cov=_initial(plant, larger))
    if known.disturbances:
        larger = _enlarged(larger, _Disturbed(larger, known.disturbances), [_shaped(d, plant.dt) for d in known.disturbances])
    return replace(larger, uncertainty=Uncertainty(considered=tuple(s.name for s in larger.states if s.name in considered)))


def _added(p: Parameter, dt: float, farthest: float) -> tuple[Signal, float, float]:
    """The state of a parameter: its signal, at most that many sd away, initial variance and variance of its change in dt."""
    low, high = max(p.low, p.nominal - farthest * p.sd), min(p.high, p.nominal + farthest * p.sd)
    signal = Signal(p.name, p.unit, p.nominal, low, high, initial_sigma=p.sd)
    return (signal, 0.0, 0.0) if p.treatment == "frozen" else (signal, p.sd**2, p.rate**2 * dt / HOUR)


def _shaped(d: Disturbance, dt: float) -> tuple[Signal, float, float]:
    """The state of a disturbance: xi+ = exp(-dt / tau) xi + eta keeps its variance."""
    signal = Signal(d.name, "1", initial_sigma=d.sd)
    return (
        (signal, 0.0, 0.0) if d.treatment == "frozen" else (signal, d.sd**2, -(d.sd**2) * np.expm1(-2 * dt / d.time_constant))
    )


@dataclass(frozen=True, eq=False)
class _Unknown:
    """The functions of a plant with z = (x, theta, delta), of n, p and e states."""

    plant: Plant

    @cached_property
    def counts(self) -> tuple[int, int]:
        """States and parameters of the plant."""
        return len(self.plant.states), len(self.plant.uncertainty.parameters)

    @cached_property
    def erring(self) -> Array:
        """Positions (e,) of the inputs with an error."""
        return np.array([i for i, s in enumerate(self.plant.inputs) if s.name in self.plant.uncertainty.inputs], dtype=int)

    @cached_property
    def selection(self) -> Array:
        """The inputs with an error as rows of a selection (e, m)."""
        return np.eye(len(self.plant.inputs))[self.erring]

    @cached_property
    def columns(self) -> Array:
        """Where the derivatives with respect to (x, theta, delta) are among those with respect to (x, u, theta)."""
        n, p = self.counts
        return np.concatenate([np.arange(n), n + len(self.plant.inputs) + np.arange(p), n + self.erring])

    @property
    def numerics(self) -> Numerics:
        """With Jacobians where those with respect to x, u and theta are stated."""
        known = self.plant.uncertainty
        return replace(
            self.plant.numerics,
            step_jacobian=None if known.step_jacobian is None else getattr(self.step, "jacobian", self.step_jacobian),
            output_jacobian=None if known.output_jacobian is None else getattr(self.output, "jacobian", self.output_jacobian),
        )

    def split(self, z: Array, u: Array) -> tuple[Array, Array, Array]:
        """The state x (..., n), the input that acts (..., m) and theta (..., p)."""
        n, p = self.counts
        return z[..., :n], u + z[..., n + p :] @ self.selection if self.erring.size else u, z[..., n : n + p]

    @cached_property
    def step(self) -> StepFunction:
        """The step, with its Jacobian by the same call where that is stated at other values of the parameters."""
        known = self.plant.uncertainty
        both = with_jacobian(known.step, known.step_jacobian)
        return self._step if both is None else Differentiable(self._step, partial(self._step_with, both))

    @cached_property
    def output(self) -> OutputFunction:
        """The same of the output."""
        known = self.plant.uncertainty
        both = with_jacobian(known.output, known.output_jacobian)
        return self._output if both is None else Differentiable(self._output, partial(self._output_with, both))

    def _step(self, t_start: float, z: Array, u: Array, dt: float) -> Array:
        x, acting, theta = self.split(z, u)
        at = self.plant.uncertainty.step
        ahead = self.plant.step(t_start, x, acting, dt) if at is None else at(t_start, x, acting, dt, theta)
        return joined(ahead, z[..., x.shape[-1] :])

    def _output(self, t: float, z: Array, u: Array) -> Array:
        x, acting, theta = self.split(z, u)
        at = self.plant.uncertainty.output
        return self.plant.output(t, x, acting) if at is None else at(t, x, acting, theta)

    def step_jacobian(self, t_start: float, z: Array, u: Array, dt: float) -> Array:
        x, acting, theta = self.split(z, u)
        at = self.plant.uncertainty.step_jacobian
        assert at is not None
        return self._tangent(at(t_start, x, acting, dt, theta), z)

    def _step_with(
        self, both: Callable[..., tuple[Array, Array]], t_start: float, z: Array, u: Array, dt: float
    ) -> tuple[Array, Array]:
        x, acting, theta = self.split(z, u)
        ahead, by_all = both(t_start, x, acting, dt, theta)
        return joined(ahead, z[..., x.shape[-1] :]), self._tangent(by_all, z)

    def _tangent(self, by_all: Array, z: Array) -> Array:
        """The Jacobian of the step (..., n + p + e, n + p + e) from the derivatives of x with respect to (x, u, theta)."""
        n = by_all.shape[-2]
        found = np.zeros((*by_all.shape[:-2], z.shape[-1], z.shape[-1]))
        of_inputs = n + len(self.plant.inputs)
        found[..., :n, :n], found[..., :n, n : n + self.counts[1]] = by_all[..., :n], by_all[..., of_inputs:]
        found[..., :n, n + self.counts[1] :] = by_all[..., n + self.erring]
        on_diagonal(found)[..., n:] = 1.0
        return found

    def output_jacobian(self, t: float, z: Array, u: Array) -> Array:
        at = self.plant.uncertainty.output_jacobian
        assert at is not None
        x, acting, theta = self.split(z, u)
        return at(t, x, acting, theta)[..., self.columns]

    def _output_with(self, both: Callable[..., tuple[Array, Array]], t: float, z: Array, u: Array) -> tuple[Array, Array]:
        x, acting, theta = self.split(z, u)
        y, by_all = both(t, x, acting, theta)
        return y, by_all[..., self.columns]


@dataclass(frozen=True, eq=False)
class _Disturbed:
    """The functions of a plant with z = (x, xi), of n and d states, of which a disturbance acts on the first."""

    plant: Plant
    disturbances: tuple[Disturbance, ...]

    @cached_property
    def directions(self) -> tuple[Array, Array, Array]:
        """V (n, d), W (N, d) and the time constants (d,)."""
        v = np.zeros((len(self.plant.states), len(self.disturbances)))
        for j, d in enumerate(self.disturbances):
            v[: d.state.size, j] = d.state
        return (
            v,
            np.stack([d.reading for d in self.disturbances], axis=-1),
            np.array([d.time_constant for d in self.disturbances]),
        )

    @property
    def numerics(self) -> Numerics:
        return replace(self.plant.numerics, step_jacobian=self.step_jacobian, output_jacobian=self.output_jacobian)

    def step(self, t_start: float, z: Array, u: Array, dt: float) -> Array:
        v, _, tau = self.directions
        x, xi = z[..., : len(v)], z[..., len(v) :]
        ahead = self.plant.step(t_start, x, u, dt) + xi @ v.T * (dt / self.plant.dt)
        return joined(ahead, xi * np.exp(-dt / tau))

    def output(self, t: float, z: Array, u: Array) -> Array:
        v, w, _ = self.directions
        return np.asarray(self.plant.output(t, z[..., : len(v)], u) + z[..., len(v) :] @ w.T)

    def step_jacobian(self, t_start: float, z: Array, u: Array, dt: float) -> Array:
        v, _, tau = self.directions
        n = len(v)
        by_x = self.plant.step_jacobian_at(t_start, z[..., :n], u, dt)
        found = np.zeros((*by_x.shape[:-2], z.shape[-1], z.shape[-1]))
        found[..., :n, :n] = by_x
        found[..., :n, n:] = v * (dt / self.plant.dt)
        np.einsum("...ii->...i", found)[..., n:] = np.exp(-dt / tau)
        return found

    def output_jacobian(self, t: float, z: Array, u: Array) -> Array:
        v, w, _ = self.directions
        by_x = self.plant.output_jacobian_at(t, z[..., : len(v)], u)
        return joined(by_x, w)


def joined(a: Array, b: Array) -> Array:
    """Return a (..., i) and b (..., j) side by side, their batches broadcast."""
    if a.shape[:-1] == b.shape[:-1]:
        return np.concatenate([a, b], axis=-1)
    batch = np.broadcast_shapes(a.shape[:-1], b.shape[:-1])
    return np.concatenate([np.broadcast_to(v, (*batch, v.shape[-1])) for v in (a, b)], axis=-1)


def _enlarged(plant: Plant, model: _Unknown | _Disturbed, added: Sequence[tuple[Signal, float, float]]) -> Plant:
    """The plant with these states behind its own: signal, initial variance and variance of the change in dt of each."""
    signals, start, walk = zip(*added, strict=True)
    nominal = np.array([s.nominal for s in signals])
    bound, finer = plant.process_bound, plant.truth.finer
    return replace(
        plant,
        states=(*plant.states, *signals),
        step=model.step,
        output=model.output,
        x0=np.concatenate([plant.x0, nominal]),
        initial_cov=_with_variances(plant.initial_cov, np.array(start)),
        process_cov=_with_variances(plant.process_cov, np.array(walk)),
        process_bound=None if bound is None else np.concatenate([np.broadcast_to(bound, plant.x0.shape), np.zeros(len(added))]),
        numerics=model.numerics,
        truth=replace(plant.truth, finer=None if finer is None else partial(_finer, finer, nominal)),
    )


def _with_variances(cov: Array, variances: Array) -> Array:
    return np.concatenate([cov, variances]) if cov.ndim == 1 else block_diag(cov, np.diag(variances))


def _initial(plant: Plant, larger: Plant) -> Array:
    """Covariance of the initial state (x, theta, delta) where x0 is the steady state x = f(x; theta, delta).

    To first order x0 changes by (I - F)^-1 F_theta, with the derivatives of the step at x0 under the usual input.
    """
    n = len(plant.states)
    F = larger.step_jacobian_at(0.0, larger.x0, larger.input_at(0.0), larger.dt)
    change = np.linalg.solve(np.eye(n) - F[:n, :n], F[:n, n:])
    follows = np.eye(len(F))
    follows[:n, n:] = change
    return np.asarray(follows @ dense(larger.initial_cov) @ follows.T)


def _finer(finer: Finer, nominal: Array) -> tuple[Plant, Callable[[Array], Array]]:
    model, to_states = finer()
    return model, partial(_with, to_states, nominal)


def _with(to_states: Callable[[Array], Array], nominal: Array, x: Array) -> Array:
    return joined(to_states(x), nominal)


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


def fixed(plant: Plant) -> Plant:
    """The plant at its nominal parameters, augmented by its disturbances alone."""
    return augment(replace(plant, uncertainty=Uncertainty(disturbances=plant.uncertainty.disturbances)))
