"""Detector: principal components of healthy readings, the multivariate statistical monitoring of process plants."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.arguments import number, probability, shown
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.data_driven.component_model import ComponentModel
from fusion_sfdia.data_driven.healthy_limits import upper_limit
from fusion_sfdia.data_driven.reconstruction import ReconstructionDetector

Array = NDArray[Any]


@dataclass(frozen=True, eq=False)
class PrincipalComponents(ReconstructionDetector):
    """T2 and SPE of standardised readings x, their limits and the model from healthy data (Jackson and Mudholkar 1979):

        t = P x    T2 = t' Lambda^-1 t    SPE = |x - P' t|^2

    The statistic is the larger one over its limit; an alarm is raised beyond either. `ComponentModel` has the model, with the
    lags of dynamic components, and the index T2 + SPE / noise of its contributions; `ReconstructionDetector` how sensors are
    isolated. Readings are divided by the noise that their sensors state: divided by the standard deviation of an operation that
    moves, a fault would be hidden that is small against the movement, however large it is against the noise.
    """

    limit_t2: float
    limit_spe: float

    def __post_init__(self) -> None:
        super().__post_init__()
        for what in ("limit_t2", "limit_spe"):
            object.__setattr__(self, what, number(what, value := getattr(self, what)))
            if not getattr(self, what) > 0:
                raise ValueError(f"{what} is {shown(value)}; expected a positive number, as of PrincipalComponents.fit")

    @classmethod
    def fit(
        cls,
        plant: Plant,
        y: Array,
        false_alarm: float = 1e-3,
        components: int | None = None,
        max_faults: int = 3,
        lags: int = 0,
    ) -> PrincipalComponents:
        """Model and limits from healthy readings y (K, ..., N), at that rate of false alarms per step.

        The model is that of `ComponentModel.fit`, which trains on half of the data; the rest set the limits as order
        statistics, T2 and SPE sharing the rate equally. Without a component SPE has all of it. ValueError where the data are
        too few for the rate or the sensors, NotApplicableError for a plant of one sensor.
        """
        probability("false_alarm", false_alarm)
        model, _, judge = ComponentModel.fit(plant, y, lags, components)
        unlimited = cls(plant, model, np.inf, np.inf, max_faults=max_faults)
        t2, spe = unlimited.statistics(model.reconstruct(judge).x)
        if not model.variances.size:
            return replace(unlimited, limit_spe=upper_limit(spe, false_alarm))
        limit_t2, limit_spe = (upper_limit(value, false_alarm / 2) for value in (t2, spe))
        return replace(unlimited, limit_t2=limit_t2, limit_spe=limit_spe)

    def statistics(self, x: Array) -> tuple[Array, Array]:
        """T2 and SPE (B,) of standardised windows x (B, D)."""
        p = self.model.components
        scores = x @ p.T
        return np.sum(scores**2 / self.model.variances, axis=-1), np.sum((x - scores @ p) ** 2, axis=-1)

    def excess(self, x: Array) -> Array:
        t2, spe = self.statistics(x)
        return np.asarray(np.sqrt(np.maximum(t2 / self.limit_t2, spe / self.limit_spe)))
