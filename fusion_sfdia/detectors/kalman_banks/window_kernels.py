"""Compiled loops of windows of likelihood ratios: for each run of a batch by itself, so that it has the bits it has alone.

Arrays have one batch axis first, of B runs, or of 1 where they are the same for all.
"""

from __future__ import annotations

from math import log1p
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.derivatives.equation import compiled, part, python_first

Array = NDArray[Any]

SPARSE = 1 / 8  # share of entries up to which a product by those that are not 0 takes less time


@python_first
def shift(a: Array, b: Array, age: Array, places: Array) -> tuple[Array, Array, Array]:
    """Sums a (B, L, q), b (B or 1, L, q) and age (B, L) with the onset of each slot taken from the slot `places` (L,).

    A new one where that is negative.
    """
    sums, squares, ages = np.empty(a.shape), np.empty(b.shape), np.empty(age.shape)
    for r in range(a.shape[0]):
        for l in range(places.shape[0]):  # noqa: E741
            k = places[l]
            ages[r, l] = age[r, k] + 1.0 if k >= 0 else 1.0
            for j in range(a.shape[2]):
                sums[r, l, j] = a[r, k, j] if k >= 0 else 0.0
                if r < b.shape[0]:
                    squares[r, l, j] = b[r, k, j] if k >= 0 else 0.0
    return sums, squares, ages


@part
def entries(H: Array, first: int, row: Array, column: Array, value: Array) -> int:
    """Write the entries of H (N, d) from column `first` on that are not 0 to room for all, and return how many they are."""
    few = 0
    for i in range(H.shape[0]):
        for j in range(first, H.shape[1]):
            if H[i, j] != 0:
                row[few], column[few], value[few] = i, j, H[i, j]
                few += 1
    return few


@compiled
def subtract_product(A: Array, B: Array, H: Array, into: Array) -> None:
    """A <- A - B H, the first columns of A (n, ..), with H (N, d); `into` (n, d) is workspace.

    Where most entries of H are 0, as of sensors that each read one state, only the others are taken.
    """
    N, d = H.shape
    row, column, value = np.empty(N * d, np.int64), np.empty(N * d, np.int64), np.empty(N * d, H.dtype)
    few = entries(H, 0, row, column, value)
    if few > SPARSE * N * d:
        np.dot(B, H, into)
        for i in range(A.shape[0]):
            for j in range(d):
                A[i, j] -= into[i, j]
    else:
        for i in range(A.shape[0]):
            of, to = B[i], A[i]
            for f in range(few):
                to[column[f]] -= of[row[f]] * value[f]


@compiled
def transition(
    F: Array, K: Array, before: Array, H: Array, half: Array, turned: Array, sizes: tuple[int, int, int]
) -> tuple[Array, Array, Array, Array]:
    """A = F - F K H, its columns of the `leading` states, F K, and -U' H of the states that are `read`, its first rows.

    sizes: leading, read, and how many rows. F (B, n, n), K (B, n, N), H of the update before and now (B, N, n), U (B, N, N),
    each of 1 run where it is the same for all, are rounded to the type of `turned` first, to which U' is written.
    """
    B = max(F.shape[0], K.shape[0], before.shape[0], H.shape[0], half.shape[0])
    n, N = K.shape[1:]
    leading, read, rank = sizes
    kind = turned.dtype
    A, columns, FK = np.empty((B, n, n), kind), np.empty((B, n, leading), kind), np.empty((B, n, N), kind)
    seen = np.empty((B, rank, read), kind)
    gain, taken, room = np.empty((n, N), kind), np.empty((n, read), kind), np.empty((rank, read), kind)
    was, now = np.empty((N, read), kind), np.empty((N, read), kind)
    for k in range(half.shape[0]):
        for i in range(N):
            for j in range(N):
                turned[k, i, j] = half[k, j, i]
    for k in range(B):
        f, g, h, m, u = k % F.shape[0], k % K.shape[0], k % before.shape[0], k % H.shape[0], k % turned.shape[0]
        for i in range(n):
            for j in range(n):
                A[k, i, j] = F[f, i, j]
            for j in range(N):
                gain[i, j] = K[g, i, j]
        for i in range(N):
            for j in range(read):
                was[i, j] = before[h, i, j]
                now[i, j] = H[m, i, j]
        np.dot(A[k], gain, FK[k])
        for i in range(rank):
            for j in range(read):
                seen[k, i, j] = 0.0
        subtract_product(A[k], FK[k], was, taken)
        subtract_product(seen[k], turned[u, :rank], now, room)
        for i in range(n):
            for j in range(leading):
                columns[k, i, j] = A[k, i, j]
    return A, columns, FK, seen


