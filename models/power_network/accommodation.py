"""Accommodation of an isolated fault: the controller compensates for it, or the area is unplugged (a Switch).

Boem et al. 2018, sec. VII and VIII-B: after a sign flip has been isolated the command is inverted.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.models.power_network.control import Control
from fusion_sfdia.models.power_network.model import NetworkModel

Array = NDArray[Any]


@dataclass(eq=False)
class Compensated:
    """A controller that divides its references, within limits, by `gain` (B, N), the faulty gain of their actuators.

    Set gain[run, area] once the fault is isolated: it acts from the next reference on. ValueError for a gain of 0.
    """

    control: Control
    gain: Array

    def __call__(self, model: NetworkModel, y: Array, load: Array) -> Array:
        if np.any(self.gain == 0) or not np.all(np.isfinite(self.gain)):
            raise ValueError("a gain of 0 cannot be compensated; unplug the area")
        limit = model.parameters.reference_limit
        reference: Array = np.clip(self.control(model, y, load) / self.gain, -limit, limit)
        return reference
