"""The noise that readings show while a filter runs: its size, its correlation from sample to sample, and single outliers.

Of each sensor e = u / sqrt(w), the leave-one-out innovation over its stated standard deviation, is white with variance 1 where
the model and the stated noise are right. Five things are followed, all so that a fault moves them little:

    size          ln kappa <- ln kappa +- STEP, + where e^2 > .455 kappa, the median of chi-square (Robbins and Monro 1951),
                  with ln kappa at most LARGER (higher for many sensors, see `larger_from`), since the part above enlarges
                  the filter's noise;
                  what all sensors have in common is followed faster, as a fault of a sensor does not move it
    correlation   q = 1 - mean of min((e_k - e_k-1)^2 / (2 kappa), CUT) / CUT_MEAN: a lasting fault of a sensor changes one
                  difference; a fault of the process, which grows in many, raises the q of all sensors together: more of that
                  counts a block of BLOCK samples later where hypotheses compete, and for the process
    clipping      readings count as if |e| were CLIP at most, the worst first
    level         m, the mean of clipped e over the last LEVEL samples; the model is off by M = max(0, median of m^2 / .455 -
                  (1 + CHANCE_LEVEL / sqrt(N)) V), the median over N sensors, V the variance that noise gives m; this counts a
                  block of BLOCK samples later, so that a fault which begins is judged without it
    sums          v, the mean of min(a^2 / (b c), CUT) / CUT_MEAN, at most 1, over sensors and the onsets of windows at least
                  LONG samples ago, c as below: the process may move less than the model allows, the filter may take up a part
                  of slow noise, and then sums vary less than the noise lets them

A sum over n samples of noise with the correlation q from each sample to the next varies c(n, q) times as much as one of white
noise, see `plant.slow_noise`, and where levels vary by M from sensor to sensor the square of the sum grows by n^2 M, its
variance over that of white noise by n M. Where a sensor states slow noise (`SlowNoise`), of the share s and the correlation q
from sample to sample, sums vary at least 1 + s (c(n, q) - 1) times as much. The statistics of windows are divided by all that,
from LONG samples on by v times it, but by no less than for white noise or for the noise that is stated, those of the process
without M: all sensors together show it.
"""

from __future__ import annotations

from dataclasses import replace
from math import exp, isfinite
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammainc

from fusion_sfdia.common.alike import single
from fusion_sfdia.derivatives.equation import compiled, part, python_first
from fusion_sfdia.detectors.kalman_banks.bank_kernels import contiguous
from fusion_sfdia.detectors.kalman_banks.leave_one_out import LeaveOneOut
from fusion_sfdia.detectors.kalman_banks.likelihood_window import Inflation, Weighed
from fusion_sfdia.plant import slow_noise

Array = NDArray[Any]

STEP, FIRST = 0.025, 4.0  # of ln kappa in a sample, and 1 / (FIRST + k) in the k-th where that is more
TOGETHER = 0.2  # of what all sensors have in common, where all are on one side
MEDIAN = 0.45493642311957283  # of chi-square with 1 degree of freedom
LARGER = 0.5  # of ln kappa; by what is above it the filter's noise is enlarged, below it the difference may be chance
MANY, LARGEST = 100, 1.0  # sensors above which chance alone exceeds LARGER: it rises by LARGER / 2 per doubling, up to LARGEST
MOST = 6.0  # |ln kappa|
FADE = 1 - 1 / 32  # of `spread` in a sample: windows still have sums from before the filter's noise was enlarged
CLIP = 3.0  # standard deviations
CUT = 4.0  # of half the squared difference of neighbours
CUT_MEAN = float(gammainc(1.5, CUT / 2) + CUT * (1 - gammainc(0.5, CUT / 2)))  # of min(chi-square, CUT)
LEVEL = 64.0  # samples in the running mean of e
BLOCK = 16  # samples
CHANCE_LEVEL = 2.33  # standard error of the median of N chi-square variables, times sqrt(N), over that median: 1 / (2 f .455)
OWN, ALL = 128.0, 24.0  # samples in the running means of a sensor, and of all together
SUPPOSED, WEIGHT = 0.8, 8.0  # correlation before any reading, and the samples that it counts for
CHANCE = 0.2  # correlation of a sensor alone that counts: about two standard errors of OWN samples
HIGHEST = 0.98  # correlation
LONG = 8.0  # samples in sums whose variance is followed
SUMS, EXPECTED = 256.0, 64.0  # samples in its running mean, and those that count as expected before any
SMALLEST = 0.4  # of what is expected

