"""How many sensors may be left out at once: majorities on plants with known modes, against all subsets."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from toy_plants import Array, chain, changed, tanks

from fusion_sfdia.detectors import registry
from fusion_sfdia.plant.linear import linear_plant
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.redundancy import most_faults
from fusion_sfdia.plant.signals import Sensor


def linear(F: Array, H: Array) -> Plant:
    n = len(F)
    sensors = [Sensor(f"s{i}", f"y{i}", sigma=1.0) for i in range(len(H))]
    return linear_plant("linear", F, H, sensors, dt=1.0, x0=np.zeros(n), initial_cov=np.ones(n), process_cov=np.ones(n))


def by_all_subsets(F: Array, H: Array) -> int:
    """The most sensors, whichever they are, of which as many again may fail without losing a mode that lasts."""
    n, count = len(F), len(H)
    worst = count // 2
    lasting = [v for v in np.linalg.eigvals(F) if abs(v) > 0.99005]
    for k in range(worst, 0, -1):
        kept = [np.delete(H, chosen, axis=0) for chosen in map(list, combinations(range(count), 2 * k))]
        pencils = [np.vstack([F - v * np.eye(n), h]) for v in lasting for h in kept]
        if all(np.linalg.matrix_rank(p, tol=1e-6) == n for p in pencils):
            return k
    return 1


@pytest.mark.parametrize(
    ("name", "expected"), [("gas-pipeline", 29), ("marine-engine", 3), ("power-network", 24), ("two-tanks", 2)]
)
def test_of_the_registered_plants(name: str, expected: int) -> None:
    """Lasting modes are seen by 60 of the pipeline's sensors and 8 of the engine's, in the network a turn of all angles by the
    15 + 34 that read angles; the tanks have none: half of 4.
    """
    assert most_faults(registry.plant(name)) == expected


@pytest.mark.parametrize("count", range(1, 9))
def test_half_of_the_sensors_where_every_mode_decays(count: int) -> None:
    assert most_faults(chain(3, sensors=count)) == max(1, count // 2)


@pytest.mark.parametrize(
    "F",
    [
        np.diag([1.0, 0.9]),
        np.diag([1.0, 1.2, 0.5]),
        np.diag([1.0, 1.0]),
        np.array([[1.0, 1.0], [0.0, 1.0]]),  # position and velocity: of the double mode one can be lost
        np.array([[0.6, 0.8], [-0.8, 0.6]]),  # a circle
    ],
    ids=["one", "two", "repeated", "defective", "turning"],
)
@pytest.mark.parametrize("groups", [(3, 3), (5, 3), (1, 5), (2, 6)])
def test_a_mode_that_lasts_keeps_a_majority_of_those_that_see_it(F: Array, groups: tuple[int, int]) -> None:
    H = np.repeat(np.eye(len(F))[:2], groups, axis=0)
    assert most_faults(linear(F, H)) == by_all_subsets(F, H)


def test_states_and_readings_in_other_units_have_the_same() -> None:
    rng = np.random.default_rng(0)
    T, F = np.diag([1e5, 1e-3, 1.0]), np.diag([1.0, 0.9, 0.8]) + np.diag([0.1, 0.1], 1)
    H = rng.standard_normal((7, 3))
    H[:4, 0] = 0.0  # the lasting mode is the first state: three sensors see it
    assert most_faults(linear(F, H)) == 1 == by_all_subsets(F, H)
    assert most_faults(linear(T @ F @ np.linalg.inv(T), 1e-4 * H @ np.linalg.inv(T))) == 1


def test_a_model_without_a_slope_at_x0_has_half_of_the_sensors() -> None:

    broken = changed(tanks(), step_jacobian=lambda t, x, u, dt: np.full((2, 2), np.nan))
    assert most_faults(broken) == 2
