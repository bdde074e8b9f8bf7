"""Discretised plants from continuous physics, see `integration`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import floats, number
from fusion_sfdia.derivatives.differentiable import Differentiable
from fusion_sfdia.derivatives.equation import difference_jacobian, step_of_change
from fusion_sfdia.plant.integration import (
    Integrated,
    IntegratedOutput,
    IntegratedStep,
)
from fusion_sfdia.plant.linear import constant, picked
from fusion_sfdia.plant.physics import Physics
from fusion_sfdia.plant.plant import FROM_STATES, Numerics, Plant, Truth
from fusion_sfdia.plant.signals import Sensor
from fusion_sfdia.plant.uncertainty import Parameter, Uncertainty

Array = NDArray[Any]


def _require_rates(physics: Physics, x0: Array, u: Array) -> None:
    """Raise ValueError unless f and phi give one number for each state and algebraic variable: RK4 would broadcast others."""
    x = np.broadcast_to(x0, (2, 1, x0.size)).copy()
    z = np.broadcast_to([s.nominal for s in physics.algebraic], (2, 1, len(physics.algebraic))).astype(float)
    for what, like, kind in (("phi", z, "algebraic variable"), ("f", x, "state")):
        function = getattr(physics, what)
        if function is None:
            continue
        try:
            with np.errstate(all="ignore"):
                found = np.shape(function(0.0, x, z, u[None], physics.parameters))
        except ArithmeticError:
            continue  # fails at x0: left to the runs
        fits = found[-1:] == like.shape[-1:] and len(found) <= 3 and np.broadcast_shapes(found, like.shape) == like.shape
        if not fits:
            raise ValueError(
                f"{what} of {physics.name!r} gives shape {found} for states {x.shape}; expected {like.shape}: one number for "
                f"each {kind}, with a batch as leading axes (np.stack([...], axis=-1))"
            )


def largest_step(model: Integrated, dt: float, x0: Array, scale: Array, u: Array) -> float:
    """Largest step (s) for which a step's noise is that of the process: max(dt, 0.1 / |D^-1 A D|), A = df/dx at x0.

    A step dt' adds Q dt' to the covariance; the physics adds the integral of exp(A s) Q exp(A' s) over the step. To first order
    they differ by (A Q + Q A') dt'^2 / 2, at most |D^-1 A D| dt' of Q in units D = diag(scale) of the states. With 0.1 that is
    a tenth of the variance, a twentieth of sigma. The error of a substep of Runge-Kutta 4 is then 0.1^5 / 120 of a deviation,
    far within its stability (2.78). The result is inf for a pure integrator, whose noise is exact. A dt that the user chose is
    always admitted.
    """
    with np.errstate(all="ignore"):
        try:
            rates = difference_jacobian(lambda p: model.slope(0.0, p, u), x0, scale)
        except ArithmeticError:
            return dt
    return step_of_change(rates, scale, dt)


def discretise(
    physics: Physics,
    sensors: Sequence[Sensor],
    *,
    dt: float,
    x0: Array = FROM_STATES,
    initial_cov: Array = FROM_STATES,
    process_cov: Array = FROM_STATES,
    substeps: int = 1,
    process_bound: Array | None = None,
    operation: Callable[[float], Array] | None = None,
    decay: Array | None = None,
    max_dt: float | None = None,
    unknown: Sequence[Parameter] = (),
    input_errors: Mapping[str, float] | None = None,
) -> Plant:
    """Return the plant that integrates physics by RK4 with held inputs; each sensor reads a state or an algebraic variable.

    Parameters
    ----------
    physics : Physics
        The equations in continuous time.
    sensors : sequence of Sensor
        Each measures a state or an algebraic variable.
    dt : float
        Time between readings in s, divided into `substeps`.
    x0 : array (n,), optional
        Initial state in SI, by default from the signals of the states as in `Plant`.
    initial_cov : array (n,) or (n, n), optional
        Covariance of x0 in SI, by default likewise.
    process_cov : array (n,) or (n, n), optional
        Covariance of the process noise over dt in SI, by default likewise.
    substeps : int, default 1
        Steps of the integration within dt.
    process_bound : array (n,), optional
        As in `Plant`.
    operation : callable, optional
        As in `Truth`.
    decay : array (n,), optional
        Rates a of states that follow x' = -a x + h, in 1/s; with them the plant is integrated by the exponential midpoint rule.
    max_dt : float, optional
        The longest step at once in s, None for `largest_step`; `diagnose` divides longer gaps into steps of dt.
    unknown : sequence of Parameter, default ()
        Those of physics.parameters that are not known exactly, by their names; f and phi then get each as an array (...) of the
        batch.
    input_errors : mapping of str to float, optional
        As `inputs` of `Uncertainty`.

    Returns
    -------
    Plant
        Named as physics.

    Raises
    ------
    ValueError
        For a sensor of an unknown variable, f or phi of another shape, less than one substep, a rate that is not positive and
        an unknown parameter that physics.parameters does not have.

    Examples
    --------
    >>> import numpy as np
    >>> from fusion_sfdia import Physics, Sensor, Signal, discretise
    >>> level = Signal("level", "m", nominal=1.0, low=0.0, high=2.0, initial_sigma=0.05, process_sigma=1e-3)
    >>> tank = Physics("tank", (level,), f=lambda t, x, z, u, c: u - c * np.sqrt(x), inputs=(Signal("inflow", "m/s", 1e-3),),
    ...                parameters=1e-3)
    >>> plant = discretise(tank, [Sensor("gauge", "level", "m", sigma=0.01)], dt=60.0)
    >>> plant.step(0.0, plant.x0, np.array([2e-3]), 60.0).round(3)
    array([1.059])
    """
    if substeps < 1:
        raise ValueError(f"substeps is {substeps}; a step of {physics.name!r} takes at least 1")
    names = [s.name for s in (*physics.states, *physics.algebraic)]
    if wrong := [s.name for s in sensors if s.measures not in names]:
        raise ValueError(f"sensors {', '.join(wrong)} measure no variable of {physics.name!r}; variables: {', '.join(names)}")
    picks = np.array([names.index(s.measures) for s in sensors])
    n = len(physics.states)
    if decay is not None and not (np.shape(decay) == (n,) and np.all(np.isfinite(decay)) and np.all(decay > 0)):
        raise ValueError(f"decay of {physics.name!r} is {decay}; expected {n} positive rates in 1/s, one a state")
    model = Integrated(physics, picks, substeps, decay, _names_of(physics, tuple(unknown)))
    x0 = floats(f"x0 of {physics.name!r}", [s.nominal for s in physics.states] if x0 is None else x0)
    u = np.array([s.nominal for s in physics.inputs]) if operation is None else floats("the input of operation", operation(0.0))
    fits = x0.shape == (n,) and u.shape == (len(physics.inputs),)  # Plant refuses what does not
    if fits:
        _require_rates(physics, x0, u)
    only_states = bool(np.all(picks < n))
    selection = np.eye(n)[picks[picks < n]]
    plant = Plant(
        name=physics.name,
        states=physics.states,
        inputs=physics.inputs,
        sensors=tuple(sensors),
        step=IntegratedStep(model),
        output=partial(picked, picks) if only_states else IntegratedOutput(model),
        dt=dt,
        x0=x0,
        initial_cov=initial_cov,
        process_cov=process_cov,
        process_bound=process_bound,
        numerics=Numerics(
            output_jacobian=partial(constant, selection) if only_states else None,
            max_dt=np.inf if max_dt is None else number("max_dt", max_dt),
        ),
        truth=Truth(operation=operation),
        uncertainty=_uncertainty(model, tuple(unknown), input_errors or {}),
    )
    if max_dt is not None:
        return plant
    longest = largest_step(model, dt, x0, plant.state_scale, u)
    return replace(plant, numerics=replace(plant.numerics, max_dt=longest))


def _names_of(physics: Physics, unknown: tuple[Parameter, ...]) -> tuple[str, ...]:
    """The names of the parameters; ValueError for those that the physics does not have, or at another value."""
    c = physics.parameters
    for p in unknown:
        fields = getattr(c, "_fields", ())
        if p.name not in fields:
            raise ValueError(
                f"unknown has {p.name!r}, which the parameters of {physics.name!r} do not; they are "
                f"{', '.join(fields) or 'no NamedTuple'}"
            )
        if getattr(c, p.name) != p.nominal:
            raise ValueError(
                f"parameter {p.name!r} is nominally {p.nominal}, but {getattr(c, p.name)} in the physics; give both alike"
            )
    return tuple(p.name for p in unknown)


def _uncertainty(model: Integrated, unknown: tuple[Parameter, ...], input_errors: Mapping[str, float]) -> Uncertainty:
    """The model at other values of its physics' parameters."""
    if not (unknown or input_errors):
        return Uncertainty()
    step: Any = model.step_at
    output: Any = model.output_at
    if model.program is not None:
        step, output = Differentiable(step, model.step_and_jacobian_at), Differentiable(output, model.output_and_jacobian_at)
    by_step, by_output = (getattr(function, "jacobian", None) for function in (step, output))
    at = (step, output) if unknown else (None, None)
    return Uncertainty(unknown, at[0], at[1], by_step, by_output, inputs=input_errors)
