"""The interpreter of straight-line programs, and the steps of a plant by it.

A register holds a value V (S,) and its derivatives D (S, w) along w directions; w is 0 where none are asked. A state of a batch
is taken by itself, so that it has the bits that it has alone.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.derivatives.equation import compiled

Array = NDArray[Any]
# Elements are copied one by one: numba takes seconds to compile the check of shapes in an assignment of arrays.

MAX_SWEEPS = 200
ALGEBRAIC_TOLERANCE = 1e-13  # relative change of a sweep at which the fixed point is taken as reached
LN10 = float(np.log(10.0))


@compiled
def interpret(start: int, stop: int, operations: Array, V: Array, D: Array) -> None:
    """Run the operations of the slots from start to stop; constants stand in V already."""
    width = D.shape[1]
    for s in range(start, stop):
        what, i, j = operations[s, 0], operations[s, 1], operations[s, 2]
        if what == 0:
            continue
        a, b = V[i], V[j]
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
            if width:
                by_a = b * a ** (b - 1.0)
                for c in range(width):
                    if D[j, c] != 0.0:
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
            if width:
                by_a = np.cos(a)
        elif what == 14:
            v = np.cos(a)
            if width:
                by_a = -np.sin(a)
        elif what == 15:
            v = np.tanh(a)
            by_a = 1.0 - v * v
        else:
            v, by_a = np.arctan(a), 1.0 / (1.0 + a * a)
        V[s] = v
        if by_b == 0.0:
            for c in range(width):
                D[s, c] = by_a * D[i, c]
        else:
            for c in range(width):
                D[s, c] = by_a * D[i, c] + by_b * D[j, c]


@compiled
def settle(k: int, z: int, nominal: Array, program: Any, V: Array, D: Array) -> bool:
    """Solve z = phi by sweeps from the nominal values (k,), in the slots of z from `z` on; whether it has settled."""
    width = D.shape[1]
    for j in range(k):
        V[z + j] = nominal[j]
        for c in range(width):
            D[z + j, c] = 0.0
    if k == 0:
        return True
    for _ in range(MAX_SWEEPS):
        interpret(0, program.first, program.operations, V, D)
        settled = True
        for j in range(k):
            new, old = V[program.phi[j]], V[z + j]
            if abs(new - old) > ALGEBRAIC_TOLERANCE * max(abs(new), max(abs(nominal[j]), 1e-300)):
                settled = False
        for c in range(width):
            largest = 0.0
            for j in range(k):
                largest = max(largest, abs(D[program.phi[j], c]))
            for j in range(k):
                if abs(D[program.phi[j], c] - D[z + j, c]) > ALGEBRAIC_TOLERANCE * largest:
                    settled = False
        for j in range(k):
            V[z + j] = V[program.phi[j]]
            for c in range(width):
                D[z + j, c] = D[program.phi[j], c]
        if settled or not program.implicit:
            return True
    return False


@compiled
def slope(t: float, x: Array, dx: Array, k: int, nominal: Array, program: Any, V: Array, D: Array) -> bool:
    """Write f at (t, x) to the registers of program.f, with derivatives along those of x, dx (n, w); whether z has settled."""
    n = x.shape[0]
    V[0] = t
    for i in range(n):
        V[1 + i] = x[i]
        for c in range(D.shape[1]):
            D[1 + i, c] = dx[i, c]
    settled = settle(k, 1 + n, nominal, program, V, D)
    interpret(program.first, program.operations.shape[0], program.operations, V, D)
    return settled


@compiled
def load(x: Array, u: Array, theta: Array, k: int, dx: Array, program: Any, V: Array, D: Array) -> None:
    """Put constants, u (m,) and theta (p,) into the registers, with derivatives along x, and where w > n along u and theta."""
    n, m, p = x.shape[0], u.shape[0], theta.shape[0]
    for s in range(V.shape[0]):
        V[s] = program.value[s]
        for c in range(D.shape[1]):
            D[s, c] = 0.0
    for i in range(n):
        for c in range(D.shape[1]):
            dx[i, c] = 1.0 if i == c else 0.0
    for j in range(m + p):
        V[1 + n + k + j] = u[j] if j < m else theta[j - m]
        if n + j < D.shape[1]:
            D[1 + n + k + j, n + j] = 1.0


@compiled
def advance(
    t: float, x: Array, u: Array, theta: Array, dt: float, substeps: int, decay: Array, nominal: Array, width: int, program: Any
) -> tuple[Array, Array, bool]:
    """The states (B, n) after dt, their derivatives (B, n, w) and whether every z has settled; x, u, theta with B rows or one.

    By `runge_kutta_4`, with rates `decay` (n,) by `exponential_midpoint`. w = 0, n, or n + m + p for those along u and theta.
    """
    B, n, k = max(x.shape[0], u.shape[0], theta.shape[0]), x.shape[1], nominal.shape[0]
    ahead, tangent = np.empty((B, n)), np.empty((B, n, width))
    V, D = np.empty(program.value.shape[0]), np.empty((program.value.shape[0], width))
    at, dat, start, dstart = np.empty(n), np.empty((n, width)), np.empty(n), np.empty((n, width))
    total, dtotal = np.empty(n), np.empty((n, width))
    settled = True
    h = dt / substeps
    for b in range(B):
        load(x[b % x.shape[0]], u[b % u.shape[0]], theta[b % theta.shape[0]], k, dstart, program, V, D)
        for i in range(n):
            start[i] = x[b % x.shape[0], i]
        for s in range(substeps):
            t0 = t + s * h
            if decay.shape[0]:
                settled &= slope(t0, start, dstart, k, nominal, program, V, D)
                for i in range(n):
                    step = np.expm1(-decay[i] * h / 2) / decay[i]
                    at[i] = start[i] - step * V[program.f[i]]
                    for c in range(width):
                        dat[i, c] = dstart[i, c] - step * D[program.f[i], c]
                settled &= slope(t0 + h / 2, at, dat, k, nominal, program, V, D)
                for i in range(n):
                    step = np.expm1(-decay[i] * h) / decay[i]
                    start[i] = start[i] - step * (V[program.f[i]] + decay[i] * at[i] - decay[i] * start[i])
                    for c in range(width):
                        change = D[program.f[i], c] + decay[i] * dat[i, c] - decay[i] * dstart[i, c]
                        dstart[i, c] = dstart[i, c] - step * change
                continue
            for i in range(n):
                at[i] = start[i]
                for c in range(width):
                    dat[i, c] = dstart[i, c]
            for stage in range(4):
                settled &= slope(t0 + (0.0 if stage == 0 else h if stage == 3 else h / 2), at, dat, k, nominal, program, V, D)
                weight, reach = 2.0 if 0 < stage < 3 else 1.0, h if stage == 2 else h / 2
                for i in range(n):
                    rate = V[program.f[i]]
                    total[i] = rate if stage == 0 else total[i] + weight * rate
                    at[i] = start[i] + reach * rate
                    for c in range(width):
                        drate = D[program.f[i], c]
                        dtotal[i, c] = drate if stage == 0 else dtotal[i, c] + weight * drate
                        dat[i, c] = dstart[i, c] + reach * drate
            for i in range(n):
                start[i] = start[i] + h / 6 * total[i]
                for c in range(width):
                    dstart[i, c] = dstart[i, c] + h / 6 * dtotal[i, c]
        for i in range(n):
            ahead[b, i] = start[i]
            for c in range(width):
                tangent[b, i, c] = dstart[i, c]
    return ahead, tangent, settled


@compiled
def read(
    t: float, x: Array, u: Array, theta: Array, picks: Array, nominal: Array, width: int, program: Any
) -> tuple[Array, Array, bool]:
    """Variables (x, z) at `picks` (N,) of states (B, n): (B, N), derivatives (B, N, w), and whether every z has settled."""
    B, n = max(x.shape[0], u.shape[0], theta.shape[0]), x.shape[1]
    k, N = nominal.shape[0], picks.shape[0]
    y, by = np.empty((B, N)), np.empty((B, N, width))
    V, D, dx = np.empty(program.value.shape[0]), np.empty((program.value.shape[0], width)), np.empty((n, width))
    settled = True
    for b in range(B):
        load(x[b % x.shape[0]], u[b % u.shape[0]], theta[b % theta.shape[0]], k, dx, program, V, D)
        V[0] = t
        for i in range(n):
            V[1 + i] = x[b % x.shape[0], i]
            for c in range(width):
                D[1 + i, c] = dx[i, c]
        settled &= settle(k, 1 + n, nominal, program, V, D)
        for i in range(N):
            y[b, i] = V[1 + picks[i]]
            for c in range(width):
                by[b, i, c] = D[1 + picks[i], c]
    return y, by, settled
