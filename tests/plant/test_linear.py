"""Plants that are matrices: their steps and outputs, what is refused, and the exact hold of inputs."""

from typing import Any

import numpy as np
import pytest
from rounding import rounding
from scipy.linalg import expm
from scipy.signal import cont2discrete

from fusion_sfdia.detectors.detector import run
from fusion_sfdia.detectors.kalman_banks.central_filter import CentralFilter
from fusion_sfdia.plant.linear import linear_plant, zero_order_hold
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Sensor, Signal

EPS = np.finfo(float).eps


@pytest.mark.parametrize("dt", [1e-3, 0.5, 20.0])
def test_zero_order_hold_is_exact(dt: float) -> None:
    rng = np.random.default_rng(3)
    a, b = rng.normal(size=(4, 4)) - 2 * np.eye(4), rng.normal(size=(4, 2))
    f, g = zero_order_hold(a, b, dt)
    # the exponential magnifies a relative change of its argument by the argument's norm; the other g is solved with a
    size = max(np.abs(f).max(), np.abs(g).max(), 1.0)
    near = {"rtol": 0.0, "atol": size * rounding(1 + np.linalg.norm(a * dt, 1), 6)}
    np.testing.assert_allclose(f, expm(a * dt), **near)
    solved = {"rtol": 0.0, "atol": near["atol"] * np.linalg.cond(a)}
    np.testing.assert_allclose(g, np.linalg.solve(a, (expm(a * dt) - np.eye(4)) @ b), **solved)
    expected_f, expected_g, *_ = cont2discrete((a, b, np.eye(4), np.zeros((4, 2))), dt)
    np.testing.assert_allclose(f, expected_f, **near)
    np.testing.assert_allclose(g, expected_g, **near)


def test_zero_order_hold_of_an_integrator_and_without_inputs() -> None:
    f, g = zero_order_hold(np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]]), 3.0)
    np.testing.assert_allclose(f, [[1.0, 3.0], [0.0, 1.0]], rtol=0, atol=rounding(3, 20))
    np.testing.assert_allclose(g, [[4.5], [3.0]], rtol=0, atol=rounding(4.5, 20))  # dt^2 / 2 and dt
    f, g = zero_order_hold(-np.eye(2), np.zeros((2, 0)), 1.0)
    assert g.shape == (2, 0) and f[0, 0] == pytest.approx(np.exp(-1.0), rel=1e-14)
    for a, b in ((np.eye(3), np.ones((2, 1))), (np.ones((2, 3)), np.ones((2, 1))), (np.eye(2), np.ones(2))):
        with pytest.raises(ValueError, match=r"do not fit; expected \(n, n\) and \(n, m\)"):
            zero_order_hold(a, b, 1.0)
    with pytest.raises(ValueError, match="dt is nan s"):
        zero_order_hold(np.eye(2), np.ones((2, 1)), np.nan)


def build_linear(f: Any, h: Any, **more: Any) -> Plant:
    return linear_plant(
        "line",
        f,
        h,
        [Sensor("a", "x0", sigma=1.0), Sensor("b", "x1", sigma=1.0)],
        dt=1.0,
        x0=np.zeros(2),
        initial_cov=np.ones(2),
        process_cov=np.ones(2),
        **more,
    )


def test_a_linear_plant_is_its_matrices() -> None:
    f, g, h = np.array([[1.0, 0.1], [0.0, 0.9]]), np.array([[0.0], [2.0]]), np.array([[1.0, 1.0], [0.0, 1.0]])
    plant = build_linear(f, h, input_matrix=g, inputs=[Signal("u")])
    x, u = np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([[1.0], [-1.0]])
    np.testing.assert_allclose(
        plant.step(0.0, x, u, 1.0), [f @ x[0] + g @ u[0], f @ x[1] + g @ u[1]], rtol=rounding(5.6 / 1.6, 3)
    )
    np.testing.assert_allclose(plant.output(0.0, x, u), x @ h.T, rtol=4 * EPS)
    assert plant.numerics.fixed_dt and [s.name for s in plant.states] == ["x0", "x1"]


