"""Models of the network: discretisation, changes in operation, borders of areas."""

from __future__ import annotations

import numpy as np
import pytest
from network_loop import rates
from scipy.linalg import expm, expm_frechet

from fusion_sfdia.models.power_network import equations
from fusion_sfdia.models.power_network.area_model import area_model
from fusion_sfdia.models.power_network.model import NetworkModel, network_model
from fusion_sfdia.models.power_network.parameters import generate_network, load_network
from fusion_sfdia.models.power_network.plant import power_network

MODEL = network_model()
RNG = np.random.default_rng(1)
X = 0.1 * RNG.standard_normal((15, 4))
LOAD, REFERENCE = 0.2 * RNG.standard_normal((2, 15))
EPS = np.finfo(float).eps


NAMES = MODEL.names


@pytest.mark.parametrize("governor_time", [0.1, 1000.0, 1e-3])
def test_the_hold_is_the_matrix_exponential(governor_time: float) -> None:
    constants = load_network().constants.copy()
    constants[:, 4] = governor_time
    matrices = equations.area_matrices(MODEL.stiffness, constants, np.empty(0, int))[:, 0]
    whole = np.zeros((15, 6, 6))
    whole[:, :4] = matrices
    held = equations.hold(matrices[:, None], 1.0)[:, 0]
    # squaring s times multiplies rounding by 2^s, some norm of A dt
    assert np.abs(held - expm(whole)[:, :4]).max() < 20 * EPS * np.abs(matrices).sum(axis=2).max() * np.abs(held).max()


@pytest.mark.parametrize("governor_time", [0.1, 1000.0, 1e-3])
def test_the_derivatives_of_the_hold_are_those_of_the_matrix_exponential(governor_time: float) -> None:
    constants = np.tile(load_network().constants, (2, 1))[:20]  # more areas than are computed together
    constants[:, 4] = governor_time
    stiffness = np.tile(MODEL.stiffness, 2)[:20]
    held = equations.rows_of(stiffness, constants, 1.0, range(6))
    assert np.array_equal(held[:, 0], equations.rows_of(stiffness, constants, 1.0)[:, 0])
    whole = np.zeros((20, 7, 6, 6))
    whole[:, :, :4] = equations.area_matrices(stiffness, constants, np.arange(6))
    for i in (0, 7, 19):
        assert np.array_equal(held[i], equations.rows_of(stiffness[i : i + 1], constants[i : i + 1], 1.0, range(6))[0])
        for d in range(1, 7):
            exact = expm_frechet(whole[i, 0], whole[i, d], compute_expm=False)[:4]
            rounding = EPS * np.abs(whole[i, 0]).sum(axis=1).max() * np.abs(whole[i, d]).sum(axis=1).max()
            assert np.abs(held[i, d] - exact).max() < 20 * rounding * np.abs(held[i, 0]).max() ** 2


def test_an_area_whose_exponential_overflows_leaves_the_others_as_they_are() -> None:
    constants = MODEL.constants.copy()
    constants[3, 0] = np.finfo(float).tiny
    held, usual = (equations.rows_of(MODEL.stiffness, c, 1.0, (0, 1)) for c in (constants, MODEL.constants))
    assert not np.all(np.isfinite(held[3, 0]))
    np.testing.assert_array_equal(np.delete(held, 3, axis=0), np.delete(usual, 3, axis=0))


def test_the_derivatives_of_the_matrices_are_those_of_the_equations() -> None:
    every = np.arange(6)
    found = equations.area_matrices(MODEL.stiffness, MODEL.constants, every)
    values = np.concatenate([MODEL.stiffness[:, None], MODEL.constants], axis=1)
    for d in every:
        step = np.where(every == d, 1e-6, 0.0) * values
        above, below = (equations.area_matrices(v[:, 0], v[:, 1:], every[:0])[:, 0] for v in (values + step, values - step))
        difference = (above - below) / (2 * step[:, d, None, None])
        assert np.abs(found[:, 1 + d] - difference).max() < 1e-8 * max(1.0, np.abs(found[:, 1 + d]).max())


