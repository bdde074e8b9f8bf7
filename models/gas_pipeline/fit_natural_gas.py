"""Fit the gas of the pipeline to GERG-2008 and print its coefficients and error box.

    python -m fusion_sfdia.models.gas_pipeline.fit_natural_gas

needs pyaga8 (the extra "gas"), an implementation of ISO 20765-2. One linear least squares for compressibility, its two
logarithmic derivatives and the heat capacity together: all are linear in the coefficients of z and of the ideal-gas C_p,
because C_p = C_p0 - T int v_TT dp. R is that of GERG-2008 over the molar mass of the mixture. The result is stored in
natural_gas.py.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.models.gas_pipeline.equations import (
    POWERS_OF_PRESSURE,
    POWERS_OF_TAU,
    PRESSURE_SCALE,
    TEMPERATURE_SCALE,
    gas,
    wave_speed_squared,
)
from fusion_sfdia.models.gas_pipeline.natural_gas import COMPOSITION, PRESSURES, TEMPERATURES, natural_gas

Array = NDArray[Any]

# one part in: z 1e4, its derivatives 2e3, C_p 2e3; what each may contribute to the error of the wave speed, which matters most
WEIGHTS = (1e4, 2e3, 2e3, 2e3)
QUANTITIES = ("z", "alpha_1", "alpha_2", "cp", "wave_speed", "joule_thomson")


def gerg_2008(p: Array, T: Array, composition: dict[str, float] = COMPOSITION) -> tuple[dict[str, Array], float]:
    """Properties at p (K,) Pa, T (K,) K as arrays by name, SI, and the specific gas constant in J/(kg K)."""
    try:
        import pyaga8
    except ImportError as error:
        raise ModuleNotFoundError(
            "the fit needs pyaga8, an implementation of GERG-2008; pip install 'fusion-sfdia[gas]'"
        ) from error
    model, mixture = pyaga8.Gerg2008(), pyaga8.Composition()
    for component, fraction in composition.items():
        setattr(mixture, component, fraction)
    model.set_composition(mixture)
    model.calc_molar_mass()
    molar_mass = model.mm / 1e3
    rows = []
    for pressure, temperature in zip(p, T, strict=True):
        model.pressure, model.temperature = pressure / 1e3, temperature  # kPa, K
        model.calc_density(0)
        model.calc_properties()
        stiffness, density = model.dp_dd, model.d * 1e3  # Pa m3/mol, mol/m3
        alpha_1 = temperature * model.dp_dt * 1e3 / (density * stiffness)
        rows.append((model.z, alpha_1, pressure / (density * stiffness), model.cp / molar_mass, model.w, model.jt / 1e3))
    return dict(zip(QUANTITIES, np.array(rows).T, strict=True)), 8.314472 / molar_mass


def grid(points: int, chebyshev: bool) -> tuple[Array, Array]:
    """Pressures and temperatures of a grid over the box; Chebyshev nodes for the fit, equal steps to check it."""
    axis = np.cos(np.pi * (np.arange(points) + 0.5) / points) if chebyshev else np.linspace(-1, 1, points)
    sides = [(low + high) / 2 + (high - low) / 2 * axis for low, high in (PRESSURES, TEMPERATURES)]
    p, T = np.meshgrid(*sides, indexing="ij")
    return p.ravel(), T.ravel()


def fit() -> tuple[Array, Array, float]:
    """Return the coefficients z (6, 7) and cp0 (3,) of `equations.gas`, and the specific gas constant."""
    p, T = grid(24, chebyshev=True)
    expected, R = gerg_2008(p, T)
    x, tau = p / PRESSURE_SCALE, TEMPERATURE_SCALE / T
    powers = [np.polynomial.Polynomial.basis(j) for j in range(POWERS_OF_TAU + 1)]
    y = tau - 1
    terms = [(i, f(y), f.deriv(1)(y), f.deriv(2)(y)) for i in range(1, POWERS_OF_PRESSURE + 1) for f in powers]
    z = np.stack([x**i * f for i, f, _, _ in terms], axis=1)
    p_z_p = np.stack([i * x**i * f for i, f, _, _ in terms], axis=1)
    t_z_t = np.stack([-(x**i) * tau * f1 for i, _, f1, _ in terms], axis=1)
    cp = np.stack([-R * x**i / i * tau**2 * f2 for i, _, _, f2 in terms], axis=1)
    ideal = np.vander(T / TEMPERATURE_SCALE - 1, 3, increasing=True)
    none, size = np.zeros_like(ideal), np.mean(expected["cp"])
    system = [np.hstack([z, none]), np.hstack([p_z_p, none]), np.hstack([t_z_t, none]), np.hstack([cp, ideal]) / size]
    target = [
        expected["z"] - 1,
        expected["z"] * (1 - expected["alpha_2"]),
        expected["z"] * (expected["alpha_1"] - 1),
        expected["cp"] / size,
    ]
    matrix = np.vstack([w * s for w, s in zip(WEIGHTS, system, strict=True)])
    right = np.concatenate([w * t for w, t in zip(WEIGHTS, target, strict=True)])
    columns = np.linalg.norm(matrix, axis=0)
    solution = np.linalg.lstsq(matrix / columns, right, rcond=None)[0] / columns
    return solution[: len(terms)].reshape(POWERS_OF_PRESSURE, -1), solution[len(terms) :], R


def properties(p: Array, T: Array) -> dict[str, Array]:
    """Properties of the fitted gas, by the names of QUANTITIES."""
    c = natural_gas()
    z, alpha_1, alpha_2, cp = gas(p, T, c)
    rho = p / (z * c.gas_constant * T)
    speed = np.sqrt(wave_speed_squared(p, rho, T, alpha_1, alpha_2, cp))
    return dict(zip(QUANTITIES, (z, alpha_1, alpha_2, cp, speed, (alpha_1 - 1) / (rho * cp)), strict=True))


def largest_errors(points: int = 33) -> dict[str, float]:
    """Largest relative deviation of the gas in natural_gas.py from GERG-2008 over the box, by quantity."""
    p, T = grid(points, chebyshev=False)
    expected, _ = gerg_2008(p, T)
    return {name: float(np.max(np.abs(value / expected[name] - 1))) for name, value in properties(p, T).items()}


def main() -> None:
    """Print coefficients and error box."""
    z, cp0, R = fit()
    rows = ",\n".join("    [" + ", ".join(f"{v:.12g}" for v in row) + "]" for row in z)
    print(f"GAS_CONSTANT = {R:.12g}\nZ = [\n{rows},\n]\nCP0 = [{', '.join(f'{v:.12g}' for v in cp0)}]")
    print(f"over {PRESSURES} Pa x {TEMPERATURES} K, largest relative error of the gas in natural_gas.py:")
    for name, error in largest_errors().items():
        print(f"  {name:14s}{error:.2e}")


if __name__ == "__main__":
    main()
