"""The fit of the natural gas: it regenerates the stored coefficients, and names a missing package."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from fusion_sfdia.models.gas_pipeline import fit_natural_gas
from fusion_sfdia.models.gas_pipeline.equations import gas
from fusion_sfdia.models.gas_pipeline.natural_gas import GAS_CONSTANT, PRESSURES, TEMPERATURES, natural_gas

Array = NDArray[Any]

# what the docstring of natural_gas states, rounded up
BOX = {"z": 5e-5, "alpha_1": 1e-3, "alpha_2": 6e-4, "cp": 8e-4, "wave_speed": 4e-4, "joule_thomson": 9e-3}


@pytest.fixture
def random_states() -> tuple[Array, Array]:
    rng = np.random.default_rng(1)
    return rng.uniform(*PRESSURES, 200), rng.uniform(*TEMPERATURES, 200)


def test_fit_regenerates_the_stored_gas(random_states: tuple[Array, Array]) -> None:
    pytest.importorskip("pyaga8")
    p, T = random_states
    z, cp0, gas_constant = fit_natural_gas.fit()
    again = natural_gas()._replace(gas_constant=gas_constant, z=z, cp0=cp0)
    # twelve digits are stored; the coefficients of up to 1700 cancel to about 1, and bases differ in rounding
    for fitted, stored in zip(gas(p, T, again), gas(p, T, natural_gas()), strict=True):
        np.testing.assert_allclose(fitted, stored, rtol=1e-7)
    assert gas_constant == pytest.approx(GAS_CONSTANT, rel=1e-11)


@pytest.fixture
def without_pyaga8(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setitem(sys.modules, "pyaga8", None)
    yield


@pytest.mark.usefixtures("without_pyaga8")
def test_missing_extra_is_named() -> None:
    with pytest.raises(ModuleNotFoundError, match=r"fusion-sfdia\[gas\]"):
        fit_natural_gas.fit()


def test_script_prints_coefficients_and_errors(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("pyaga8")
    fit_natural_gas.main()
    printed = capsys.readouterr().out
    assert f"GAS_CONSTANT = {GAS_CONSTANT:.12g}" in printed
    assert all(name in printed for name in BOX)