def advanced(discretisation: str, parts: int) -> np.ndarray:
    """The transition of the whole network over 1 s in equal parts."""
    return np.linalg.matrix_power(network_model(discretisation=discretisation, dt=1 / parts).matrices[0], parts)


def test_the_exact_discretisation_does_not_depend_on_the_step() -> None:
    a = network_model().continuous[0]
    for parts in (1, 4):
        assert np.abs(advanced("exact", parts) - expm(a)).max() < 1e-11


def test_area_by_area_is_of_first_order() -> None:
    exact = expm(network_model().continuous[0])
    error = [np.abs(advanced("area-by-area", parts) - exact).max() for parts in (64, 128, 256)]
    # halving the step halves the error, but for the second order, which halves itself
    assert abs(error[1] / error[2] - 2) < 0.6 * abs(error[0] / error[1] - 2) < 0.2


def test_how_far_area_by_area_is_from_exact_at_one_second() -> None:
    difference = np.abs(MODEL.matrices[0] - network_model(discretisation="exact").matrices[0])
    assert [round(float(difference[k::4].max()), 2) for k in range(4)] == [0.04, 0.11, 0.73, 1.86]


def test_an_area_by_itself_is_exact() -> None:
    alone = {d: network_model(unplugged=NAMES, discretisation=d) for d in ("area-by-area", "exact")}
    a, b = (model.step(X, REFERENCE, LOAD) for model in alone.values())
    assert a == pytest.approx(b, abs=1e-11)


@pytest.mark.parametrize("discretisation", ["area-by-area", "exact"])
def test_steps_are_the_matrices_for_any_batch(discretisation: str) -> None:
    model = network_model(discretisation=discretisation, unplugged=["7"])
    f, by_reference, by_load = model.matrices
    x = RNG.standard_normal((3, 2, 15, 4))
    reference, load = RNG.standard_normal((2, 1, 2, 15))
    after = model.step(x, reference[0], load[0])
    expected = x.reshape(3, 2, 60) @ f.T + reference[0] @ by_reference.T + load[0] @ by_load.T
    assert after.shape == (3, 2, 15, 4)
    assert after.reshape(3, 2, 60) == pytest.approx(expected, abs=1000 * EPS * np.abs(f).max())
    one = model.step(x[1:2, 1:2], reference[0, 1], load[0, 1])
    assert np.array_equal(one[0, 0], after[1, 1])


def changed_rows(before: NetworkModel, after: NetworkModel) -> set[str]:
    return {NAMES[i] for i in range(15) if before.area[i].tobytes() != after.area[i].tobytes()}


def test_unplugging_changes_the_neighbours_alone() -> None:
    without = MODEL.switched(unplug=["4"])
    assert changed_rows(MODEL, without) == {"3", "4", "5", "13"}
    for name in set(NAMES) - {"3", "4", "5", "13"}:
        before, after = area_model(MODEL, name), area_model(without, name)
        assert all(np.array_equal(a, b) for a, b in zip(before, after, strict=True) if not isinstance(a, dict))
    joined = network_model(unplugged=["15"]).switched(plug_in=["15"])
    assert changed_rows(network_model(unplugged=["15"]), joined) == {"14", "15"}


def test_unplugging_takes_the_slope_out_of_both_ends_at_once() -> None:
    without = MODEL.switched(unplug=["4"])
    before, after = area_model(MODEL, "5"), area_model(without, "5")
    assert after.neighbours == ("2", "6")
    assert after.A[1, 0] - before.A[1, 0] == pytest.approx(3 / (2 * 10), abs=4 * EPS)  # P_45 / 2 H_5
    assert area_model(without, "4").A[1, 0] == 0 and area_model(without, "4").neighbours == ()
    # with the tie out of `external` alone, a common shift of the others' angles would drive area 5
    flat = np.zeros((15, 4))
    flat[:, 0] = 0.3
    assert np.abs(rates(without, flat, np.zeros(15), np.zeros(15))).max() < 10 * EPS


