"""The number of arbitrary sensors that may be isolated together while the others still outvote them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import null_space, qr

from fusion_sfdia.core.arguments import whole
from fusion_sfdia.core.plant import Plant

Array = NDArray[Any]

NEGLIGIBLE = 1e-6  # relative: the smallest part of a mode in a reading, above rounding, that counts as seen
LASTING = 100.0  # samples, our choice: a mode that keeps more than 1/e of an error for longer lasts, others decay


def most_faults(plant: Plant) -> int:
    """Return the number of sensors that the plant's redundancy allows to be left out together, at least 1.

    The N - k sensors that stay and the model's prediction, one vote more, must outnumber the k that are left out: k <= N / 2.
    Where more sensors contradict the model than agree with it, the model is suspect. A mode of the plant that does not decay
    must be measured, because its prediction keeps an error: of the m sensors that see it those that stay must outnumber those
    left out, k <= (m - 1) / 2 (Fawzi, Tabuada and Diggavi 2014, there for all modes). A decaying mode forgets its error.

    The modes are those of the linearisation at x0 under the usual input; by the test of Popov, Belevitch and Hautus they
    are all of a state that can become unobservable. So one count for each mode covers the worst choice of k of N sensors. It
    is exact for a simple eigenvalue. For several modes of one eigenvalue, the modes are combined so that few sensors see each:
    that finds the minimum where groups of sensors see one mode each, and otherwise an upper bound.
    """
    t, x, u, scale = 0.0, plant.x0, plant.input_at(0.0), plant.state_scale
    step, output = plant.step_jacobian_at(t, x, u, plant.dt), plant.output_jacobian_at(t, x, u)
    count = len(plant.sensors) // 2
    if np.all(np.isfinite(step)) and np.all(np.isfinite(output)):  # else the model has no modes at x0
        seen = _seen(step * scale / scale[:, None], output * scale / plant.sensor_sigma[:, None])
        count = min([count, *((m - 1) // 2 for m in seen)])
    return max(count, 1)


def require_max_faults(plant: Plant, given: int | None) -> None:
    """Raise ValueError unless max_faults is None (then it is `most_faults`) or a number from 1 to less than the sensors."""
    if given is not None and not whole("max_faults", given, least=1) < len(plant.sensors):
        raise ValueError(f"max_faults is {given}; plant {plant.name!r} has {len(plant.sensors)} sensors, give fewer")


def _seen(F: Array, H: Array) -> list[int]:
    """The number of sensors, the rows of H, in which each lasting mode of F is observable."""
    found, lasting = [], [v for v in np.linalg.eigvals(F) if abs(v) > np.exp(-1 / LASTING) and v.imag >= 0]
    for k, value in enumerate(lasting):
        if any(abs(value - other) <= NEGLIGIBLE for other in lasting[:k]):
            continue  # its modes have been counted
        shown = H @ null_space(F - value * np.eye(len(F)), rcond=NEGLIGIBLE)
        _, _, order = qr(shown.T, mode="economic", pivoting=True)
        pivot = shown[order[: shown.shape[1]]]
        if pivot.size and np.linalg.cond(pivot) < 1 / NEGLIGIBLE:
            shown = np.linalg.solve(pivot.T, shown.T).T  # each mode is seen by one of the pivots
        visible = np.abs(shown)
        found += np.sum(visible > NEGLIGIBLE * np.max(visible, axis=0), axis=0).tolist()
    return found
