"""Equations and their derivatives: the complex step and differences against analytic Jacobians."""

import numpy as np
import pytest
from numba import njit
from numba.core.caching import FunctionCache

from fusion_sfdia.derivatives.equation import (
    argument_names,
    batch_rows,
    compiled,
    complex_step_jacobian,
    difference_jacobian,
    equation,
)

EPS = np.finfo(float).eps


def curve(x: np.ndarray) -> np.ndarray:
    """(..., 3) to (..., 2)."""
    a, b, c = np.moveaxis(x, -1, 0)
    return np.stack([np.exp(a) * np.sin(b), c**3 / a + np.sqrt(b)], axis=-1)


def slope_of_curve(x: np.ndarray) -> np.ndarray:
    a, b, c = np.moveaxis(x, -1, 0)
    zero = np.zeros_like(a)
    first = np.stack([np.exp(a) * np.sin(b), np.exp(a) * np.cos(b), zero], axis=-1)
    second = np.stack([-(c**3) / a**2, 0.5 / np.sqrt(b), 3 * c**2 / a], axis=-1)
    return np.stack([first, second], axis=-2)


@pytest.mark.parametrize("batch", [(), (4,), (2, 3)])
def test_complex_step_is_the_analytic_jacobian_to_rounding(batch: tuple[int, ...]) -> None:
    x = np.random.default_rng(0).uniform(0.5, 2.0, (*batch, 3))
    got = complex_step_jacobian(curve, x)
    assert got.shape == (*batch, 2, 3) and got.dtype == float
    # no subtraction takes place: a few roundings of elementary functions, relative to the largest entry, about 30
    np.testing.assert_allclose(got, slope_of_curve(x), rtol=20 * EPS, atol=20 * EPS)


@pytest.mark.parametrize("batch", [(), (4,), (2, 3)])
def test_difference_jacobian_errs_by_its_order_only(batch: tuple[int, ...]) -> None:
    x = np.random.default_rng(1).uniform(0.5, 2.0, (*batch, 3))
    got = difference_jacobian(curve, x, np.ones(3))
    assert got.shape == (*batch, 2, 3)
    # width eps^(1/3): truncation and rounding both go with eps^(2/3), here times a third derivative of at most 6 * 8 / .5^4
    np.testing.assert_allclose(got, slope_of_curve(x), atol=800 * EPS ** (2 / 3), rtol=0)


def test_difference_jacobian_takes_the_scale_of_each_component() -> None:
    # slopes per pascal and per kelvin differ by 1e6; one width for both would lose either
    def mixed(x: np.ndarray) -> np.ndarray:
        return np.stack([np.sin(x[..., 0] / 1e6) + np.cos(x[..., 1])], axis=-1)

    got = difference_jacobian(mixed, np.array([8e6, 1.0]), np.array([1e6, 1.0]))
    np.testing.assert_allclose(got, [[np.cos(8.0) / 1e6, -np.sin(1.0)]], rtol=1e-8)
    assert np.all(np.isfinite(difference_jacobian(mixed, np.array([8e6, 1.0]), np.zeros(2))))


@equation
def discharge(coefficient, p_in, p_out):
    return coefficient * np.sqrt(p_in - p_out)


def test_an_equation_is_python_and_compiles_into_its_caller_with_the_same_numbers() -> None:
    @njit
    def total(p: np.ndarray) -> float:
        flow = 0.0
        for i in range(p.size - 1):
            flow += discharge(0.5, p[i], p[i + 1])
        return flow

    p = np.array([9.0, 5.0, 4.0, 0.25])
    assert total(p) == pytest.approx(sum(discharge(0.5, p[:-1], p[1:])), rel=4 * EPS)
    assert discharge(0.5, 9.0, 5.0) == 1.0
    assert discharge(0.5, 9.0 + 1e-20j, 5.0).imag / 1e-20 == pytest.approx(0.5 / (2 * 2.0), rel=4 * EPS)


def test_argument_names_are_the_row_of_the_structure() -> None:
    assert argument_names(discharge) == ("coefficient", "p_in", "p_out")


def test_code_is_compiled_where_no_folder_can_be_written_to(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("numba.core.caching.CompileResultCacheImpl._locator_classes", [])
    assert compiled(lambda x: x + 1.0)(1.0) == 2.0


@pytest.mark.parametrize("kind", [float, complex])
def test_rows_of_a_batch_are_of_one_type_and_the_given_array_stays_writable(kind: type) -> None:
    a = np.arange(24.0).reshape(2, 3, 4)
    rows_of_a = a.reshape(6, 4)
    for given, expected in ((a, rows_of_a), (a[0, 0], np.tile(a[0, 0], (6, 1))), (a[..., :1], rows_of_a[:, :1])):
        rows = batch_rows(given, (2, 3), kind)
        assert np.array_equal(rows, expected) and rows.dtype == kind
        assert rows.flags.c_contiguous and not rows.flags.writeable and given.flags.writeable
    matrices = batch_rows(a, (2,), kind, 2)
    assert np.array_equal(matrices, a) and not matrices.flags.writeable and a.flags.writeable


def test_machine_code_of_modules_that_are_gone_is_compiled_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    def gone(*_: object) -> None:
        raise ModuleNotFoundError("No module named 'fusion_sfdia.of_before'")

    monkeypatch.setattr(FunctionCache, "load_overload", gone)
    assert compiled(_summed)(np.arange(4.0)) == 6.0


def _summed(a: np.ndarray) -> float:
    total = 0.0
    for k in range(a.size):
        total += a[k]
    return total