inflation = part(slow_noise.inflation)


class ReadingNoise(NamedTuple):
    """What is known of the noise: ln kappa (..., N), the last e (..., N), NaN before, running means of the cut differences.

    common (...): the part of ln kappa that all sensors have. spread (..., N): what kappa has been lately, where the filter did
    not take it into account. own (..., N): of each sensor, every (...): of all; samples (...): samples in these means. level
    (..., N): m. off (...): M as it counts, later (...): as it will in the next block. sums (...): v. q (...), q_later
    (...): the correlation of all sensors together, likewise.
    """

    size: Array
    common: Array
    spread: Array
    last: Array
    own: Array
    every: Array
    samples: Array
    level: Array
    off: Array
    later: Array
    sums: Array
    q: Array
    q_later: Array


def nothing_shown(batch: tuple[int, ...], sensors: int) -> ReadingNoise:
    """Before the first readings noise is supposed to be of the stated size and correlated by SUPPOSED."""
    shape, supposed = (*batch, sensors), (1 - SUPPOSED) * CUT_MEAN
    return ReadingNoise(
        np.zeros(shape),
        np.zeros(batch),
        np.ones(shape),
        np.full(shape, np.nan),
        np.full(shape, CUT_MEAN),
        np.full(batch, supposed),
        np.full(batch, WEIGHT),
        np.zeros(shape),
        np.zeros(batch),
        np.zeros(batch),
        np.ones(batch),
        np.full(batch, SUPPOSED),
        np.full(batch, SUPPOSED),
    )


def learnt(now: ReadingNoise, found: LeaveOneOut, where: Array) -> ReadingNoise:
    """With the readings of a sample, in runs `where` (...) holds; sensors that are not used keep what is known of them."""
    u, w, used, where = map(contiguous, (found.whitened, found.weight, found.used, where))
    known = ReadingNoise(*(np.array(v, order="C") for v in now))
    _learnt(larger_from(now.size.shape[-1]), u, w, used, where, known)
    return known


def larger_from(sensors: int) -> float:
    """The ln kappa by what is above which the filter's noise is enlarged, of so many sensors."""
    return max(LARGER, min(LARGER * (1 + float(np.log2(sensors / MANY)) / 2), LARGEST))


@part
def unseen(size: float, larger: float) -> float:
    """Variance of e, from ln kappa: that part of the noise which the filter does not take into account."""
    return exp(min(size, larger))


@part
def correlation(mean: float) -> float:
    """q, from the mean of the cut differences."""
    return min(max(1 - mean / CUT_MEAN, 0.0), HIGHEST)


@part
def common_correlation(own: Array, every: float) -> float:
    """Correlation q of all sensors together, from the means of each (N,) and that of all."""
    found = 0.0
    for i in range(own.size):
        found += correlation(own[i]) / own.size
    return max(found, correlation(every))


