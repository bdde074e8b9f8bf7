"""The frozen filter: innovations of the plain filter, and derivatives by causes as differences show them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from toy_plants import tanks

from fusion_sfdia.diagnosis.simulate import simulate
from fusion_sfdia.learning.frozen_model.frozen_filter import FRESH, FrozenFilter, FrozenRow, Tracked
from fusion_sfdia.learning.innovations import filtered, held
from fusion_sfdia.plant.log import Log

Array = NDArray[Any]

PLANT = tanks()
VALUES = np.concatenate([PLANT.uncertainty.nominal, np.zeros(len(PLANT.uncertainty.inputs))])
STEPS = 60


def log() -> Log:
    found = simulate(PLANT, STEPS, [3], process_noise=True)
    return Log(found.t, found.y, found.u_of_runs)


def rows(values: Array, readings: Log, **settings: Any) -> tuple[list[FrozenRow], Tracked]:
    filter_ = FrozenFilter(PLANT, values, **settings)
    now, found, before = filter_.start((1,)), [], float(readings.t[0]) - PLANT.dt
    for t, y, u in zip(readings.t.tolist(), readings.y, readings.u, strict=True):
        now, row = filter_.step(now, before, t - before, y, u)
        found.append(row)
        before = t
    return found, now


def test_the_innovations_are_those_of_the_filter_with_held_unknowns() -> None:
    """Both update by the same S: whitened they are the same numbers, to rounding of readings over their noise."""
    readings = log()
    own = rows(VALUES, readings)[0]
    for row, sample in zip(own, filtered(held(PLANT), readings), strict=True):
        np.testing.assert_allclose(row.nis[0] * 4, np.sum(sample.normal[0] ** 2), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("cause", range(4 + VALUES.size))
def test_the_derivatives_are_those_of_differences(cause: int) -> None:
    """A small lasting cause, against the run without it; the gain of a plant that is not linear depends on it, too."""
    readings, size, count = log(), 1e-4, len(PLANT.sensors)
    sd = np.concatenate(
        [PLANT.uncertainty.sd, [PLANT.uncertainty.inputs[s.name] for s in PLANT.inputs if s.name in PLANT.uncertainty.inputs]]
    )
    plain = rows(VALUES, readings)[0]
    if cause < count:
        step = size * PLANT.sensor_sigma[cause]
        other = rows(VALUES, readings._replace(y=readings.y + step * np.eye(count)[cause]))[0]
    else:
        step = -size * sd[cause - count]  # the truth is above a model that is below it
        other = rows(VALUES + step * np.eye(VALUES.size)[cause - count], readings)[0]
        step = -step
    for one, two in zip(plain[5:], other[5:], strict=True):
        change = (two.innovation - one.innovation)[0] / step
        expected = one.by_cause[0, :, cause]
        np.testing.assert_allclose(change, expected, rtol=1e-2, atol=1e-2 * np.max(np.abs(expected)))


def test_what_has_just_begun_is_seen_as_it_is_at_first() -> None:
    """Of the age of the whole run, a cause that has just begun is a lasting one; of age 1 a sensor's fault is its own alone."""
    few = log()
    few = few._replace(t=few.t[:FRESH], y=few.y[:FRESH], u=few.u[:FRESH])
    found, now = rows(VALUES, few)
    lasting = sum(row.by_cause[0] for row in found)
    np.testing.assert_allclose(now.grown[0, FRESH - 1], lasting, rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(now.grown[0, 0, :, : len(PLANT.sensors)], np.eye(len(PLANT.sensors)))


def test_causes_that_began_at_a_chosen_row_are_followed_from_there() -> None:
    """Chosen FRESH rows after the start and followed for five more, they are lasting ones since the start."""
    few, filter_ = log(), FrozenFilter(PLANT, VALUES)
    now, lasting, before = filter_.start((1,)), 0.0, float(few.t[0]) - PLANT.dt
    for k, t in enumerate(few.t[: FRESH + 5].tolist()):
        now, row = filter_.step(now, before, t - before, few.y[k], few.u[k])
        lasting, before = lasting + row.by_cause[0], t
        if k == FRESH - 1:
            now = now.since(np.array([FRESH]), np.array([True]))
    np.testing.assert_allclose(now.grown[0, FRESH], lasting, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(row.by_begun[0], row.by_cause[0], rtol=1e-9, atol=1e-12)


def test_without_causes_of_sensors_the_others_are_the_same() -> None:
    whole, part = rows(VALUES, log())[0], rows(VALUES, log(), of_sensors=False)[0]
    for one, two in zip(whole, part, strict=True):
        np.testing.assert_allclose(one.by_cause[..., len(PLANT.sensors) :], two.by_cause, rtol=1e-12, atol=1e-14)
        np.testing.assert_array_equal(one.innovation, two.innovation)
