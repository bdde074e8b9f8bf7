"""A plant's equations as modules: what is refused; the published threshold's integral against quadrature."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from toy_plants import tank_modules

from fusion_sfdia.plant.modules import ObserverBound

MODULES = tank_modules()


@pytest.mark.parametrize("c", [ObserverBound(1.5, 25.0, 2.0, 20.0), ObserverBound(0.5, 6.0, 9.0, 6.0)], ids=str)
@pytest.mark.parametrize("t", [0.001, 0.2, 3.0])
def test_the_published_threshold_is_its_integral(c: ObserverBound, t: float) -> None:
    """K24 (10): E(t) + rho Lambda int_0^t E(tau) exp(-xi (t - tau)) dtau, for equal rates of decay too."""
    start, bound, lipschitz, others = 3.0, 0.7, 5.0, 11.0

    def effect(s: float) -> float:
        first = c.rho * np.exp(-c.xi * s) * start
        noise = c.rho_d * bound / c.xi_d * (1 - np.exp(-c.xi_d * s))
        return float(first + noise + c.rho * others / c.xi * (1 - np.exp(-c.xi * s)))

    memory, _ = quad(lambda s: effect(s) * np.exp(-c.xi * (t - s)), 0.0, t, epsabs=0, epsrel=1e-11, limit=200)
    expected = effect(t) + c.rho * lipschitz * memory
    assert c.threshold(np.array(t), start, bound, lipschitz, others) == pytest.approx(expected, rel=1e-9)


def test_the_states_come_first_and_the_inputs_last() -> None:
    assert MODULES.states == ("level_1", "level_2")
    assert MODULES.variables == ("level_1", "level_2", "flow_12", "flow_out", "inflow")


def test_what_is_refused() -> None:
    with pytest.raises(ValueError, match="there are no equations"):
        replace(MODULES, equations={})
    with pytest.raises(ValueError, match="equation of flow_12 has the unknown arguments pressure"):
        replace(MODULES, equations={**MODULES.equations, "flow_12": lambda pressure, c: pressure})
    with pytest.raises(ValueError, match="names lacks flow_out"):
        replace(MODULES, names={k: v for k, v in MODULES.names.items() if k != "flow_out"})
    for gain in (-0.01, 0.0, np.nan, np.inf):
        with pytest.raises(ValueError, match="the observer of level_2 has the gain"):
            replace(MODULES, gains={"level_1": 0.05, "level_2": gain})
    with pytest.raises(ValueError, match="the observer of level_2 has the gain nan"):
        replace(MODULES, gains={"level_1": 0.05})
