"""The fitted gas against GERG-2008, by two implementations of it, and against thermodynamics."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from fusion_sfdia.derivatives.equation import COMPLEX_STEP
from fusion_sfdia.models.gas_pipeline import fit_natural_gas
from fusion_sfdia.models.gas_pipeline.equations import PRESSURE_SCALE, gas, wave_speed_squared
from fusion_sfdia.models.gas_pipeline.natural_gas import COMPOSITION, CP0, GAS_CONSTANT, PRESSURES, TEMPERATURES, natural_gas

Array = NDArray[Any]

# what the docstring of natural_gas states, rounded up
BOX = {"z": 5e-5, "alpha_1": 1e-3, "alpha_2": 6e-4, "cp": 8e-4, "wave_speed": 4e-4, "joule_thomson": 9e-3}
OPERATION = {"z": 5e-6, "alpha_1": 6e-5, "alpha_2": 6e-5, "cp": 3e-4, "wave_speed": 1.5e-4, "joule_thomson": 4e-4}

# the mixture of the NIST test of GERG-2008, mole fractions
NIST = {
    "methane": 0.77824, "nitrogen": 0.02, "carbon_dioxide": 0.06, "ethane": 0.08, "propane": 0.03, "isobutane": 0.0015,
    "n_butane": 0.003, "isopentane": 0.0005, "n_pentane": 0.00165, "hexane": 0.00215, "heptane": 0.00088, "octane": 0.00024,
    "nonane": 0.00015, "decane": 0.00009, "hydrogen": 0.004, "oxygen": 0.005, "carbon_monoxide": 0.002, "water": 0.0001,
    "hydrogen_sulfide": 0.0025, "helium": 0.007, "argon": 0.001,
}  # fmt: skip


@pytest.fixture
def random_states() -> tuple[Array, Array]:
    rng = np.random.default_rng(1)
    return rng.uniform(*PRESSURES, 200), rng.uniform(*TEMPERATURES, 200)


def test_mole_fractions_sum_to_one() -> None:
    assert sum(COMPOSITION.values()) == pytest.approx(1.0, abs=1e-12)


def test_nist_mixture() -> None:
    pytest.importorskip("pyaga8")
    expected, gas_constant = fit_natural_gas.gerg_2008(np.array([50e6]), np.array([400.0]), NIST)
    assert expected["z"][0] == pytest.approx(1.174690666, rel=1e-8)
    assert expected["wave_speed"][0] == pytest.approx(714.42488, rel=1e-8)
    molar_mass = 8.314472 / gas_constant
    density = 50e6 / (expected["z"][0] * gas_constant * 400.0) / molar_mass  # mol/m3
    assert density == pytest.approx(12798.286, rel=3e-8)  # as many digits as are given


def test_errors_are_as_stated() -> None:
    pytest.importorskip("pyaga8")
    for name, error in fit_natural_gas.largest_errors().items():
        assert error < BOX[name], name
    p, T = (a.ravel() for a in np.meshgrid(np.linspace(7.5e6, 8.5e6, 11), np.linspace(275.0, 305.0, 13)))
    expected, _ = fit_natural_gas.gerg_2008(p, T)
    for name, value in fit_natural_gas.properties(p, T).items():
        assert np.max(np.abs(value / expected[name] - 1)) < OPERATION[name], name


def test_coolprop_agrees() -> None:
    """CoolProp's mixture of GERG equations: another implementation, its own pure-fluid equations, no common code."""
    coolprop = pytest.importorskip("CoolProp.CoolProp")
    names = {
        "methane": "Methane", "ethane": "Ethane", "propane": "Propane", "isobutane": "IsoButane", "n_butane": "n-Butane",
        "isopentane": "Isopentane", "n_pentane": "n-Pentane", "hexane": "n-Hexane", "nitrogen": "Nitrogen",
        "carbon_dioxide": "CarbonDioxide",
    }  # fmt: skip
    mixture = coolprop.AbstractState("HEOS", "&".join(names[n] for n in COMPOSITION))
    mixture.set_mole_fractions(list(COMPOSITION.values()))
    mixture.specify_phase(coolprop.iphase_gas)
    p, T = (a.ravel() for a in np.meshgrid(np.linspace(7.5e6, 8.5e6, 3), np.linspace(275.0, 305.0, 4)))
    ours = fit_natural_gas.properties(p, T)
    for k in range(p.size):
        mixture.update(coolprop.PT_INPUTS, p[k], T[k])
        # its reference equations of the pure fluids differ from GERG's by up to 1e-4 in z, 7e-4 in C_p here
        assert ours["z"][k] == pytest.approx(mixture.compressibility_factor(), rel=2e-4)
        assert ours["cp"][k] == pytest.approx(mixture.cpmass(), rel=1.5e-3)
        assert ours["wave_speed"][k] == pytest.approx(mixture.speed_sound(), rel=1e-3)
    # molar masses of the components are those of different years
    assert mixture.molar_mass() == pytest.approx(8.314472 / GAS_CONSTANT, rel=3e-5)


