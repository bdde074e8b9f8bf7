"""Detector: principal components of healthy readings, the multivariate statistical monitoring of process plants."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import number, probability, shown
from fusion_sfdia.detectors.data_driven.component_model import ComponentModel, Reconstruction
from fusion_sfdia.detectors.data_driven.healthy_limits import upper_limit
from fusion_sfdia.detectors.data_driven.reconstruction import ReconstructionDetector
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]


@dataclass(frozen=True, eq=False)
class PrincipalComponents(ReconstructionDetector):
    """T2, SPE and the largest contribution c of standardised readings x, their limits and the model from healthy data:

        t = P x    T2 = t' Lambda^-1 t    SPE = |x - P' t|^2    c_i^2 = (M x)_i' (M_ii)^-1 (M x)_i

    T2 and SPE (Jackson and Mudholkar 1979) test whether there is any fault. c_i^2, the reconstruction-based contribution of a
    sensor (Alcala and Qin 2009), is also the generalised likelihood ratio of a fault of any size in that sensor, in which a
    small fault is not hidden by the noise of all other sensors. The statistic is the largest over its limit; an alarm is
    raised beyond any. `ComponentModel` is the model, with the lags of dynamic components; `ReconstructionDetector` isolates
    the sensors. Readings are divided by the noise that their sensors state: divided by the standard deviation of a varying
    operation, a fault would be hidden that is small against the variation, however large it is against the noise.

    Parameters
    ----------
    model : ComponentModel
        Of the variation of healthy readings.
    limit_t2 : float
        Of T2; infinite where there is no component.
    limit_spe : float
        Of SPE.
    limit_contribution : float
        Of c^2.
    max_faults : int, default 3
        Sensors that are isolated at once at most.

    Examples
    --------
    >>> from fusion_sfdia import run, simulate
    >>> from fusion_sfdia.detectors import PrincipalComponents
    >>> from fusion_sfdia.plants import two_tanks
    >>> plant = two_tanks()
    >>> pca = PrincipalComponents.fit(plant, simulate(plant, 200, seeds=range(4), process_noise=True), false_alarm=0.01)
    >>> recording = simulate(plant, 40, seeds=[9])
    >>> y = recording.y[:, 0] + (recording.t > 100)[:, None] * [0.5, 0.0, 0.0, 0.0]
    >>> run(pca, pca.init(), recording.t, y, recording.u)[1].isolated[-1].tolist()
    [True, False, False, False]
    """

    limit_t2: float
    limit_spe: float
    limit_contribution: float

    def __post_init__(self) -> None:
        super().__post_init__()
        for what in ("limit_t2", "limit_spe", "limit_contribution"):
            object.__setattr__(self, what, number(what, value := getattr(self, what)))
            if not getattr(self, what) > 0:
                raise ValueError(f"{what} is {shown(value)}; expected a positive number; use PrincipalComponents.fit")

    @classmethod
    def fit(
        cls,
        plant: Plant,
        healthy: Any,
        false_alarm: float = 1e-3,
        *,
        components: int | None = None,
        lags: int = 0,
        **settings: Any,
    ) -> Self:
        """Model and limits from healthy readings, at a rate of false alarms per step.

        The model is that of `ComponentModel.fit`, which trains on half of the data; the rest set the limits as order
        statistics, which share the rate equally; that of T2 is infinite where there is no component.

        Parameters
        ----------
        plant : Plant
            The model, for the names and noise of its sensors.
        healthy : Recording, Log, frame or tuple
            See `healthy_readings`.
        false_alarm : float, default 1e-3
            The rate.
        components : int, optional
            As of `ComponentModel.fit`.
        lags : int, default 0
            Samples before the present one in a window.
        **settings
            Of the detector, by name.

        Returns
        -------
        Self
            The fitted detector.

        Raises
        ------
        ValueError
            Where the data are too few for the rate or the sensors.
        NotApplicableError
            For a plant of one sensor.
        """
        probability("false_alarm", false_alarm)
        model, _, judge = ComponentModel.fit(plant, healthy, lags, components)
        unlimited = cls(plant, model, np.inf, np.inf, np.inf, **settings)
        t2, spe, contribution = unlimited.statistics(model.reconstruct(judge))
        moves = model.variances.size > 0
        share = false_alarm / (3 if moves else 2)
        return replace(
            unlimited,
            limit_t2=upper_limit(t2, share) if moves else np.inf,
            limit_spe=upper_limit(spe, share),
            limit_contribution=upper_limit(contribution, share),
            fitted_rate=false_alarm,
        )

    def statistics(self, found: Reconstruction) -> tuple[Array, Array, Array]:
        """T2, SPE and the largest contribution.

        Parameters
        ----------
        found : Reconstruction
            Of the readings of B runs.

        Returns
        -------
        t2, spe, contribution : array (B,)
            To be compared with the limits.
        """
        p = self.model.components
        scores = found.x @ p.T
        t2 = np.sum(scores**2 / self.model.variances, axis=-1)
        return t2, np.sum((found.x - scores @ p) ** 2, axis=-1), np.max(found.contribution, axis=-1)

    def excess(self, found: Reconstruction) -> Array:
        t2, spe, contribution = self.statistics(found)
        squared = np.maximum(t2 / self.limit_t2, spe / self.limit_spe)
        return np.asarray(np.maximum(np.sqrt(squared), contribution / self.limit_contribution))
