from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from fusion_sfdia.diagnosis.simulate import simulate
from fusion_sfdia.models.two_tanks.comparison import other_tanks
from fusion_sfdia.models.two_tanks.plant import INFLOW, NOMINAL, STEP, two_tanks
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.study.cases import case_readings
from fusion_sfdia.study.comparison.subjects import compared_plant, plant_of
from fusion_sfdia.study.truths import double_spread, finest, fluctuating, trending

X, U = np.array([[0.9, 1.1]]), np.array([INFLOW])


def test_a_trend_begins_as_the_first_plant_and_ends_as_the_last() -> None:
    first, last = two_tanks(outlet=0.95), two_tanks(outlet=1.05)
    found = trending(first, last, 100.0)
    for t, ends in (
        (0.0, {"first": 1.0, "last": 0.0}),
        (50.0, {"first": 0.5, "last": 0.5}),
        (500.0, {"first": 0.0, "last": 1.0}),
    ):
        expected = ends["first"] * finest(first).step(t, X, U, STEP) + ends["last"] * finest(last).step(t, X, U, STEP)
        np.testing.assert_allclose(found.step(t, X, U, STEP), expected, rtol=1e-14)
        read = ends["first"] * finest(first).output(t, X, U) + ends["last"] * finest(last).output(t, X, U)
        np.testing.assert_allclose(found.output(t, X, U), read, rtol=1e-14)


def test_a_trend_of_no_time_is_refused() -> None:
    with pytest.raises(ValueError, match="positive time"):
        trending(two_tanks(), two_tanks(), 0.0)


def test_an_input_fluctuates_with_its_spread_and_correlation() -> None:
    """A tank that integrates its inflow: level_1 follows xi B, its innovations give xi back.

    100 runs of 160 samples of an AR(1) with phi = exp(-1/4): the variance of the mean square is (1 + phi^2)/(1 - phi^2) 2/n.
    """
    spread, time_constant, runs, steps = 0.02 * INFLOW, 4 * STEP, 100, 160
    plant = fluctuating(two_tanks, {"inflow": spread}, time_constant)
    recording = simulate(two_tanks(), steps, tuple(range(runs)), truth=plant, process_noise=True)
    quiet = finest(two_tanks())
    levels = recording.signal[..., :2]
    ahead = quiet.step(0.0, levels[:-1], U, STEP)[..., 0]
    xi = (levels[1:, :, 0] - ahead)[20:] * NOMINAL.area / STEP
    phi = np.exp(-STEP / time_constant)
    error = np.sqrt(2 * (1 + phi**2) / (1 - phi**2) / xi.size)
    # the derivative of a step by the inflow is taken about x0 : second order in the changes of level, below a percent here
    assert abs(np.mean(xi**2) / spread**2 - 1) < 4 * error + 0.02
    assert abs(np.mean(xi[1:] * xi[:-1]) / np.mean(xi**2) - phi) < 4 * error + 0.02


def test_a_plant_that_fluctuates_is_disturbed_though_the_usual_one_is_not() -> None:
    of = compared_plant("two-tanks")
    found = case_readings(plant_of(of), 30, (0, 1), truth=fluctuating(two_tanks, {"inflow": 0.05 * INFLOW}, 50.0))
    assert np.std(found.signal[-1, :, 0]) > 0
    assert np.std(case_readings(plant_of(of), 30, (0, 1)).signal[-1, :, 0]) == 0


def test_an_input_that_a_plant_lacks_cannot_fluctuate() -> None:
    with pytest.raises(ValueError, match="no input outflow; its inputs: inflow"):
        fluctuating(two_tanks, {"outflow": 1.0}, 10.0)


def test_a_double_spread_is_two_standard_deviations_in_turn_above_and_below() -> None:
    known = {p.name: p for p in two_tanks().uncertainty.parameters}
    asked: dict[str, float] = {}

    def rebuild(**values: float) -> Plant:
        asked.update(values)
        return two_tanks()

    double_spread(two_tanks, rebuild, ("outlet_1", "outlet_2"))
    for sign, name in ((2.0, "outlet_1"), (-2.0, "outlet_2")):
        assert asked[name] == pytest.approx(known[name].nominal + sign * known[name].sd, rel=1e-14)
    with pytest.raises(ValueError, match="states no spread of area"):
        double_spread(two_tanks, partial(other_tanks), ("area",))
