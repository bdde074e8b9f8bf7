"""A step of an observer with bounds, written out for one state, one algebraic variable and one input."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from fusion_sfdia.detectors.adaptive_thresholds.monitoring import Settings, box, decide, into_envelope, monitor
from fusion_sfdia.plant.modules import Modules

Array = NDArray[Any]
DT = 0.1
EQUATIONS = {"x": lambda x, z, v, c: 3 * z - v - c * x, "z": lambda x: 0.5 * x}
SETTINGS = Settings(
    nominal=np.array([10.0, 5.0]), half_width=np.array([100.0, 50.0]), bound=np.array([0.1, 0.2]), rates=np.array([0.2]),
    gains=np.array([0.5]), signs=np.array([[-1.0, 1.0, -1.0], [1.0, 0.0, 0.0]]), unproved=np.zeros((2, 3)), rounding=0.0,
)  # fmt: skip


def z_alone(x: Array, c: Any) -> Array:
    return 0.5 * x


def modules(equations: dict[str, Any]) -> Modules:
    return Modules(
        equations=equations, rates=SETTINGS.rates, nominal={"x": 10.0, "z": 5.0}, parameters=0.1, inputs=("v",),
        names={"x": "M1", "z": "M2"}, gains={"x": 0.5},
    )  # fmt: skip


def step(before: list[float], settings: Settings = SETTINGS, x: float = 10.5) -> list[float]:
    equations = {"x": EQUATIONS["x"], "z": z_alone}
    reading, u = np.array([[10.2, 5.1]]), np.array([[1.0]])
    m = modules(equations)
    found = monitor(m, np.array([[x]]), np.array([[0.4]]), np.array([before]), reading, u, DT, settings)
    return [float(a[0, 0]) for a in found]


def test_a_step_of_an_observer_checked_by_hand() -> None:
    """x' = h - 0.2 x + 0.5 (y - x), h = 3 z - v - 0.1 x: z in [4.8, 5.3] over the step, x in [9.9, 10.5] with the estimate."""
    lam = np.exp(-0.7 * DT)
    held = (1 - lam) / 0.7
    h, least, most = 3 * 5.05 - 1 - 1.05, 3 * 4.8 - 1 - 1.05, 3 * 5.3 - 1 - 0.99
    ahead = lam * 10.5 + held * (h + 0.5 * 10.0)
    steady = lam * 0.4 + held * (max(most - h, h - least) + 0.5 * 0.1)
    assert step([10.0, 5.0]) == pytest.approx([ahead, steady, 5.05, 5.15], rel=1e-12)
    slow, fast = SETTINGS._replace(drift=0.3), SETTINGS._replace(drift=1e6)
    assert step([10.0, 5.0], slow)[1] == pytest.approx(steady + 0.5 * held * 0.3 * DT, rel=1e-12)
    speed = max(abs(most - 2.1), abs(least - 2.1)) + 0.2 * 0.4
    assert step([10.0, 5.0], fast)[1] == pytest.approx(steady + 0.5 * (DT - held) / 0.7 * speed, rel=1e-12)
    tight = SETTINGS._replace(nominal=np.array([11.5, 5.0]), half_width=np.array([1e-3, 50.0]))
    assert step([10.0, 5.0], tight)[:2] == pytest.approx([ahead, abs(ahead - 11.5) + 1e-3], rel=1e-12)


def test_without_a_reading_the_observer_runs_open_loop_within_the_envelope() -> None:
    """The box of x is the envelope, [8, 12]; of z, which is read, as before. Gain 0: a = 0.2."""
    narrow = SETTINGS._replace(half_width=np.array([2.0, 50.0]), drift=1e6)
    lam = np.exp(-0.2 * DT)
    held = (1 - lam) / 0.2
    h, least, most = 3 * 5.05 - 1 - 1.05, 3 * 4.8 - 1 - 1.2, 3 * 5.3 - 1 - 0.8
    ahead = lam * 10.5 + held * h
    bound = lam * 0.4 + held * max(most - h, h - least)
    assert step([np.nan, 5.0], narrow)[:2] == pytest.approx([ahead, bound], rel=1e-12)
    frozen = narrow._replace(rates=np.array([0.0]))  # a = 0: the input is held for dt
    assert step([np.nan, 5.0], frozen)[:2] == pytest.approx([10.5 + DT * h, 0.4 + DT * max(most - h, h - least)], rel=1e-12)


def test_unproved_slopes_and_rounding_widen_bounds() -> None:
    loose = SETTINGS._replace(unproved=np.array([[0.0, 0.0, 0.0], [0.7, 0.0, 0.0]]), rounding=1e-3)
    slack = 0.1 * 0.7 + 1e-3 * 5.15  # half the width of x in [10.1, 10.3], and of the larger end
    assert step([10.0, 5.0], loose)[2:] == pytest.approx([5.05 - slack, 5.15 + slack], rel=1e-12)


def test_boxes_checked_by_hand() -> None:
    low, high = box(np.array([[1.0, np.nan]]), np.array([[2.0, 7.0]]), np.array([[3.0]]), SETTINGS)
    np.testing.assert_allclose(low, [[0.9, -45.0, 3.0]])
    np.testing.assert_allclose(high, [[2.1, 55.0, 3.0]])
    low, high = box(np.array([[1.0, 3.0]]), np.array([[2.0, np.nan]]), np.array([[3.0]]), SETTINGS)
    np.testing.assert_allclose([low[0], high[0]], [[0.9, -45.0, 3.0], [2.1, 55.0, 3.0]])
    low, high = into_envelope(np.array([[-95.0, 0.0, -1e9]]), np.array([[0.0, 60.0, 1e9]]), SETTINGS)
    np.testing.assert_array_equal(low, [[-90.0, 0.0, -1e9]])
    np.testing.assert_array_equal(high, [[0.0, 55.0, 1e9]])


