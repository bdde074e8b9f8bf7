"""Plants: the discretised model with its states and sensors, on which every detector runs.

All values are in SI units inside. A batch (seeds, ensemble members, sigma points) is leading axes everywhere.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import floats, number, require_unique, shown
from fusion_sfdia.common.covariance import diagonal, require_covariance
from fusion_sfdia.common.html import as_html
from fusion_sfdia.derivatives.analytic import WRONG, Use, non_analytic
from fusion_sfdia.derivatives.differentiable import Differentiable, with_jacobian
from fusion_sfdia.derivatives.equation import complex_step_holds, complex_step_jacobian, difference_jacobian, with_complex_step
from fusion_sfdia.plant.areas import Areas
from fusion_sfdia.plant.cyclic import Cyclic, cyclic, near
from fusion_sfdia.plant.limits import within
from fusion_sfdia.plant.modules import Modules
from fusion_sfdia.plant.signals import Sensor, Signal
from fusion_sfdia.plant.slow_noise import SlowNoise
from fusion_sfdia.plant.uncertainty import Uncertainty, error_of

Array = NDArray[Any]
StepFunction = Callable[[float, Array, Array, float], Array]
OutputFunction = Callable[[float, Array, Array], Array]
Feedback = Callable[[float, Array, Array], Array]
Finer = Callable[[], "tuple[Plant, Callable[[Array], Array]]"]
LARGE, FEW = 16 * 16, 1 / 8  # entries of a Jacobian, and the share of them that is not 0
FROM_STATES: Any = None  # the values that the signals of the states give


@dataclass(frozen=True)
class Numerics:
    """The Jacobians of a model, and the steps for which it holds.

    Parameters
    ----------
    step_jacobian : callable, optional
        step_jacobian(t_start, x, u, dt) -> (..., n, n). None for that which the function has itself as an attribute `jacobian`,
        of the same arguments (with an attribute `with_jacobian`, which returns both, estimators call the model once, see
        `differentiable`); otherwise the complex step, or central differences (to about 1e-10) where the complex step fails
        because of abs, sign, interp or the like.
    output_jacobian : callable, optional
        output_jacobian(t, x, u) -> (..., N, n); None likewise.
    max_dt : float, default inf
        Longest step in s, inf for no limit.
    fixed_dt : bool, default False
        Whether the model holds for the plant's nominal dt only.

    Raises
    ------
    ValueError
        For a Jacobian that is no function and a max_dt that is not positive.

    Notes
    -----
    Complex step and differences are compared once, at points about x0. At a kink itself, |x| at 0, differences give the mean of
    both slopes.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from fusion_sfdia.plants import Numerics, two_tanks
    >>> plant = replace(two_tanks(), numerics=Numerics(max_dt=10.0))
    >>> plant.check_dt(10.0)  # silent where the model holds
    """

    step_jacobian: StepFunction | None = None
    output_jacobian: OutputFunction | None = None
    max_dt: float = np.inf
    fixed_dt: bool = False

    def __post_init__(self) -> None:
        _require_functions(self, "step_jacobian", "output_jacobian")
        if not number("max_dt", self.max_dt) > 0:
            raise ValueError(f"max_dt is {self.max_dt} s; it must be positive, inf for no limit")


@dataclass(frozen=True)
class Truth:
    """The truth of simulations, which represents the real plant; a detector uses only its operation, for unknown inputs.

    Parameters
    ----------
    operation : callable, optional
        operation(t): the input (m,) that acts from t (s) on where none is given; None for the nominal values of the inputs.
    feedback : callable, optional
        feedback(t, y, u): the input (..., m) that acts from t on in closed loop, by controllers that read y (..., N) at t and
        replace u (..., m); None in open loop.
    finer : callable, optional
        finer(): a high-fidelity model with the same sensors and inputs (a finer grid, for example) and the map from its states
        to those of the plant; None where there is none. Simulations take their readings from it unless another truth is given.
    disturbed : bool, default False
        Whether process noise acts on the real plant, too, and on healthy recordings for fitting. Otherwise the process noise
        only represents what the model neglects.

    Raises
    ------
    ValueError
        For an operation, feedback or finer that is no function.

    Examples
    --------
    >>> from dataclasses import replace
    >>> import numpy as np
    >>> from fusion_sfdia.plants import Truth, two_tanks
    >>> plant = replace(two_tanks(), truth=Truth(operation=lambda t: np.array([1e-3 if t < 600 else 1.1e-3])))
    >>> plant.input_at(900.0)
    array([0.0011])
    """

    operation: Callable[[float], Array] | None = None
    feedback: Feedback | None = None
    finer: Finer | None = None
    disturbed: bool = False

    def __post_init__(self) -> None:
        _require_functions(self, "operation", "feedback", "finer")


@dataclass(frozen=True)
class Structure:
    """The single equations of a plant, in SI.

    Parameters
    ----------
    modules : Modules, optional
        The scalar equations as monitoring modules.
    areas : Areas, optional
        The linear areas, each with its own diagnoser.

    Notes
    -----
    None where not stated; detectors that need them are then not applicable, and one diagnoser reads all sensors.

    Examples
    --------
    >>> from fusion_sfdia.plants import Structure, two_tanks
    >>> structure: Structure = two_tanks().structure
    >>> structure.modules.variables, structure.areas
    (('level_1', 'level_2', 'flow_12', 'flow_out', 'inflow'), None)
    """

    modules: Modules | None = None
    areas: Areas | None = None

    def __post_init__(self) -> None:
        for what, kind in (("modules", Modules), ("areas", Areas)):
            value = getattr(self, what)
            if not isinstance(value, kind | None):
                raise ValueError(f"{what} is {shown(value)}; expected {kind.__name__} or None")


def _require_functions(group: Any, *names: str) -> None:
    for what in names:
        value = getattr(group, what)
        if not (value is None or callable(value)):
            raise ValueError(f"{what} is {shown(value)}; expected a function or None")


@dataclass(frozen=True)
class Plant:
    """A discretised plant: x(t_start + dt) = step(t_start, x, u, dt) + w, y(t) = output(t, x, u) + v.

    A first plant needs the first six fields.

    Parameters
    ----------
    name : str
        Of the plant.
    states : tuple of Signal (n,)
        The signals of x.
    sensors : tuple of Sensor (N,)
        The signals of y, which never change: a missing reading is NaN.
    step : callable
        step(t_start, x (..., n), u (..., m), dt) -> (..., n), a function of batches. u is the input that acts over
        [t_start, t_start + dt].
    output : callable
        output(t, x (..., n), u (..., m)) -> (..., N), a function of batches. u is the input that acted until t, the time of the
        readings (s).
    dt : float
        Nominal time between readings in s.
    inputs : tuple of Signal (m,), default ()
        The signals of u.
    x0 : array (n,), optional
        Initial state, by default the nominal values of the states.
    initial_cov : array (n,) or (n, n), optional
        Covariance of x0, by default diag(initial_sigma^2) of the states.
    process_cov : array (n,) or (n, n), optional
        Covariance of w over one nominal dt, by default diag(process_sigma^2) of the states; it grows in proportion to dt. There
        is no default noise.
    process_bound : array (n,), optional
        Largest |w| over one nominal dt, None where not stated.
    printed_process_noise : float, optional
        What the plant's paper prints for its filters, where the plant states another: the standard deviation of w over that of
        the sensor that reads the state. The paper's detectors use it.
    numerics : Numerics, default Numerics()
        Jacobians and admissible steps.
    truth : Truth, default Truth()
        Operation, controllers and high-fidelity model of simulations.
    structure : Structure, default Structure()
        Scalar equations and areas.
    uncertainty : Uncertainty, default Uncertainty()
        Parameters, errors of inputs and disturbances that the model does not know, see `augment`.

    Raises
    ------
    ValueError
        For what does not fit together.

    Examples
    --------
    >>> import numpy as np
    >>> from fusion_sfdia import Plant, Sensor, Signal
    >>> level = Signal("level", "m", nominal=1.0, initial_sigma=0.02, process_sigma=1e-3)
    >>> def step(t_start, x, u, dt):
    ...     return x + dt * (1e-3 - 1e-3 * np.sqrt(x))
    >>> def output(t, x, u):
    ...     return x
    >>> plant = Plant("tank", (level,), (Sensor("gauge", "level", "m", sigma=0.01),), step, output, dt=60.0)
    >>> plant.step(0.0, np.array([[1.0], [4.0]]), np.zeros(0), 60.0).round(2).tolist()  # a batch of two
    [[1.0], [3.94]]
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
    printed_process_noise: float | None = None
    numerics: Numerics = field(default_factory=Numerics)
    truth: Truth = field(default_factory=Truth)
    structure: Structure = field(default_factory=Structure)
    uncertainty: Uncertainty = field(default_factory=Uncertainty)

    def __post_init__(self) -> None:
        _require_kinds(self)
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
        printed = self.printed_process_noise
        if printed is not None and not 0 <= number(f"plant {self.name!r}: printed_process_noise", printed) < np.inf:
            raise ValueError(f"plant {self.name!r}: printed_process_noise is {printed}; it must be finite and at least 0")
        _require_considered(self)
        _require_shapes(self)

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
    def modelled(self) -> int:
        """How many sensors, the first ones, read a variable of the model; of others, which measure "", it predicts nothing."""
        return sum(s.measures != "" for s in self.sensors)

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
        """Readings on the turn of the expected ones: y - expected is then the wrapped residual.

        Parameters
        ----------
        y : array (..., N)
            Readings in the units of the sensors.
        expected : array (..., N)
            Those that are expected.

        Returns
        -------
        array (..., N)
            y itself where no sensor is cyclic.
        """
        return near(y, expected, self.cyclic_sensors)

    def states_near(self, x: Array, other: Array) -> Array:
        """States on the turn of others.

        Parameters
        ----------
        x : array (..., n)
            States.
        other : array (..., n)
            Those of the turn.

        Returns
        -------
        array (..., n)
            x itself where no state is cyclic.
        """
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
        """Return the position of a sensor.

        Parameters
        ----------
        name : str
            Of the sensor.

        Returns
        -------
        int
            Its position among `sensors`.

        Raises
        ------
        ValueError
            For an unknown name.
        """
        if name not in self.sensor_names:
            raise ValueError(f"unknown sensor {name!r} of plant {self.name!r}; known: {', '.join(self.sensor_names)}")
        return self.sensor_names.index(name)

    def input_at(self, t: float) -> Array:
        """Return the plant's usual input at t.

        Parameters
        ----------
        t : float
            Time in s from which it acts.

        Returns
        -------
        array (m,)
            In the units of the inputs.

        Raises
        ------
        ValueError
            Where `truth.operation` gives another shape.
        """
        if self.truth.operation is None:
            return np.array([s.nominal for s in self.inputs])
        u = floats(f"the input that operation of plant {self.name!r} gives", self.truth.operation(t))
        if u.shape != (len(self.inputs),):
            raise ValueError(f"operation of plant {self.name!r} gives shape {u.shape}; expected ({len(self.inputs)},)")
        return u

    def check_dt(self, dt: float) -> None:
        """Raise ValueError where the model does not hold for a step of dt seconds.

        Parameters
        ----------
        dt : float
            Length of the step in s.

        Raises
        ------
        ValueError
            Which states the admissible steps.
        """
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
        """Process-noise covariance of a step of dt seconds.

        Parameters
        ----------
        dt : float
            Length of the step in s.

        Returns
        -------
        array (n,) or (n, n)
            `process_cov` times dt over the nominal dt.
        """
        return self.process_cov if dt == self.dt else self.process_cov * (dt / self.dt)

    def step_jacobian_at(self, t_start: float, x: Array, u: Array, dt: float) -> Array:
        """F = d step / d x.

        Parameters
        ----------
        t_start : float
            Time at which the step begins, in s.
        x : array (..., n)
            State at t_start.
        u : array (..., m)
            Input that acts during the step.
        dt : float
            Length of the step in s.

        Returns
        -------
        array (..., n, n)
            That which `numerics` states, or from the complex step, or from differences where that does not hold.
        """
        if (jacobian := self.jacobians[0]) is not None:
            return self.jacobian_of_shape("step_jacobian", jacobian(t_start, x, u, dt), len(self.states))
        if self._complex_step_holds[0]:
            return complex_step_jacobian(lambda p: self.step(t_start, p, u[..., None, :], dt), x)
        here = x if self.cyclic_states is None else self.step(t_start, x, u, dt)[..., None, :]
        ahead = partial(self.step, t_start)
        return difference_jacobian(lambda p: self.states_near(ahead(p, u[..., None, :], dt), here), x, self.state_scale)

    def output_jacobian_at(self, t: float, x: Array, u: Array) -> Array:
        """H = d output / d x.

        Parameters
        ----------
        t : float
            Time of the readings in s.
        x : array (..., n)
            State at t.
        u : array (..., m)
            Input that acted until t.

        Returns
        -------
        array (..., N, n) or (N, n)
            The latter where it is the same for the whole batch.
        """
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

    def step_with_jacobian(self, t_start: float, x: Array, u: Array, dt: float) -> tuple[Array, Array]:
        """The step and its Jacobian F = d step / d x.

        Parameters
        ----------
        t_start : float
            As of `step_jacobian_at`.
        x : array (..., n)
            As of `step_jacobian_at`.
        u : array (..., m)
            As of `step_jacobian_at`.
        dt : float
            As of `step_jacobian_at`.

        Returns
        -------
        ahead : array (..., n)
            The state at t_start + dt.
        jacobian : array (..., n, n)
            As of `step_jacobian_at`; of a model without one by the same call, to rounding, where the complex step holds.
        """
        if self.jacobians[0] is None and self._complex_step_holds[0]:
            both = with_complex_step(lambda p: np.asarray(self.step(t_start, p, u[..., None, :], dt)), x)
            if both is not None:
                return both
        return np.asarray(self.step(t_start, x, u, dt)), self.step_jacobian_at(t_start, x, u, dt)

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
        """The functions on which step and output depend and that are not analytic, see `derivatives.analytic`."""
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
        """The Jacobian itself, checked.

        Parameters
        ----------
        what : str
            Its name, for the error.
        jacobian : array (..., rows, n)
            To be checked.
        rows : int
            n or N.

        Returns
        -------
        array (..., rows, n)
            As it was given.

        Raises
        ------
        ValueError
            For any other shape.
        """
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
        """Return states moved into their limits, and whether any state was moved.

        Parameters
        ----------
        x : array (..., n)
            States.

        Returns
        -------
        x : array (..., n)
            Within the limits of the states.
        moved : array (...) of bool
            Whether any state was outside.
        """
        return within(np.asarray(x), *self.state_limits)

    def in_units(self, units: Mapping[str, tuple[str, float]]) -> Plant:
        """Return the same plant with some sensors read in another unit.

        Parameters
        ----------
        units : mapping of str to (str, float)
            {sensor: (unit, readings per present unit)}.

        Returns
        -------
        Plant
            With the noise of these sensors in the new unit.
        """
        return _in_units(self, units)


