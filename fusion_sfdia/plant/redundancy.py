"""The number of arbitrary sensors that may be isolated together while the others still outvote them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import null_space, qr

from fusion_sfdia.common.arguments import whole
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

NEGLIGIBLE = 1e-6  # relative: the smallest part of a mode in a reading, above rounding, that counts as seen
LASTING = 100.0  # samples, our choice: a mode that keeps more than 1/e of an error for longer lasts, others decay


class Mode(NamedTuple):
    """A lasting mode of a plant: the state that it moves most, in units of its scale, and the sensors that see it."""

    state: str
    sensors: tuple[str, ...]


class Redundancy(NamedTuple):
    """faults: sensors that may be left out together, at least 1. reason: what limits it, a phrase. modes: those that last."""

    faults: int
    reason: str
    modes: tuple[Mode, ...]

    @property
    def indispensable(self) -> tuple[str, ...]:
        """Sensors that alone see a lasting mode: without one of them the estimate keeps its error, so that it cannot be
        readmitted on its own, and its fault cannot be told from a change of the state.
        """
        return tuple(dict.fromkeys(mode.sensors[0] for mode in self.modes if len(mode.sensors) == 1))


def redundancy(plant: Plant) -> Redundancy:
    """Return the number of sensors that the plant's redundancy allows to be left out together, and why.

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
    count, names = len(plant.sensors), np.array(plant.sensor_names)
    modes: tuple[Mode, ...] = ()
    if np.all(np.isfinite(step)) and np.all(np.isfinite(output)):  # else the model has no modes at x0
        found = _seen(step * scale / scale[:, None], output * scale / plant.sensor_sigma[:, None])
        modes = tuple(Mode(plant.states[largest].name, tuple(map(str, names[sees]))) for largest, sees in found)
    half = f"half of the {count} sensors"
    if not modes or (len((least := min(modes, key=lambda m: len(m.sensors))).sensors) - 1) // 2 >= count // 2:
        return Redundancy(max(count // 2, 1), half if count > 1 else "the only sensor", modes)
    seen = len(least.sensors)
    by = f"{seen} sensor{'s' * (seen != 1)} ({', '.join(least.sensors[:4])}{', ...' * (seen > 4)})" if seen else "no sensor"
    what = ", of which most must be healthy" if seen > 2 else ": no majority remains where one of them fails"
    reason = f"an error of the estimated {least.state} does not fade by itself, and can be corrected by {by} only{what}"
    return Redundancy(max((seen - 1) // 2, 1), reason if seen else reason.replace(" only", ""), modes)


def most_faults(plant: Plant) -> int:
    """Return the number of sensors that may be left out together, see `redundancy`."""
    return redundancy(plant).faults


def require_max_faults(plant: Plant, given: int | None) -> None:
    """Raise ValueError unless max_faults is None (then it is `most_faults`) or a number from 1 to less than the sensors."""
    if given is not None and not whole("max_faults", given, least=1) < len(plant.sensors):
        raise ValueError(f"max_faults is {given}; plant {plant.name!r} has {len(plant.sensors)} sensors, give fewer")


def _seen(F: Array, H: Array) -> list[tuple[int, Array]]:
    """Of each lasting mode of F the state with its largest part, and in which sensors (N,), the rows of H, it is observable."""
    values, vectors = np.linalg.eig(F)
    found, lasts = [], (np.abs(values) > np.exp(-1 / LASTING)) & (values.imag >= 0)
    for k in np.flatnonzero(lasts):
        alike = np.abs(values - values[k]) <= NEGLIGIBLE
        if np.any(alike[:k] & lasts[:k]):
            continue  # its modes have been counted
        single = np.sum(alike) == 1
        modes = vectors[:, [k]] if single else null_space(F - values[k] * np.eye(len(F)), rcond=NEGLIGIBLE)
        shown = H @ modes
        _, _, order = qr(shown.T, mode="economic", pivoting=True)
        pivot = shown[order[: shown.shape[1]]]
        if pivot.size and np.linalg.cond(pivot) < 1 / NEGLIGIBLE:
            modes = np.linalg.solve(pivot.T, modes.T).T
            shown = np.linalg.solve(pivot.T, shown.T).T  # each mode is seen by one of the pivots
        visible = np.abs(shown)
        sees = visible > NEGLIGIBLE * np.max(visible, axis=0)
        found += list(zip(np.argmax(np.abs(modes), axis=0).tolist(), sees.T, strict=True))
    return found
