"""Steps without readings over the time between two rows, as `diagnose` fills the gaps of a log."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.plant import Plant

Array = NDArray[Any]


def steps_over(plant: Plant, t_before: float, u_before: Array, t: float, u: Array) -> list[tuple[float, Array]]:
    """Times and inputs of the steps strictly between two rows; none where the plant can step over the gap at once.

    Otherwise equal steps of about dt, with inputs (m,) interpolated between those of the rows.
    """
    gap = t - t_before
    longest = plant.dt if plant.numerics.fixed_dt else plant.numerics.max_dt
    if gap <= longest * (1 + 1e-9):
        return []
    parts = int(np.ceil(gap / plant.dt * (1 - 1e-9)))
    return [
        (t - ahead * (gap / parts), u * (1 - ahead / parts) + u_before * (ahead / parts)) for ahead in range(parts - 1, 0, -1)
    ]
