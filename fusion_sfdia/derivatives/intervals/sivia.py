"""Set inversion via interval analysis, SIVIA (Jaulin and Walter 1993; Kougiatsos 2024, sec. IV-B, for sensor thresholds).

The set of all x in a box with f(x, p) in a target: boxes are accepted, rejected or bisected until they are small. The result
encloses the set from both sides: inner boxes are subsets of the set, and inner and boundary boxes together contain it.

With interval parameters p, the outer boxes contain every x that is a solution for some p, and the inner boxes only x that are
solutions for every p. An empty result means that the measurements contradict the model.

All boxes of a generation are processed at once, for every problem of a batch (seeds, times); the result is that of a loop.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fusion_sfdia.derivatives.intervals.contractors import backward
from fusion_sfdia.derivatives.intervals.expression import Expression, record
from fusion_sfdia.derivatives.intervals.interval import Interval, select

Array = NDArray[Any]


@dataclass(frozen=True)
class Boxes:
    """Boxes by component (n, boxes), and the index of the problem of each box (boxes,)."""

    boxes: Interval
    problem: Array

    def __len__(self) -> int:
        return len(self.problem)

    @property
    def columns(self) -> list[Interval]:
        return [self.boxes[i] for i in range(self.boxes.shape[0])]

    def where(self, condition: Array) -> Boxes:
        return Boxes(self.boxes[:, condition], self.problem[condition])

    @staticmethod
    def join(parts: Sequence[Boxes]) -> Boxes:
        lo = np.concatenate([part.boxes.lo for part in parts], axis=1)
        hi = np.concatenate([part.boxes.hi for part in parts], axis=1)
        return Boxes(Interval.unchecked(lo, hi), np.concatenate([part.problem for part in parts]))


@dataclass(frozen=True)
class Paving:
    """The result of set inversion for each problem of a batch (...), in n variables.

    hull: (..., n), the least box that contains inner and boundary boxes, empty without a solution.
    inner, boundary: (boxes, n); inner_problem, boundary_problem: (boxes,), the index of the problem in the flattened batch.
    complete: (...), False where the budget ran out: the enclosure holds, but boundary boxes are larger than the tolerance.
    examined: (...), number of boxes examined.
    """

    hull: Interval
    inner: Interval
    inner_problem: Array
    boundary: Interval
    boundary_problem: Array
    complete: Array
    examined: Array

    @classmethod
    def of(cls, inner: Boxes, boundary: Boxes, complete: Array, examined: Array) -> Paving:
        """Return the paving with these boxes; complete and examined: (...)."""
        outer = Boxes.join([inner, boundary])
        ends = np.full((2, len(outer.boxes.lo), complete.size), np.inf)
        for row, values in zip(ends, (outer.boxes.lo, -outer.boxes.hi), strict=True):
            for component, value in zip(row, values, strict=True):
                np.minimum.at(component, outer.problem, value)
        lo, hi = (np.where(np.isinf(ends[0]), np.nan, e).T.reshape(*complete.shape, -1) for e in (ends[0], -ends[1]))
        lists = [(Interval.unchecked(part.boxes.lo.T, part.boxes.hi.T), part.problem) for part in (inner, boundary)]
        return cls(Interval.unchecked(lo, hi), *lists[0], *lists[1], complete, examined)

    @property
    def is_empty(self) -> Array:
        """Where it is proved that no solution exists: (...)."""
        return np.asarray(self.hull.is_empty.any(axis=-1))

    @property
    def inner_volume(self) -> Array:
        """Volume of the inner boxes, to rounding: (...)."""
        return _volume(self.inner, self.inner_problem, self.complete.shape)

    @property
    def outer_volume(self) -> Array:
        """Volume of inner and boundary boxes, to rounding: (...)."""
        return self.inner_volume + _volume(self.boundary, self.boundary_problem, self.complete.shape)


def sivia(
    function: Callable[..., Any] | Expression,
    target: Interval | Sequence[Interval],
    box: Interval,
    tolerance: ArrayLike,
    *,
    parameters: Sequence[Interval | ArrayLike] = (),
    budget: int = 10_000,
    contract: bool = True,
) -> Paving:
    """Return inner and outer pavings of {x in box: function(x_1, ..., x_n, *parameters) in target}.

    function: an equation, or one that returns a tuple of results, each with its own target. It is recorded
        here; to invert it often, record it once (`expression.record`).
    target: one for each result, each (...). box: (..., n), finite. parameters: each (...).
    tolerance: width at which boxes are not cut any more, in the units of the variables: one number, or (n,).
    budget: boxes that may be examined for each problem; pending boxes beyond it count as boundary.
    contract: cut boxes by forward-backward contraction with the target and with its complement, in addition to bisection.

    Raises ValueError for a box that is empty, infinite or without an axis of variables, a tolerance that is not positive, a
    budget below 1, and a wrong number of targets or arguments.
    """
    n = checked_size(box, tolerance, budget)
    expression = record(function, n + len(parameters))
    targets = [target] if isinstance(target, Interval) else list(target)
    if len(targets) != len(expression.outputs):
        raise ValueError(f"{len(targets)} targets for {len(expression.outputs)} results; expected one for each")
    given = [p if isinstance(p, Interval) else Interval(p) for p in parameters]
    shape = np.broadcast_shapes(box.shape[:-1], *(x.shape for x in (*targets, *given)))
    constraint = _Constraint(expression, [_flat(x, shape) for x in given], [_flat(x, shape) for x in targets])

    work = Boxes(Interval.stack([_flat(box[..., i], shape) for i in range(n)], axis=0), np.arange(math.prod(shape)))
    scale = np.broadcast_to(np.asarray(tolerance, dtype=float), (n,))[:, None]
    examined, complete = np.zeros(len(work), dtype=int), np.ones(len(work), dtype=bool)
    inner, boundary = [work.where(~complete)], [work.where(~complete)]
    while len(work):
        pending = np.bincount(work.problem, minlength=complete.size)
        over = examined + pending > budget
        complete &= ~over
        examined += np.where(over, 0, pending)
        boundary.append(work.where(over[work.problem]))
        work = work.where(~over[work.problem])

        if contract:
            work = constraint.without_outside(work)
        inside, outside = constraint.classify(work)
        inner.append(work.where(inside))
        work = work.where(~inside & ~outside)
        if contract:
            work, cut_off = constraint.without_inside(work)
            inner += cut_off

        relative = work.boxes.width / scale
        small = np.asarray((relative <= 1).all(axis=0))
        boundary.append(work.where(small))
        work = work.where(~small)
        widest = np.arange(n)[:, None] == relative[:, ~small].argmax(axis=0)
        work = Boxes.join([Boxes(select(widest, half, work.boxes), work.problem) for half in work.boxes.bisect()])
    return Paving.of(Boxes.join(inner), Boxes.join(boundary), complete.reshape(shape), examined.reshape(shape))


@dataclass(frozen=True)
class _Constraint:
    """An expression with the parameters and targets of each problem."""

    expression: Expression
    parameters: list[Interval]
    targets: list[Interval]

    def values(self, work: Boxes) -> list[Interval]:
        return self.expression.evaluate([*work.columns, *(p[work.problem] for p in self.parameters)])

    def contracted(self, work: Boxes, values: list[Interval], targets: Sequence[Interval]) -> Interval:
        return Interval.stack(backward(self.expression, values, targets)[: work.boxes.shape[0]], axis=0)

    def without_outside(self, work: Boxes) -> Boxes:
        """Cut off points that certainly do not meet the target."""
        left = self.contracted(work, self.values(work), [t[work.problem] for t in self.targets])
        return Boxes(left, work.problem).where(~np.asarray(left.is_empty.any(axis=0)))

    def classify(self, work: Boxes) -> tuple[Array, Array]:
        """Return whether each box is inside the set, and whether it is outside."""
        values = self.values(work)
        inside, outside = (
            np.array(np.broadcast_to(self.expression.is_defined(values), len(work))),
            np.zeros(len(work), dtype=bool),
        )
        for i, target in zip(self.expression.outputs, self.targets, strict=True):
            inside &= target[work.problem].contains(values[i])
            outside |= target[work.problem].intersection(values[i]).is_empty
        return inside & ~outside, outside

    def without_inside(self, work: Boxes) -> tuple[Boxes, list[Boxes]]:
        """Cut off points that certainly meet the target; return the remaining boxes and the boxes cut off.

        A remaining box is the hull of points that may violate a target on either side or may have no value.
        """
        if all((t.lo == t.hi).all() for t in self.targets):  # every point is arbitrarily close to one that violates it
            return work, []
        values = self.values(work)
        left = select(~self.expression.is_defined(values), work.boxes, Interval.empty())
        free = [Interval(-np.inf, np.inf)] * len(self.targets)
        for k, target in enumerate(t[work.problem] for t in self.targets):
            for lo, hi in ((np.full(len(work), -np.inf), target.lo), (target.hi, np.full(len(work), np.inf))):
                side = select(np.isinf(lo) & (lo == hi), Interval.empty(), Interval.unchecked(lo, hi))
                left = left.hull(self.contracted(work, values, [*free[:k], side, *free[k + 1 :]]))
        gone = np.asarray(left.is_empty.any(axis=0))
        cut_off = [work.where(gone)]
        work, left = work.where(~gone), left[:, ~gone]
        shell = work.boxes
        for i in range(shell.shape[0]):
            this = np.arange(shell.shape[0])[:, None] == i
            for lo, hi in ((shell.lo, left.lo), (left.hi, shell.hi)):
                slab = Boxes(select(this, Interval.unchecked(lo, hi), shell), work.problem)
                cut_off.append(slab.where(lo[i] < hi[i]))
            shell = select(this, left, shell)
        return Boxes(left, work.problem), cut_off


def checked_size(box: Interval, tolerance: ArrayLike, budget: int) -> int:
    """Return the number of variables of the box."""
    if not box.shape or not box.shape[-1]:
        raise ValueError(f"the box has shape {box.shape}; expected (..., n) with the variables on the last axis")
    if not (np.isfinite(box.lo) & np.isfinite(box.hi)).all():
        raise ValueError("the start box is empty or infinite; give the finite physical range of each variable")
    size = np.asarray(tolerance, dtype=float)
    if size.shape not in ((), box.shape[-1:]) or not (size > 0).all():
        raise ValueError(
            f"tolerance is {tolerance!r}; expected a positive width, one number or one for each of {box.shape[-1]} variables"
        )
    if budget < 1:
        raise ValueError(f"budget is {budget}; expected 1 or more, since the start box has to be examined")
    return box.shape[-1]


def _flat(x: Interval, shape: tuple[int, ...]) -> Interval:
    return Interval.unchecked(np.broadcast_to(x.lo, shape).reshape(-1), np.broadcast_to(x.hi, shape).reshape(-1))


def _volume(boxes: Interval, problem: Array, shape: tuple[int, ...]) -> Array:
    sizes = np.prod(boxes.hi - boxes.lo, axis=-1)
    return np.bincount(problem, weights=sizes, minlength=math.prod(shape)).reshape(shape)