class Onsets(NamedTuple):
    """The onsets of windows, by slot: age (B, L), places (L,) of theirs in the windows before, -1 for none; D of the readings
    before, and now (B, L).
    """

    age: Array
    places: Array
    before: Array
    readings: Array


class StepArrays(NamedTuple):
    """What a step takes windows over: of `WindowStep` A, its leading columns, FK, U', -U' H and U' d; change (B, n, r): C, the
    first `once` at the onset only.
    """

    A: Array
    leading: Array
    FK: Array
    half: Array
    seen: Array
    scores: Array
    change: Array
    once: int


@compiled
def weighed(old: Array, eta: Array, a: Array, b: Array, onsets: Onsets, step: StepArrays) -> None:
    """Take windows over a step, and add the present innovations to a and b (B, L, q), in place: see `window_step`.

    eta (B, L, n, q) is written, from the slots `places` of `old`. A (B, n, n), and its columns of the `leading` states; the
    others count only where they are not 0. FK (B, n, N), half (B, N, N), seen (B, rank, read): -U' H of the states that are
    read, whose other rows are 0, scores (B, N). Each is of 1 run where it is the same for all; eta and b may be. One onset
    comes after the other, so that what belongs to it stays near. Onsets that are the same have the same bits.
    """
    age, places, before, readings = onsets
    A, leading, FK, half, seen, scores, change, once = step
    E, L, n, q = eta.shape
    N, r, d, rank, read = half.shape[1], change.shape[2], leading.shape[2], seen.shape[1], seen.shape[2]
    number = eta.dtype.type
    zero = number(0)
    M, sums, squares = np.empty((N, q), eta.dtype), np.empty(q, eta.dtype), np.empty(q, eta.dtype)
    row, column, factor = np.empty(n * n, np.int64), np.empty(n * n, np.int64), np.empty(n * n, eta.dtype)
    for k in range(E):
        own = k % A.shape[0]
        few = entries(A[own], d, row, column, factor)
        c, now, turn = k % change.shape[0], k % seen.shape[0], k % half.shape[0]
        for l in range(L):  # noqa: E741
            into = eta[k, l]
            if places[l] < 0:
                for i in range(n):
                    for j in range(q):
                        into[i, j] = zero
            else:
                out_of, by = old[k, places[l]], number(before[k % before.shape[0], places[l]])
                np.dot(leading[own], out_of[:d], into)
                for f in range(few):
                    to, of, times = into[row[f]], out_of[column[f]], factor[f]
                    for j in range(q):
                        to[j] += times * of[j]
                for i in range(n):
                    to, of = into[i], FK[own, i]
                    for j in range(N):
                        to[j] += by * of[j]
            for i in range(n if r else 0):
                to, of = into[i, q - r :], change[c, i]
                for j in range(0 if age[k, l] <= 1 else once, r):
                    to[j] -= of[j]
            unseen = places[l] < 0 and not r
            if not unseen:
                np.dot(seen[now], into[:read], M[:rank])
            for i in range(0 if unseen else rank, N):
                for j in range(q):
                    M[i, j] = zero
            by = number(readings[k % readings.shape[0], l])
            for j in range(q):
                squares[j] = zero
            for i in range(N):
                to, of = M[i], half[turn, i]
                for j in range(N):
                    to[j] += by * of[j]
                for j in range(q):
                    squares[j] += to[j] * to[j]
            for run in range(k, k + 1 if E == a.shape[0] else a.shape[0]):
                for j in range(q):
                    sums[j] = zero
                for i in range(N):
                    of, score = M[i], scores[run, i]
                    for j in range(q):
                        sums[j] += score * of[j]
                for j in range(q):
                    a[run, l, j] += sums[j]
                if run < b.shape[0]:
                    for j in range(q):
                        b[run, l, j] += squares[j]