def test_heat_capacity_follows_from_compressibility(random_states: tuple[Array, Array]) -> None:
    """(d C_p / d p)_T = -T (d2 v / d T2)_p, with v_T = R alpha_1 z / p."""
    p, T = random_states
    c = natural_gas()
    cp_p = gas(p + 1j * COMPLEX_STEP, T, c)[3].imag / COMPLEX_STEP

    def v_T(T: Array) -> Array:
        z, alpha_1, _, _ = gas(p, T, c)
        slope: Array = c.gas_constant * z * alpha_1 / p
        return slope

    v_TT = v_T(T + 1j * COMPLEX_STEP).imag / COMPLEX_STEP
    # rounding of terms up to a thousand times the sum
    np.testing.assert_allclose(cp_p, -T * v_TT, rtol=1e-10, atol=1e-13 * np.abs(T * v_TT).max())


def test_alphas_are_the_derivatives_they_claim(random_states: tuple[Array, Array]) -> None:
    p, T = random_states
    c = natural_gas()
    z, alpha_1, alpha_2, _ = gas(p, T, c)
    z_T = gas(p, T + 1j * COMPLEX_STEP, c)[0].imag / COMPLEX_STEP
    z_p = gas(p + 1j * COMPLEX_STEP, T, c)[0].imag / COMPLEX_STEP
    np.testing.assert_allclose(alpha_1, 1 + T / z * z_T, rtol=1e-11)
    np.testing.assert_allclose(alpha_2, 1 - p / z * z_p, rtol=1e-11)


def test_wave_speed_is_the_isentropic_derivative(random_states: tuple[Array, Array]) -> None:
    """d rho / d p along dT = (T v_T / C_p) dp, by the complex step in both."""
    p, T = random_states
    c = natural_gas()
    z, alpha_1, alpha_2, cp = gas(p, T, c)
    rho = p / (z * c.gas_constant * T)
    dT = alpha_1 / (rho * cp) * COMPLEX_STEP
    p_, T_ = p + 1j * COMPLEX_STEP, T + 1j * dT
    rho_p = (p_ / (gas(p_, T_, c)[0] * c.gas_constant * T_)).imag / COMPLEX_STEP
    np.testing.assert_allclose(wave_speed_squared(p, rho, T, alpha_1, alpha_2, cp), 1 / rho_p, rtol=1e-11)


def test_thin_gas_is_ideal() -> None:
    z, alpha_1, alpha_2, cp = gas(1e-9 * PRESSURE_SCALE, 300.0, natural_gas())
    assert np.array([z, alpha_1, alpha_2]) == pytest.approx(np.ones(3), abs=2e-9)  # off by B p, B about -0.18/1e7 Pa
    assert cp == pytest.approx(CP0[0], rel=1e-8)