def test_decisions_checked_by_hand() -> None:
    """Sensors of the state in kilo-units, of the other variable, and of the state again; the last has fired before."""
    y = np.array([[0.012, 5.0, np.nan], [0.0104, np.nan, 10.0]])
    x, state_bound, lower, upper = (
        np.array([[10.0], [np.nan]]),
        np.full((2, 1), 0.5),
        np.full((2, 1), 4.0),
        np.full((2, 1), 5.0),
    )
    extra, fired = np.array([0.25, 0.1]), np.array([[False, False, True], [False, False, False]])
    scale = np.array([-1e-3, 1.0, 1.0])
    y[:, 0] *= -1
    found = decide(y, x, state_bound, lower, upper, extra, np.array([0, 1, 0]), scale, fired, 2.0)
    residual, threshold, reconstruction, firing, lost = found
    np.testing.assert_allclose(residual[0], [-2e-3, 0.5, np.nan], rtol=1e-12)
    np.testing.assert_allclose(threshold, [[1.5e-3, 2 * (0.5 + 0.1), 1.5]] * 2, rtol=1e-12)
    np.testing.assert_allclose(reconstruction[0], [-0.012, 5.0, 10.0], rtol=1e-12)
    np.testing.assert_allclose(reconstruction[1], [-0.0104, 4.5, 10.0], rtol=1e-12)
    assert firing.tolist() == [[True, False, True], [False, False, False]]
    assert lost.tolist() == [False, True]


def test_a_slope_without_a_sign_is_evaluated_in_the_middle() -> None:
    flat = SETTINGS._replace(signs=np.zeros((2, 3)), unproved=np.array([[0.0, 0.0, 0.0], [0.7, 0.0, 0.0]]))
    assert step([10.0, 5.0], flat)[2:] == pytest.approx([5.1 - 0.1 * 0.7, 5.1 + 0.1 * 0.7], rel=1e-12)


def test_bounds_exceed_rounding() -> None:
    """Of a point, 0.5 * 10.2, by 1e-12 of it unless another share is stated."""
    assert Settings._field_defaults["rounding"] == 1e-12
    point = SETTINGS._replace(bound=np.zeros(2), rounding=1e-12)
    _, _, lower, upper = step([10.0, 5.0], point)
    assert 0.9e-12 < 1 - lower / 5.1 < 1.1e-12 and 0.9e-12 < upper / 5.1 - 1 < 1.1e-12


def test_the_state_moves_at_most_at_the_larger_of_both_speeds() -> None:
    """z in [-5.2, 5.3] over the step: dx/dt is largest in size at the lower end."""
    lam = np.exp(-0.7 * DT)
    held = (1 - lam) / 0.7
    h, least, most = 3 * 0.05 - 1 - 1.05, 3 * -5.2 - 1 - 1.05, 3 * 5.3 - 1 - 0.99
    speed = max(abs(most - 2.1), abs(least - 2.1)) + 0.2 * 0.4
    assert abs(least - 2.1) > abs(most - 2.1)
    bound = lam * 0.4 + held * (max(most - h, h - least) + 0.5 * 0.1) + 0.5 * (DT - held) / 0.7 * speed
    assert step([10.0, -5.0], SETTINGS._replace(drift=1e6))[1] == pytest.approx(bound, rel=1e-12)


def test_an_equation_without_a_value_is_evaluated_in_the_envelope() -> None:
    """A root of z in [-3.2, -2.8], moved into its envelope [3, 7], and of x in [-2.9, -2.7], moved into [8, 12]."""
    equations = {"x": lambda z, c: np.sqrt(z), "z": lambda x, c: np.sqrt(x)}
    settings = SETTINGS._replace(half_width=np.array([2.0, 2.0]))
    z, x = -3.0, -2.8
    given = np.array([[10.5]]), np.array([[0.4]]), np.array([[10.0, z]]), np.array([[x, z]]), np.array([[1.0]])
    with np.errstate(invalid="ignore"):
        found = monitor(modules(equations), *given, DT, settings)
    lam = np.exp(-0.7 * DT)
    held = (1 - lam) / 0.7
    ahead, root = lam * 10.5 + held * (np.sqrt(3.0) + 0.5 * 10.0), np.sqrt(8.0)
    expected = [ahead, lam * 0.4 + held * 0.5 * 0.1, root, root]
    assert [float(a[0, 0]) for a in found] == pytest.approx(expected, rel=1e-12)


def test_a_residual_at_its_threshold_is_no_alarm_and_one_infinite_prediction_marks_the_run() -> None:
    """Sensor 2: prediction 4.5, radius 0.5 and 0.5 more. Sensor 1, before it, has no finite prediction."""
    y, bounds = np.array([[1.0, 5.5]] * 2), np.array([[4.0], [4.0]])
    x = np.array([[np.inf], [np.nan]])
    residual, threshold, _, firing, lost = decide(
        y,
        x,
        np.zeros((2, 1)),
        bounds,
        bounds + 1,
        np.array([0.0, 0.5]),
        np.array([0, 1]),
        np.ones(2),
        np.zeros((2, 2), bool),
        1.0,
    )
    assert residual[:, 1].tolist() == threshold[:, 1].tolist() == [1.0, 1.0]
    assert not firing[:, 1].any() and lost.all()
