"""Equations and their derivatives: the complex step and differences against analytic Jacobians."""

import gc
from collections.abc import Callable
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numba import njit

from fusion_sfdia.derivatives import equation as module
from fusion_sfdia.derivatives.equation import (
    AsPython,
    argument_names,
    batch_rows,
    complex_step_jacobian,
    difference_jacobian,
    equation,
    python_first,
    with_complex_step,
)
from fusion_sfdia.detectors import registry
from fusion_sfdia.diagnosis.simulate import simulate

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
def test_value_and_complex_step_come_by_one_call(batch: tuple[int, ...]) -> None:
    x, calls = np.random.default_rng(0).uniform(0.5, 2.0, (*batch, 3)), count()

    def counted(p: np.ndarray) -> np.ndarray:
        next(calls)
        return curve(p)

    found = with_complex_step(counted, x)
    assert found is not None and next(calls) == 1
    np.testing.assert_allclose(found[0], curve(x), rtol=20 * EPS, atol=20 * EPS)
    np.testing.assert_array_equal(found[1], complex_step_jacobian(curve, x))


@pytest.mark.parametrize("b", [-1.0, np.inf])
def test_outside_of_its_domain_a_function_has_no_complex_step(b: float) -> None:
    """The root of -1 is i: with real numbers it is NaN, by which a filter notices it."""
    with np.errstate(invalid="ignore", over="ignore"):
        assert with_complex_step(curve, np.array([1.0, b, 1.0])) is None


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


def test_a_loop_runs_as_python_first_and_is_compiled_once_it_has_taken_its_time(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(AsPython, "patient", True)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr("numba.core.config.CACHE_DIR", str(tmp_path))
    clock = count(0.0, module.AS_PYTHON * 0.6)  # of which each call takes that share
    monkeypatch.setattr(module, "thread_time", lambda: next(clock))
    loop: Any = python_first(_ratio)
    zero = np.zeros(2)
    for _ in range(2):
        assert np.isnan(loop(zero)) and not loop.signatures  # as compiled: no ZeroDivisionError, no warning
    assert np.isnan(loop(zero)) and len(loop.signatures) == 1
    again: Any = python_first(_ratio)
    assert np.isnan(again(zero)) and len(again.signatures) == 1  # it is on disk


def _ratio(a: np.ndarray) -> Any:
    return a[1] / a[0]


@pytest.mark.parametrize("name", ["two-tanks", "gas-pipeline"])
def test_loops_have_the_same_bits_as_python_and_compiled(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    compared: dict[str, int] = {}

    def both_ways(loop: AsPython, *arguments: Any) -> Callable[..., Any]:
        run = loop.dispatcher.overloads[types(loop, arguments)].entry_point

        def both(*given: Any) -> Any:
            mine = [a.copy() if isinstance(a, np.ndarray) and a.flags.writeable else a for a in given]
            expected, found = run(*given), loop.run(*mine)
            name = loop.dispatcher.py_func.__name__
            for a, b in zip(arrays((expected, given)), arrays((found, mine)), strict=True):
                assert a.dtype == b.dtype and np.array_equal(a, b, equal_nan=a.dtype.kind == "f"), name
            compared[name] = compared.get(name, 0) + 1
            return expected

        return both

    plant = registry.plant(name)
    detector = registry.detector("robust-glr", plant)
    loops = [one.dispatcher for one in gc.get_objects() if type(one) is AsPython]
    log = simulate(plant, 40, seeds=[1], truth="model")
    y, sigma = log.y[:, 0].copy(), np.array([s.sigma for s in plant.sensors])
    y[20:, 0] += 10 * sigma[0]
    y[10:13, 1], y[30, 2] = np.nan, y[30, 2] + 50 * sigma[2]
    u = np.broadcast_to(log.u, (40, len(plant.inputs)))

    def decided() -> None:
        state = detector.init((), 0.0)
        for k in range(40):
            state, _ = detector.step(state, float(log.t[k]), y[k], u[k])

    monkeypatch.setattr(AsPython, "patient", False)
    decided()
    monkeypatch.setattr(AsPython, "__call__", both_ways)
    for dispatcher in loops:
        dispatcher._clear()
    try:
        decided()
    finally:
        for dispatcher in loops:
            for result in list(dispatcher.overloads.values()):
                dispatcher.add_overload(result)
    assert len(compared) > 9 and max(compared.values()) >= 40


def types(loop: AsPython, arguments: tuple[Any, ...]) -> tuple[Any, ...]:
    return tuple(loop.dispatcher.typeof_pyval(a) for a in arguments)


def arrays(values: Any) -> Any:
    """What is in nested tuples and lists, as arrays, in order."""
    if isinstance(values, tuple | list):
        return [a for value in values for a in arrays(value)]
    return [] if values is None else [np.asarray(values)]
