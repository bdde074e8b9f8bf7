"""Detector: moving-horizon estimation of the state with sparse sensor faults (L1), see `moving_horizon`.

The sums of a horizon depend on its beginning, so a window that slides sample by sample would need as many recursions as it has
samples. Instead a horizon begins every L // 2 samples and ends after twice as many: there is always one of up to half the
length and one that is longer. A third horizon is the present reading alone, which detects large faults immediately. The three
problems share the false-alarm probability. The problem with the largest |g_i| / s_i is solved where this exceeds lambda.
Sensors with a fault in its solution are left out, replaced and readmitted by a likelihood ratio, as in `leave_one_out_bank`.
The state is then that of the moving-horizon problem with these faults free, and all horizons restart.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from fusion_sfdia.common.arguments import whole
from fusion_sfdia.detectors.batch_detector import TimeStep
from fusion_sfdia.detectors.detector import Decision
from fusion_sfdia.detectors.exclusion import Exclusion, none_excluded
from fusion_sfdia.detectors.kalman_banks import moving_horizon
from fusion_sfdia.detectors.kalman_banks.excluding_bank import ExclusionUpdate, SensorTests
from fusion_sfdia.detectors.kalman_banks.leave_one_out import posterior, statistics
from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.detectors.kalman_banks.moving_horizon import Horizons
from fusion_sfdia.filters import gaussian
from fusion_sfdia.filters.estimators import UNUSED, GaussianState, step_stream

Array = NDArray[Any]
HORIZONS = 2  # besides the horizon of the present reading


class MovingHorizonMemory(NamedTuple):
    """The filter's estimate, the sensors that are left out, and the sums of the horizons."""

    estimate: GaussianState
    exclusion: Exclusion
    horizons: Horizons


@dataclass(frozen=True)
class MovingHorizon(LeaveOneOutBank):
    """Moving-horizon estimation with an L1 penalty on faults, on one central filter.

    Parameters
    ----------
    window : int, default 15
        Largest number of samples in a horizon.
    false_alarm : float, default 1e-3
        Shared equally by sensors and horizons (Bonferroni).

    Notes
    -----
    The other settings are those of LeaveOneOutBank.

    Examples
    --------
    >>> from fusion_sfdia import run, simulate
    >>> from fusion_sfdia.detectors import MovingHorizon
    >>> from fusion_sfdia.plants import two_tanks
    >>> bank = MovingHorizon(two_tanks())
    >>> recording = simulate(bank.plant, 40, seeds=[1])
    >>> y = recording.y[:, 0] + (recording.t > 100)[:, None] * [0.2, 0.0, 0.0, 0.0]
    >>> run(bank, bank.init(), recording.t, y, recording.u)[1].isolated[-1].tolist()
    [True, False, False, False]
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        whole("window, in samples,", self.window, least=2)

    @property
    def penalty(self) -> float:
        """lambda: |g_i| / s_i of a healthy sensor exceeds it, in a horizon, with its share of false_alarm."""
        share = self.false_alarm / len(self.plant.sensors) / (1 + HORIZONS)
        return float(-self.threshold_scale * ndtri(share / 2))

    def _start(self, batch: tuple[int, ...], seed: int) -> Any:
        n, count = len(self.plant.states), len(self.plant.sensors)
        estimate = self.estimator.start(self.plant, batch, step_stream(seed, 0))
        horizons = moving_horizon.empty(batch, HORIZONS, n, count)
        return MovingHorizonMemory(estimate, none_excluded(batch, count), horizons)

    def _judge(self, memory: Any, now: TimeStep, y: Array, u: Array) -> tuple[Any, Decision]:
        estimate, exclusion, past = memory
        plant, est, t = self.plant, self.estimator, now.t
        prior = est.predict(plant, estimate, now.t_start, u, now.dt, UNUSED)
        joint = est.joint(plant, prior, t, u)
        y = plant.near(y, joint.y)
        usable = np.isfinite(y) & ~exclusion.out
        found = statistics(joint, y, usable)
        x, p = posterior(joint, found)
        gain = gaussian.gain(joint, found.inverse)
        tangent = prior.tangent if prior.tangent is not None else plant.step_jacobian_at(now.t_start, estimate.x, u, now.dt)
        if now.k % (self.window // 2) == 0:
            past = moving_horizon.renew(past)
        past = moving_horizon.extend(past, tangent, plant.output_jacobian_at(t, prior.core.x, u), gain, found)
        present = moving_horizon.of_present(gain, found)
        known = np.concatenate([moving_horizon.information(h, usable, plant.sensor_cov) for h in (present, past)], axis=-2)
        g = np.concatenate([present.g, past.g], axis=-2)
        deviation = 1 / np.sqrt(np.where(known > 0, known, np.inf))
        ratio = np.abs(g) * deviation / self.penalty
        room = self.most_faults - np.sum(exclusion.out, axis=-1)
        free_x, free_p, isolated, size, capped = self._solve((present, past), known > 0, ratio, room, x, p)
        if self.accommodate and np.any(isolated):
            x, p = free_x, free_p
            keep = ~np.any(isolated, axis=-1)[..., None, None]
            past = Horizons(past.effect * keep[..., None], past.g * keep, past.G * keep[..., None])

        worst = np.argmax(ratio, axis=-2)[..., None, :]
        alone, deviation = (np.take_along_axis(a, worst, axis=-2)[..., 0, :] for a in (g * deviation**2, deviation))
        threshold = np.where(deviation > 0, self.penalty * deviation, np.inf)
        update = ExclusionUpdate(x, p, prior, joint, found)
        tested = SensorTests(usable, isolated, alone, threshold, size, capped, self.penalty**2)
        exclusion, decision = self._conclude(now, y, u, exclusion, update, tested)
        return MovingHorizonMemory(GaussianState(x, p), exclusion, past), decision

    def _solve(
        self, problems: tuple[Horizons, ...], known: Array, ratio: Array, room: Array, x: Array, p: Array
    ) -> tuple[Array, Array, Array, Array, Array]:
        """Solve, in each run with a ratio above 1 and room for a fault, the horizon with the largest.

        Return estimate and covariance with the detected faults free, the sensors isolated (..., N), the sizes of their
        faults (..., N), and whether more would be isolated without max_faults (...).
        """
        shape = (*x.shape[:-1], ratio.shape[-1])
        isolated, size = np.zeros(shape, bool), np.zeros(shape)
        above = np.any(ratio > 1, axis=(-2, -1))
        capped = above & (room <= 0)
        if np.any(above):
            x, p = x.copy(), p.copy()
        for run in zip(*np.nonzero(above & (room > 0)), strict=True):
            j, worst = divmod(int(np.argmax(ratio[run])), ratio.shape[-1])
            effect, g, G = (a[run][max(j - 1, 0)] for a in problems[min(j, 1)])
            f = moving_horizon.sparse_faults(g, G, known[run][j], self.penalty)
            f[worst] = f[worst] or g[worst]  # the first to enter; exactly at the threshold its f is 0 up to rounding
            fit = moving_horizon.refitted(g, G, np.flatnonzero(f), self.penalty, int(room[run]))
            isolated[run][fit.sensors], size[run][fit.sensors], capped[run] = True, fit.f, fit.capped
            moved = effect[:, fit.sensors]
            x[run] -= moved @ fit.f
            p[run] += moved @ fit.covariance @ moved.T
        return x, p, isolated, size, capped
