"""What areas exchange, and how their copies start."""

from __future__ import annotations

import numpy as np
import pytest

from fusion_sfdia.detectors.stochastic_thresholds.consensus import MODES, Diagnosers, Prediction, initial_state, predict, take
from fusion_sfdia.models.power_network.diagnosis import network_areas
from fusion_sfdia.models.power_network.model import network_model

LAM = 0.3
AREAS = network_areas(network_model())
AT = AREAS.network.topology


def test_an_area_uses_only_its_own_data_and_what_neighbours_send() -> None:
    rng, i = np.random.default_rng(1), AT.index("5")
    count = AREAS.size[0]
    whole = Diagnosers(*(rng.uniform(0.0, 1.0, a.shape) for a in initial_state(AREAS, (2,))))
    reference, load = rng.standard_normal((2, 2, count))
    near = AT.neighbour[AREAS.network.sides(i)]
    about = np.isin(AT.neighbour, [i, *near])  # copies of the states that area 5 shares
    mine, theirs = AT.node == i, np.isin(AT.node, near)
    poisoned = []
    for k, a in enumerate(whole):
        keep = np.zeros(a.shape, bool)
        if a.ndim == 3:
            keep[:, i] = True
            keep[:, near, 0] = True  # brackets of what they share
            if k in (0, 2):
                keep[:, near] = True  # in the drive, with the readings at their other sides
        elif a.ndim == 2:
            keep[:, about | mine] = True
            if k in (1, 3):
                keep[:, theirs] = True
        poisoned.append(np.where(keep, a, np.nan))
    known = np.isin(np.arange(count), [i, *near])
    for mode in MODES:
        clean = predict(AREAS, whole, reference, load, LAM, mode)
        dirty = predict(
            AREAS, Diagnosers(*poisoned), np.where(known, reference, np.nan), np.where(known, load, np.nan), LAM, mode
        )
        for name in ("estimate", "deviation", "error_bound"):
            np.testing.assert_array_equal(getattr(dirty, name)[:, i], getattr(clean, name)[:, i])
            np.testing.assert_array_equal(getattr(dirty, name + "_shared")[:, mine], getattr(clean, name + "_shared")[:, mine])
        assert np.isnan(dirty.estimate).any()


def test_of_a_drive_only_one_number_is_sent() -> None:
    rng, i = np.random.default_rng(2), AT.index("5")
    j = int(AT.neighbour[AREAS.network.sides(i)][0])
    whole = Diagnosers(*(rng.uniform(0.0, 1.0, a.shape) for a in initial_state(AREAS, (1,))))
    reference, load = rng.standard_normal((2, 1, 15))
    other, given = Diagnosers(*(a.copy() for a in whole)), reference.copy()
    other.held[0, j, 1:] += [1.0, -2.0, 3.0]
    given[0, j] -= AREAS.matrices[j, 0, 1:4] @ [1.0, -2.0, 3.0] / AREAS.matrices[j, 0, 4]  # the drive is the same
    a, b = (predict(AREAS, w, r, load, LAM, "corrected") for w, r in ((whole, reference), (other, given)))
    mine = AT.node == i
    tolerance = 100 * np.finfo(float).eps * np.abs(given).max()
    np.testing.assert_allclose(b.estimate[0, i], a.estimate[0, i], rtol=0, atol=tolerance)
    np.testing.assert_allclose(b.estimate_shared[0, mine], a.estimate_shared[0, mine], rtol=0, atol=tolerance)
    assert abs(b.estimate[0, j, 1] - a.estimate[0, j, 1]) > 0.1


def test_a_copy_starts_from_its_first_reading_and_an_open_tie_has_none() -> None:
    unplugged = network_areas(network_model(unplugged=["4"]))
    now = initial_state(unplugged, (1,))
    zero, y = np.zeros((1, 15)), np.random.default_rng(4).standard_normal((1, 15, 4))
    shared = np.where(unplugged.network.closed, 0.5, np.nan)[None]
    first = predict(unplugged, now, zero, zero, LAM, "corrected")
    assert np.all(first.deviation > 1e50) and np.all(first.deviation_shared > 1e50)
    now = take(unplugged, first, y, shared)
    np.testing.assert_array_equal(now.held, y)
    assert not now.residual.any() and not now.error_bound.any()
    second = predict(unplugged, now, zero, zero, LAM, "corrected")
    assert np.all(second.deviation < 1.0)
    np.testing.assert_array_equal(second.deviation_shared[0] < 1.0, unplugged.network.closed)


def test_the_memory_of_diagnosers_after_readings_of_some_sensors() -> None:
    """Estimate 1, deviation 2, error bound 3: a reading of 5 replaces the estimate, a missing one keeps it."""
    own, shared = (np.ones(a.shape) for a in initial_state(AREAS, (1,))[:2])
    y, y_shared = np.where(own.cumsum().reshape(own.shape) % 2, 5.0, np.nan), np.full(shared.shape, np.nan)
    kept = take(AREAS, Prediction(own, shared, 2 * own, 2 * shared, 3 * own, 3 * shared), y, y_shared)
    read = np.isfinite(y)
    for found, reading, missing in ((kept.held, 5, 1), (kept.error_bound, 0, 3), (kept.residual, 4, 0), (kept.deviation, 2, 0)):
        np.testing.assert_array_equal(found, np.where(read, reading, missing))
    for found, missing in (
        (kept.held_shared, 1),
        (kept.error_bound_shared, 3),
        (kept.residual_shared, 0),
        (kept.deviation_shared, 0),
    ):
        np.testing.assert_array_equal(found, np.full(shared.shape, missing))


def test_an_unknown_mode_is_refused() -> None:
    with pytest.raises(ValueError, match="mode is 'printed'; known: corrected, paper"):
        predict(AREAS, initial_state(AREAS, ()), np.zeros(15), np.zeros(15), LAM, "printed")
