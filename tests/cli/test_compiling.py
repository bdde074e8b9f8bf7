"""Compiling is announced."""

from __future__ import annotations

import gc

import numba
import pytest

from fusion_sfdia.cli.compiling import announced


def test_a_module_of_which_something_is_compiled_is_announced_once(capsys: pytest.CaptureFixture[str]) -> None:
    one, two, other = (numba.njit(lambda x: x + 1), numba.njit(lambda x: x + 2), numba.njit(lambda x: x + 3))
    other.py_func.__module__ = "fusion_sfdia.core.other"
    with announced():
        assert (one(1), two(1), other(1)) == (2, 3, 4)
    lines = "fusion-sfdia: compiling, once: {}\n"
    assert capsys.readouterr().err == lines.format(__name__) + lines.format("core.other")
    assert gc.isenabled()
    with announced():
        one(2)
    numba.njit(lambda x: x + 3)(1)  # outside
    assert capsys.readouterr().err == ""
