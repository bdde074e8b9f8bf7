"""A fresh look at the verdicts that stand: a second filter with all sensors, also those that are left out.

Where a sensor fails while the process changes, the filter may take a part of the one for the other. What is left out then fits
an estimate that is wrong, and stays out. While a verdict stands, a look estimates the states again. On its innovations the
causes c that may be there are estimated together, a bias of each sensor and a jump of each unknown, as constants since the look
began (Friedland 1969; eta, M as in `likelihood_window`):

    eta <- F eta,  M = D - H eta,  eta <- eta + K M,    a = sum M' S^-1 d,  A = sum M' S^-1 M,    c = A^-1 a

- The first look begins with a verdict, at what is known then. A sensor is in doubt where what is isolated explains the look no
  better, by a margin of evidence, than if one jump of an unknown took its place.
- Where the verdict is that an unknown has changed, and no sensor is left out, it begins at what was known before. Two faults
  that begin together may look at first as one change of the process: after `ENOUGH` samples the verdict is that one or two
  sensors have failed, if their biases explain the look better, by `AGAINST`, than any one or two causes with a jump.
- The later ones begin after `FIRST` samples, then after `MOST`, with states and unknowns as uncertain as at first, since what
  is known may be wrong. The sensors are right where such a look fits all readings, no bias is beyond `WITHIN` standard
  deviations, and the faults f for which they are left out would show: f'A f - 2 f'a, the evidence against them, is at least
  `AGAINST`. The bank then goes on from the look. Where the evidence against them is less, the sensors are in doubt if a process
  hypothesis has stood, too.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.detectors.health import of_runs
from fusion_sfdia.detectors.kalman_banks.leave_one_out import LeaveOneOut, posterior_and_gain
from fusion_sfdia.filters.estimators import GaussianState
from fusion_sfdia.filters.gaussian import Joint

Array = NDArray[Any]

LEAST, ENOUGH = 8, 16  # samples before a look shows that sensors are right, and before it raises doubt
LINEARISED_AGAIN = 4  # samples after which a later look begins once more, at its own estimate of the states
FIRST, MOST = 32, 64  # samples of the first look, and of the later ones
FITS = 1.5  # normalised innovation squared of a look that explains the readings
FADING = 1 / 16  # share of the present sample in its running mean
WITHIN = 2.0  # standard deviations
AGAINST = 20.0  # twice the logarithm of a likelihood ratio
FORGOTTEN = 32  # samples without a verdict, after which the hypotheses that have stood are forgotten


class Look(NamedTuple):
    """A look at N sensors and p unknowns, with augmented states z.

    estimate: of the augmented plant. samples (...): since the look began, its beginning counted, 0 for no look. nis (...):
    running mean of the normalised innovation squared. eta (..., z, N + p), a (..., N + p), A (..., N + p, N + p): of biases and
    jumps. first (...): whether it is the first one. doubt (..., N): sensors in doubt. stood (..., P): the process hypotheses
    that have stood lately. idle (...): samples without a verdict.
    """

    estimate: GaussianState
    samples: Array
    nis: Array
    eta: Array
    a: Array
    A: Array
    first: Array
    doubt: Array
    stood: Array
    idle: Array


def no_look(estimate: GaussianState, batch: tuple[int, ...], sensors: int, jumps: int) -> Look:
    """Return the state in which nothing is looked at; estimate: of the augmented states, of which the last are the unknowns."""
    states, causes = estimate.x.shape[-1], (*batch, sensors + jumps)
    eta = np.zeros((*batch, states, sensors + jumps))
    eta[..., states - jumps :, sensors:] = -np.eye(jumps)
    return Look(
        estimate, np.zeros(batch), np.ones(batch), eta, np.zeros(causes), np.zeros((*causes, causes[-1])),
        np.ones(batch, bool), np.zeros((*batch, sensors), bool), np.zeros((*batch, states), bool), np.zeros(batch),
    )  # fmt: skip


def begun(now: Look, estimate: GaussianState, where: Array, first: bool, samples: int = 1) -> Look:
    """The look that begins at an estimate in the runs `where` (...) holds; what is in doubt stays so until it has seen enough.

    samples: to begin with.
    """
    if not where.any():
        return now
    sensors = now.doubt.shape[-1]
    fresh = no_look(estimate, where.shape, sensors, now.a.shape[-1] - sensors)
    at = np.full(where.shape, float(samples))
    fresh = fresh._replace(samples=at, first=np.full(where.shape, first), doubt=now.doubt, stood=now.stood, idle=now.idle)
    found: Look = of_runs(where, fresh, now)
    return found


def with_sample(now: Look, F: Array, joint: Joint, found: LeaveOneOut) -> Look:
    """The look after a sample: tangent F (..., z, z) of the step, joint of its prediction, found: of the readings."""
    assert joint.H is not None and found.scores is not None
    x, p, K = posterior_and_gain(joint, found)
    eta = F @ now.eta
    M = -(joint.H @ eta)
    N = M.shape[-2]
    M[..., :N] += np.eye(N)
    back = np.swapaxes(M, -1, -2)
    squared = np.sum(found.scores**2, axis=-1) / np.maximum(np.sum(found.used, axis=-1), 1)
    return now._replace(
        estimate=GaussianState(x, p),
        samples=now.samples + 1,
        nis=now.nis + np.maximum(FADING, 1 / (now.samples + 1)) * (squared - now.nis),
        eta=eta + K @ M,
        a=now.a + (back @ found.whitened[..., None])[..., 0],
        A=now.A + back @ found.inverse @ M,
    )


class Question(NamedTuple):
    """What a look is asked: whether the faults of the sensors that are `out` (..., N) are there.

    fault (..., N): their sizes. size (N + p,): standard deviation of a bias and of a jump before any reading. inflation (...):
    by how much sums over the samples of the look vary more than those of white noise. margin: of evidence.
    """

    out: Array
    fault: Array
    size: Array
    inflation: Array
    margin: float


def answered(now: Look, asked: Question) -> tuple[Look, Array]:
    """The look with its doubt, and the runs (...) in which it shows that the sensors that are out are right."""
    out, fault, size, inflation, margin = asked
    N = out.shape[-1]
    some = np.flatnonzero(out.reshape(-1, N).any(axis=0))
    if not some.size:
        return now._replace(doubt=np.zeros(out.shape, bool)), np.zeros(now.samples.shape, bool)
    causes = np.concatenate([some, np.arange(N, size.size)])
    a = now.a[..., causes] / inflation[..., None]
    A = now.A[..., causes[:, None], causes] / inflation[..., None, None]
    sums, biases = Sums(a, A, size[causes]), out[..., some]
    isolated = np.concatenate([biases, np.zeros((*biases.shape[:-1], size.size - N), bool)], axis=-1)

    b, P = sums.estimated(isolated)
    sd = np.where(isolated, np.sqrt(np.einsum("...ii->...i", P)), np.inf)
    f = np.where(isolated, np.concatenate([fault[..., some], np.zeros(isolated.shape)[..., some.size :]], axis=-1), 0.0)
    against = np.einsum("...i,...ij,...j->...", f, A, f) - 2 * np.sum(f * a, axis=-1)
    within = (np.abs(b) <= WITHIN * sd)[..., : some.size]
    fits = ~now.first & (now.nis <= FITS)
    right = biases.any(axis=-1) & fits & (now.samples > LEAST) & (against >= AGAINST) & np.all(within | ~biases, axis=-1)

    doubt = now.doubt[..., some] & biases
    enough = now.samples > ENOUGH
    unshown = biases & within & (now.stood.any(axis=-1) & (against > 0))[..., None]
    doubt = np.where((enough & fits)[..., None], unshown, doubt)
    if (knows := enough & now.first).any():
        doubt = np.where(knows[..., None], sums.replaced(isolated, some.size, knows, margin), doubt)
    every = np.zeros(out.shape, bool)
    every[..., some] = doubt
    return now._replace(doubt=every), right


def failed_instead(now: Look, size: Array, inflation: Array, where: Array) -> tuple[Array, Array, GaussianState]:
    """In the runs `where` (...) holds, the two sensors (..., N) that have failed in place of the process, none where a jump and
    another cause may explain the look as well; the biases (..., N), and the estimate without what they have done to it.

    size, inflation: as of `Question`.
    """
    N, q = now.doubt.shape[-1], size.size
    failed, bias, estimate = np.zeros(now.doubt.shape, bool), np.zeros(now.doubt.shape), now.estimate
    where = where & now.first & (now.samples == ENOUGH + 1)
    if not where.any():
        return failed, bias, estimate
    sums = Sums(now.a / inflation[..., None], now.A / inflation[..., None, None], size)
    two = sums.of_two()
    biases, jump = two[..., :N, :N].reshape(*where.shape, N * N), two[..., N:, :].max(axis=(-2, -1), initial=-np.inf)
    best = np.argmax(biases, axis=-1)[..., None]
    decisive = where & (np.take_along_axis(biases, best, axis=-1)[..., 0] - jump >= AGAINST)
    which = ((np.arange(q) == best // N) | (np.arange(q) == best % N)) & decisive[..., None]
    found, P = sums.estimated(which)
    x = estimate.x - (now.eta @ found[..., None])[..., 0]
    P = estimate.P + now.eta @ P @ np.swapaxes(now.eta, -1, -2)
    return which[..., :N], found[..., :N], GaussianState(x, P)


class Sums(NamedTuple):
    """a (..., q), A (..., q, q) of q causes, and the standard deviation of each before any reading (q,)."""

    a: Array
    A: Array
    size: Array

    def estimated(self, which: Array) -> tuple[Array, Array]:
        """The causes `which` (..., q) together, and their covariance (..., q, q); 0 of others."""
        held = which[..., None] & which[..., None, :]
        P = np.where(held, np.linalg.inv(np.where(held, self.A, 0.0) + np.eye(self.size.size) / self.size**2), 0.0)
        return (P @ np.where(which, self.a, 0.0)[..., None])[..., 0], P

    def evidence(self, which: Array) -> Array:
        """Twice the logarithm of the likelihood ratio (...) of the causes `which` (..., q) to none, averaged over their sizes:
        a'(A + D^-2)^-1 a - ln det(I + D A D), D = diag(size).
        """
        a = np.where(which, self.a, 0.0) * self.size
        held = which[..., None] & which[..., None, :]
        scaled = np.where(held, self.A * self.size[:, None] * self.size, 0.0) + np.eye(self.size.size)
        return np.asarray(np.sum(a * np.linalg.solve(scaled, a[..., None])[..., 0], axis=-1) - np.linalg.slogdet(scaled)[1])

    def of_two(self) -> Array:
        """The evidence of each two causes (..., q, q); -inf on the diagonal."""
        a, A = self.a * self.size, self.A * self.size[:, None] * self.size
        d = np.einsum("...ii->...i", A) + 1
        det = d[..., None] * d[..., None, :] - A**2
        square = a[..., None] ** 2 * d[..., None, :]
        found = square + np.swapaxes(square, -1, -2) - 2 * A * a[..., None] * a[..., None, :]
        same = np.eye(self.size.size, dtype=bool)
        det = np.where(same, 1.0, det)
        return np.where(same, -np.inf, found / det - np.log(det))

    def replaced(self, isolated: Array, biases: int, where: Array, margin: float) -> Array:
        """Whether one jump in the place of each bias (..., biases) explains as much, but for the margin, as all `isolated`; of
        the isolated ones in the runs `where` (...) holds.
        """
        q = self.size.size
        a, A, which = self.a.reshape(-1, q), self.A.reshape(-1, q, q), isolated.reshape(-1, q)
        found, jumps = np.zeros((len(which), biases), bool), np.eye(q, dtype=bool)[biases:]
        for i in range(biases):
            runs = np.flatnonzero(where.ravel() & which[:, i])
            if not runs.size:
                continue
            others = (which[runs, None] & (np.arange(q) != i)) | jumps  # (runs, jumps, q)
            rivals = Sums(a[runs, None], A[runs, None], self.size).evidence(others)
            own = Sums(a[runs], A[runs], self.size).evidence(which[runs])
            found[runs, i] = np.any(own[:, None] - rivals < margin, axis=-1)
        return found.reshape(*where.shape, biases)


def remembered(now: Look, stands: Array, process: Array) -> Look:
    """With the process hypotheses that stand (..., P); forgotten where no verdict `stands` (...) for `FORGOTTEN` samples."""
    idle = np.where(stands, 0.0, now.idle + 1)
    kept = (idle <= FORGOTTEN)[..., None]
    ended = np.where(stands, now.samples, 0.0)
    return now._replace(stood=(now.stood | process) & kept, idle=idle, samples=ended, doubt=now.doubt & stands[..., None])