@python_first
def residual_and_threshold(
    whitened: Array, weight: Array, used: Array, statistic: Array, size: Array, information: Array, one: float, window: float
) -> tuple[Array, Array]:
    """Residual and threshold (B, N) of the sample or of the best onset, see `likelihood_window.residual_and_threshold`."""
    residual, threshold = np.empty(whitened.shape), np.empty(whitened.shape)
    for r in range(whitened.shape[0]):
        for i in range(whitened.shape[1]):
            innovation = whitened[r, i] / weight[r, i] if used[r, i] else whitened[r, i]
            if statistic[r, i] / window > whitened[r, i] * innovation / one:
                residual[r, i], threshold[r, i] = size[r, i], np.sqrt(window / information[r, i])
            else:
                residual[r, i], threshold[r, i] = innovation, np.sqrt(one * (1.0 / weight[r, i]))
    return residual, threshold


@python_first
def merged(
    recent: tuple[Array, ...],
    slow: tuple[Array, ...],
    slot: Array,
    age: Array,
    handicap: Array,
    bias: float,
) -> tuple[Array, Array, Array]:
    """Statistic, size, information and evidence (4, B, q) of the window with more evidence of each hypothesis, recent or slow.

    And whether that is the slow one (B, s), of the first s hypotheses, and the size, of the slow one times the age of its onset
    and `bias`. recent (B, q); slow, slot (B, s); age (B, L). handicap (B, P), or (1, P): taken off the last P hypotheses.
    """
    (B, q), (s, P) = recent[0].shape, (slot.shape[1], handicap.shape[1])
    found, far, level = np.empty((4, B, q)), np.empty((B, s), np.bool_), np.empty((B, q))
    for r in range(B):
        for j in range(q):
            of_slow = j < s and slow[3][r, j] > recent[3][r, j]
            for v in range(4):
                found[v, r, j] = slow[v][r, j] if of_slow else recent[v][r, j]
            level[r, j] = found[1, r, j] * (age[r, slot[r, j]] * bias if of_slow else 1.0)
            if j < s:
                far[r, j] = of_slow
            if j >= q - P:
                found[3, r, j] -= handicap[r % handicap.shape[0], j - (q - P)]
    return found, far, level


@python_first
def best(
    a: Array, b: Array, usable: Array, size: Array, common: Array, own: Array, first: int, least: float
) -> tuple[Array, Array, Array, Array, Array]:
    """Statistic, size, information, evidence and slot (B, q) of the best onset from the slot `first` on, see `best_onset`.

    size (B, L, q), (1, L, q) or (1, 1, q): standard deviations before any reading; usable (B, q). common (B, L) or (1, 1), own
    (B, L, N) or (1, 1, 0): inflation of all sums of an onset, and of those of the first N hypotheses.
    """
    B, L, q = a.shape
    statistic, found, information = np.empty((B, q)), np.empty((B, q)), np.empty((B, q))
    evidence, slot = np.empty((B, q)), np.empty((B, q), np.int64)
    top, at = np.empty(q), np.empty(q)  # largest statistic, and its onset as a number of the same kind: vector instructions
    for r in range(B):
        for j in range(q):
            top[j], at[j] = -1.0, first
        for l in range(first, L):  # noqa: E741
            sums, squares, spread, place = a[r, l], b[r, l], size[r % size.shape[0], l % size.shape[1]], float(l)
            scale = common[r % common.shape[0], l % common.shape[1]]
            for j in range(q):
                informed = squares[j] * (spread[j] * spread[j]) > least
                value = sums[j] * sums[j] / (squares[j] * scale)
                better = informed & (value > top[j])
                top[j] = value if better else top[j]
                at[j] = place if better else at[j]
        for j in range(q):
            statistic[r, j], found[r, j], information[r, j], evidence[r, j], slot[r, j] = 0.0, 0.0, 1.0, -np.inf, first
            if usable[r, j] and top[j] >= 0.0:
                l = int(at[j])  # noqa: E741
                s, scale = size[r % size.shape[0], l % size.shape[1], j], common[r % common.shape[0], l % common.shape[1]]
                slot[r, j], found[r, j], expected = l, a[r, l, j] / b[r, l, j], b[r, l, j] / scale * (s * s)
                value = found[r, j] * found[r, j] * (b[r, l, j] / scale)
                evidence[r, j] = value * (expected / (1.0 + expected)) - log1p(expected)
                if j < own.shape[2]:
                    scale = own[r, l, j]
                information[r, j] = b[r, l, j] / scale
                statistic[r, j] = found[r, j] * found[r, j] * information[r, j]
    return statistic, found, information, evidence, slot