def with_same_states(model: Callable[[], Plant]) -> tuple[Plant, Callable[[Array], Array]]:
    """A `Truth.finer` for a model whose states are those of the plant: partial(with_same_states, model)."""
    return model(), np.asarray


# functions of a plant are methods or partials of module functions, not closures, so that plants can be pickled


def scaled(output: Callable[..., Array], factor: Array, *arguments: Any) -> Array:
    """Readings, or their Jacobian, times a factor for each sensor."""
    return output(*arguments) * factor


def fed_back(feedback: Feedback, factor: Array, t: float, y: Array, u: Array) -> Array:
    """The feedback of readings that are given times a factor for each sensor."""
    return feedback(t, y / factor, u)


def _in_units(plant: Plant, units: Mapping[str, tuple[str, float]]) -> Plant:
    """Return the plant with {sensor: (unit, readings per present unit)}; ValueError for an unknown sensor or other forms."""
    if not isinstance(units, Mapping):
        raise ValueError(
            f'units are {shown(units)}; expected those of sensors by name, as in {{"p1": ("bar", 1e-5)}} for one in Pa'
        )
    factor = np.ones(len(plant.sensors))
    sensors = list(plant.sensors)
    for name, given in units.items():
        i = plant.sensor_index(name)
        s = sensors[i]
        if not isinstance(given, tuple | list) or len(given) != 2 or not isinstance(given[0], str):
            raise ValueError(
                f"unit of sensor {name!r} is {shown(given)}; expected the unit and readings in it per {s.unit}, as in "
                '("mm", 1000.0) for a sensor in m'
            )
        unit, scale = given
        factor[i] = scale = number(f"scale of sensor {name!r}", scale)
        sigma, bound = s.sigma and s.sigma * abs(scale), s.bound and s.bound * abs(scale)
        period, step = s.period and s.period * abs(scale), s.resolution * abs(scale)
        sensors[i] = replace(s, unit=unit, sigma=sigma, bound=bound, scale=s.scale * scale, period=period, resolution=step)
    jacobian, finer, feedback = plant.jacobians[1], plant.truth.finer, plant.truth.feedback
    return replace(
        plant,
        sensors=tuple(sensors),
        output=partial(scaled, plant.output, factor),
        numerics=replace(
            plant.numerics, output_jacobian=None if jacobian is None else partial(scaled, jacobian, factor[:, None])
        ),
        truth=replace(
            plant.truth,
            finer=None if finer is None else partial(_finer_in_units, finer, dict(units)),
            feedback=None if feedback is None else partial(fed_back, feedback, factor),
        ),
        uncertainty=_uncertainty_in_units(plant.uncertainty, factor, units),
    )


