"""Sequential computation of many residuals at once: each equation is evaluated on all residuals and runs that need it.

A state x' = -rate x + h is integrated with h held over the step, exact for its linear part (exponential Euler), h at the mean
of the readings before and after. With feedback (gain L) of the reading y before the step,

    x+ = lam x + (1 - lam) / a (h + L y),   a = rate + L,   lam = exp(-a dt).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.derivatives.equation import complex_step_jacobian
from fusion_sfdia.detectors.structural_residuals.structure import Residual, arguments
from fusion_sfdia.plant.modules import Modules

Array = NDArray[Any]
Evaluation = tuple[int, Array]  # an equation, and the residuals that use it


@dataclass(frozen=True, eq=False)
class Sequences:
    """R residuals of the equations of E variables, S of them states, and m inputs. The runs (B) are the last axis; SI."""

    modules: Modules
    residuals: tuple[Residual, ...]

    @cached_property
    def _functions(self) -> list[tuple[Callable[..., Any], list[int]]]:
        """Each equation with the places of its arguments among variables and inputs."""
        places, taken = {v: k for k, v in enumerate(self.modules.variables)}, arguments(self.modules)
        return [(f, [places[a] for a in taken[v]]) for v, f in self.modules.equations.items()]

    @cached_property
    def integrated(self) -> Array:
        """Whether each residual integrates each state (R, S)."""
        return np.array([[v in r.integrated for v in self.modules.states] for r in self.residuals], bool)

    @cached_property
    def gain(self) -> Array:
        """Observer gains, 1/s (R, S), 0 without feedback."""
        gains = self.modules.gains
        return np.array(
            [[gains[v] if r.feedback and v == r.target else 0.0 for v in self.modules.states] for r in self.residuals]
        )

    @cached_property
    def target(self) -> Array:
        """The variable of each residual (R,)."""
        variables = tuple(self.modules.equations)
        return np.array([variables.index(r.target) for r in self.residuals])

    @cached_property
    def _schedule(self) -> list[Evaluation]:
        """Evaluations in an order that each residual allows, for as many residuals at once as possible."""
        variables, taken = tuple(self.modules.equations), arguments(self.modules)
        left, schedule = [set(r.computed) for r in self.residuals], []
        while any(left):
            ready = {
                v: [k for k, expected in enumerate(left) if v in expected and not expected & set(taken[v])] for v in variables
            }
            waiting = {v: sum(v in expected for expected in left) - len(rows) for v, rows in ready.items()}
            best = max((v for v in variables if ready[v]), key=lambda v: len(ready[v]) - waiting[v])
            schedule.append((variables.index(best), np.array(ready[best])))
            for k in ready[best]:
                left[k].remove(best)
        return schedule

    @cached_property
    def _compared(self) -> list[Evaluation]:
        """The equations of targets whose readings other equations use."""
        own = [r.target not in (*r.integrated, *r.computed) for r in self.residuals]
        return [(int(e), np.flatnonzero(own & (self.target == e))) for e in np.unique(self.target[own])]

    def _evaluate(self, e: int, rows: Array, values: Array) -> Any:
        function, columns = self._functions[e]
        return function(*(values[rows, k] for k in columns), self.modules.parameters)

    def _values(self, x: Array, y: Array, u: Array) -> Array:
        """All variables and inputs in each residual (R, E + m, B)."""
        count, (e, runs) = len(self.residuals), y.shape
        values = np.empty((count, e + len(u), runs), np.result_type(x, y))
        values[:, :e], values[:, e:] = y, u
        s = x.shape[1]
        values[:, :s] = np.where(self.integrated[..., None], x, values[:, :s])
        for equation, rows in self._schedule:
            values[rows, equation] = self._evaluate(equation, rows, values)
        return values

    def advance(self, x: Array, before: Array, held: Array, y: Array, u: Array, dt: float) -> Array:
        """Return the states x (R, S, B) a step of dt seconds later, under the input u (m, B).

        before: readings by variable (E, B) at its beginning, NaN where missing; held, y: at its beginning and end, with the
        last ones in place of the missing ones. A state whose equation has no value there stays.
        """
        values = self._values(x, (held + y) / 2, u)
        ahead = x.copy()
        for s in np.flatnonzero(self.integrated.any(axis=0)):
            rows = np.flatnonzero(self.integrated[:, s])
            now, known = x[rows, s], np.isfinite(before[s])
            gain = np.where(known, self.gain[rows, s][:, None], 0.0)
            a = self.modules.rates[s] + gain
            share = np.divide(-np.expm1(-a * dt), a, out=np.full_like(a, dt), where=a > 0)
            h = self._evaluate(int(s), rows, values) + gain * np.where(known, before[s], 0.0)
            later = np.exp(-a * dt) * now + share * h
            ahead[rows, s] = np.where(np.isfinite(later), later, now)
        return ahead

    def predicted(self, x: Array, y: Array, u: Array) -> Array:
        """Return the computed value of each residual's target (R, B), from states x (R, S, B) and readings y (E, B)."""
        values = self._values(x, y, u)
        found = values[np.arange(len(self.residuals)), self.target]
        for equation, rows in self._compared:
            found[rows] = self._evaluate(equation, rows, values)
        return np.asarray(found)

    def forgetting(self, u: Array, dt: float) -> Array:
        """Return the largest share (R,) of a small error of the states that a step leaves, at the nominal values under u (m,).

        The spectral radius of the Jacobian of `advance`, by the complex step; 0 where nothing is integrated.
        """
        m = self.modules
        nominal = np.array([m.nominal[v] for v in m.equations])
        states = nominal[: len(m.states)]

        def step(x: Array) -> Array:
            """Of states (R, B, S)."""
            runs = x.shape[1]
            y, inputs = (np.repeat(a[:, None], runs, axis=1) for a in (nominal, u))
            return np.swapaxes(self.advance(np.swapaxes(x, 1, 2), y, y, y, inputs, dt), 1, 2)

        jacobian = complex_step_jacobian(step, np.broadcast_to(states, (len(self.residuals), states.size)))
        jacobian *= self.integrated[:, :, None] & self.integrated[:, None]
        return np.asarray(np.max(np.abs(np.linalg.eigvals(jacobian)), axis=-1))
