"""The bank on an identified model as an outlier detector of scikit-learn."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from sklearn.base import BaseEstimator, OutlierMixin
from sklearn.utils.validation import check_is_fitted, validate_data

from fusion_sfdia.detectors.detector import Decision, run
from fusion_sfdia.learning.identification.choice import Candidate, ModelChoice
from fusion_sfdia.learning.identification.healthy_runs import groups_of, runs_of
from fusion_sfdia.learning.outlier_detectors.calibration import Calibration
from fusion_sfdia.learning.outlier_detectors.methods import Methods
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.signals import Signal

Array = NDArray[Any]

NOT_APPLICABLE = {
    "check_methods_subset_invariance": "rows are samples in time: what is found in one depends on those before it",
    "check_methods_sample_order_invariance": "rows are samples in time: their order matters",
}


class SensorFaultDetector(OutlierMixin, BaseEstimator):  # type: ignore[misc]
    """A `LeaveOneOutBank` on a model that is identified from healthy rows; rows are samples in time, at equal steps.

    An outlier detector as scikit-learn has them. All methods but `fit` step through X from the initial state of the model: pass
    a whole run.

    Parameters
    ----------
    inputs : sequence of int, default ()
        Positions of the columns that are inputs.
    kind : str, optional
        Of the model, see `Candidate`; None for the choice by left-out stretches.
    order : int, default 1
        Of a model of that kind, see `Candidate`; without effect where kind is None.
    false_alarm : float, default 0.01
        Share of healthy samples in alarm, raised to what the rows can set.
    folds : int, default 4
        Stretches that are left out in turn.

    Attributes
    ----------
    choice_ : ModelChoice
        The model, after `fit` as the following ones.
    calibration_ : Calibration
        The thresholds.
    offset_ : float
        -1.
    n_features_in_ : int
        D.
    sensors_ : array (N,) of int
        The positions of the columns that are tested, the others being inputs or columns that never move.

    Raises
    ------
    ValueError
        For fewer than two samples, inputs that are no columns, and data that no model can be identified from.

    Examples
    --------
    >>> import numpy as np
    >>> from fusion_sfdia.learning import SensorFaultDetector
    >>> rng = np.random.default_rng(0)
    >>> def rows(count):
    ...     return np.sin(np.arange(count) / 30)[:, None] * [1.0, 0.8, 0.5] + 0.02 * rng.standard_normal((count, 3))
    >>> detector = SensorFaultDetector(kind="factors", order=1, false_alarm=0.05).fit(rows(150))
    >>> X = rows(60)
    >>> X[30:, 1] += 1.0
    >>> int(detector.predict(X)[40]), detector.isolated(X)[40].tolist()
    (-1, [False, True, False])
    """

    def __init__(
        self,
        inputs: Sequence[int] = (),
        kind: str | None = None,
        order: int = 1,
        false_alarm: float = 0.01,
        folds: int = 4,
    ) -> None:
        self.inputs = inputs
        self.kind = kind
        self.order = order
        self.false_alarm = false_alarm
        self.folds = folds

    def fit(self, X: Any, y: Any = None) -> Self:
        """Identify the model and set thresholds from healthy rows.

        Parameters
        ----------
        X : array (K, D)
            Healthy readings and inputs, NaN where missing.
        y : optional
            Ignored.

        Returns
        -------
        Self
            This detector.
        """
        X = validate_data(self, X, dtype=float, ensure_min_samples=2, ensure_all_finite="allow-nan")
        if bad := [i for i in self.inputs if not 0 <= i < X.shape[1]]:
            raise ValueError(f"inputs has {bad}; expected positions of the {X.shape[1]} columns")
        columns = [i for i in range(X.shape[1]) if i not in self.inputs]
        sensors = [Signal(f"x{i}") for i in columns]
        inputs = [Signal(f"x{i}") for i in self.inputs]
        log = self._log(X, columns)
        candidates = None if self.kind is None else [Candidate(self.kind, self.order)]
        self.choice_ = ModelChoice.of("rows", sensors, [log], inputs=inputs, candidates=candidates, folds=self.folds)
        self.sensors_ = np.array([i for i in columns if f"x{i}" not in self.choice_.still])
        moving = [Signal(f"x{i}") for i in self.sensors_]
        groups = groups_of(runs_of(moving, inputs, [self._log(X, self.sensors_)]), self.folds)[1]
        warm_up = min(20, len(X) // self.folds // 4)
        rate = max(self.false_alarm, 1.0 / max(len(X) - 2 * warm_up * self.folds, 2))
        methods = Methods(self.choice_, moving, inputs, rate)
        self.calibration_ = Calibration.of(methods.bank, groups, rate, warm_up)
        self.offset_ = -1.0
        return self

    def score_samples(self, X: Any) -> Array:
        """Minus the largest residual over its threshold, -2 at most while a sensor is isolated: more is healthier.

        Parameters
        ----------
        X : array (K, D)
            A whole run.

        Returns
        -------
        array (K,)
            Of each sample.
        """
        found = self._decisions(X)
        held = np.any(found.isolated, axis=-1)
        return -np.asarray(np.where(held, np.maximum(found.score, 2.0), found.score))

    def decision_function(self, X: Any) -> Array:
        """score_samples less offset_: negative for a sample in alarm.

        Parameters
        ----------
        X : array (K, D)
            A whole run.

        Returns
        -------
        array (K,)
            Of each sample.
        """
        return np.asarray(self.score_samples(X) - self.offset_)

    def predict(self, X: Any) -> NDArray[np.int64]:
        """1 for a healthy sample, -1 for one in alarm.

        Parameters
        ----------
        X : array (K, D)
            A whole run.

        Returns
        -------
        array (K,) of int
            Of each sample.
        """
        return np.where(self.decision_function(X) < 0, -1, 1).astype(np.int64)

    def isolated(self, X: Any) -> NDArray[np.bool_]:
        """Which sensors, in the order of sensors_, are isolated in each sample.

        Parameters
        ----------
        X : array (K, D)
            A whole run.

        Returns
        -------
        array (K, N) of bool
            Of each sample and sensor.
        """
        return np.asarray(self._decisions(X).isolated)

    def _decisions(self, X: Any) -> Decision:
        check_is_fitted(self)
        X = validate_data(self, X, dtype=float, reset=False, ensure_all_finite="allow-nan")
        detector = self.calibration_.detector
        log = self._log(X, self.sensors_)
        log = log._replace(u=np.where(np.isfinite(log.u), log.u, [s.nominal for s in detector.plant.inputs]))
        return run(detector, detector.init((), -detector.plant.dt), log)[1]

    def _log(self, X: Array, columns: Any) -> Log:
        return Log(np.arange(len(X), dtype=float), X[:, columns], X[:, list(self.inputs)])

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.input_tags.allow_nan = True
        return tags