def _uncertainty_in_units(known: Uncertainty, factor: Array, units: Mapping[str, tuple[str, float]]) -> Uncertainty:
    output, jacobian, rebuild = known.output, known.output_jacobian, known.rebuild
    return replace(
        known,
        output=None if output is None else partial(scaled, output, factor),
        output_jacobian=None if jacobian is None else partial(scaled, jacobian, factor[:, None]),
        disturbances=tuple(replace(d, reading=d.reading * factor) for d in known.disturbances),
        rebuild=None if rebuild is None else partial(_rebuilt_in_units, rebuild, dict(units)),
    )


def _rebuilt_in_units(rebuild: Callable[..., Plant], units: Mapping[str, tuple[str, float]], **values: float) -> Plant:
    return rebuild(**values).in_units(units)


def _finer_in_units(finer: Finer, units: Mapping[str, tuple[str, float]]) -> tuple[Plant, Callable[[Array], Array]]:
    model, to_states = finer()
    return model.in_units(units), to_states


def _require_kinds(plant: Plant) -> None:
    """Raise ValueError unless signals, sensors, functions and groups are of these types."""
    for what, kind in (("states", Signal), ("inputs", Signal), ("sensors", Sensor)):
        members = getattr(plant, what)
        if not isinstance(members, tuple | list) or not all(isinstance(m, kind) for m in members):
            raise ValueError(f"plant {plant.name!r}: {what} is {shown(members)}; expected a tuple of {kind.__name__} objects")
    for what in ("step", "output"):
        if not callable(function := getattr(plant, what)):
            raise ValueError(f"plant {plant.name!r}: {what} is {shown(function)}; expected a function")
    for what, group in (("numerics", Numerics), ("truth", Truth), ("structure", Structure), ("uncertainty", Uncertainty)):
        if not isinstance(value := getattr(plant, what), group):
            raise ValueError(f"plant {plant.name!r}: {what} is {shown(value)}; expected a {group.__name__} object")


