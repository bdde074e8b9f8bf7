"""An own detector: a model runs along with the plant, and each reading has a fixed limit about its prediction."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fusion_sfdia import register_detector
from fusion_sfdia.detectors import BatchDetector, Decision


class Memory(NamedTuple):
    x: np.ndarray  # state estimate (*batch, n)


@register_detector("my-limits", "fixed limits on the error of predicted readings", memory="state estimate only")
@dataclass(frozen=True)
class MyDetector(BatchDetector):
    limit: float = 5.0  # in standard deviations of the sensor
    gain: float = 0.1  # of the correction of the estimate

    def _start(self, batch, seed):
        return Memory(np.broadcast_to(self.plant.x0, (*batch, self.plant.x0.size)).copy())

    def _judge(self, memory, now, y, u):
        plant = self.plant
        x, guarded = plant.guard(plant.step(now.t_start, memory.x, u, now.dt))
        predicted = plant.output(now.t, x, u)
        residual = y - predicted  # NaN where a reading is missing
        threshold = np.broadcast_to(self.limit * self.threshold_scale * plant.sensor_sigma, y.shape)
        isolated = np.abs(residual) > threshold
        used = np.isfinite(y) & ~isolated
        error = np.where(used, residual, 0.0)
        x = x + self.gain * (np.linalg.pinv(plant.output_jacobian_at(now.t, x, u)) @ error[..., None])[..., 0]
        decision = Decision(
            estimate=x,
            reconstruction=np.where(used, y, predicted),
            residual=residual,
            threshold=threshold,
            isolated=isolated,
            fault_size=np.where(isolated, residual, np.nan),
            diverged=~np.isfinite(x).all(axis=-1),
            guarded=guarded,
            nis=np.full(y.shape[:-1], np.nan),  # a filter gives its normalised innovation squared
        )
        return Memory(x), decision
