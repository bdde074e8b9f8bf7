"""Steps without readings over the time between two rows, as `diagnose` fills the gaps of a log."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.plant import Plant

Array = NDArray[Any]


def steps_over(
    plant: Plant, longest: float, before: tuple[float, Array], now: tuple[float, Array]
) -> list[tuple[float, Array]]:
    """Times and inputs of the steps strictly between two rows, given by times and inputs (m,); none up to `longest` s.

    Otherwise equal steps of about dt, with inputs interpolated between those of the rows, as in `core.gaps.bridged`.
    """
    (t_before, u_before), (t, u) = before, now
    gap = t - t_before
    if gap <= longest * (1 + 1e-9):
        return []
    parts = int(np.ceil(gap / plant.dt * (1 - 1e-9)))
    return [
        (t - ahead * (gap / parts), u * (1 - ahead / parts) + u_before * (ahead / parts)) for ahead in range(parts - 1, 0, -1)
    ]
