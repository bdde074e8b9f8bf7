"""Thresholds from healthy data, for a method that defines none."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.arguments import floats, probability, whole
from fusion_sfdia.core.detector import run
from fusion_sfdia.core.order_statistics import order_statistic
from fusion_sfdia.kalman_banks.fusing_bank import FusingBank

Array = NDArray[Any]


def calibrate(bank: FusingBank, t: Array, y: Array, u: Array, false_alarm: float = 1e-3, warm_up: int = 20) -> FusingBank:
    """Return the bank with one threshold for each quantity, at the stated rate of false alarms per sample.

    t (K,), y (K, ..., N) healthy readings, u (K, ..., m). The threshold of a quantity is an order statistic of its
    largest residual after the first `warm_up` samples, in which the filter settles; the quantities share the budget
    equally. Runs in which the bank diverges are left out. ValueError for another detector, and where the data are too few for
    the rate: less than one sample expected above the threshold.
    """
    if not isinstance(bank, FusingBank):
        raise ValueError(
            f"bank is a {type(bank).__name__}; only a FusingBank is calibrated here, because its method defines no thresholds. "
            "LeaveOneOutBank and CentralFilter take false_alarm, Chebyshev alpha or its `calibrated`, and FixedLimits, "
            "PrincipalComponents and StructuralResiduals are fitted by their fit()"
        )
    probability("false_alarm", false_alarm)
    whole("warm_up", warm_up, least=0)
    t, y, u = floats("t", t), floats("y", y), floats("u", u)
    if t.ndim != 1 or not t.size or y.ndim < 2:
        raise ValueError(f"t {t.shape}, y {y.shape} do not fit; expected at least one time (K,) and readings (K, ..., sensors)")
    groups = bank.plant.quantities
    silent = replace(bank, thresholds=(np.inf,) * len(bank.plant.sensors))
    _, decisions = run(silent, silent.init(y.shape[1:-1], float(t[0]) - bank.plant.dt), t, y, u)
    residual = np.abs(decisions.residual[warm_up:, ~np.any(decisions.diverged, axis=0)]).reshape(-1, y.shape[-1])
    share = false_alarm / len(groups)
    if share * residual.shape[0] < 1:
        raise ValueError(
            f"{residual.shape[0]} healthy samples cannot set a false-alarm rate of {false_alarm:g} over {len(groups)} "
            f"quantities; give at least {int(np.ceil(len(groups) / false_alarm))} or ask for a higher rate"
        )
    thresholds = np.empty(y.shape[-1])
    for members in groups.values():
        largest = np.nanmax(np.where(np.isfinite(residual[:, members]), residual[:, members], -np.inf), axis=1)
        thresholds[members] = order_statistic(largest, share)
    return replace(bank, thresholds=tuple(thresholds.tolist()))
