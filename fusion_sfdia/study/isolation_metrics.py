"""Whether the right sensors are isolated, by samples: isolated (K, B, N) bool against active (K, B, N) bool.

`where` (K, B) bool restricts what is counted. Intervals: see metrics.rate_over_runs.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.metrics import confusion_matrix

from fusion_sfdia.common.run_statistics import Estimate, by_run, per_sample, rate_over_runs, require_shapes

Array = NDArray[Any]


def isolation_recall(isolated: Array, active: Array, where: Array | None = None) -> Estimate:
    """Share of the faulty sensor-samples that are isolated."""
    return _rate(isolated, active, _counted(isolated, active, where))


def isolation_precision(isolated: Array, active: Array, where: Array | None = None) -> Estimate:
    """Share of the isolated sensor-samples that are faulty."""
    return _rate(active, isolated, _counted(isolated, active, where))


def false_flag_rate(isolated: Array, active: Array, where: Array | None = None) -> Estimate:
    """Share of the healthy sensor-samples that are isolated (false isolation)."""
    return _rate(isolated, ~active, _counted(isolated, active, where))


def exact_isolation(isolated: Array, active: Array, where: Array | None = None) -> Estimate:
    """Share of the faulty samples (some sensor is faulty) at which exactly the faulty sensors are isolated."""
    counted = _counted(isolated, active, where) & active.any(axis=-1)
    exact = (isolated == active).all(axis=-1)
    return rate_over_runs((exact & counted).sum(axis=0), counted.sum(axis=0))


def confusion(isolated: Array, active: Array, where: Array | None = None) -> Array:
    """Confusion matrix (N + 1, N + 1), rows the truth, columns what is isolated, index 0 none (Shaheen 2024, Fig. 6).

    Parameters
    ----------
    isolated : array (K, B, N) of bool
        Whether each sensor is isolated; of one run also (K, N), or (K,) of one sensor.
    active : array (K, B, N) of bool
        Whether each sensor is faulty; of one run as isolated.
    where : array (K, B) of bool, optional
        The samples that count, of one run also (K,); None for all.

    Returns
    -------
    array (N + 1, N + 1)
        Numbers of samples.

    Notes
    -----
    Each sample is one entry in the row of every faulty sensor, or in row 0 where none is. It falls in its own column
    where the sensor is isolated; else evenly in the columns of the healthy sensors that are isolated, or in column 0
    where none is. A row adds up to its number of samples; only isolation_precision shows a healthy sensor that is isolated
    in addition to the faulty one.

    Examples
    --------
    >>> import numpy as np
    >>> from fusion_sfdia import confusion
    >>> active = np.array([[[False, False]], [[True, False]], [[True, False]]])  # (K, B, N): one run, two sensors
    >>> isolated = np.array([[[False, False]], [[True, False]], [[False, True]]])
    >>> confusion(isolated, active)
    array([[1., 0., 0.],
           [0., 1., 1.],
           [0., 0., 0.]])
    """
    isolated, active, where = by_run(isolated), by_run(active), per_sample(where)
    counted = _counted(isolated, active, where)
    found, faulty = isolated[counted], active[counted]
    n = found.shape[-1]
    wrong = found & ~faulty
    healthy = ~faulty.any(axis=-1)
    truth, guess, weight = [], [], []
    for row, samples, right in [(0, healthy, np.zeros_like(healthy))] + [
        (i + 1, faulty[:, i], found[:, i]) for i in range(n) if faulty[:, i].any()
    ]:
        missed = samples & ~right
        blank = missed & ~wrong.any(axis=-1)
        sample, column = np.nonzero(wrong & missed[:, None])
        share = 1.0 / np.maximum(wrong.sum(axis=-1), 1)
        columns = [np.full(int((samples & right).sum()), row), np.zeros(int(blank.sum()), int), column + 1]
        guess += columns
        weight += [np.ones(columns[0].size), np.ones(columns[1].size), share[sample]]
        truth.append(np.full(sum(c.size for c in columns), row))
    if not sum(part.size for part in truth):
        return np.zeros((n + 1, n + 1))
    matrix: Array = confusion_matrix(
        np.concatenate(truth), np.concatenate(guess), labels=np.arange(n + 1), sample_weight=np.concatenate(weight)
    )
    return matrix


def _counted(isolated: Array, active: Array, where: Array | None) -> Array:
    counted = np.ones(active.shape[:2], bool) if where is None else where
    require_shapes(isolated=(isolated, active.shape), where=(counted, active.shape[:2]))
    return counted


def _rate(hit: Array, among: Array, counted: Array) -> Estimate:
    among = among & counted[..., None]
    return rate_over_runs((hit & among).sum(axis=(0, 2)), among.sum(axis=(0, 2)))
