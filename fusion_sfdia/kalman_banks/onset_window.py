"""Generalised likelihood ratios over onsets (Willsky and Jones 1976) for any additive hypothesis, on one set of innovations.

A hypothesis of unit size changes the readings by D and the state by C in each step from its onset on. Its effect on the
filter's prediction, eta, and on the innovation, M, follow from the filter's own F, H and K:

    eta <- F eta - C,    M = D - H eta,    eta <- eta + K M

so that eta is the change of the estimate less that of the state. Over the steps since the onset a = sum M' S^-1 d and
b = sum diag(M' S^-1 M) give the statistic a^2 / b (chi-square with 1 degree of freedom when healthy), the size a / b and its
variance 1 / b.

    bias of a sensor              D = e_i                    ramp of a sensor       D = (samples since the onset) e_i
    jump of an augmented state    C = F e_j at the onset     drift of one           C = F e_j in each step
    error of a state equation     C = phi_1(F) e_j in each step

Onsets are dense in the near past and sparse before: of each power of two, the four latest onsets that are multiples of it are
kept, two more for each doubling of the memory.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

LATEST = 4  # onsets kept of each power of two


class Onsets(NamedTuple):
    """Sums over the steps since each of L onsets, for q hypotheses.

    eta (..., L, n, q): after the update. a, b (..., L, q). age (..., L): steps since the onset, counting its own.
    """

    eta: Array
    a: Array
    b: Array
    age: Array


def slots(memory: int) -> int:
    """Number of onsets kept for a memory of that many samples."""
    return LATEST + 2 * (levels(memory) - 1)


def levels(memory: int) -> int:
    """Powers of two whose onsets are kept."""
    return max(1, int(np.ceil(np.log2(max(memory, LATEST) / LATEST))) + 1)


def kept(step: int, memory: int) -> list[int]:
    """The onsets (steps, newest first) that are kept at a step; negative ones stand for none yet."""
    found: set[int] = set()
    for level in range(levels(memory)):
        size = 2**level
        last = step // size * size
        found |= {last - i * size for i in range(LATEST)}
    return sorted(found, reverse=True)


def moves(step: int, memory: int) -> list[int]:
    """For each place but the first, from which place of the step before its onset comes."""
    before = {onset: i for i, onset in enumerate(kept(step - 1, memory))}
    return [before[onset] for onset in kept(step, memory)[1:]]


def empty(batch: tuple[int, ...], memory: int, states: int, hypotheses: int, kind: Any = float) -> Onsets:
    count = slots(memory)
    sums = (*batch, count, hypotheses)
    return Onsets(np.zeros((*batch, count, states, hypotheses), kind), np.zeros(sums), np.zeros(sums), np.zeros((*batch, count)))


def aged(window: Onsets, step: int, memory: int) -> Onsets:
    """Add the present step as an onset; the others move to the places where they are kept."""
    places = moves(step, memory)
    parts = []
    for v, axis in zip(window, (-3, -2, -2, -1), strict=True):
        old = np.take(v, places, axis=axis)
        new = np.zeros_like(np.take(v, [0], axis=axis))
        parts.append(np.concatenate([new, old], axis=axis))
    return Onsets(*parts)._replace(age=parts[3] + 1)
