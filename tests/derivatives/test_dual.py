import numpy as np
from numba import njit

from fusion_sfdia.derivatives.dual import dual
from fusion_sfdia.derivatives.equation import COMPLEX_STEP, equation


@equation
def every_rule(x, y):
    sums = (x + y) + (x + 2.0) - (3.0 - y) - (y - 0.5) + (1.5 + x) - (x - y)
    products = (x * y) * (3.0 * x) * (y * 0.5)
    quotients = (x / y) / 3.0 + 2.0 / x
    powers = np.exp(0.1 * x) + x**0.7 + (x - y) ** 2 + np.maximum(x, 1.0) * np.maximum(y, 5.0)
    return np.log(products) * np.sqrt(quotients) - (-sums) + powers


@njit(error_model="numpy")
def along(x, y, dx, dy):
    found = every_rule(dual(x, dx), dual(y, dy))
    return found.value, found.slope


@njit(error_model="numpy")
def plain(x, y):
    return every_rule(x, y)


def test_value_is_that_of_numbers_and_slope_that_of_the_complex_step():
    for dx, dy in ((1.0, 0.0), (0.0, 1.0), (0.3, -2.0)):
        value, slope = along(1.7, 2.3, dx, dy)
        exact = every_rule(1.7 + 1j * COMPLEX_STEP * dx, 2.3 + 1j * COMPLEX_STEP * dy).imag / COMPLEX_STEP
        assert value == plain(1.7, 2.3)
        assert abs(slope - exact) <= 50 * np.finfo(float).eps * (abs(exact) + 1)  # some 20 operations on numbers of order 1