def _require_considered(plant: Plant) -> None:
    """Raise ValueError for a considered state that neither the plant nor its uncertainty has."""
    known = plant.uncertainty
    states = [s.name for s in plant.states]
    added = [
        *(v.name for v in known.parameters),
        *(error_of(name) for name in known.inputs),
        *(v.name for v in known.disturbances),
    ]
    if strange := [name for name in known.considered if name not in (*states, *added)]:
        raise ValueError(
            f"plant {plant.name!r} has no states {', '.join(strange)} to consider; states: {', '.join([*states, *added])}"
        )


def _require_shapes(plant: Plant) -> None:
    """Raise ValueError unless step and output take a batch of states; a step that fails at x0 is left to the runs.

    So is a `Differentiable` one: it would be compiled here by itself, where filters need what gives its Jacobian, too.
    The batch (b, 1) has b other than n: indexing states along the first axis, x[0], then never gives the expected shape.
    """
    n, count = len(plant.states), len(plant.sensors)
    batch = (3 if n == 2 else 2, 1)
    x, u = np.broadcast_to(plant.x0, (*batch, n)).copy(), plant.input_at(0.0)[None]
    for what, expected, arguments in (("step", (*batch, n), (x, u, plant.dt)), ("output", (*batch, count), (x, u))):
        if isinstance(getattr(plant, what), Differentiable):
            continue
        try:
            with np.errstate(all="ignore"):
                found = np.shape(getattr(plant, what)(0.0, *arguments))
        except ArithmeticError:
            continue
        except (IndexError, TypeError, ValueError) as error:
            if not plant.inputs and isinstance(error, IndexError) and "with size 0" in str(error):  # only u has an axis of 0
                raise ValueError(
                    f"{what} of plant {plant.name!r} uses an input, and the plant declares none; pass inputs=(Signal(...), "
                    "...), a Signal for each input"
                ) from error
            raise ValueError(
                f"{what} of plant {plant.name!r} fails for states {x.shape} and inputs {u.shape}: {error}; {_cure(error)}"
            ) from error
        if found != expected:
            raise ValueError(
                f"{what} of plant {plant.name!r} gives shape {found} for states {x.shape}; expected {expected}: one number "
                f"for each {'state' if what == 'step' else 'sensor'}, with a batch as leading axes (x[..., 0])"
                f"{_axis(found, expected)}"
            )


def _cure(error: Exception) -> str:
    """What to write in place of what fails on a batch."""
    text = str(error)
    if "truth value of an array" in text:
        return (
            "`if`, `min` and `max` of Python take one number; write np.where, np.minimum and np.maximum, which take batches of "
            "states"
        )
    if "can be converted to Python scalars" in text or "must be real number" in text or "unsupported format" in text:
        return "functions of `math` and float() take one number; write those of numpy, np.sqrt, which take batches of states"
    if "could not be broadcast" in text:
        return (
            "write it for batches, which are leading axes: x[..., 0], not x[0], and join states along the last axis, "
            "np.stack([...], axis=-1)"
        )
    return "write it for batches, which are leading axes: x[..., 0]"


def _axis(found: tuple[int, ...], expected: tuple[int, ...]) -> str:
    """What to write where the numbers are stacked along another axis than the last."""
    return "; stack them along the last axis, np.stack([...], axis=-1)" if found == (expected[-1], *expected[:-1]) else ""