@pytest.mark.parametrize(("plug_in", "unplug"), [((), ("4",)), (("15",), ()), (("15",), ("4", "9"))])
def test_a_switched_model_is_the_one_built_so(plug_in: tuple[str, ...], unplug: tuple[str, ...]) -> None:
    switched = network_model(unplugged=["15"]).switched(plug_in=plug_in, unplug=unplug)
    built = network_model(unplugged=(*unplug, *(() if plug_in else ("15",))))
    assert np.array_equal(switched.area, built.area) and np.array_equal(switched.side_slope, built.side_slope)
    assert np.array_equal(switched.stiffness, built.stiffness)


def test_there_and_back_restores_every_bit() -> None:
    again = MODEL.switched(unplug=["4", "5"]).switched(plug_in=["5"]).switched(plug_in=["4"])
    assert np.array_equal(again.area, MODEL.area)
    exact = network_model(discretisation="exact")
    assert np.array_equal(exact.switched(unplug=["4"]).switched(plug_in=["4"]).matrices[0], exact.matrices[0])


def test_other_constants_change_one_area() -> None:
    slow = MODEL.altered("4", governor_time=1000.0)
    assert changed_rows(MODEL, slow) == {"4"}
    assert area_model(slow, "4").A[3].tolist() == [0, -1 / (0.08 * 1000.0), 0, -1 / 1000.0]
    for change, message in (({"governor_time": 0.0}, "governor_time of area 4 is 0"), ({"T_g": 1.0}, "unknown constants T_g")):
        with pytest.raises(ValueError, match=message):
            MODEL.altered("4", **change)
    with pytest.raises(ValueError, match="unknown node '16'"):
        MODEL.altered("16", governor_time=1.0)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"unplugged": ["16"]}, "unknown node '16'"),
        ({"unplugged": ["4", "4"]}, "the names 4 occur more than once"),
        ({"noise": "large"}, "noise is 'large'; known: lit, small"),
        ({"discretisation": "euler"}, "known: area-by-area, exact"),
        ({"dt": 0.0}, "positive and finite"),
    ],
)
def test_settings_that_do_not_fit(settings: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        network_model(**settings)  # type: ignore[arg-type]


def test_large_networks_have_no_dense_matrices() -> None:
    large = generate_network(300, 0)
    assert network_model(large).step(np.zeros((300, 4)), np.zeros(300), np.zeros(300)).shape == (300, 4)
    with pytest.raises(ValueError, match="at most 250 areas"):
        network_model(large, discretisation="exact")
    with pytest.raises(ValueError, match="at most 250 areas"):
        power_network(300)


@pytest.mark.slow
def test_a_network_of_150_000_areas_fits_in_memory() -> None:
    n = 150_000
    c = generate_network(n, 0)
    model = network_model(c)
    at = model.network.topology
    arrays = (model.area, model.side_slope, model.constants, at.links, at.node, at.neighbour, at.link, at.start, c.side_slope)
    assert sum(a.nbytes for a in arrays) < 400 * n  # bytes: 24 numbers of its discretisation, five constants, 4.5 sides
    x = np.random.default_rng(0).standard_normal((n, 4))
    after = model.step(x, np.zeros(n), np.zeros(n))
    area = area_model(model, "75000")
    theta = x[[int(j) - 1 for j in area.neighbours], 0]
    assert area.transition @ x[74999] + area.by_angles @ theta == pytest.approx(after[74999], abs=1e-11)
    without = model.switched(unplug=["75000"])
    rows = np.flatnonzero(np.any(without.area != model.area, axis=(1, 2)))
    assert {model.names[i] for i in rows} == {"75000", *area.neighbours}
