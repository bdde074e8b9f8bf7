"""Plants: the discretised model with its states and sensors, on which every detector runs.

All values are in SI units inside. A batch (seeds, ensemble members, sigma points) is leading axes everywhere.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property, partial
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.analytic import WRONG, Use, non_analytic
from fusion_sfdia.core.arguments import floats, number, require_unique
from fusion_sfdia.core.covariance import diagonal, require_covariance
from fusion_sfdia.core.cyclic import Cyclic, cyclic, near
from fusion_sfdia.core.differentiable import with_jacobian
from fusion_sfdia.core.equation import complex_step_holds, complex_step_jacobian, difference_jacobian
from fusion_sfdia.core.html import as_html
from fusion_sfdia.core.limits import within
from fusion_sfdia.core.plant_checks import require_considered, require_kinds, require_shapes
from fusion_sfdia.core.plant_groups import Numerics, OutputFunction, StepFunction, Structure, Truth
from fusion_sfdia.core.signals import Sensor, Signal
from fusion_sfdia.core.slow_noise import SlowNoise
from fusion_sfdia.core.uncertainty import Uncertainty
from fusion_sfdia.core.units import in_units

Array = NDArray[Any]
LARGE, FEW = 16 * 16, 1 / 8  # entries of a Jacobian, and the share of them that is not 0
FROM_STATES: Any = None  # the values that the signals of the states give


@dataclass(frozen=True)
class Plant:
    """A discretised plant: x(t_start + dt) = step(t_start, x, u, dt) + w, y(t) = output(t, x, u) + v.

    A first plant needs the first six fields:

    name, and the signals of states (n,) and sensors (N,), which never change: a missing reading is NaN. step, output:
    functions of batches, x (..., n) to (..., n) and (..., N). u (..., m) is the input that acts over [t_start,
    t_start + dt]; for the output, the input that acted until t, the time of the readings (s). dt: nominal time between
    readings, s.

    inputs: the signals of u. x0 (n,): initial state. initial_cov: covariance of x0. process_cov: covariance of w over one
    nominal dt; it grows in proportion to dt. Both are a diagonal (n,) or a matrix (n, n). By default the signals of the states
    give them: x0 = nominal, initial_cov = diag(initial_sigma^2), process_cov = diag(process_sigma^2); there is no default
    noise. process_bound (n,): largest |w| over one nominal dt, None where not stated.

    numerics: Jacobians and admissible steps. truth: operation, controllers and high-fidelity model of simulations. structure:
    scalar equations and areas. uncertainty: parameters, errors of inputs and disturbances that the model does not know, see
    `augment`. Raises ValueError for what does not fit together.
    """

    name: str
    states: tuple[Signal, ...]
    sensors: tuple[Sensor, ...]
    step: StepFunction
    output: OutputFunction
    dt: float
    inputs: tuple[Signal, ...] = ()
    x0: Array = FROM_STATES
    initial_cov: Array = FROM_STATES
    process_cov: Array = FROM_STATES
    process_bound: Array | None = None
    numerics: Numerics = field(default_factory=Numerics)
    truth: Truth = field(default_factory=Truth)
    structure: Structure = field(default_factory=Structure)
    uncertainty: Uncertainty = field(default_factory=Uncertainty)

    def __post_init__(self) -> None:
        require_kinds(self)
        for what in ("states", "sensors", "inputs"):
            object.__setattr__(self, what, tuple(getattr(self, what)))
        n = len(self.states)
        if not self.states or not self.sensors:
            raise ValueError(f"plant {self.name!r} has {n} states and {len(self.sensors)} sensors; give at least one of each")
        require_unique(f"plant {self.name!r}", [s.name for s in (*self.states, *self.inputs)])
        require_unique(f"sensors of plant {self.name!r}", [s.name for s in self.sensors])
        if not 0 < number(f"plant {self.name!r}: dt", self.dt) < np.inf:
            raise ValueError(f"plant {self.name!r}: dt is {self.dt} s; it must be positive and finite")
        self._take_from_states()
        for what in ("x0", "initial_cov", "process_cov", "process_bound"):
            if getattr(self, what) is not None:
                object.__setattr__(self, what, floats(f"plant {self.name!r}: {what}", getattr(self, what)))
        if np.shape(self.x0) != (n,) or not np.all(np.isfinite(self.x0)):
            raise ValueError(f"plant {self.name!r}: x0 has shape {np.shape(self.x0)}; expected {n} finite values, one a state")
        for what in ("initial_cov", "process_cov"):
            require_covariance(f"plant {self.name!r}: {what}", getattr(self, what), n)
        bound = self.process_bound
        if bound is not None and (np.shape(bound) not in {(), (n,)} or not np.all(np.asarray(bound) >= 0)):
            raise ValueError(
                f"plant {self.name!r}: process_bound has shape {np.shape(bound)}; expected ({n},) numbers of at least 0"
            )
        require_considered(self)
        require_shapes(self)

    def _repr_html_(self) -> str:
        sizes = f"{len(self.states)} states, {len(self.sensors)} sensors, {len(self.inputs)} inputs, dt {self.dt:g} s"
        rows = [(s.name, s.measures, s.unit, s.noise_sigma) for s in self.sensors]
        return as_html(self.name, sizes, ("sensor", "measures", "unit", "sigma"), rows)

    def _take_from_states(self) -> None:
        """Fill in x0 and the covariances that are not given; ValueError for a state whose signal does not give them."""
        for what, stated in (("x0", "nominal"), ("initial_cov", "initial_sigma"), ("process_cov", "process_sigma")):
            if getattr(self, what) is None:
                values = [getattr(s, stated) for s in self.states]
                if missing := [s.name for s, value in zip(self.states, values, strict=True) if value is None]:
                    raise ValueError(
                        f"plant {self.name!r}: no {stated} of the states {', '.join(missing)}; give "
                        f"Signal(..., {stated}=...) for each state, or {what} of the plant"
                    )
                object.__setattr__(self, what, np.array(values) if what == "x0" else np.square(values))

    @cached_property
    def sensor_names(self) -> tuple[str, ...]:
        return tuple(s.name for s in self.sensors)

    @cached_property
    def sensor_sigma(self) -> Array:
        """Standard deviation of each reading (N,), in the sensors' units."""
        return np.array([s.noise_sigma for s in self.sensors])

    @cached_property
    def sensor_resolution(self) -> Array:
        """The step of the readings of each sensor (N,), 0 where none is stated."""
        return np.array([s.resolution for s in self.sensors])

    @cached_property
    def slow_noise(self) -> tuple[Array, Array]:
        """The slow part of each sensor's noise: its share of the variance (N,), and its correlation after dt (N,).

        Time constants above 1e6 dt count as 1e6 dt: no log is longer, and beyond it rounding counts.
        """
        slow = [s.noise or SlowNoise(0.0, self.dt) for s in self.sensors]
        samples = np.array([min(s.time_constant / self.dt, 1e6) for s in slow])
        return np.array([s.share for s in slow]), np.exp(-1 / samples)

    @cached_property
    def sensor_cov(self) -> Array:
        """R as its diagonal (N,): the errors of the readings are independent of each other."""
        return self.sensor_sigma**2

    @cached_property
    def largest_readings(self) -> Array:
        """The largest magnitude of a reading of each sensor (N,), in its unit: sigma / ((N + n) eps).

        An update sums over N readings and n states; a term of size |y| rounds the sum by up to (N + n) eps |y|. Where that
        exceeds the noise sigma, the information of all other sensors is lost. No instrument comes near: its noise would be
        below the last digits of its reading.
        """
        return self.sensor_sigma / ((len(self.sensors) + len(self.states)) * np.finfo(float).eps)

    @cached_property
    def sensor_scale(self) -> Array:
        """Reading of each sensor over what it measures in SI (N,)."""
        return np.array([s.scale for s in self.sensors])

    @cached_property
    def cyclic_sensors(self) -> Cyclic | None:
        """The sensors whose readings are cyclic: those that state a period, or measure a variable that does."""
        period = {s.name: s.period for s in (*self.states, *self.inputs) if s.period is not None}
        of_measured = [None if s.measures not in period else period[s.measures] * s.scale for s in self.sensors]
        return cyclic([own if s.period is None else s.period for s, own in zip(self.sensors, of_measured, strict=True)])

    @cached_property
    def cyclic_states(self) -> Cyclic | None:
        """The states that are cyclic."""
        return cyclic([s.period for s in self.states])

    def near(self, y: Array, expected: Array) -> Array:
        """Readings (..., N) on the turn of the expected ones (..., N): y - expected is then the wrapped residual."""
        return near(y, expected, self.cyclic_sensors)

    def states_near(self, x: Array, other: Array) -> Array:
        """States (..., n) on the turn of others (..., n)."""
        return near(x, other, self.cyclic_states)

    @cached_property
    def state_scale(self) -> Array:
        """A scale for each state (n,): the larger standard deviation of x0 and of one step's noise; where both are 0, the
        initial_sigma of its signal, or 1.
        """
        variance = np.maximum(diagonal(self.initial_cov), diagonal(self.process_cov))
        return np.where(variance > 0, np.sqrt(np.maximum(variance, 0.0)), [s.initial_sigma or 1.0 for s in self.states])

    @cached_property
    def quantities(self) -> dict[str, Array]:
        """Indices of the sensors of each quantity, in the order of the sensors."""
        groups: dict[str, list[int]] = {}
        for i, sensor in enumerate(self.sensors):
            groups.setdefault(sensor.quantity or sensor.name, []).append(i)
        return {name: np.array(members) for name, members in groups.items()}

    def sensor_index(self, name: str) -> int:
        """Return the position of a sensor; ValueError for an unknown name."""
        if name not in self.sensor_names:
            raise ValueError(f"unknown sensor {name!r} of plant {self.name!r}; known: {', '.join(self.sensor_names)}")
        return self.sensor_names.index(name)

    def input_at(self, t: float) -> Array:
        """Return the plant's usual input at t, (m,); ValueError where `truth.operation` gives another shape."""
        if self.truth.operation is None:
            return np.array([s.nominal for s in self.inputs])
        u = floats(f"the input that operation of plant {self.name!r} gives", self.truth.operation(t))
        if u.shape != (len(self.inputs),):
            raise ValueError(f"operation of plant {self.name!r} gives shape {u.shape}; expected ({len(self.inputs)},)")
        return u

    def check_dt(self, dt: float) -> None:
        """Raise ValueError where the model does not hold for a step of dt seconds."""
        if not (isfinite(dt) and dt > 0):
            raise ValueError(f"a step of {dt} s; times must be finite and increase")
        if self.numerics.fixed_dt and not abs(dt - self.dt) <= 1e-8 + 1e-9 * self.dt:
            raise ValueError(f"a step of {dt} s; plant {self.name!r} holds for {self.dt} s only")
        if dt > self.numerics.max_dt * (1 + 1e-9):
            raise ValueError(
                f"a step of {dt:g} s; the largest admissible step of plant {self.name!r} is {self.numerics.max_dt:.4g} s: "
                "feed NaN readings in between, as diagnose does, or build the plant with more substeps or another max_dt"
            )

    def process_cov_over(self, dt: float) -> Array:
        """Process-noise covariance of a step of dt seconds, (n,) or (n, n)."""
        return self.process_cov if dt == self.dt else self.process_cov * (dt / self.dt)

    def step_jacobian_at(self, t_start: float, x: Array, u: Array, dt: float) -> Array:
        """F = d step / d x, (..., n, n)."""
        if (jacobian := self.jacobians[0]) is not None:
            return self.jacobian_of_shape("step_jacobian", jacobian(t_start, x, u, dt), len(self.states))
        if self._complex_step_holds[0]:
            return complex_step_jacobian(lambda p: self.step(t_start, p, u[..., None, :], dt), x)
        here = x if self.cyclic_states is None else self.step(t_start, x, u, dt)[..., None, :]
        ahead = partial(self.step, t_start)
        return difference_jacobian(lambda p: self.states_near(ahead(p, u[..., None, :], dt), here), x, self.state_scale)

    def output_jacobian_at(self, t: float, x: Array, u: Array) -> Array:
        """H = d output / d x, (..., N, n) or (N, n) where it is the same for the whole batch."""
        if (jacobian := self.jacobians[1]) is not None:
            return self.jacobian_of_shape("output_jacobian", jacobian(t, x, u), len(self.sensors))
        if self._complex_step_holds[1]:
            return complex_step_jacobian(lambda p: self.output(t, p, u[..., None, :]), x)
        here = x if self.cyclic_sensors is None else self.output(t, x, u)[..., None, :]
        return difference_jacobian(lambda p: self.near(self.output(t, p, u[..., None, :]), here), x, self.state_scale)

    @cached_property
    def jacobians(self) -> tuple[StepFunction | None, OutputFunction | None]:
        """The Jacobians of step and output that are stated, or that they have themselves; None for others."""
        given = self.numerics
        return (
            getattr(self.step, "jacobian", None) if given.step_jacobian is None else given.step_jacobian,
            getattr(self.output, "jacobian", None) if given.output_jacobian is None else given.output_jacobian,
        )

    @cached_property
    def with_jacobians(self) -> tuple[Any, Any]:
        """The functions that give step and output together with these Jacobians, of the same arguments; None without."""
        step, output = self.jacobians
        return with_jacobian(self.step, step), with_jacobian(self.output, output)

    @cached_property
    def _complex_step_holds(self) -> tuple[bool, bool]:
        """Whether it agrees with differences for step and for output, at points about x0, where, for example, a valve acts,
        and neither depends on abs, sign or the like, perhaps elsewhere.
        """
        given = self.jacobians
        x, u, scale = self._points, self.input_at(0.0), self.state_scale
        functions = (lambda p: self.step(0.0, p, u, self.dt)), (lambda p: self.output(0.0, p, u))
        step, output = (
            jacobian is not None or (not any(use.effect == WRONG for use in used) and complex_step_holds(function, x, scale))
            for jacobian, used, function in zip(given, self.non_analytic, functions, strict=True)
        )
        return step, output

    @cached_property
    def linear(self) -> tuple[bool, bool]:
        """Whether step and output are linear: their stated Jacobians are the same for all states and explain their changes, to
        1e-9 of what these add up, at points about x0; and, of the step, no state has a limit.
        """
        x, x0, u = self._points, self.x0, self.input_at(0.0)

        def explained(J: Any, function: Any, rows: int) -> bool:
            if np.shape(J) != (rows, x0.size):
                return False
            rounding = 1e-9 * ((np.abs(x) + np.abs(x0)) @ np.abs(J).T)
            return bool(np.all(np.abs(function(x) - function(x0) - (x - x0) @ J.T) <= rounding))

        step, output = self.jacobians
        by_x = step and step(0.0, x, u, self.dt), output and output(0.0, x, u)
        return (
            not np.any(np.isfinite(self.state_limits)) and explained(by_x[0], lambda p: self.step(0.0, p, u, self.dt), x0.size),
            explained(by_x[1], lambda p: self.output(0.0, p, u), len(self.sensors)),
        )

    @cached_property
    def _points(self) -> Array:
        """Four states about x0, not on a limit of the model."""
        spread = self.state_scale * np.random.default_rng(0).standard_normal((4, len(self.states)))
        return np.asarray(self.x0 + (self.guard(self.x0 + spread)[0] - self.x0) / 2)

    @cached_property
    def non_analytic(self) -> tuple[tuple[Use, ...], tuple[Use, ...]]:
        """The functions on which step and output depend and that are not analytic, see `core.analytic`."""
        u = self.input_at(0.0)
        return (
            non_analytic(lambda p: self.step(0.0, p, u, self.dt), self._points),
            non_analytic(lambda p: self.output(0.0, p, u), self._points),
        )

    @cached_property
    def sparse(self) -> tuple[bool, bool]:
        """Whether the Jacobians of step and output are so large, and at x0 have so few entries that are not 0, that products
        with these alone take less time.
        """
        x, u = self.x0, self.input_at(0.0)
        with np.errstate(all="ignore"):
            found = self.step_jacobian_at(0.0, x, u, self.dt), self.output_jacobian_at(0.0, x, u)
        step, output = (a.size >= LARGE and bool(np.count_nonzero(a) <= FEW * a.size) for a in found)
        return step, output

    @cached_property
    def same_readings(self) -> Array | None:
        """A number for each sensor (N,), the same for those with the same row of H at x0; None where all rows differ."""
        rows, number = np.unique(self.output_jacobian_at(0.0, self.x0, self.input_at(0.0)), axis=0, return_inverse=True)
        return number.ravel() if len(rows) < len(self.sensors) else None

    def jacobian_of_shape(self, what: str, jacobian: Array, rows: int) -> Array:
        """The Jacobian itself; ValueError unless it is (..., rows, n)."""
        if np.shape(jacobian)[-2:] != (rows, len(self.states)):
            raise ValueError(
                f"{what} of plant {self.name!r} gives shape {np.shape(jacobian)}; expected (..., {rows}, {len(self.states)})"
            )
        return jacobian

    @cached_property
    def considered(self) -> Array | None:
        """Positions (k,) of the states that a filter does not update but whose uncertainty counts; None without any."""
        found = [i for i, s in enumerate(self.states) if s.name in self.uncertainty.considered]
        return np.array(found) if found else None

    @cached_property
    def state_limits(self) -> tuple[Array, Array]:
        """Lower and upper limits of the states, (n,) each; none of a cyclic state whose limits are a period apart."""
        whole = np.array([s.period is not None and s.high - s.low >= s.period * (1 - 1e-9) for s in self.states])
        low, high = np.array([s.low for s in self.states]), np.array([s.high for s in self.states])
        return np.where(whole, -np.inf, low), np.where(whole, np.inf, high)

    def guard(self, x: Array) -> tuple[Array, Array]:
        """Return x (..., n) moved into the limits of the states, and whether any state was moved (...)."""
        return within(np.asarray(x), *self.state_limits)

    def in_units(self, units: Mapping[str, tuple[str, float]]) -> Plant:
        """Return the same plant with some sensors read in another unit: {sensor: (unit, readings per present unit)}."""
        return in_units(self, units)
