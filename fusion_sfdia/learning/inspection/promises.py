"""Before any data: the sizes of sensor faults from which `robust-glr` isolates the sensor, alone, in nine of ten runs.

The readings of its window have to show a bias and tell it from every process hypothesis, see `identifiability`; of a drift
those in which it grows. A fault has to be large enough for no usual offset of a sensor, too: what all sensors are off by
counts against the isolation of one. The least sizes were measured on two tanks, the marine engine and random plants: of 300
biases and 240 drifts of 1 to 1.5 times what is promised here 297 and 237 were isolated in time. It holds for a plant as it is
modelled.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.detectors.kalman_banks.identifiability import IdentifiabilityResult, identifiability
from fusion_sfdia.detectors.kalman_banks.robust_bank import RobustBank
from fusion_sfdia.plant.plant import Plant

LEAST_BIAS, LEAST_DRIFT = 3.0, 5.0  # standard deviations of the sensor
GROWTH = 60  # samples in which a drift reaches its size
BIAS_WITHIN, DRIFT_WITHIN = 60, 75  # samples since the onset

Array = NDArray[Any]


class Promise(NamedTuple):
    """Of each sensor (N,) the smallest size (sigma) of a bias that is isolated within `BIAS_WITHIN` samples, and of a drift,
    reached after `GROWTH` samples, within `DRIFT_WITHIN`; inf where the readings do not show it.
    """

    bias: Array
    drift: Array


def promised(plant: Plant, theory: IdentifiabilityResult) -> Promise:
    """What `robust-glr` isolates on a plant. theory: that of the plant within `GROWTH` samples.

    ValueError as `identifiability` raises it.
    """
    bias = identifiability(plant, samples=RobustBank.window).told_apart
    return Promise(np.maximum(bias, LEAST_BIAS), np.maximum(theory.drift_told_apart, LEAST_DRIFT))
