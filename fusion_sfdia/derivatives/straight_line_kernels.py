"""The interpreter of straight-line programs, and the steps of a plant by it.

A row of the registers R (S, 1 + w) holds a value and its derivatives along w directions; w is 0 where none are asked. So does
one of states (n, 1 + w): what is linear is the same for all its columns. A state of a batch is taken by itself, so that it has
the bits that it has alone.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.derivatives.equation import compiled, part

Array = NDArray[Any]
# Elements are copied one by one: numba takes seconds to compile the check of shapes in an assignment of arrays.

MAX_SWEEPS = 200
ALGEBRAIC_TOLERANCE = 1e-13  # relative change of a sweep at which the fixed point is taken as reached
LN10 = float(np.log(10.0))


@compiled
def interpret(start: int, stop: int, operations: Array, R: Array) -> None:
    """Run the operations of the slots from start to stop; constants stand in R already."""
    w = R.shape[1]
    for s in range(start, stop):
        what, i, j = operations[s, 0], operations[s, 1], operations[s, 2]
        if what == 0:
            continue
        a, b = R[i, 0], R[j, 0]
        by_a, by_b = 1.0, 0.0
        if what == 1:
            v, by_b = a + b, 1.0
        elif what == 2:
            v, by_b = a - b, -1.0
        elif what == 3:
            v, by_a, by_b = a * b, b, a
        elif what == 4:
            v = a / b
            by_a, by_b = 1.0 / b, -v / b
        elif what == 5:
            v = a**b
            if w > 1:
                by_a = b * a ** (b - 1.0)
                for c in range(1, w):
                    if R[j, c] != 0.0:
                        by_b = v * np.log(a)
        elif what == 6:
            v, by_a = -a, -1.0
        elif what == 7:
            v = np.sqrt(a)
            by_a = 0.5 / v
        elif what == 8:
            v = np.exp(a)
            by_a = v
        elif what == 9:
            v = np.expm1(a)
            by_a = v + 1.0
        elif what == 10:
            v, by_a = np.log(a), 1.0 / a
        elif what == 11:
            v, by_a = np.log10(a), 1.0 / (a * LN10)
        elif what == 12:
            v, by_a = np.log1p(a), 1.0 / (1.0 + a)
        elif what == 13:
            v = np.sin(a)
            if w > 1:
                by_a = np.cos(a)
        elif what == 14:
            v = np.cos(a)
            if w > 1:
                by_a = -np.sin(a)
        elif what == 15:
            v = np.tanh(a)
            by_a = 1.0 - v * v
        else:
            v, by_a = np.arctan(a), 1.0 / (1.0 + a * a)
        R[s, 0] = v
        if by_b == 0.0:
            for c in range(1, w):
                R[s, c] = by_a * R[i, c]
        else:
            for c in range(1, w):
                R[s, c] = by_a * R[i, c] + by_b * R[j, c]


@part
def settle(k: int, z: int, nominal: Array, program: Any, R: Array) -> bool:
    """Solve z = phi by sweeps from the nominal values (k,), in the slots of z from `z` on; whether it has settled."""
    w = R.shape[1]
    for j in range(k):
        for c in range(w):
            R[z + j, c] = 0.0
        R[z + j, 0] = nominal[j]
    settled = k == 0
    for _ in range(0 if settled else MAX_SWEEPS):
        interpret(z, program.first, program.operations, R)
        settled = True
        for c in range(w):
            largest = 0.0
            for j in range(k):
                new = R[program.phi[j], c]
                largest = max(largest if c else max(abs(nominal[j]), 1e-300), abs(new))
                if c == 0 and abs(new - R[z + j, 0]) > ALGEBRAIC_TOLERANCE * largest:
                    settled = False
            for j in range(k if c else 0):
                if abs(R[program.phi[j], c] - R[z + j, c]) > ALGEBRAIC_TOLERANCE * largest:
                    settled = False
        for j in range(k):
            for c in range(w):
                R[z + j, c] = R[program.phi[j], c]
        settled = settled or not program.implicit
        if settled:
            break
    return settled


@part
def load(x: Array, u: Array, theta: Array, k: int, state: Array, program: Any, R: Array) -> None:
    """Put constants, u (m,) and theta (p,) into the registers, with derivatives along x, and where w > n along u and theta.

    And x (n,) into `state` (n, 1 + w).
    """
    n, m, w = x.shape[0], u.shape[0], R.shape[1]
    for s in range(R.shape[0]):
        for c in range(w):
            R[s, c] = program.value[s] if c == 0 else 0.0
    for i in range(n):
        for c in range(w):
            state[i, c] = x[i] if c == 0 else 1.0 if c == 1 + i else 0.0
    for j in range(m + theta.shape[0]):
        R[1 + n + k + j, 0] = u[j] if j < m else theta[j - m]
        if 1 + n + j < w:
            R[1 + n + k + j, 1 + n + j] = 1.0


@part
def enter(t: float, state: Array, k: int, nominal: Array, program: Any, R: Array) -> bool:
    """Put t, `state` (n, 1 + w) and the z that belongs to them into the registers; whether it has settled."""
    n = state.shape[0]
    R[0, 0] = t
    for i in range(n):
        for c in range(R.shape[1]):
            R[1 + i, c] = state[i, c]
    return settle(k, 1 + n, nominal, program, R)


@compiled
def advance(
    t: float,
    x: Array,
    u: Array,
    theta: Array,
    dt: float,
    substeps: int,
    decay: Array,
    nominal: Array,
    program: Any,
    picks: Array,
    width: int,
) -> tuple[Array, Array, bool]:
    """The variables (x, z) at `picks` (N,) after dt, 0 substeps for now, of states (B, n): (B, N), derivatives (B, N, width)
    and whether every z has settled; x, u, theta with B rows or one.

    By `runge_kutta_4`, with rates `decay` (n,) by `exponential_midpoint`. width: 0, n, or n + m + p for derivatives along u
    and theta, too. It is one loop for steps and readings, since most of the time to compile is that of what both contain.
    """
    B, n, k, w = max(x.shape[0], u.shape[0], theta.shape[0]), x.shape[1], nominal.shape[0], 1 + width
    found, by = np.empty((B, picks.shape[0])), np.empty((B, picks.shape[0], width))
    R, at, start, total = np.empty((program.value.shape[0], w)), np.empty((n, w)), np.empty((n, w)), np.empty((n, w))
    settled, decays, h = True, decay.shape[0] > 0, dt / max(substeps, 1)
    stages, last = 2 if decays else 4, 0
    for i in range(picks.shape[0]):
        last = max(last, picks[i])
    for b in range(B):
        load(x[b % x.shape[0]], u[b % u.shape[0]], theta[b % theta.shape[0]], k, start, program, R)
        for s in range(substeps + 1):
            for i in range(n):
                for c in range(w):
                    at[i, c] = start[i, c]
            for stage in range(stages):
                if s == substeps and last < n:
                    break
                offset = 0.0 if stage == 0 else h if stage == 3 else h / 2
                settled &= enter(t + s * h + offset, at, k, nominal, program, R)
                if s == substeps:
                    break
                interpret(program.first, program.operations.shape[0], program.operations, R)
                weight, reach, decayed = 2.0 if 0 < stage < 3 else 1.0, h if stage == 2 else h / 2, 0.0
                for i in range(n):
                    rate = R[program.f[i]]
                    if decays:
                        reach = -np.expm1(-decay[i] * (h / 2 if stage == 0 else h)) / decay[i]
                        decayed = decay[i] if stage == 1 else 0.0
                    for c in range(w):
                        slope = rate[c] + decayed * at[i, c] - decayed * start[i, c]
                        total[i, c] = slope if stage == 0 else total[i, c] + weight * slope
                        at[i, c] = start[i, c] + reach * slope
            for i in range(n if s < substeps else 0):
                for c in range(w):
                    start[i, c] = at[i, c] if decays else start[i, c] + h / 6 * total[i, c]
        for i in range(picks.shape[0]):
            of = start[picks[i]] if picks[i] < n else R[1 + picks[i]]
            found[b, i] = of[0]
            for c in range(width):
                by[b, i, c] = of[1 + c]
    return found, by, settled
