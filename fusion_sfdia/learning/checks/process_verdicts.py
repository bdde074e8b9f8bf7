"""The check of a detector's verdicts on the process."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_array_equal

from fusion_sfdia.detectors.detector import Detector, ProcessHypothesis, run
from fusion_sfdia.learning.checks.readings import Healthy
from fusion_sfdia.learning.checks.require import require

KINDS = ("parameter", "input", "state", "disturbance", "unnamed", "outside")


def process_verdicts_have_numbers(detector: Detector, healthy: Healthy) -> None:
    """Of a detector with process_hypotheses: they are named apart from each other and from what it isolates; an accepted one
    has a size and a standard deviation unless its kind has none, another none; probabilities of exclusive hypotheses.
    """
    tested = detector.process_hypotheses
    names_of_all = [*detector.hypotheses, *(h.name for h in tested)]
    require(len(set(names_of_all)) == len(names_of_all), "names of all hypotheses differ", names_of_all)
    for h in tested:
        require(isinstance(h, ProcessHypothesis) and h.kind in KINDS, f"a ProcessHypothesis of a kind of {KINDS}", h)
    if not tested:
        return
    t, y, u = healthy(30, 2)
    y = y.copy()
    y[10:, 0, 0] += 30 * detector.plant.sensor_sigma[0]
    y[10:, 1] += 30 * detector.plant.sensor_sigma  # no single sensor explains it
    _, d = run(detector, detector.init((2,)), t, y, u)
    sized = np.asarray(d.process) & np.array([h.has_size for h in tested])
    for what in ("process_size", "process_sd"):
        assert_array_equal(np.isnan(getattr(d, what)), ~sized, f"{what} is NaN just where nothing is accepted")
    sd = np.asarray(d.process_sd)[sized]
    require(np.all((sd >= 0) & np.isfinite(sd)), "standard deviations are finite and not negative", sd)
    probability = np.asarray(d.probability)[~d.diverged]
    require(np.all((probability >= 0) & (probability <= 1)), "probabilities are from 0 to 1", probability)
    total, rounding = np.sum(probability, axis=-1), probability.shape[-1] * np.finfo(float).eps
    require(np.all(total <= 1 + rounding), "probabilities of hypotheses add up to at most 1", np.max(total))
    require(not np.any(np.asarray(d.process)[d.diverged]), "nothing is accepted once the estimate has diverged", d.process)
    require(not np.any(np.asarray(d.suspect)[d.diverged]), "nothing is suspected once the estimate has diverged", d.suspect)
