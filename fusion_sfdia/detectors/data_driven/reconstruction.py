"""Common to detectors that test whole windows with one statistic and isolate by reconstruction of single sensors."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import shown, whole
from fusion_sfdia.detectors.batch_detector import IsolatingDetector, TimeStep
from fusion_sfdia.detectors.data_driven.component_model import ComponentModel, Reconstruction
from fusion_sfdia.detectors.data_driven.healthy_limits import LearntFromReadings, without_model
from fusion_sfdia.detectors.detector import Decision, require_no_cycles

Array = NDArray[Any]


class LaggedReadings(NamedTuple):
    """The readings (..., N, L) of each sensor before the next one, the latest first, NaN where missing."""

    past: Array


@dataclass(frozen=True, eq=False)
class ReconstructionDetector(LearntFromReadings, IsolatingDetector):
    """A detector with a statistic of windows of present and lagged readings; an alarm is an `excess` above 1.

    After an alarm the sensors of the largest contribution are reconstructed one by one, at most max_faults, until the statistic
    is within its limit: then these are isolated; none is isolated where it stays beyond. All readings of a sensor in the
    window are reconstructed, so that with lags it stays isolated until a fault that is over has left the window.

    reconstruction: isolated and missing readings from all others. fault_size: reading less reconstruction. residual: each
    reading less its reconstruction from all other sensors. threshold: such that the largest ratio is the excess and the others
    are to it as the contributions are. No state is estimated: estimate is the plant's x0.
    """

    model: ComponentModel
    max_faults: int = field(default=3, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        require_no_cycles(self.plant, "relations that are learnt from readings")
        if not isinstance(self.model, ComponentModel) or self.model.plant is not self.plant:
            raise ValueError(f"model is {shown(self.model)}; expected a ComponentModel of plant {self.plant.name!r}")
        if whole("max_faults", self.max_faults, least=1) > (n := len(self.plant.sensors)):
            raise ValueError(f"max_faults is {self.max_faults}; plant {self.plant.name!r} has {n} sensors")

    @abstractmethod
    def excess(self, found: Reconstruction) -> Array:
        """The root of the statistic over its limit (B,), without threshold_scale."""

    def _start(self, batch: tuple[int, ...], seed: int) -> LaggedReadings:
        return LaggedReadings(np.full((*batch, len(self.plant.sensors), self.model.lags), np.nan))

    def _judge(self, memory: LaggedReadings, now: TimeStep, y: Array, u: Array) -> tuple[LaggedReadings, Decision]:
        window = np.concatenate([y[..., None], memory.past], axis=-1)
        found = self.model.reconstruct(window)
        excess, known = self.excess(found) / self.threshold_scale, np.isfinite(window[..., 0])
        isolated = self._isolate(window, excess > 1, found.contribution)
        reconstruction = self.model.present(found.x)
        named = isolated.any(axis=-1)
        if named.any():
            trusted = np.where(isolated[named][..., None], np.nan, window[named])
            reconstruction[named] = self.model.present(self.model.reconstruct(trusted).x)
        reconstruction = np.where(known & ~isolated, y, reconstruction)
        residual = np.where(known, found.error * self.model.scale, np.nan)
        weight = np.max(found.contribution, axis=-1, keepdims=True) / excess[:, None]
        threshold = np.abs(residual) * weight / found.contribution
        threshold = np.where(threshold > 0, threshold, np.inf)  # 0 / 0 without a reading
        decision = without_model(self.plant, y, reconstruction, residual, threshold, isolated)
        return LaggedReadings(window[..., : self.model.lags].copy()), decision

    def _isolate(self, window: Array, alarm: Array, contribution: Array) -> Array:
        """The sensors (B, N) whose reconstruction brings the statistic within its limit."""
        isolated = np.zeros(contribution.shape, bool)
        rows = np.flatnonzero(alarm & contribution.any(axis=-1))
        suspects = np.zeros((len(rows), contribution.shape[-1]), bool)
        contribution = contribution[rows]
        for _ in range(self.max_faults):
            if not rows.size:
                break
            suspects[np.arange(len(rows)), np.argmax(contribution, axis=-1)] = True
            rest = self.model.reconstruct(np.where(suspects[..., None], np.nan, window[rows]))
            explained = self.excess(rest) <= self.threshold_scale
            isolated[rows[explained]] = suspects[explained]
            rows, suspects = rows[~explained], suspects[~explained]
            contribution = rest.contribution[~explained]
        return isolated & np.isfinite(window[..., 0])
