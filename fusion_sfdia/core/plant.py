"""Plants: the discretised model, with its states and sensors, on which every detector runs.

Everything is SI inside. A batch (seeds, ensemble members, sigma points) is leading axes everywhere.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.areas import Areas
from fusion_sfdia.core.arguments import floats, number, require_unique, shown
from fusion_sfdia.core.equation import complex_step_holds, complex_step_jacobian, difference_jacobian
from fusion_sfdia.core.modules import Modules
from fusion_sfdia.core.physics import Block
from fusion_sfdia.core.signals import Sensor, Signal

Array = NDArray[Any]
StepFunction = Callable[[float, Array, Array, float], Array]
OutputFunction = Callable[[float, Array, Array], Array]
Feedback = Callable[[float, Array, Array], Array]
Finer = Callable[[], "tuple[Plant, Callable[[Array], Array]]"]


@dataclass(frozen=True)
class Plant:
    """A discretised plant: x(t + dt) = step(t, x, u, dt) + w, y(t) = output(t, x, u) + v.

    u is the input that acts over [t, t + dt] and, for the output, the one that acted until t. A covariance is given as
    its diagonal (n,) or as a matrix (n, n): `initial_cov` of x0, `process_cov` of w over one nominal dt (it grows in
    proportion to dt). Sensors are fixed for life: a missing reading is NaN, never another set of sensors.

    step_jacobian(t, x, u, dt) and output_jacobian(t, x, u) are optional; the complex step gives them otherwise, and central
    differences (to some 1e-10) where it does not hold because of abs, sign, interp or the like: both are compared once, at
    points about x0. At a kink itself, |x| at 0, differences give the mean of both slopes.
    operation(t) is the input that a simulation applies when it is given none; feedback(t, y, u) what controllers make of it at
    t, from the readings y (..., N) of that time: the input (..., m) that acts from t on. None in open loop.
    finer(): a truer twin with the same sensors and inputs (a finer grid, say) and the map from its states to these, from
    which simulations take their readings unless told otherwise; None where there is none.
    fixed_dt: whether the model holds for its nominal dt only. disturbed: whether what happens is disturbed by the process
    noise, too, and healthy recordings to learn from should be; otherwise it stands for what the model neglects.
    modules: its scalar equations as monitoring modules, in SI; None where it does not say them.
    areas: its linear areas, each with a diagnoser of its own, in SI; None where one diagnoser reads everything.
    sensor_scale: what a sensor shows over what it measures in SI (N,); `in_units` sets it.
    """

    name: str
    states: tuple[Signal, ...]
    sensors: tuple[Sensor, ...]
    step: StepFunction
    output: OutputFunction
    dt: float
    x0: Array
    initial_cov: Array
    process_cov: Array
    inputs: tuple[Signal, ...] = ()
    operation: Callable[[float], Array] | None = None
    feedback: Feedback | None = None
    step_jacobian: StepFunction | None = None
    output_jacobian: OutputFunction | None = None
    process_bound: Array | None = None
    blocks: tuple[Block, ...] = ()
    finer: Finer | None = None
    fixed_dt: bool = False
    disturbed: bool = False
    max_dt: float = np.inf
    modules: Modules | None = None
    areas: Areas | None = None
    sensor_scale: Array | float = 1.0

    def __post_init__(self) -> None:
        for what, kind in (("states", Signal), ("inputs", Signal), ("sensors", Sensor)):
            members = getattr(self, what)
            if not isinstance(members, tuple | list) or not all(isinstance(m, kind) for m in members):
                raise ValueError(
                    f"plant {self.name!r}: {what} is {shown(members)}; expected a tuple of {kind.__name__} objects"
                )
            object.__setattr__(self, what, tuple(members))
        n = len(self.states)
        if not self.states or not self.sensors:
            raise ValueError(f"plant {self.name!r} has {n} states and {len(self.sensors)} sensors; give at least one of each")
        require_unique(f"plant {self.name!r}", [s.name for s in (*self.states, *self.inputs)])
        require_unique(f"sensors of plant {self.name!r}", [s.name for s in self.sensors])
        for what in ("step", "output"):
            if not callable(getattr(self, what)):
                raise ValueError(f"plant {self.name!r}: {what} is {shown(getattr(self, what))}; expected a function")
        if not 0 < number(f"plant {self.name!r}: dt", self.dt) < np.inf:
            raise ValueError(f"plant {self.name!r}: dt is {self.dt} s; it must be positive and finite")
        if not number(f"plant {self.name!r}: max_dt", self.max_dt) > 0:
            raise ValueError(f"plant {self.name!r}: max_dt is {self.max_dt} s; it must be positive, inf for no limit")
        for what in ("x0", "initial_cov", "process_cov", "process_bound"):
            if what != "process_bound" or self.process_bound is not None:
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
        self._require_shapes()

    def _require_shapes(self) -> None:
        """Raise ValueError unless step and output take a batch of states; where x0 has no step, it is for the runs to say."""
        n, count = len(self.states), len(self.sensors)
        x, u = np.broadcast_to(self.x0, (2, 1, n)).copy(), self.input_at(0.0)[None]
        for what, expected, arguments in (("step", (2, 1, n), (x, u, self.dt)), ("output", (2, 1, count), (x, u))):
            try:
                with np.errstate(all="ignore"):
                    found = np.shape(getattr(self, what)(0.0, *arguments))
            except ArithmeticError:
                continue
            except (IndexError, TypeError, ValueError) as error:
                raise ValueError(
                    f"{what} of plant {self.name!r} fails for states {x.shape} and inputs {u.shape}: {error}; write it for "
                    "batches, which are leading axes: x[..., 0]"
                ) from error
            if found != expected:
                raise ValueError(
                    f"{what} of plant {self.name!r} gives shape {found} for states {x.shape}; expected {expected}: one number "
                    f"for each {'state' if what == 'step' else 'sensor'}, with a batch as leading axes (x[..., 0])"
                )

    @cached_property
    def sensor_names(self) -> tuple[str, ...]:
        return tuple(s.name for s in self.sensors)

    @cached_property
    def sensor_sigma(self) -> Array:
        """Standard deviation of each reading (N,), in the sensors' units."""
        return np.array([s.noise_sigma for s in self.sensors])

    @cached_property
    def sensor_cov(self) -> Array:
        """R as its diagonal (N,): readings err independently of each other."""
        return self.sensor_sigma**2

    @cached_property
    def state_scale(self) -> Array:
        """A size of change that matters for each state (n,): the standard deviation of x0 or of one step's noise."""
        variance = np.maximum(diagonal(self.initial_cov), diagonal(self.process_cov))
        return np.sqrt(np.where(variance > 0, variance, 1.0))

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
        """Return the plant's usual input at t, (m,); ValueError where `operation` gives another shape."""
        if self.operation is None:
            return np.array([s.nominal for s in self.inputs])
        u = floats(f"the input that operation of plant {self.name!r} gives", self.operation(t))
        if u.shape != (len(self.inputs),):
            raise ValueError(f"operation of plant {self.name!r} gives shape {u.shape}; expected ({len(self.inputs)},)")
        return u

    def check_dt(self, dt: float) -> None:
        """Raise ValueError where the model does not hold for a step of dt seconds."""
        if not (np.isfinite(dt) and dt > 0):
            raise ValueError(f"a step of {dt} s; times must be finite and increase")
        if self.fixed_dt and not np.isclose(dt, self.dt, rtol=1e-9):
            raise ValueError(f"a step of {dt} s; plant {self.name!r} holds for {self.dt} s only")
        if dt > self.max_dt * (1 + 1e-9):
            raise ValueError(
                f"a step of {dt:g} s; the largest admissible step of plant {self.name!r} is {self.max_dt:.4g} s: "
                "feed NaN readings in between, as diagnose does, or build the plant with more substeps or another max_dt"
            )

    def process_cov_over(self, dt: float) -> Array:
        """Process-noise covariance of a step of dt seconds, (n,) or (n, n)."""
        return self.process_cov if dt == self.dt else self.process_cov * (dt / self.dt)

    def step_jacobian_at(self, t: float, x: Array, u: Array, dt: float) -> Array:
        """F = d step / d x, (..., n, n)."""
        if self.step_jacobian is not None:
            return self._of_shape("step_jacobian", self.step_jacobian(t, x, u, dt), len(self.states))
        if self._complex_step_holds[0]:
            return complex_step_jacobian(lambda p: self.step(t, p, np.expand_dims(u, -2), dt), x)
        return difference_jacobian(lambda p: self.step(t, p, np.expand_dims(u, -2), dt), x, self.state_scale)

    def output_jacobian_at(self, t: float, x: Array, u: Array) -> Array:
        """H = d output / d x, (..., N, n) or (N, n) where it is the same for the whole batch."""
        if self.output_jacobian is not None:
            return self._of_shape("output_jacobian", self.output_jacobian(t, x, u), len(self.sensors))
        if self._complex_step_holds[1]:
            return complex_step_jacobian(lambda p: self.output(t, p, np.expand_dims(u, -2)), x)
        return difference_jacobian(lambda p: self.output(t, p, np.expand_dims(u, -2)), x, self.state_scale)

    @cached_property
    def _complex_step_holds(self) -> tuple[bool, bool]:
        """Of step and output, at points within the spread of x0: at x0 itself a valve may just not act."""
        spread = self.state_scale * np.random.default_rng(0).standard_normal((4, len(self.states)))
        x = self.x0 + (self.guard(self.x0 + spread)[0] - self.x0) / 2  # not on a limit of the model
        u = self.input_at(0.0)
        return (
            self.step_jacobian is not None or complex_step_holds(lambda p: self.step(0.0, p, u, self.dt), x, self.state_scale),
            self.output_jacobian is not None or complex_step_holds(lambda p: self.output(0.0, p, u), x, self.state_scale),
        )

    def _of_shape(self, what: str, jacobian: Array, rows: int) -> Array:
        if np.shape(jacobian)[-2:] != (rows, len(self.states)):
            raise ValueError(
                f"{what} of plant {self.name!r} gives shape {np.shape(jacobian)}; expected (..., {rows}, {len(self.states)})"
            )
        return jacobian

    @cached_property
    def state_limits(self) -> tuple[Array, Array]:
        return np.array([s.low for s in self.states]), np.array([s.high for s in self.states])

    def guard(self, x: Array) -> tuple[Array, Array]:
        """Return x (..., n) moved into the limits of the states, and whether any had to be moved (...)."""
        low, high = self.state_limits
        inside = np.clip(x, low, high)
        return inside, np.any(inside != x, axis=-1)

    def in_units(self, units: Mapping[str, tuple[str, float]]) -> Plant:
        """Return the same plant with some sensors read in another unit: {sensor: (unit, readings per present unit)}."""
        factor = np.ones(len(self.sensors))
        sensors = list(self.sensors)
        for name, (unit, scale) in units.items():
            i = self.sensor_index(name)
            s = sensors[i]
            factor[i] = scale = number(f"scale of sensor {name!r}", scale)
            sensors[i] = replace(s, unit=unit, sigma=s.sigma and s.sigma * abs(scale), bound=s.bound and s.bound * abs(scale))
        jacobian, finer, feedback = self.output_jacobian, self.finer, self.feedback
        return replace(
            self,
            sensors=tuple(sensors),
            output=partial(_scaled, self.output, factor),
            output_jacobian=None if jacobian is None else partial(_scaled, jacobian, factor[:, None]),
            finer=None if finer is None else partial(_finer_in_units, finer, dict(units)),
            feedback=None if feedback is None else partial(_fed_back, feedback, factor),
            sensor_scale=self.sensor_scale * factor,
        )


