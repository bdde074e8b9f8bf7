"""The fault of an area: an estimator with thresholds for each fault function of a given set (Boem et al. 2018, "B18",
sec. IV, the generalised observer scheme).

Under hypothesis l area i follows x+ = F x + b u + g e + phi_l(x, u, e) + w, e = sum_j P_ij z_j - d, so (24) to (28) are the
equations of its diagnoser (consensus_equations) for that model; the area sends the effect of phi_l on the shared first state to
the areas that read it. Var[Delta f + Delta phi_l] is of both at once, with their covariance in (26): by differences of phi_l
over the deviations of the readings, exact where phi_l is affine and of first order elsewhere. On the right of (26) and (27)
stand the thresholds of the present step, in (27) of area j, not i as printed.

A hypothesis is excluded when, p steps in a row, a residual of the area's own readings exceeds its threshold alpha s. The answer
is the one that is left, once its own residuals are within their thresholds; "none of these" when all are excluded; "not
isolated" when several are left `patience` steps after the start.

Guaranteed, in mode "corrected": a residual of the true hypothesis exceeds its threshold in a step with probability at most r
of the rule (1 / alpha^2 by Chebyshev), any of n with n r. Of any p steps in a row one is a multiple of p, and all of them must
alarm for an exclusion. So the true fault is excluded within T steps with probability at most floor(T / p) n r, however alarms
depend on each other. (1 / alpha^2)^p (B18, Proposition 5) would need independence, which residuals that share a reading do not
have. At alpha = 2, n = 4 the bound exceeds 1: take alpha from `exclusion_alpha`. It holds where the start does not depend on
the readings: an alarm selects the readings that enter the first residuals. A step later all noise in them is new.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.areas import Areas
from fusion_sfdia.core.arguments import number, probability, require_unique, shown, whole
from fusion_sfdia.stochastic_thresholds import consensus_equations as equations
from fusion_sfdia.stochastic_thresholds.consensus import MODES, Diagnosers
from fusion_sfdia.stochastic_thresholds.consensus_equations import ENOUGH, UNKNOWN
from fusion_sfdia.stochastic_thresholds.threshold_rules import alpha_for, false_alarm_of

Array = NDArray[Any]
FaultFunction = Callable[[Array, Array, Array], Array]

NONE, NOT_ISOLATED, UNDECIDED = "none of these", "not isolated", "undecided"


class Isolation(NamedTuple):
    """B runs, L hypotheses, m readings: the area's own n and those of its first state at its sides.

    held, doubt, residual, deviation (B, L, m): as of consensus.Diagnosers. exceeded (B, L): steps in a row. excluded (B, L).
    age (B,): steps since the start, -1 before it; it ends at `patience`, and with it all changes.
    """

    held: Array
    doubt: Array
    residual: Array
    deviation: Array
    exceeded: Array
    excluded: Array
    age: Array


@dataclass(frozen=True, eq=False)
class FaultHypotheses:
    """The hypotheses of one area, by name: phi(x (..., n), u (...), e (...)) -> (..., n), what a fault adds to the next state.

    areas: of the network as it is; after a switch, `replace` it: a state fits on. lam, mode: as of the detection. alpha, rule:
    thresholds in standard deviations, and by what they claim something. confirmations: p. patience: steps until the time-out.
    ValueError for what does not fit, and for a fault function that does not give (..., n) finite numbers.
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
            raise ValueError(f"lam is {self.lam}; expected at least 0 and less than 1, for the residuals to forget")
        if self.mode not in MODES:
            raise ValueError(f"mode is {shown(self.mode)}; known: {', '.join(MODES)}")
        false_alarm_of(self.rule, self.alpha)
        whole("confirmations", self.confirmations, 1)
        whole("patience", self.patience, self.confirmations)
        if not self.faults:
            raise ValueError("there is no fault function; give at least one by its name")
        require_unique("faults and answers", self.answers)
        n = self.areas.size[1]
        for name, phi in self.faults.items():
            given = np.asarray(phi(np.zeros((3, n)), np.zeros(3), np.zeros(3)))
            if given.shape != (3, n) or given.dtype.kind not in "fi" or not np.all(np.isfinite(given)):
                raise ValueError(
                    f"the fault function of {name!r} gives {given.dtype} {given.shape} for states (3, {n}); expected {n} "
                    f"finite numbers for each of them, (3, {n})"
                )
        self._area  # noqa: B018 - refuses an unknown area

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
    def _there(self) -> Array:  # the sides at which the neighbours read the area's first state
        there: Array = self.areas.opposite[self._sides]
        return there

    def false_exclusion(self, steps: int | None = None) -> float:
        """The largest probability that the true hypothesis is excluded within `steps`, None for `patience`; 1 as printed."""
        blocks = (self.patience if steps is None else whole("steps", steps, 0)) // self.confirmations
        rate = false_alarm_of(self.rule, self.alpha) * self.areas.size[1]
        return min(1.0, blocks * rate) if self.mode == "corrected" else 1.0

    def idle(self, runs: int) -> Isolation:
        """The state of runs in which nothing has been detected."""
        shape = runs, len(self.faults)
        z = np.zeros((*shape, self.areas.size[1] + self._sides.size))
        return Isolation(z, z, z, z, np.zeros(shape, int), np.zeros(shape, bool), np.full(runs, -1))

    def begin(self, state: Isolation, runs: Array, now: Diagnosers) -> Isolation:
        """Start, or start again, in the runs chosen by (B,) truth values, from the memory of the diagnosers after their
        alarm.
        """
        chosen = np.asarray(runs, bool)[:, None, None]
        return Isolation(
            np.where(chosen, self._of_area(now.held, now.held_shared), state.held),
            np.where(chosen, self._of_area(now.doubt, now.doubt_shared), state.doubt),
            np.where(chosen, 0.0, state.residual),
            np.where(chosen, 0.0, state.deviation),
            np.where(chosen[..., 0], 0, state.exceeded),
            np.where(chosen[..., 0], False, state.excluded),
            np.where(runs, 0, state.age),
        )

    def step(self, state: Isolation, before: Diagnosers, reference: Array, load: Array, own: Array, shared: Array) -> Isolation:
        """After the next readings own (B, N, n), shared (B, 2E), NaN where missing, under reference and load (B, N).

        before: the diagnosers of the detection until then, which hold what the area read of its neighbours.
        """
        estimate, deviation, doubt = self._predict(state, before, reference, load)
        y, n = self._of_area(own, shared), own.shape[-1]
        known = (read := np.isfinite(y)) & (deviation < ENOUGH)
        residual = np.where(known, y - estimate, 0.0)
        deviation = np.where(known, deviation, 0.0)
        beyond = np.any(np.abs(residual[..., :n]) > self.alpha * deviation[..., :n], axis=-1)
        running = ((state.age >= 0) & (state.age < self.patience))[:, None] & np.any(known[..., :n], axis=-1)
        exceeded = np.where(running, np.where(beyond, state.exceeded + 1, 0), state.exceeded)
        age = np.where((state.age >= 0) & (state.age < self.patience), state.age + 1, state.age)
        held, doubt = np.where(read, y, estimate), np.where(read, 0.0, doubt)
        excluded = state.excluded | (exceeded >= self.confirmations)
        return Isolation(held, doubt, residual, deviation, exceeded, excluded, age)

    def answer(self, state: Isolation) -> Array:
        """(B,): places in `answers`."""
        none = len(self.faults)
        left = ~state.excluded
        count, one = left.sum(axis=-1), np.argmax(left, axis=-1)
        calm = np.take_along_axis(state.exceeded, one[:, None], axis=-1)[:, 0] == 0
        late = state.age >= self.patience
        named = (count == 1) & (calm | late) & (state.age >= self.confirmations)
        answers: Array = np.select([count == 0, named, late], [none, one, none + 1], none + 2)
        return answers

    def _of_area(self, own: Array, shared: Array) -> Array:  # (B, 1, m)
        return np.concatenate([own[:, self._area], shared[:, self._there]], axis=-1)[:, None]

    def _predict(self, state: Isolation, before: Diagnosers, reference: Array, load: Array) -> tuple[Array, Array, Array]:
        """Estimates, deviations and doubts (B, L, m) for the next readings: (24) and (25), (26) and (27), weights (28)."""
        i, sides, n, closed = self._area, self._sides, self.areas.size[1], self.areas.network.closed[self._sides]
        slope, noise_there = np.where(closed, self.areas.slope[sides], 0.0), self.areas.shared_noise[sides]
        known, in_doubt = before.held_shared[:, sides], np.where(closed, before.doubt_shared[:, sides], 0.0)
        e = (known @ slope - load[:, i])[:, None]  # (B, 1)
        e_variance = (equations.noise_read(noise_there, in_doubt) @ slope**2)[:, None, None]
        e_doubt = (in_doubt @ np.abs(slope))[:, None, None]

        noise = np.concatenate([self.areas.noise[i], self.areas.shared_noise[self._there]])
        process, row, lam = self.areas.process_variance[i], self.areas.matrices[i], self.lam
        read = equations.noise_read(noise, state.doubt)
        x, u = state.held[..., :n], reference[:, i, None]
        phi, change = self._fault(x, u, e)
        M, g = row[:, :n] + change[..., :n], row[:, n + 1] + change[..., n]
        value = x @ row[:, :n].T + row[:, n] * u[..., None] + row[:, n + 1] * e[..., None] + phi
        a = M[..., :1, 0].copy()
        drive = value[..., :1] - a * x[..., :1]
        M[..., 0, 0] = 0.0  # now row 0 is that of the drive
        variance = (M**2 @ read[..., :n, None])[..., 0] + g**2 * e_variance
        unsure = (np.abs(M) @ state.doubt[..., :n, None])[..., 0] + np.abs(g) * e_doubt
        memory = lam * state.deviation[..., :n]
        estimate = equations.private_term(value, state.residual[..., :n], lam)
        deviation = equations.residual_deviation(memory, variance, process, noise[:n], unsure)
        doubt = equations.error_deviation(memory, variance, process, unsure)

        copies = np.r_[0, n : noise.size]
        z, r, s, d = (part[..., copies] for part in (state.held, state.residual, state.deviation, state.doubt))
        v, read = noise[copies], read[..., copies]
        drive_variance, drive_doubt, q = variance[..., :1], unsure[..., :1], process[0]
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
        shared_doubt = np.abs(a) * consensus(d) + drive_doubt
        if as_printed:
            alike = memory + np.sqrt(consensus(W * equations.printed_variance(v, d, a, drive_variance, q))) + shared_doubt
            deviations = np.broadcast_to(alike, z.shape)
        else:
            deviations = equations.residual_deviation(memory, shared_variance, q, v, shared_doubt)
        doubts = equations.error_deviation(memory, shared_variance, q, shared_doubt)
        at = np.broadcast_to(closed, (*z.shape[:-1], sides.size))
        return (
            np.concatenate([agreed, estimate[..., 1:], np.where(at, agreed, z[..., 1:])], axis=-1),
            np.concatenate([deviations[..., :1], deviation[..., 1:], np.where(at, deviations[..., 1:], UNKNOWN)], axis=-1),
            np.minimum(np.concatenate([doubts, doubt[..., 1:], np.where(at, doubts, UNKNOWN)], axis=-1), UNKNOWN),
        )

    def _fault(self, x: Array, u: Array, e: Array) -> tuple[Array, Array]:
        """What the faults add (B, L, n), and its derivatives (B, L, n, n + 1) by the state and by e."""
        n = x.shape[-1]
        width = np.sqrt(np.append(self.areas.noise[self._area], np.max(self.areas.noise[self._area])))
        shifts = np.concatenate([np.zeros((1, n + 1)), np.diag(width), -np.diag(width)])
        values, slopes = [], []
        for one, phi in enumerate(self.faults.values()):
            points = np.concatenate([x[:, one], e], axis=-1)[:, None] + shifts
            found = np.asarray(phi(points[..., :n], np.broadcast_to(u, points.shape[:-1]), points[..., n]), float)
            values.append(found[:, 0])
            slopes.append(np.swapaxes(found[:, 1 : n + 2] - found[:, n + 2 :], -1, -2) / (2 * width))
        return np.stack(values, axis=1), np.stack(slopes, axis=1)


def exclusion_alpha(rule: str, false_exclusion: float, components: int, patience: int, confirmations: int = 3) -> float:
    """The alpha with which the true fault is excluded with at most this probability: FaultHypotheses.false_exclusion."""
    blocks = whole("patience", patience, whole("confirmations", confirmations, 1)) // confirmations
    return alpha_for(rule, probability("false_exclusion", false_exclusion) / blocks, components)