@pytest.mark.parametrize(
    ("f", "h", "more"),
    [
        (np.ones((2, 3)), np.eye(2), {}),
        (np.float64(1.0), np.eye(2), {}),
        (np.eye(2), np.ones((3, 2)), {}),
        (np.eye(2), np.eye(2), {"input_matrix": np.ones((2, 2)), "inputs": [Signal("u")]}),
        (np.eye(2), np.eye(2), {"input_matrix": np.ones((2, 1))}),
    ],
)
def test_matrices_that_do_not_fit_are_refused(f: Any, h: Any, more: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="do not fit"):
        build_linear(f, h, **more)


def test_matrices_that_are_not_finite_are_refused() -> None:
    with pytest.raises(ValueError, match="F, G, H, D or an offset of plant 'line' has entries that are not finite"):
        build_linear(np.array([[1.0, np.nan], [0.0, 1.0]]), np.eye(2))


def affine(given: bool) -> tuple[Plant, dict[str, Any]]:
    rng = np.random.default_rng(3)
    n, m, count = 3, 2, 4
    m_ = {
        "F": 0.5 * rng.standard_normal((n, n)), "G": rng.standard_normal((n, m)), "c": rng.standard_normal(n),
        "H": rng.standard_normal((count, n)), "D": rng.standard_normal((count, m)), "d": rng.standard_normal(count),
    }  # fmt: skip
    more = {"offset": m_["c"], "feedthrough": m_["D"], "output_offset": m_["d"]} if given else {}
    plant = linear_plant(
        "affine", m_["F"], m_["H"], [Sensor(f"s{i}", "x0", sigma=0.3) for i in range(count)], dt=1.0, x0=np.ones(n),
        initial_cov=np.ones(n), process_cov=np.full(n, 0.1), input_matrix=m_["G"], inputs=(Signal("a"), Signal("b")), **more,
    )  # fmt: skip
    return plant, m_


def test_the_extended_filter_of_an_affine_plant_is_the_kalman_filter() -> None:
    plant, m_ = affine(True)
    rng = np.random.default_rng(4)
    y, u = rng.standard_normal((25, 4)), rng.standard_normal((25, 2))
    _, found = run(CentralFilter(plant), CentralFilter(plant).init(), np.arange(1.0, 26.0), y, u, covariance=True)
    x, p = np.ones(3), np.eye(3)
    for k in range(25):
        x, p = m_["F"] @ x + m_["G"] @ u[k] + m_["c"], m_["F"] @ p @ m_["F"].T + 0.1 * np.eye(3)
        s = m_["H"] @ p @ m_["H"].T + 0.09 * np.eye(4)
        gain = np.linalg.solve(s, m_["H"] @ p).T
        x, p = x + gain @ (y[k] - m_["H"] @ x - m_["D"] @ u[k] - m_["d"]), p - gain @ m_["H"] @ p
        # both are solves with S, of condition below 1e4, over some steps of a stable filter
        np.testing.assert_allclose(found.estimate[k], x, rtol=0, atol=1e5 * EPS * np.abs(x).max())
        np.testing.assert_allclose(found.covariance[k], p, rtol=0, atol=1e5 * EPS * np.abs(p).max())
    for change in ({"offset": np.zeros(2)}, {"feedthrough": np.zeros((4, 3))}, {"output_offset": np.zeros(3)}):
        with pytest.raises(ValueError, match=r"do not fit .*; expected \(3,\), \(4, 2\), \(4,\)"):
            linear_plant(
                "affine", m_["F"], m_["H"], plant.sensors, dt=1.0, x0=np.ones(3), initial_cov=np.ones(3),
                process_cov=np.ones(3), input_matrix=m_["G"], inputs=plant.inputs, **change,
            )  # fmt: skip
    with pytest.raises(ValueError, match="or an offset of plant 'line' has entries that are not finite"):
        linear_plant(
            "line", np.eye(1), np.eye(1), [Sensor("s", "x0", sigma=1.0)], dt=1.0, x0=np.zeros(1), initial_cov=np.ones(1),
            process_cov=np.ones(1), offset=np.array([np.nan]),
        )  # fmt: skip


def test_text_and_rows_of_unlike_length_are_refused_by_name() -> None:
    with pytest.raises(ValueError, match=r"offset is \['a', 'b'\]; expected an array of numbers"):
        build_linear(np.eye(2), np.eye(2), offset=["a", "b"])
    with pytest.raises(ValueError, match=r"transition is .*; expected an array of numbers"):
        build_linear([[1.0, 0.0], [1.0]], np.eye(2))
