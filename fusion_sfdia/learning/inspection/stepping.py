"""Whether the step of a plant is short enough: its time constants, its error by comparison with two half steps, and whether the
nominal state is steady under the nominal inputs, as far as the plant claims to know it.

With the Jacobian F(h) of a step of h seconds, A = (F(h) - I) / h for h -> 0 is that of the differential equation, whatever the
method of the step; its eigenvalues s are the rates of the modes. A mode with Re s < 0 whose F(dt) grows is unstable by the step
alone. The error of a step is estimated by Richardson's comparison of one step of dt with two of dt / 2: for a method of first
order the difference is half of the error, for higher orders nearly all of it.

A nominal state is rounded: the steady one is x0 + e, where e has the initial covariance P0. With the Jacobian F of a step and
the process noise w, x0 then moves by about w - (F - I) e in a step, of covariance (F - I) P0 (F - I)' + Q. A far larger
movement contradicts what the plant states: a nominal value, or a constant of an equation, in another unit.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.covariance import dense, diagonal
from fusion_sfdia.learning.checks.plants import points
from fusion_sfdia.learning.inspection.plant_findings import MISTAKE, REMARK, PlantFinding
from fusion_sfdia.plant.integration import IntegratedStep
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

SHORT = 1e-4  # of dt, for A: the error of (F - I) / h is of its order, rounding 1e-12
SET = 0.5  # |s| h of a state that its equation sets at once, as by an input: no mode
CHANGE = 0.05  # of the inputs, in the excursion
STIFF = 2.0  # |s| dt above which an explicit step is unstable (Euler) or nearly so
LONGEST = 1024  # steps of dt in the longest gap that is tried
NOTED = 0.1  # of the process noise: an error of a step above it is worth a remark
MOST = 5.0  # standard deviations: Gaussian chance 6e-7 a state


class Stepping(NamedTuple):
    """rates: eigenvalues of A in 1/s, complex, without states that are set at once. growth (n,): |eigenvalues| of F(dt).

    fastest: the state with the largest part in the fastest of these modes, in units of its scale; "" where there is none.
    error (n,): of a step of dt, over the process noise of a step (inf where that is 0 and the step errs). holds: longest step
    in s whose error is below that noise, at least dt, inf beyond 1024 dt. timeless: whether the step ignores dt. NaN where the
    plant has a fixed dt.
    """

    rates: Array
    growth: Array
    fastest: str
    error: Array
    holds: float
    timeless: bool


def stepping(plant: Plant) -> Stepping:
    """Examine the step at x0, its error while the inputs are 5 % off; about x0 where there are none."""
    n, dt, u = len(plant.states), plant.dt, plant.input_at(0.0)
    jacobian = plant.step_jacobian_at(0.0, plant.x0, u, dt) * plant.state_scale / plant.state_scale[:, None]
    growth = np.sort(np.abs(np.linalg.eigvals(jacobian)))[::-1]
    nothing = np.full(n, np.nan)
    if plant.numerics.fixed_dt:
        return Stepping(nothing.astype(complex), growth, "", nothing, dt, False)
    x = _excursion(plant)
    short = SHORT * dt
    F = plant.step_jacobian_at(0.0, plant.x0, u, short) * plant.state_scale / plant.state_scale[:, None]
    rates, modes = np.linalg.eig((F - np.eye(n)) / short)
    lasts = np.abs(rates) * short < SET
    rates, modes = rates[lasts], modes[:, lasts]
    fastest = plant.states[int(np.argmax(np.abs(modes[:, np.argmax(np.abs(rates))])))].name if rates.size else ""
    moved = np.any(plant.step(0.0, x, _over(u, x), dt) != x)
    timeless = bool(moved and np.array_equal(plant.step(0.0, x, _over(u, x), dt), plant.step(0.0, x, _over(u, x), dt / 2)))
    error = _error(plant, x, u, dt, 2)
    holds, times = dt, 2
    while times <= LONGEST and np.all(_error(plant, x, u, times * dt, times) < np.sqrt(times)):
        holds, times = times * dt, 2 * times
    return Stepping(rates, growth, fastest, error, np.inf if times > LONGEST else holds, timeless)


def _excursion(plant: Plant) -> Array:
    """States (5, n) after one to five steps under inputs that are higher by 5 %; some about x0 where there are none."""
    u, x, found = plant.input_at(0.0), plant.x0, []
    if not u.size:
        return points(plant)
    high = np.array([s.high for s in plant.inputs])
    u = np.minimum(u + CHANGE * np.where(u == 0, [s.nominal or 1.0 for s in plant.inputs], np.abs(u)), high)
    for k in range(5):
        with np.errstate(all="ignore"):
            x = plant.guard(plant.step(k * plant.dt, x, u, plant.dt))[0]
        found.append(x)
    return np.array(found)


def _error(plant: Plant, x: Array, u: Array, span: float, parts: int) -> Array:
    """Largest difference (n,) of one step of `span` from `parts` of them, over the process noise of a step of dt."""
    with np.errstate(all="ignore"):
        at_once, divided = plant.step(0.0, x, _over(u, x), span), x
        for k in range(parts):
            divided = plant.step(k * span / parts, divided, _over(u, x), span / parts)
        difference = np.max(np.abs(at_once - divided), axis=0)
        rounding = 64 * np.finfo(float).eps * np.max(np.abs(x), axis=0)
        noise = np.sqrt(np.maximum(diagonal(plant.process_cov), 0.0))
        return np.where(difference <= rounding, 0.0, np.nan_to_num(difference / noise, nan=np.inf, posinf=np.inf))


def _over(u: Array, x: Array) -> Array:
    return np.broadcast_to(u, (len(x), u.size))


def of_step(plant: Plant, found: Stepping) -> Iterator[PlantFinding]:
    """What to correct, or know, about the step."""
    dt, names = plant.dt, [s.name for s in plant.states]
    if found.timeless:
        yield PlantFinding(
            REMARK, "step", "it ignores dt: a gap in a log counts as one step; use dt, or state Numerics(fixed_dt=True)"
        )
        return
    if plant.numerics.fixed_dt:
        return
    fastest = np.max(np.abs(found.rates), initial=0.0)
    if found.growth[0] > 1 + 1e-6 and found.rates.size and np.all(found.rates.real < 1e-9 * fastest):
        yield PlantFinding(
            MISTAKE,
            "step",
            f"a step of {dt:g} s is unstable: an error grows by {found.growth[0]:.3g} in each, while the fastest mode, of "
            f"{found.fastest}, decays in {1 / fastest:.3g} s; if {found.fastest} is not that fast, correct the units in its "
            f"equation (J or kJ, s or min); otherwise make dt shorter than {1 / fastest:.2g} s inside of the step, or use "
            "`discretise`",
        )
        return
    worst, stiff = int(np.argmax(found.error)), fastest * dt > STIFF
    if found.error[worst] > NOTED and (stiff or np.isfinite(found.error[worst])):
        size = found.error[worst]
        by = f"by {size:.2g} times the process noise in {names[worst]}"
        fast = f", and the fastest mode, of {found.fastest}, decays in {1 / fastest:.3g} s" if stiff else ""
        yield PlantFinding(
            REMARK,
            "step",
            f"one step of {dt:g} s and two of {dt / 2:g} s differ "
            f"{by if np.isfinite(size) else f'in {names[worst]}, which has no process noise'}{fast}; "
            f"{_finer(plant, size, fastest)}{', or state more process_sigma' if size > 1 else ''}",
        )
    if np.isinf(plant.numerics.max_dt) and np.isfinite(found.holds):
        yield PlantFinding(
            REMARK,
            "step",
            f"no longest step is stated, but its error exceeds the process noise beyond {found.holds:g} s; state "
            f"Numerics(max_dt={found.holds:g}), and longer gaps are divided",
        )


def _finer(plant: Plant, error: float, fastest: float) -> str:
    """How to divide the step so that its error is NOTED: for Runge-Kutta 4 it falls with the fourth power of the substeps, and
    a substep has to be stable; of a step of unknown order at least as their number.
    """
    times = error / NOTED if np.isfinite(error) else 2.0
    if not isinstance(plant.step, IntegratedStep):
        return f"take {np.ceil(times):.0f} times the substeps that the step has (none counts as 1), or `discretise`"
    now = plant.step.model.substeps
    if plant.step.model.decay is not None:
        return f"give `discretise` substeps={2 * now}"
    return f"give `discretise` substeps={max(np.ceil(now * times**0.25), np.ceil(fastest * plant.dt / STIFF)):.0f}, or decay"


def of_start(plant: Plant) -> Iterator[PlantFinding]:
    """That x0 moves under the inputs at 0 s by more than its uncertainty and the process noise account for."""
    x, u = plant.x0, plant.input_at(0.0)
    with np.errstate(all="ignore"):
        moved = plant.step(0.0, x, u, plant.dt) - x
        A = plant.step_jacobian_at(0.0, x, u, plant.dt) - np.eye(x.size)
        sigma = np.sqrt(diagonal(A @ dense(plant.initial_cov) @ A.T) + diagonal(plant.process_cov))
        rounding = 64 * np.finfo(float).eps * np.abs(x)
        times = np.where(np.abs(moved) <= rounding, 0.0, np.abs(moved) / sigma)
    worst = int(np.argmax(times))
    if times[worst] > MOST:
        state = plant.states[worst]
        yield PlantFinding(
            REMARK,
            "start",
            f"with the usual inputs the nominal state is not steady: {state.name} moves by {moved[worst]:.2g} {state.unit} in "
            f"a step of {plant.dt:g} s, {times[worst]:.2g} times what initial_sigma and process_sigma account for; if it is "
            f"meant to be steady, check the nominal values that the equation of {state.name} uses, its constants, and their "
            "units",
        )
