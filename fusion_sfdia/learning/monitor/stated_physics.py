"""Physics that a user states: sensors of one quantity, and inputs that drive readings.

Same quantity. Sensors i of a group read y_i = a_i + b_i q + e_i, q their quantity. With the scaled readings z_i and gains
g_i, x_i = g_i z_i is q about its healthy mean, in one unit. The gain of i against the reference r of its group, the sensor
with which the others correlate most, is by means of windows zbar

    g_i = sign(rho) sd(zbar_r) / sd(zbar_i),  its error at most c_i = 1 - |rho|,  rho = corr(zbar_r, zbar_i)

(the reduced major axis; the error is that of noise in one of both alone), where |rho| >= 0.9 or their units differ; else that
of the unit, g_i = sd_i / sd_r, c_i = 0.05. Over every window of w rows a sensor disagrees with all others of its group by

    d_i = min_j max(|xbar_i - xbar_j| - (c_i + c_j) |xbar_i + xbar_j| / 2, 0),

a test like others, with limits from held-out blocks. What moves the quantity moves all of them: d_i above its limit is a
sensor. Of three or more it is the one with d_i above its limit while the others agree. Of two, d_1 = d_2, and a third witness
decides: the errors of each given all channels but the other one, levels (by other channels) and changes (by its own past: a
step in one row), over their limits, h_1 and h_2. If 1 is wrong by b, h_1 holds b and h_2 does not; if 2 is wrong, q has moved
by b in the same rows, hidden in 2 by its fault. With limits of l standard deviations

    log p(1 is wrong) / p(2 is wrong) = D l^2 / 2,    D = max (h_1^2 - h_2^2) - max (h_2^2 - h_1^2)

the maxima over tests, and over rows since the two disagree by half a limit: a quantity that moves later moves both. Sensor 1
is named where D > 0.6, a ratio above 100 for l = 4, else one of the two is. A sensor whose level is off by more than twice
d_i is not wrong alone: its quantity has moved.

Drives. What an input drives moves with it: while it is outside its healthy range, levels of what it drives are no fault of a
sensor, but an operation that was not learnt. While it is inside, they are no operator's action, and a fault of the process
that acts on one of several readings that it drives acts on the others: one that nothing else measures is wrong if it alone
moves.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.learning.monitor.channels import Channels
from fusion_sfdia.learning.monitor.residuals import LATE, Means
from fusion_sfdia.learning.monitor.windows import window_means
from fusion_sfdia.logs.physics import StatedPhysics

Array = NDArray[Any]

WINDOW = 16  # rows of the means that teach gains
MOVE_TOGETHER, AT_LEAST = 0.9, 0.5  # correlation from which on a gain is learnt, and, of unlike units, below which it cannot be
GAIN_ERROR = 0.05  # of sensors of one unit whose gain is not learnt
BEYOND = 0.05  # of the healthy range of an input, by which it must be outside


class Stated(NamedTuple):
    """Of the sensors that are used: group (N,), -1 for none; gain (N,), and its error (N,), relative.

    driver (N, d): what drives which; columns (d,), low, high (d,): where each driver stands among all columns, and its healthy
    range with a margin, in its unit.
    """

    group: Array
    gain: Array
    error: Array
    driver: Array
    columns: Array
    low: Array
    high: Array

    @classmethod
    def none(cls, sensors: int) -> Stated:
        """Of nothing."""
        no, drivers = np.zeros(0), np.zeros((sensors, 0), bool)
        return cls(np.full(sensors, -1), np.ones(sensors), np.zeros(sensors), drivers, no.astype(int), no, no)

    @property
    def groups(self) -> list[Array]:
        """The sensors of each group."""
        return [np.flatnonzero(self.group == g) for g in range(int(self.group.max(initial=-1)) + 1)]

    def beyond(self, v: Array) -> Array:
        """Which sensors are driven by an input outside its healthy range (K, N), by readings v (K, n) of all columns."""
        own = v[:, self.columns]
        with np.errstate(invalid="ignore"):
            return np.asarray(((own < self.low) | (own > self.high)).astype(float) @ self.driver.T > 0)

    def disagreement(self, means: Means, w: int) -> Array:
        """By how much each sensor disagrees with all others of its group (K, N), NaN without a group or another reading.

        Over windows of at least `LATE` rows at most twice what the last quarters of these show.
        """
        n = self.group.size
        found = np.full((len(means.now), n), np.nan)
        now, quarter = means.now[:, :n] * self.gain, means.quarter if w >= LATE else None
        for of in self.groups:
            for i in of:
                others = of[of != i]
                with np.errstate(invalid="ignore"):
                    by = now[:, [i]] - now[:, others]
                    excused = (self.error[i] + self.error[others]) * np.abs(now[:, [i]] + now[:, others]) / 2
                    size = np.maximum(np.abs(by) - excused, 0.0)
                    if quarter is not None:
                        last = quarter[:, [i]] * self.gain[i] - quarter[:, others] * self.gain[others]
                        most = np.where(by * last > 0, 2 * np.abs(last), np.where(np.isfinite(last), 0.0, np.inf))
                        size = np.minimum(size, most)
                found[:, i] = np.fmin.reduce(size, axis=1)
        return found


def learn_stated(
    physics: StatedPhysics, channels: Channels, z: Sequence[Array], v: Sequence[Array]
) -> tuple[Stated, list[str]]:
    """What of the physics can be used, by scaled readings z (K, n) and readings v (K, all) of pieces; and remarks on the rest.

    ValueError for a group whose gain can be neither learnt nor read from the units.
    """
    n, sensors = channels.count, channels.sensors
    found, remarks = Stated.none(n), []
    at = {name: i for i, name in enumerate(channels.names[:n])}
    means = np.concatenate([window_means(one[:, :n], WINDOW) for one in z])
    next_group = 0
    for names in physics.same:
        of = [at[name] for name in names if name in at]
        if unused := [name for name in names if name not in at]:
            remarks.append(f"{', '.join(unused)}: left out, so not compared with others of {', '.join(names)}")
        if len(of) < 2:
            continue
        known = means[:, of][np.isfinite(means[:, of]).all(axis=1)]
        rho = np.corrcoef(known.T) if len(known) > 2 else np.eye(len(of))
        r = int(np.argmax(np.sum(np.abs(np.nan_to_num(rho)), axis=0)))
        found.group[of] = next_group
        next_group += 1
        for j, i in enumerate(of):
            ref, one = sensors[channels.used[of[r]]], sensors[channels.used[i]]
            alike = one.unit == ref.unit and not np.isfinite(channels.floor[[i, of[r]]]).any()
            learnt = abs(rho[j, r])
            if i != of[r] and (learnt >= MOVE_TOGETHER or not alike):
                if learnt < AT_LEAST:
                    raise ValueError(
                        f"same: {ref.name} [{ref.unit}] and {one.name} [{one.unit}] hardly move together in the healthy logs "
                        f"(correlation {rho[j, r]:.2g}), so that no gain can be learnt between units; log both in one unit"
                    )
                found.gain[i] = np.sign(rho[j, r]) * known[:, r].std() / known[:, j].std()
                found.error[i] = 1 - learnt
            elif i != of[r]:
                found.gain[i], found.error[i] = channels.sd[i] / channels.sd[of[r]], GAIN_ERROR
    drivers = list(physics.drives)
    columns = np.array([len(sensors) + [s.name for s in channels.inputs].index(u) for u in drivers], int)
    every = np.concatenate(v)[:, columns]
    driver = np.zeros((n, len(drivers)), bool)
    for k, names in enumerate(physics.drives.values()):
        driver[[at[name] for name in names if name in at], k] = True
    some = np.isfinite(every).any(axis=0)
    low, high = np.full(len(drivers), -np.inf), np.full(len(drivers), np.inf)
    low[some], high[some] = np.nanmin(every[:, some], axis=0), np.nanmax(every[:, some], axis=0)
    margin = BEYOND * np.where(some, high - low, 0.0)
    return found._replace(driver=driver, columns=columns, low=low - margin, high=high + margin), remarks