# functions of a plant are methods or partials of what stands in a module, not closures: so that plants can be pickled


def _scaled(output: OutputFunction, factor: Array, t: float, x: Array, u: Array) -> Array:
    return output(t, x, u) * factor


def _fed_back(feedback: Feedback, factor: Array, t: float, y: Array, u: Array) -> Array:
    return feedback(t, y / factor, u)


def _finer_in_units(finer: Finer, units: Mapping[str, tuple[str, float]]) -> tuple[Plant, Callable[[Array], Array]]:
    twin, coarse = finer()
    return twin.in_units(units), coarse


def with_same_states(twin: Callable[[], Plant]) -> tuple[Plant, Callable[[Array], Array]]:
    """A `finer` by a twin whose states are those of the plant: partial(with_same_states, twin)."""
    return twin(), np.asarray


def diagonal(cov: Array) -> Array:
    """Variances (..., n) of a covariance given as its diagonal (n,) or as a matrix (..., n, n)."""
    return cov if cov.ndim == 1 else np.diagonal(cov, axis1=-2, axis2=-1)


def require_covariance(what: str, cov: Array, n: int) -> None:
    """Raise ValueError unless cov is (n,) non-negative variances or an (n, n) positive semi-definite matrix."""
    if np.shape(cov) not in {(n,), (n, n)}:
        raise ValueError(f"{what} has shape {np.shape(cov)}; expected ({n},) variances or a ({n}, {n}) matrix")
    if not np.all(np.isfinite(cov)):
        raise ValueError(f"{what} has entries that are not finite; expected variances or a covariance matrix")
    variances = diagonal(np.asarray(cov))
    if np.any(variances < 0):
        raise ValueError(f"{what} has a negative variance ({variances.min():g}); a variance is at least 0")
    if np.ndim(cov) == 2:
        scale = np.sqrt(np.where(variances > 0, variances, 1.0))
        unit = cov / np.outer(scale, scale)
        if not np.allclose(unit, unit.T, atol=1e-9) or np.linalg.eigvalsh(unit).min() < -1e-9:
            raise ValueError(f"{what} is not symmetric positive semi-definite; give a covariance matrix")
