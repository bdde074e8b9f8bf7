"""Compiling is announced once."""

from __future__ import annotations

import numba
import pytest

from fusion_sfdia.cli.compiling import announced


def test_the_first_function_that_is_compiled_is_announced(capsys: pytest.CaptureFixture[str]) -> None:
    one, two = (numba.njit(lambda x: x + 1), numba.njit(lambda x: x + 2))
    with announced():
        assert (one(1), two(1)) == (2, 3)
    assert capsys.readouterr().err == "fusion-sfdia: compiling, once (up to a minute)\n"
    with announced():
        one(2)
    numba.njit(lambda x: x + 3)(1)  # outside
    assert capsys.readouterr().err == ""
