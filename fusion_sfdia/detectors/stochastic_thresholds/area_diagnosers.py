"""The diagnosers of a plant's areas behind one interface: each reading (B, N) goes to the area that owns its sensor."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.covariance import dense, diagonal
from fusion_sfdia.detectors.batch_detector import TimeStep
from fusion_sfdia.detectors.stochastic_thresholds.consensus import (
    Diagnosers,
    Prediction,
    initial_state,
    predict,
    require_mode,
    take,
)
from fusion_sfdia.detectors.stochastic_thresholds.consensus_equations import UNKNOWN
from fusion_sfdia.detectors.stochastic_thresholds.present_readings import PredictedReadings, Taken
from fusion_sfdia.detectors.stochastic_thresholds.unread_states import require_estimable
from fusion_sfdia.plant.areas import Areas
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]


@dataclass(frozen=True)
class AreaDiagnosers:
    """The local diagnosers of a plant that states its areas; their memory is `Diagnosers`.

    areas: as stated; then, the noise of states without a sensor is infinite.
    Raises ValueError where states or inputs of the plant are not those of its areas, where a sensor belongs to no area, and
    where states without a sensor cannot be estimated (require_estimable).
    """

    plant: Plant
    areas: Areas
    lam: float
    mode: str

    def __post_init__(self) -> None:
        plant, count = self.plant, self.areas.size[0]
        state_names = tuple(name for names in self.areas.states for name in names)
        if tuple(s.name for s in plant.states) != state_names or len(plant.inputs) != 2 * count:
            raise ValueError(
                f"plant {plant.name!r} has {len(plant.states)} states and {len(plant.inputs)} inputs, its areas "
                f"{len(state_names)} states and {2 * count} inputs, references then loads; give the areas of this plant"
            )
        own, shared = self._of_areas(np.ones(len(plant.sensors)), 0.0)
        if np.any(np.isposinf(self.areas.noise) & (own > 0)):
            raise ValueError(
                f"plant {plant.name!r} has sensors of states whose noise is inf in its areas; give the variance of each sensor"
            )
        if not (np.all(own) and np.all(shared)):
            noise = np.where(own > 0, self.areas.noise, np.inf)
            shared_noise = np.where(shared > 0, self.areas.shared_noise, np.inf)
            object.__setattr__(self, "areas", replace(self.areas, noise=noise, shared_noise=shared_noise))
            require_mode(self.areas, self.mode)
            require_estimable(self.areas)

    @cached_property
    def _place(self) -> Array:
        return np.array([self.areas.place(s.measures, s.owner) for s in self.plant.sensors])

    @cached_property
    def _scale(self) -> Array:
        return np.broadcast_to(self.plant.sensor_scale, self._place.shape)

    def at_sides(self, sides: Array) -> Array:
        """Return (N,) bool: the sensors at the sides chosen by `sides` (2E,) bool."""
        count, n, _ = self.areas.size
        chosen: Array = np.concatenate([np.zeros(count * n, bool), sides])[self._place]
        return chosen

    def start(self, batch: tuple[int, ...], seed: int) -> Diagnosers:
        """Return the diagnosers at the plant's x0 and initial covariance; copies at open ties are unknown."""
        count, n, _ = self.areas.size
        neighbour, closed = self.areas.network.topology.neighbour, self.areas.network.closed
        x0, sigma = (a.reshape(count, n) for a in (self.plant.x0, np.sqrt(diagonal(self.plant.initial_cov))))
        now = initial_state(self.areas, batch)
        now.held[...], now.error_bound[...] = x0, sigma
        some = np.any(self.areas.unread, axis=1)
        if np.any(some):
            now.error_bound[..., some, :] = 0.0
            of_areas = dense(self.plant.initial_cov).reshape(count, n, count, n)
            now.covariance[..., some, :, :] = np.einsum("iaib->iab", of_areas)[some]
        now.held_shared[...], now.error_bound_shared[...] = x0[neighbour, 0], np.where(closed, sigma[neighbour, 0], UNKNOWN)
        return now

    def predict(self, memory: Diagnosers, now: TimeStep, u: Array) -> PredictedReadings:
        count = self.areas.size[0]
        ahead = predict(self.areas, memory, u[..., :count], u[..., count:], self.lam, self.mode)
        deviation = self._of_sensors(ahead.deviation, ahead.deviation_shared)
        deviation = np.where(deviation < UNKNOWN**0.5, np.abs(self._scale) * deviation, np.inf)
        expected = self._scale * self._of_sensors(ahead.estimate, ahead.estimate_shared)
        lost = ~np.all(np.isfinite(expected), axis=-1)
        return PredictedReadings(expected, deviation, np.zeros(lost.shape, bool), lost, ahead)

    def take(self, predicted: PredictedReadings, y: Array) -> Taken:
        """As of PresentReadings: after the readings y (B, N), NaN where missing or left out."""
        memory = take(self.areas, predicted.inner, *self._of_areas(y / self._scale, np.nan))
        return Taken(memory, memory.held.reshape(*memory.held.shape[:-2], -1), None)

    def effects(
        self, memory: Diagnosers, predicted: PredictedReadings, now: TimeStep, u: Array, rows: Array
    ) -> tuple[Array, Array]:
        """As of PresentReadings: the equations for unit readings and unit residuals."""
        units = self._of_areas(np.eye(self._place.size), 0.0)
        still = np.zeros_like(units[0]), np.zeros_like(units[1])
        found = []
        for held, residual in ((self._held(memory, rows), still), (still, units)):
            change = self._of_sensors(*self._change(memory, rows, held, residual))
            found.append(np.swapaxes(change, -1, -2) * self._scale[:, None] / self._scale)
        return found[0], -found[1]

    def _held(self, memory: Diagnosers, rows: Array) -> tuple[Array, Array]:
        """What a unit in each of the N last readings adds to held values, own (R, N, areas, n) and shared (R, N, 2E)."""
        areas, (own, shared) = self.areas, self._of_areas(np.eye(self._place.size), 0.0)
        shared = shared * (memory.error_bound_shared[rows][:, None] == 0.0)
        kept = own * (memory.error_bound[rows][:, None] == 0.0)
        if areas.partly_read:
            read = own * (memory.deviation[rows] > 0.0)[:, None]
            K = memory.covariance[rows] / areas.noise[:, None]  # Sigma_ur / R, and a unit row of each state that is read
            kept = np.where(np.any(areas.unread, axis=1)[:, None], (K[:, None] @ read[..., None])[..., 0], kept)
            shared = np.where(areas.received, kept[..., areas.network.topology.neighbour, 0], shared)
        return kept, shared

    def _change(
        self, memory: Diagnosers, rows: Array, held: tuple[Array, Array], residual: tuple[Array, Array]
    ) -> tuple[Array, Array]:
        """What held values and residuals, own (R, N, areas, n) and shared (R, N, 2E), add to the next estimates."""
        bounds = memory.error_bound[rows][:, None], memory.error_bound_shared[rows][:, None]
        nothing = np.zeros((len(bounds[0]), self._place.size, self.areas.size[0]))
        still = np.zeros_like(residual[0]), np.zeros_like(residual[1])
        one = Diagnosers(*held, *bounds, *residual, *still, memory.covariance[rows][:, None])
        ahead = predict(self.areas, one, nothing, nothing, self.lam, self.mode)
        return ahead.estimate, ahead.estimate_shared

    def without_faults(
        self, memory: Diagnosers, predicted: PredictedReadings, now: TimeStep, u: Array, size: Array, uncertainty: Array
    ) -> PredictedReadings:
        """As of PresentReadings; estimates of unread states lose the effect, too."""
        rows = np.any(size != 0, axis=-1)
        absorbed = np.zeros((*size.shape, size.shape[-1]))
        absorbed[rows] = self.effects(memory, predicted, now, u, rows)[0]
        less = np.sum(absorbed * size[..., None, :], axis=-1)
        more = np.sum(np.abs(absorbed) * uncertainty[..., None, :], axis=-1)
        ahead: Prediction = predicted.inner
        shift, shift_shared = self._of_areas(less / self._scale, 0.0)
        wider, wider_shared = self._of_areas(more / np.abs(self._scale), 0.0)
        M = ahead.covariance
        if self.areas.partly_read:
            none = np.zeros(self.areas.noise.shape), np.zeros(self.areas.shared_noise.shape)
            change = self._change(memory, rows, self._held(memory, rows), none)[0]
            of_rows = size[rows] / self._scale, uncertainty[rows] / np.abs(self._scale)
            shift[rows] = np.where(self.areas.unread, np.einsum("rk,rkic->ric", of_rows[0], change), shift[rows])
            spread = np.einsum("rk,rkic->ric", of_rows[1], np.abs(change))
            wide = 2 * (M[rows] + spread.shape[-1] * spread[..., None] ** 2 * np.eye(spread.shape[-1]))
            M = M.copy()  # E[(A + B)(A + B)'] <= 2 E[A A'] + 2 E[B B'], B B' <= n diag(B_c^2)
            M[rows] = np.where(np.any(spread > 0, axis=-1)[..., None, None], wide, M[rows])
        return predicted._replace(
            expected=predicted.expected - less,
            deviation=predicted.deviation + more,
            inner=Prediction(
                ahead.estimate - shift,
                ahead.estimate_shared - shift_shared,
                ahead.deviation + wider,
                ahead.deviation_shared + wider_shared,
                np.minimum(ahead.error_bound + wider, UNKNOWN),
                np.minimum(ahead.error_bound_shared + wider_shared, UNKNOWN),
                M,
                ahead.ahead - shift if M.size else ahead.ahead,
            ),
        )

    def _of_sensors(self, own: Array, shared: Array) -> Array:
        flat = own.reshape(*own.shape[:-2], -1)
        return np.concatenate([flat, np.broadcast_to(shared, (*flat.shape[:-1], shared.shape[-1]))], axis=-1)[..., self._place]

    def _of_areas(self, of_sensors: Array, otherwise: float) -> tuple[Array, Array]:
        count, n, sides = self.areas.size
        whole = np.full((*of_sensors.shape[:-1], count * n + sides), otherwise)
        whole[..., self._place] = of_sensors
        return whole[..., : count * n].reshape(*whole.shape[:-1], count, n), whole[..., count * n :]
