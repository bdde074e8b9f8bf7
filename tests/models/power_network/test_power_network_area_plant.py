"""An area as a plant by itself: the network's step and derivatives, whatever its slopes and constants."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rounding import rounding

from fusion_sfdia.models.power_network.area_plant import local_areas
from fusion_sfdia.models.power_network.model import NetworkModel, network_model
from fusion_sfdia.models.power_network.plant import network_sensors, power_network
from fusion_sfdia.models.power_network.unknown import altered
from fusion_sfdia.plant.local_areas import Group, LocalAreas

Array = NDArray[Any]

MODEL = network_model()
AREAS = local_areas(MODEL)
COUNT = 15


def drawn() -> tuple[Array, Array]:
    """States (2, N, 4) and inputs (2, 2N) about the operating point."""
    rng = np.random.default_rng(0)
    return 0.1 * rng.standard_normal((2, COUNT, 4)), 0.1 * rng.standard_normal((2, 2 * COUNT))


def given(areas: LocalAreas, group: Group, x: Array, u: Array) -> Array:
    """The inputs of a group whose neighbours' angles are known."""
    return areas.inputs(group, u, x[..., 0], np.zeros(x.shape[:-1]))


def stepped(areas: LocalAreas, x: Array, u: Array, theta: dict[int, Array]) -> Array:
    """The state (2, N, 4) after a step of every area by itself; theta: of the areas' parameters, by degree."""
    after = np.full_like(x, np.nan)
    for g in areas.groups:
        step = g.plant.uncertainty.step
        assert step is not None
        after[:, g.areas] = step(0.0, x[:, g.areas], given(areas, g, x, u), 1.0, theta[g.sides.shape[1]])
    return after


def network_step(model: NetworkModel, x: Array, u: Array) -> Array:
    return model.step(x, u[..., :COUNT], u[..., COUNT:])


@pytest.mark.parametrize("unplugged", [(), ("8",)])
def test_areas_by_themselves_step_as_the_network(unplugged: tuple[str, ...]) -> None:
    model, (x, u) = network_model(unplugged=unplugged), drawn()
    areas = local_areas(model)
    usual = {g.sides.shape[1]: g.plant.uncertainty.nominal for g in areas.groups}
    after, expected = stepped(areas, x, u, usual), network_step(model, x, u)
    assert np.max(np.abs(after - expected)) < rounding(condition=10.0, operations=20)  # sums of ten terms of at most 1
    for g in areas.groups:
        assert np.array_equal(g.plant.step(0.0, x[:, g.areas], given(areas, g, x, u), 1.0), after[:, g.areas])


def test_parameters_are_relative_to_the_inputs() -> None:
    x, u = drawn()
    c = MODEL.parameters
    names, e = c.topology.names, c.slope.size
    factors = {f"inertia_{i}": 1.1 * v for i, v in zip(names, c.constants[:, 0], strict=True)}
    factors |= {f"droop_{i}": 0.8 * v for i, v in zip(names, c.constants[:, 1], strict=True)}
    factors |= {f"slope_{names[i]}-{names[j]}": 1.2 * v for (i, j), v in zip(c.topology.links, c.slope, strict=True)}
    assert len(factors) == 2 * COUNT + e
    theta = {d: np.array([1.2] * d + [1.1, 0.8]) for d in (1, 2, 3)}
    expected = network_step(network_model(altered(c, **factors)), x, u)
    assert np.max(np.abs(stepped(AREAS, x, u, theta) - expected)) < rounding(condition=10.0, operations=20)


def test_derivatives_are_those_of_differences() -> None:
    x, u = drawn()
    for g in AREAS.groups:
        known, h = g.plant.uncertainty, 1e-6
        given_u = given(AREAS, g, x, u)
        theta = np.broadcast_to(1.1 * known.nominal, (*given_u.shape[:-1], known.nominal.size))
        v, n, m = np.concatenate([x[:, g.areas], given_u, theta], axis=-1), 4, given_u.shape[-1]
        assert known.step is not None and known.step_jacobian is not None

        def step(v: Array, n: int = n, m: int = m, step: Any = known.step) -> Array:
            return np.asarray(step(0.0, v[..., :n], v[..., n : n + m], 1.0, v[..., n + m :]))

        found = known.step_jacobian(0.0, x[:, g.areas], given_u, 1.0, theta)
        by_differences = np.stack([(step(v + h * e) - step(v - h * e)) / (2 * h) for e in np.eye(v.shape[-1])], axis=-1)
        # rounding over h, and h^2 times a sixth of the third derivatives: omega / R^4 is the largest, R = 0.05, omega < 1
        assert np.max(np.abs(found - by_differences)) < rounding(10.0, 20) / h + h**2 / 0.05**4
        usual = g.plant.step_jacobian_at(0.0, g.plant.x0, given_u, 1.0)
        assert usual.shape == (2, len(g.areas), 4, 4)
        assert np.max(np.abs(usual - MODEL.area[g.areas, :, :4])) < rounding(operations=20)


def test_areas_have_the_sensors_of_the_network() -> None:
    names = [s.name for s in network_sensors(MODEL)]
    taken: list[int] = []
    for g in AREAS.groups:
        for m, row in enumerate(g.sensors):
            assert [AREAS.named(g, m, s.name) for s in g.plant.sensors] == [names[k] for k in row]
            taken += row.tolist()
    assert sorted(taken) == list(range(len(names)))  # each reading is judged by one area
    sigma = {s.name: s.sigma for s in power_network().sensors}
    assert all(sigma[AREAS.named(g, 0, s.name)] == s.sigma for g in AREAS.groups for s in g.plant.sensors)


def test_errors_of_neighbours_are_weighted_by_slopes() -> None:
    x, u = drawn()
    variance = np.linspace(1.0, 2.0, COUNT) * 1e-5
    matrices = MODEL.matrices[0].reshape(COUNT, 4, COUNT, 4)
    for g in AREAS.groups:
        found = AREAS.inputs(g, u, x[..., 0], np.broadcast_to(variance, (2, COUNT)))[..., 2]
        for m, i in enumerate(g.areas):
            others = [j for j in range(COUNT) if j != i]
            gain = matrices[i, :, others, 0].T / MODEL.area[i, :, 5, None]  # P_ij, of each state
            assert np.allclose(found[:, m], np.sqrt(gain**2 @ variance[others])[0], rtol=rounding(operations=20))


def test_a_model_of_the_whole_network_has_no_areas_by_themselves() -> None:
    with pytest.raises(ValueError, match="discretised 'exact'; areas by themselves need 'area-by-area'"):
        local_areas(network_model(discretisation="exact"))
