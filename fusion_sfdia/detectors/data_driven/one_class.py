"""Detector: a one-class support vector machine of healthy readings."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from fusion_sfdia.common.arguments import floats, number, probability, shown
from fusion_sfdia.detectors.data_driven.component_model import ComponentModel, Reconstruction
from fusion_sfdia.detectors.data_driven.healthy_limits import upper_limit
from fusion_sfdia.detectors.data_driven.reconstruction import ReconstructionDetector
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

TRAINED_ON = 2000  # samples: the time to train grows with their square


@dataclass(frozen=True, eq=False)
class OneClass(ReconstructionDetector):
    """The one-class support vector machine of Schoelkopf et al. (2001) on whitened readings w = M^(1/2) x:

        p(w) = sum_j a_j exp(-gamma |w - w_j|^2) / sum_j a_j    statistic = -log p

    The machine accepts what has p above a level, which is the limit of the statistic; its logarithm distinguishes readings that
    are so far away that p vanishes. M is the inverse covariance of `ComponentModel`, so that a distance is measured relative to
    the variation of healthy readings in its direction, and gamma = 1 / D, the usual inverse of the number of variables of
    variance 1. `ReconstructionDetector` isolates the sensors.

    Parameters
    ----------
    model : ComponentModel
        Of the variation of healthy readings.
    support : array (S, D)
        w_j.
    weights : array (S,)
        a_j, positive.
    limit : float
        Of the statistic.
    max_faults : int, default 3
        Sensors that are isolated at once at most.

    Examples
    --------
    >>> from fusion_sfdia import simulate
    >>> from fusion_sfdia.detectors import OneClass
    >>> from fusion_sfdia.plants import two_tanks
    >>> plant = two_tanks()
    >>> machine = OneClass.fit(plant, simulate(plant, 200, seeds=range(4), process_noise=True), false_alarm=0.01)
    >>> machine.support.shape[1], machine.max_faults
    (4, 3)
    """

    support: Array
    weights: Array
    limit: float

    def __post_init__(self) -> None:
        super().__post_init__()
        for what in ("support", "weights"):
            object.__setattr__(self, what, floats(what, getattr(self, what)))
        width = len(self.model.precision)
        if self.weights.ndim != 1 or not self.weights.size or self.support.shape != (self.weights.size, width):
            raise ValueError(
                f"support has shape {self.support.shape} for {self.weights.shape} weights; expected (S, {width}) and (S,)"
            )
        object.__setattr__(self, "limit", number("limit", self.limit))
        for what in ("weights", "limit"):
            if not np.all(np.asarray(value := getattr(self, what)) > 0):
                raise ValueError(f"{what} is {shown(value)}; expected positive numbers; use OneClass.fit")

    @classmethod
    def fit(cls, plant: Plant, healthy: Any, false_alarm: float = 1e-3, *, outliers: float = 0.1, **settings: Any) -> Self:
        """Model, machine and limit from healthy readings, at a rate of false alarms per step.

        Of the training half, at most TRAINED_ON samples evenly spread train the machine; the other half sets the limit as an
        order statistic.

        Parameters
        ----------
        plant : Plant
            The model, for the names and noise of its sensors.
        healthy : Recording, Log, frame or tuple
            See `healthy_readings`.
        false_alarm : float, default 1e-3
            The rate.
        outliers : float, default 0.1
            nu, the share of the training samples that is rejected at most: 0.1, chosen among 0.01, 0.1 and 0.5 on runs of other
            seeds than those compared.
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
        from sklearn.svm import OneClassSVM  # slow to import

        probability("false_alarm", false_alarm)
        model, train, judge = ComponentModel.fit(plant, healthy)
        train = train[:: -(-len(train) // TRAINED_ON)]
        w = model.reconstruct(train).x @ whitening(model)
        machine = OneClassSVM(gamma=1 / w.shape[1], nu=probability("outliers", outliers), tol=1e-6).fit(w)
        unlimited = cls(plant, model, w[machine.support_], machine.dual_coef_[0], np.inf, **settings)
        limit = upper_limit(unlimited.statistic(model.reconstruct(judge).x), false_alarm)
        return replace(unlimited, limit=limit, fitted_rate=false_alarm)

    @cached_property
    def _whitening(self) -> Array:
        return whitening(self.model)

    def statistic(self, x: Array) -> Array:
        """-log p of standardised readings.

        Parameters
        ----------
        x : array (B, D)
            Standardised readings.

        Returns
        -------
        array (B,)
            To be compared with `limit`.
        """
        w, s = x @ self._whitening, self.support
        square = np.sum(w**2, axis=-1)[:, None] - 2 * w @ s.T + np.sum(s**2, axis=-1)
        return -np.asarray(logsumexp(-np.maximum(square, 0.0) / w.shape[1], b=self.weights / self.weights.sum(), axis=-1))

    def excess(self, found: Reconstruction) -> Array:
        return np.asarray(np.sqrt(self.statistic(found.x) / self.limit))


def whitening(model: ComponentModel) -> Array:
    """M^(1/2) (D, D), symmetric: P' Lambda^-1/2 P + (I - P' P) / sqrt(noise)."""
    p = model.components
    return np.asarray((p.T / np.sqrt(model.variances)) @ p + (np.eye(p.shape[1]) - p.T @ p) / np.sqrt(model.noise))
