"""Fault isolation in an area: an estimator with thresholds for each of a set of fault functions (Boem et al. 2018, "B18", sec.
IV, the generalised observer scheme).

Under hypothesis l area i has the model x+ = F x + b u + g e + phi_l(x, u, e) + w, e = sum_j P_ij z_j - d. So (24) to (28) are
the equations of its diagnoser (consensus_equations) for that model. The area sends the effect of phi_l on the shared first
state to the areas that read it. Var[Delta f + Delta phi_l] in (26) includes the covariance of both terms. It takes differences
of phi_l over the deviations of the readings, see `effects`: exact where phi_l is affine, otherwise of second order. The
right-hand sides of (26) and (27) use the thresholds of the present step, in (27) of area j, not i as printed.

A hypothesis is excluded when a residual of the area's own readings exceeds its threshold alpha s in p consecutive steps. The
answer is the only hypothesis that is not excluded, once its own residuals are within their thresholds; "none of these" when all
are excluded; "not isolated" when several are not excluded `patience` steps after the start.

Guarantee in mode "corrected", for affine phi_l: with a curved one mean and variance are those at the reading. A residual of the
true hypothesis exceeds its threshold in a step with probability at most r of the rule (1 / alpha^2 by Chebyshev), any of n
residuals with at most n r. An exclusion needs alarms in p consecutive steps, one of which is a multiple of p. So the true fault
is excluded within T steps with probability at most floor(T / p) n r, for any dependence of the alarms. (1 / alpha^2)^p (B18,
Proposition 5) would need independent alarms, but residuals that share a reading are dependent. At alpha = 2, n = 4 the bound
exceeds 1: take alpha from `exclusion_alpha`. The bound holds where the start does not depend on the readings: a start at an
alarm selects the readings that enter the first residuals. One step later all noise in the residuals is new.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import number, probability, require_unique, shown, whole
from fusion_sfdia.detectors.stochastic_thresholds import consensus_equations as equations
from fusion_sfdia.detectors.stochastic_thresholds.consensus import MODES, Diagnosers
from fusion_sfdia.detectors.stochastic_thresholds.consensus_equations import ENOUGH, UNKNOWN
from fusion_sfdia.detectors.stochastic_thresholds.fault_functions import FaultFunction, effects, require_fault_functions
from fusion_sfdia.detectors.stochastic_thresholds.threshold_rules import alpha_for, false_alarm_of
from fusion_sfdia.plant.areas import Areas

Array = NDArray[Any]

NONE, NOT_ISOLATED, UNDECIDED = "none of these", "not isolated", "undecided"


class Isolation(NamedTuple):
    """B runs, L hypotheses, m readings: the area's own n and those of its first state at its sides.

    held, error_bound, residual, deviation (B, L, m): as of consensus.Diagnosers. exceeded (B, L): steps in a
    row. excluded (B, L). age (B,): steps since the start, -1 before it; at `patience` it stops, and nothing changes any more.
    """

    held: Array
    error_bound: Array
    residual: Array
    deviation: Array
    exceeded: Array
    excluded: Array
    age: Array


@dataclass(frozen=True, eq=False)
class FaultHypotheses:
    """The hypotheses of one area.

    Parameters
    ----------
    areas : Areas
        Of the present network; after a switch `replace` them, the state remains valid.
    area : str
        The name of the area.
    faults : mapping of str to callable
        By name phi(x (..., n), u (...), e (...)) -> (..., n), the term that a fault adds to the next state.
    lam : float, default 0.3
        As in the detection.
    alpha : float, default 2
        Thresholds in standard deviations.
    rule : str, default "chebyshev"
        Bounds the false alarms under alpha.
    mode : str, default "corrected"
        As in the detection.
    confirmations : int, default 3
        p, steps in a row of which one residual must exceed its threshold to exclude a hypothesis.
    patience : int, default 30
        Steps until the time-out.

    Raises
    ------
    ValueError
        For inconsistent settings, and for a fault function that does not give (..., n) finite numbers.

    Notes
    -----
    Boem et al. 2018, sec. IV, the generalised observer scheme; see the module for what is guaranteed.

    Examples
    --------
    >>> import numpy as np
    >>> from fusion_sfdia.detectors import FaultHypotheses
    >>> from fusion_sfdia.plants import power_network
    >>> areas = power_network(loads=()).structure.areas
    >>> faults = {"half of the load": lambda x, u, e: 0.5 * e[..., None] * np.array([0.0, 0.1, 0.0, 0.0])}
    >>> FaultHypotheses(areas, "4", faults, alpha=3.0).answers
    ('half of the load', 'none of these', 'not isolated', 'undecided')
    """

    areas: Areas
    area: str
    faults: Mapping[str, FaultFunction]
    lam: float = 0.3
    alpha: float = 2.0
    rule: str = "chebyshev"
    mode: str = "corrected"
    confirmations: int = 3
    patience: int = 30

    def __post_init__(self) -> None:
        if not 0 <= number("lam", self.lam) < 1:
            raise ValueError(f"lam is {self.lam}; expected at least 0 and less than 1, so that old residuals decay")
        if self.mode not in MODES:
            raise ValueError(f"mode is {shown(self.mode)}; known: {', '.join(MODES)}")
        false_alarm_of(self.rule, self.alpha)
        whole("confirmations", self.confirmations, 1)
        whole("patience", self.patience, self.confirmations)
        if not self.faults:
            raise ValueError("there is no fault function; give at least one by its name")
        require_unique("faults and answers", self.answers)
        require_fault_functions(self.faults, self.areas.size[1])
        self._area  # noqa: B018 - checks that the area is known
        if self.areas.partly_read:
            raise ValueError(
                f"no sensor of its area reads {self.areas.unread_names}; fault functions are isolated only where all states "
                "are read: add these sensors"
            )

    @property
    def answers(self) -> tuple[str, ...]:
        """The hypotheses, then the other results of `answer`."""
        return (*self.faults, NONE, NOT_ISOLATED, UNDECIDED)

    @cached_property
    def _area(self) -> int:
        return self.areas.network.topology.index(self.area)

    @cached_property
    def _sides(self) -> Array:
        start = self.areas.network.topology.start
        return np.arange(start[self._area], start[self._area + 1])

    @cached_property
    def _opposite(self) -> Array:  # the sides at which the neighbours read the area's first state
        opposite: Array = self.areas.opposite[self._sides]
        return opposite

    def false_exclusion(self, steps: int | None = None) -> float:
        """Bound of the probability to exclude the true hypothesis within a number of steps.

        Parameters
        ----------
        steps : int, optional
            None: `patience`.

        Returns
        -------
        float
            floor(steps / p) n r at most, see the module; 1 in mode "paper".
        """
        blocks = (self.patience if steps is None else whole("steps", steps, 0)) // self.confirmations
        rate = false_alarm_of(self.rule, self.alpha) * self.areas.size[1]
        return min(1.0, blocks * rate) if self.mode == "corrected" else 1.0

    def idle(self, runs: int) -> Isolation:
        """Return the state of runs without a detection.

        Parameters
        ----------
        runs : int
            B, their number.

        Returns
        -------
        Isolation
            Not started.
        """
        shape = runs, len(self.faults)
        z = np.zeros((*shape, self.areas.size[1] + self._sides.size))
        return Isolation(z, z, z, z, np.zeros(shape, int), np.zeros(shape, bool), np.full(runs, -1))

    def begin(self, state: Isolation, runs: Array, now: Diagnosers) -> Isolation:
        """Start or restart runs, from the memory of the diagnosers after their alarm.

        Parameters
        ----------
        state : Isolation
            Of all runs.
        runs : array (B,) of bool
            Those that start.
        now : Diagnosers
            The memory of the detection.

        Returns
        -------
        Isolation
            Started in these runs.

        Raises
        ------
        ValueError
            For diagnosers that estimate unread states.
        """
        if now.covariance.size:
            raise ValueError(
                "these diagnosers estimate unread states; fault functions are isolated only where all states are read"
            )
        chosen = np.asarray(runs, bool)[:, None, None]
        return Isolation(
            np.where(chosen, self._of_area(now.held, now.held_shared), state.held),
            np.where(chosen, self._of_area(now.error_bound, now.error_bound_shared), state.error_bound),
            np.where(chosen, 0.0, state.residual),
            np.where(chosen, 0.0, state.deviation),
            np.where(chosen[..., 0], 0, state.exceeded),
            np.where(chosen[..., 0], False, state.excluded),
            np.where(runs, 0, state.age),
        )

    def step(self, state: Isolation, before: Diagnosers, reference: Array, load: Array, own: Array, shared: Array) -> Isolation:
        """Return the state after the next readings.

        Parameters
        ----------
        state : Isolation
            Before these readings.
        before : Diagnosers
            Those of the detection before these readings, with the area's readings of its neighbours.
        reference : array (B, N)
            Reference of each area that acted until then.
        load : array (B, N)
            Load of each area that acted until then.
        own : array (B, N, n)
            Readings of the areas' states, NaN where missing.
        shared : array (B, 2E)
            Readings of the neighbours' first states at the sides of the links, NaN where missing.

        Returns
        -------
        Isolation
            After these readings.
        """
        estimate, deviation, error_bound = self._predict(state, before, reference, load)
        y, n = self._of_area(own, shared), own.shape[-1]
        known = (read := np.isfinite(y)) & (deviation < ENOUGH)
        residual = np.where(known, y - estimate, 0.0)
        deviation = np.where(known, deviation, 0.0)
        beyond = np.any(np.abs(residual[..., :n]) > self.alpha * deviation[..., :n], axis=-1)
        running = ((state.age >= 0) & (state.age < self.patience))[:, None] & np.any(known[..., :n], axis=-1)
        exceeded = np.where(running, np.where(beyond, state.exceeded + 1, 0), state.exceeded)
        age = np.where((state.age >= 0) & (state.age < self.patience), state.age + 1, state.age)
        held, error_bound = np.where(read, y, estimate), np.where(read, 0.0, error_bound)
        excluded = state.excluded | (exceeded >= self.confirmations)
        return Isolation(held, error_bound, residual, deviation, exceeded, excluded, age)

    def answer(self, state: Isolation) -> Array:
        """Return what stands of each run.

        Parameters
        ----------
        state : Isolation
            Of B runs.

        Returns
        -------
        array (B,) of int
            Indices into `answers`.
        """
        none = len(self.faults)
        remaining = ~state.excluded
        count, one = remaining.sum(axis=-1), np.argmax(remaining, axis=-1)
        within = np.take_along_axis(state.exceeded, one[:, None], axis=-1)[:, 0] == 0
        late = state.age >= self.patience
        isolated = (count == 1) & (within | late) & (state.age >= self.confirmations)
        answers: Array = np.select([count == 0, isolated, late], [none, one, none + 1], none + 2)
        return answers

    def _of_area(self, own: Array, shared: Array) -> Array:  # (B, 1, m)
        return np.concatenate([own[:, self._area], shared[:, self._opposite]], axis=-1)[:, None]

    def _predict(self, state: Isolation, before: Diagnosers, reference: Array, load: Array) -> tuple[Array, Array, Array]:
        """Estimates (24), (25), deviations (26), (27) and error bounds (B, L, m) for the next readings, with weights (28)."""
        i, sides, n, closed = self._area, self._sides, self.areas.size[1], self.areas.network.closed[self._sides]
        slope, noise_there = np.where(closed, self.areas.slope[sides], 0.0), self.areas.shared_noise[sides]
        known, tie_bound = before.held_shared[:, sides], np.where(closed, before.error_bound_shared[:, sides], 0.0)
        e = (known @ slope - load[:, i])[:, None]  # (B, 1)
        e_variance = (equations.noise_read(noise_there, tie_bound) @ slope**2)[:, None, None]
        e_bound = (tie_bound @ np.abs(slope))[:, None, None]

        noise = np.concatenate([self.areas.noise[i], self.areas.shared_noise[self._opposite]])
        process, row, lam = self.areas.process_variance[i], self.areas.matrices[i], self.lam
        read = equations.noise_read(noise, state.error_bound)
        x, u = state.held[..., :n], reference[:, i, None]
        width = np.sqrt(np.append(self.areas.noise[i], noise_there @ slope**2 or np.max(self.areas.noise[i])))
        spread = np.concatenate([read[..., :n], np.broadcast_to(e_variance, (*read.shape[:-1], 1))], axis=-1)
        phi = effects(self.faults, x, u, e, width, spread)
        M, g = row[:, :n] + phi.slopes[..., :n], row[:, n + 1] + phi.slopes[..., n]
        value = x @ row[:, :n].T + row[:, n] * u[..., None] + row[:, n + 1] * e[..., None] + phi.mean
        a = M[..., :1, 0].copy()
        drive = value[..., :1] - a * x[..., :1]
        M[..., 0, 0] = 0.0  # row 0 now gives the drive
        variance = (M**2 @ read[..., :n, None])[..., 0] + g**2 * e_variance + phi.curvature
        estimate_bound = (np.abs(M) @ state.error_bound[..., :n, None])[..., 0] + np.abs(g) * e_bound
        memory = lam * state.deviation[..., :n]
        estimate = equations.private_term(value, state.residual[..., :n], lam)
        deviation = equations.residual_deviation(memory, variance, process, noise[:n], estimate_bound)
        error_bound = equations.error_deviation(memory, variance, process, estimate_bound)

        copies = np.r_[0, n : noise.size]
        z, r, s, d = (part[..., copies] for part in (state.held, state.residual, state.deviation, state.error_bound))
        v, read = noise[copies], read[..., copies]
        drive_variance, drive_bound, q = variance[..., :1], estimate_bound[..., :1], process[0]
        as_printed = self.mode == "paper"
        weight = equations.precision_printed(v, d, a, drive_variance, q) if as_printed else equations.precision_read(v, d)
        weight = np.where(np.r_[True, closed], weight, 0.0)
        W = weight / weight.sum(axis=-1, keepdims=True)

        def consensus(terms: Array) -> Array:
            total: Array = np.sum(np.where(W > 0, W * terms, 0.0), axis=-1, keepdims=True)
            return total

        agreed = consensus(equations.shared_term(z, drive, r, a, lam))
        memory = lam * consensus(s)
        shared_variance = a**2 * consensus(W * read) + drive_variance
        shared_bound = np.abs(a) * consensus(d) + drive_bound
        if as_printed:
            alike = memory + np.sqrt(consensus(W * equations.printed_variance(v, d, a, drive_variance, q))) + shared_bound
            deviations = np.broadcast_to(alike, z.shape)
        else:
            deviations = equations.residual_deviation(memory, shared_variance, q, v, shared_bound)
        copy_bounds = equations.error_deviation(memory, shared_variance, q, shared_bound)
        at = np.broadcast_to(closed, (*z.shape[:-1], sides.size))
        return (
            np.concatenate([agreed, estimate[..., 1:], np.where(at, agreed, z[..., 1:])], axis=-1),
            np.concatenate([deviations[..., :1], deviation[..., 1:], np.where(at, deviations[..., 1:], UNKNOWN)], axis=-1),
            np.minimum(
                np.concatenate([copy_bounds, error_bound[..., 1:], np.where(at, copy_bounds, UNKNOWN)], axis=-1), UNKNOWN
            ),
        )


def exclusion_alpha(rule: str, false_exclusion: float, components: int, patience: int, confirmations: int = 3) -> float:
    """Return the alpha for which the true fault is excluded with at most this probability (FaultHypotheses.false_exclusion)."""
    blocks = whole("patience", patience, whole("confirmations", confirmations, 1)) // confirmations
    return alpha_for(rule, probability("false_exclusion", false_exclusion) / blocks, components)