@compiled
def median(values: Array, room: Array) -> float:
    """The median of values (N,), by insertion into room (N,); np.median takes longer to compile than all that is here."""
    N = values.size
    for i in range(N):
        value, place = values[i], i
        while place > 0 and room[place - 1] > value:
            room[place] = room[place - 1]
            place -= 1
        room[place] = value
    return float(room[(N - 1) // 2] + room[N // 2]) / 2


@compiled
def mean(values: Array) -> float:
    """The mean of values (N,); np.mean takes longer to compile."""
    total = 0.0
    for i in range(values.size):
        total += values[i]
    return float(total / values.size)


@python_first
def _learnt(larger: float, u: Array, w: Array, used: Array, where: Array, now: ReadingNoise) -> None:
    """The same of B runs, written into what is known. larger: see `larger_from`."""
    size, common, spread, last, own, every, samples, level, off, later, _, slow, slow_later = now
    B, N = u.shape
    side, squares, room = np.empty(N), np.empty(N), np.empty(N)
    for r in range(B):
        if where[r]:
            moves = max(STEP, 1 / (FIRST + samples[r] - WEIGHT))
            samples[r] += 1
            total, number, mean, differences = 0.0, 0, 0.0, 0
            for i in range(N):
                side[i] = 0.0
                if used[r, i]:
                    e, kappa = u[r, i] / np.sqrt(w[r, i]), unseen(size[r, i], larger)
                    side[i] = 1.0 if e * e > MEDIAN * kappa else -1.0
                    total += side[i]
                    number += 1
                    if isfinite(last[r, i]):
                        change = e - last[r, i]
                        difference = min(change * change / (2 * kappa), CUT)
                        own[r, i] += (difference - own[r, i]) / min(samples[r], OWN)
                        mean += difference
                        differences += 1
                    last[r, i] = e
                    cut = CLIP * np.sqrt(kappa)
                    level[r, i] += (min(max(e, -cut), cut) - level[r, i]) / min(samples[r] - WEIGHT, LEVEL)
                squares[i] = level[r, i] * level[r, i]
            before = common[r]
            common[r] = min(max(common[r] + TOGETHER * total / max(number, 1), -MOST), MOST)
            if differences:
                every[r] += (mean / differences - every[r]) / min(samples[r], ALL)
            for i in range(N):
                size[r, i] = min(max(size[r, i] + common[r] - before + moves * side[i], -MOST), MOST)
                spread[r, i] = max(FADE * spread[r, i], unseen(size[r, i], larger), 1.0)
            seen = samples[r] - WEIGHT
            if seen <= BLOCK or seen % BLOCK == 0:
                q = common_correlation(own[r], every[r])
                slow[r] = q if seen <= BLOCK else slow_later[r]
                slow_later[r] = q
                n = min(seen, 2 * LEVEL - 1)  # a running mean of white noise varies by 1 / (2 LEVEL - 1) in the end
                chance = (1 + CHANCE_LEVEL / np.sqrt(N)) * median(spread[r], room) * inflation(n, q) / n
                found = max(median(squares, room) / MEDIAN - chance, 0.0)
                off[r] = found if seen <= BLOCK else later[r]
                later[r] = found


def with_sums(now: ReadingNoise, window: Weighed, used: Array, stated: Array, where: Array) -> ReadingNoise:
    """With the sums of a window, in runs `where` (...) holds, of sensors that are used (..., N). stated: of `inflation_of`."""
    sums = np.array(now.sums, order="C")
    a, b, age, used, where = map(contiguous, (window.a, window.b, window.age, used, where))
    own, every, spread, off, samples = map(contiguous, (now.own, now.every, now.spread, now.off, now.samples))
    _with_sums(a, b, age, used, where, own, every, spread, off, samples, stated, sums)
    return now._replace(sums=sums)


@python_first
def _with_sums(
    a: Array, b: Array, age: Array, used: Array, where: Array, own: Array, every: Array, spread: Array, off: Array,
    samples: Array, stated: Array, sums: Array,
) -> None:  # fmt: skip
    """The same of B runs, written into sums (B,)."""
    (B, L), N = age.shape, own.shape[1]
    for r in range(B):
        total, number = 0.0, 0
        if where[r]:
            together = common_correlation(own[r], every[r])
            for l in range(L):  # noqa: E741
                n = age[r, l]
                if n >= LONG:
                    least = stated[min(int(n), len(stated) - 1)]
                    shared = max(inflation(n, together), mean(least))
                    for i in range(N):
                        if used[r, i] and b[r, l, i] > 0:
                            c = varied(n, correlation(own[r, i]), together, shared, least[i], spread[r, i], off[r])
                            total += min(a[r, l, i] * a[r, l, i] / (b[r, l, i] * c), CUT)
                            number += 1
        if number:
            step = (total / (number * CUT_MEAN) - sums[r]) / min(samples[r] + EXPECTED, SUMS)
            sums[r] = min(max(sums[r] + step, SMALLEST), 1.0)


@part
def varied(n: float, q: float, together: float, shared: float, least: float, spread: float, off: float) -> float:
    """By how much the sums of a sensor over n samples vary more than those of white noise, before v counts."""
    alone = inflation(n, q) if q > max(together, CHANCE) else shared
    return float(max(alone, least) * spread + n * off)


def is_larger(now: ReadingNoise) -> Array:
    """Whether the noise of a sensor (..., N) is clearly larger than stated."""
    return np.asarray(now.size > larger_from(now.size.shape[-1]))


def inflation_of(now: ReadingNoise, age: Array, stated: Array) -> Inflation:
    """By how much the sums over windows of that age (..., L) vary more than those of white noise.

    By the correlation of all sensors together, and the median of what their variances are over the stated ones; of each sensor
    by its own, where that is more, and by what the model is off; at least by the slow noise that sensors state, together by its
    mean. stated (M, N): what that is of sums over 0 to M - 1 samples, see `plant.slow_noise`; longer ones count as M - 1.
    """
    age, own, every, spread = map(contiguous, (age, now.own, now.every, now.spread))
    off, sums, slow = map(contiguous, (now.off, now.sums, now.q))
    return Inflation(*_inflation(age, own, every, spread, off, sums, slow, stated))


@python_first
def _inflation(
    age: Array, own: Array, every: Array, spread: Array, off: Array, sums: Array, slow: Array, stated: Array
) -> tuple[Array, Array]:
    """The same of B runs: common (B, L), own (B, L, N)."""
    (B, L), N = age.shape, own.shape[1]
    common, each, room = np.empty((B, L)), np.empty((B, L, N)), np.empty(N)
    for r in range(B):
        together = common_correlation(own[r], every[r])
        usual = median(spread[r], room)
        for l in range(L):  # noqa: E741
            n = max(age[r, l], 1.0)
            least = stated[min(int(n), len(stated) - 1)]
            usual_least = mean(least)
            shared = max(inflation(n, together), usual_least)
            between = max(inflation(n, min(together, slow[r])), usual_least)
            v = sums[r] if n >= LONG else 1.0
            common[r, l] = max(v * between, usual_least) * usual
            for i in range(N):
                c = varied(n, correlation(own[r, i]), together, shared, least[i], spread[r, i], off[r])
                each[r, l, i] = max(v * c, least[i] * spread[r, i] + n * off[r])
    return common, each


class Clipped(NamedTuple):
    """The statistics of readings that are clipped, and by how much u is less than that of the readings themselves (..., N)."""

    found: LeaveOneOut
    less: Array


def clipped(found: LeaveOneOut, variance: Array) -> Clipped:
    """Readings with |e| at most CLIP sqrt(variance) (..., N), the worst clipped first, each at most once."""
    if not (found.chi_square > CLIP**2 * variance).any():
        return Clipped(found, np.zeros((1,) * found.used.ndim))
    u, w, limit = map(contiguous, (found.whitened, found.weight, variance))
    if found.half is None:  # of gains at rest
        after, _ = _clipped(u, w, contiguous(single(found.inverse)), u[:, :0], CLIP * np.sqrt(limit), True)
        return Clipped(replace(found, whitened=after), found.whitened - after)
    assert found.scores is not None
    half = contiguous(found.half[:1] if found.half.strides[0] == 0 else found.half)
    after, turned = _clipped(u, w, half, contiguous(found.scores), CLIP * np.sqrt(limit), False)
    return Clipped(replace(found, whitened=after, scores=turned), found.whitened - after)


def unclipped(now: Clipped, found: LeaveOneOut, where: Array) -> Clipped:
    """With the readings `found` themselves in the runs `where` (...) holds."""
    if not where.any():
        return now
    chosen = where[..., None]
    whitened, scores = np.where(chosen, found.whitened, now.found.whitened), found.scores
    if now.found.scores is not None and scores is not None:
        scores = np.where(chosen, scores, now.found.scores)
    return Clipped(replace(now.found, whitened=whitened, scores=scores), np.where(chosen, 0.0, now.less))


@python_first
def _clipped(u: Array, w: Array, half: Array, scores: Array, limit: Array, inverted: bool) -> tuple[Array, Array]:
    """Whitened u and scores U' d (B, N) of readings that are clipped; half U (B or 1, N, N), or S^-1 where `inverted`, limit
    (B, N) of |e|.
    """
    B, N = u.shape
    after, turned = u.copy(), scores.copy()
    done = np.empty(N, np.bool_)
    for r in range(B):
        U = half[r % half.shape[0]]
        done[:] = False
        for _ in range(N):
            worst, most = -1, 0.0
            for i in range(N):
                if w[r, i] > 0 and not done[i]:
                    over = abs(after[r, i]) / np.sqrt(w[r, i]) - limit[r, i]
                    if over > most:
                        worst, most = i, over
            if worst < 0:
                break
            done[worst] = True
            delta = most / np.sqrt(w[r, worst])
            if after[r, worst] < 0:
                delta = -delta
            for j in range(turned.shape[1]):
                turned[r, j] -= U[worst, j] * delta
            for i in range(N):
                total = U[worst, i] if inverted else 0.0
                for j in range(turned.shape[1]):
                    total += U[i, j] * U[worst, j]
                if w[r, i] > 0:
                    after[r, i] -= total * delta
    return after, turned
