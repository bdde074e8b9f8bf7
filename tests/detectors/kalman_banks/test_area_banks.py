"""Robust banks of areas: each by itself, beside the bank of the whole network, in any order, without readings."""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from rounding import rounding

from fusion_sfdia.detectors.kalman_banks import parameter_walk, reading_noise
from fusion_sfdia.detectors.kalman_banks.area_banks import AreaBank, NetworkDecision, RobustAreas
from fusion_sfdia.detectors.kalman_banks.hypotheses import phi_1
from fusion_sfdia.detectors.kalman_banks.robust_bank import RobustBank
from fusion_sfdia.detectors.state import chosen_runs
from fusion_sfdia.models.power_network.area_plant import local_areas
from fusion_sfdia.models.power_network.model import network_model
from fusion_sfdia.models.power_network.operation import AreaFault, Switch
from fusion_sfdia.models.power_network.parameters import NetworkParameters, generate_network
from fusion_sfdia.models.power_network.plant import power_network
from fusion_sfdia.models.power_network.simulation import run_network
from fusion_sfdia.plant.network import Topology

Array = NDArray[Any]

SMALL = generate_network(5, 0)
STEPS, SEEDS = 60, (0, 1)
RECURSION = rounding(condition=1e4, operations=20 * STEPS)  # of innovations of 1e-2 from states of 1, squared


class Readings(NamedTuple):
    """t (K,), y (K, B, S), u (K, B, 2N)."""

    t: Array
    y: Array
    u: Array


def no_loads(areas: int, t: float) -> Array:
    return np.zeros(areas)


def readings(c: NetworkParameters, steps: int, seeds: tuple[int, ...], faults: tuple[AreaFault, ...] = ()) -> Readings:
    model = network_model(c)
    samples = list(run_network(model, steps - 1, seeds, loads=partial(no_loads, len(model.names)), faults=faults))
    return Readings(np.array([s.t for s in samples]), np.array([s.y for s in samples]), np.array([s.u for s in samples]))


@cache
def banks(c: NetworkParameters = SMALL) -> RobustAreas:
    return RobustAreas(local_areas(network_model(c)))


def decisions(of: RobustAreas, r: Readings, batch: tuple[int, ...] = (len(SEEDS),)) -> list[NetworkDecision]:
    state, found = of.init(batch, -1.0), []
    for t, y, u in zip(*r, strict=True):
        state, decision = of.step(state, float(t), y, u)
        found.append(decision)
    return found


@cache
def usual() -> Readings:
    return readings(SMALL, STEPS, SEEDS)


def biased(r: Readings, sensor: str, size: float, onset: int = 40) -> Readings:
    y = r.y.copy()
    y[onset:, :, banks().sensors.index(sensor)] += size
    return r._replace(y=y)


def close(one: list[NetworkDecision], other: list[NetworkDecision]) -> None:
    """Equal verdicts, and numbers but for the rounding of windows in single precision, over as many samples as they span."""
    allowed = float(np.finfo(np.float32).eps) * np.sqrt(20 * STEPS)
    for a, b in zip(one, other, strict=True):
        for x, y in zip(a, b, strict=True):
            if x.dtype == bool:
                assert np.array_equal(x, y)
            else:
                assert np.allclose(x, y, rtol=allowed, atol=allowed, equal_nan=True)


def test_an_area_in_the_network_is_its_bank_alone() -> None:
    r, of = biased(usual(), "omega_2", 0.03), banks()
    sent: list[tuple[Array, Array]] = []
    state, found = of.init((2,), -1.0), []
    for t, y, u in zip(*r, strict=True):
        x, p = np.empty((2, 5)), np.empty((2, 5))
        for g, s in zip(of.areas.groups, state, strict=True):
            x[:, g.areas], p[:, g.areas] = s.memory.estimate.x[..., 0], s.memory.estimate.P[..., 0, 0]
        sent.append((x, p))
        state, decision = of.step(state, float(t), y, u)
        found.append(decision)
    isolated = np.array([d.isolated for d in found])
    assert isolated[-1, :, of.sensors.index("omega_2")].all()
    for g, bank in zip(of.areas.groups, of.banks, strict=True):
        alone = AreaBank(
            g.plant, usual=bank.usual[:1], false_alarm=bank.false_alarm, process_false_alarm=bank.process_false_alarm
        )
        now = alone.init((2, 1), -1.0)
        for k, (t, y, u) in enumerate(zip(*r, strict=True)):
            now, d = alone.step(now, float(t), y[:, g.sensors[:1]], of.areas.inputs(g, u, *sent[k])[:, :1])
            assert np.allclose(d.estimate[:, 0], found[k].estimate[:, g.areas[0]], rtol=RECURSION, atol=RECURSION)
            assert np.array_equal(d.isolated[:, 0], isolated[k][:, g.sensors[0]])


def test_one_area_without_errors_of_neighbours_is_a_robust_bank() -> None:
    """Without an error from outside the bank of one area is that of its plant, with its own inputs as the usual ones."""
    of, r = banks(), usual()
    g = of.areas.groups[0]
    rest = of.areas.inputs(g, np.zeros(10), np.zeros(5), np.zeros(5))[0]
    inputs = tuple(replace(s, nominal=float(v)) for s, v in zip(g.plant.inputs, rest, strict=True))
    plant = replace(g.plant, inputs=inputs)
    one, other = AreaBank(g.plant, usual=rest[None]), RobustBank(plant)
    a, b = one.init((2, 1), -1.0), other.init((2, 1), -1.0)
    for t, y, u in zip(*biased(r, "theta_1", 0.03), strict=True):
        given = of.areas.inputs(g, u, np.zeros((2, 5)), np.zeros((2, 5)))[:, :1]
        a, first = one.step(a, float(t), y[:, g.sensors[:1]], given)
        b, second = other.step(b, float(t), y[:, g.sensors[:1]], given)
        assert np.array_equal(first.isolated, second.isolated)
        assert np.allclose(first.estimate, second.estimate, rtol=RECURSION, atol=RECURSION)


def test_the_areas_know_as_much_as_the_whole_network(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reading_noise, "LARGER", np.inf)  # what readings show of noise and parameters changes covariances, too
    monkeypatch.setattr(reading_noise, "CLIP", np.inf)
    monkeypatch.setattr(parameter_walk, "MOST", 0.0)
    r, of = usual(), banks()
    whole = RobustBank(power_network(SMALL))
    assert of.sensors == whole.plant.sensor_names
    state, central = of.init((2,), -1.0), whole.init(2, -1.0)
    variance, worst = np.empty((2, 5, 4)), 0.0
    for t, y, u in zip(*r, strict=True):
        state, found = of.step(state, float(t), y, u)
        central, decision = whole.step(central, float(t), y, u)
        for g, s in zip(of.areas.groups, state, strict=True):
            variance[:, g.areas] = np.diagonal(s.memory.estimate.P, axis1=-2, axis2=-1)[..., :4]
        assert decision.covariance is not None
        exact = np.diagonal(decision.covariance, axis1=-2, axis2=-1).reshape(2, 5, 4)
        difference = found.estimate - decision.estimate.reshape(2, 5, 4)
        worst = max(worst, float(np.max(np.abs(difference) / np.sqrt(exact))))
        # what the neglected covariances are worth; the variance of estimates that are not optimal is not below
        assert np.max(variance / exact) < 1.05 and np.min(variance / exact) > 0.95
    assert worst < 0.5  # standard deviations


def test_the_order_of_areas_does_not_matter() -> None:
    at = SMALL.topology
    order = np.array([3, 0, 4, 2, 1])
    place = np.argsort(order)
    moved = NetworkParameters(
        Topology(tuple(at.names[i] for i in order), place[at.links[::-1]]),
        SMALL.constants[order],
        SMALL.slope[::-1],
        SMALL.angle_limit[order],
        SMALL.reference_limit[order],
    )
    r, of, other = biased(usual(), "p_m_3", 0.1), banks(), banks(moved)
    sensors = [of.sensors.index(name) for name in other.sensors]
    # a tie's two sides are named after both of its ends, in either order
    process = [of.process_hypotheses.index(name) for name in other.process_hypotheses]
    inputs = np.concatenate([order, 5 + order])
    found = decisions(other, Readings(r.t, r.y[..., sensors], r.u[..., inputs]))
    expected = [
        NetworkDecision(
            d.isolated[..., sensors], d.process[..., process], d.process_size[..., process], d.process_sd[..., process],
            d.suspect[..., [*sensors, *(len(sensors) + k for k in process)]], d.residual[..., sensors],
            d.threshold[..., sensors], d.alarm[..., order], d.estimate[..., order, :],
        )
        for d in decisions(of, r)
    ]  # fmt: skip
    assert expected[-1].isolated.any()
    close(found, expected)


def test_a_single_run_is_one_of_a_batch() -> None:
    r = usual()
    alone = decisions(banks(), Readings(r.t, r.y[:, 1], r.u[:, 1]), ())
    close(alone, [NetworkDecision(*(v[1] for v in d)) for d in decisions(banks(), r)])


def test_an_area_without_readings_does_not_disturb_the_others() -> None:
    r, of = usual(), banks()
    y = r.y.copy()
    lost = [k for k, name in enumerate(of.sensors) if name.endswith("_3") or "theta_3@" in name]
    y[20:40, :, lost] = np.nan
    found = decisions(of, r._replace(y=y))
    assert not np.any([d.isolated for d in found]) and not np.any([d.process for d in found])
    assert np.all(np.isnan([d.residual[..., lost] for d in found[20:40]]))
    state = of.init((2,), -1.0)
    for t, u, missing in zip(r.t[:40], r.u, y, strict=False):
        state, _ = of.step(state, float(t), missing, u)
    variance = np.concatenate([s.memory.estimate.P[0, :, 0, 0] for s in state])
    areas = np.concatenate([g.areas for g in of.areas.groups])
    # 20 s of process noise of 1e-4 are more than 20 times the variance of a single reading
    assert variance[areas == 2] > 20e-5 > 20 * np.max(variance[areas != 2])


def test_a_sensor_of_a_neighbour_is_isolated_by_the_area_whose_angle_it_reads() -> None:
    of = banks()
    sensor = next(name for name in of.sensors if "@" in name)
    found = np.array([d.isolated for d in decisions(of, biased(usual(), sensor, 0.05))])
    assert found[44:, :, of.sensors.index(sensor)].all()
    assert np.sum(found) == np.sum(found[..., of.sensors.index(sensor)])


def test_a_repaired_sensor_is_used_again_in_its_area_alone() -> None:
    of, end = banks(), 50
    r, names = usual(), ["omega_2", next(name for name in banks().sensors if name.startswith("theta_4@"))]
    at = [of.sensors.index(name) for name in names]
    for name in names:
        r = biased(r, name, 0.05)
    state = of.init((2,), -1.0)
    for t, y, u in zip(r.t[:end], r.y, r.u, strict=False):
        state, decision = of.step(state, float(t), y, u)
    assert decision.isolated[:, at].all()
    t, y, u = float(r.t[end]), usual().y[end], r.u[end]
    for repaired in (names[0], [names[1]], names):
        _, after = of.step(of.readmit(state, repaired), t, y, u)
        assert after.isolated[:, at].all(axis=0).tolist() == [name not in repaired for name in names]
        assert after.isolated.sum() == 2 * sum(name not in repaired for name in names)
    with pytest.raises(ValueError, match=r"unknown sensor 'omega_9'; did you mean 'omega_\d'\?"):
        of.readmit(state, "omega_9")


def test_a_lost_load_is_attributed_to_its_area() -> None:
    of = banks()
    r = readings(SMALL, 80, SEEDS, (AreaFault("load-loss", "4", 0.2, 30.0),))
    found = decisions(of, r)
    process = np.array([d.process for d in found])
    assert not process[:30].any() and not np.any([d.isolated for d in found])
    names = {of.process_hypotheses[k] for k in np.flatnonzero(process.any(axis=(0, 1)))}
    assert process.any(axis=(0, 2)).all() and "error of load_4" in names and all(name.endswith("_4") for name in names)


@pytest.mark.slow
def test_false_alarms_are_rarer_than_stated() -> None:
    """By Bonferroni over the sensors and hypotheses of all areas, on the right model."""
    rate, process_rate, seeds, steps = 0.02, 0.01, tuple(range(8)), 150
    of = RobustAreas(local_areas(network_model(SMALL)), false_alarm=rate, process_false_alarm=process_rate)
    found = decisions(of, readings(SMALL, steps, seeds), (len(seeds),))
    alarm = np.array([d.alarm.any(axis=-1) for d in found])
    begins = alarm & ~np.concatenate([np.zeros((1, len(seeds)), bool), alarm[:-1]])
    count, expected = alarm.size, (rate + process_rate) * alarm.size
    assert 0 < np.sum(begins) < expected + 3 * np.sqrt(expected), count


def test_rates_are_those_of_each_area() -> None:
    of = banks()
    for g, bank in zip(of.areas.groups, of.banks, strict=True):
        rates = bank._hypotheses.rates
        for m, i in enumerate(g.areas):
            phi = phi_1(network_model(SMALL).area[i, :, :4])
            assert np.allclose(rates[m], phi / np.diagonal(phi), rtol=rounding(100.0, 100), atol=rounding(100.0, 100))


def test_an_area_that_leaves_keeps_its_bank() -> None:
    """Slopes are inputs: the state goes on with the areas of the changed network."""
    model, away = network_model(SMALL), ("5",)
    of, without = banks(), RobustAreas(local_areas(network_model(SMALL, unplugged=away)))
    state = of.init((2,), -1.0)
    switches = (Switch(20.0, unplug=away),)
    for s in run_network(model, 60, SEEDS, loads=partial(no_loads, 5), switches=switches):
        now = of if s.t <= 20.0 else without  # s.y at 20 s follows from the step before
        state, decision = now.step(state, s.t, s.y, s.u)
        assert not decision.isolated.any() and not decision.process.any()
        left = [k for k, name in enumerate(of.sensors) if name.endswith("@5") or name.startswith("theta_5@")]
        assert np.all(np.isnan(decision.residual[..., left]) == (s.t >= 20.0))


def test_the_runs_of_a_state_can_be_chosen() -> None:
    r, of = usual(), banks()
    state = of.init((2,), -1.0)
    for t, y, u in zip(r.t[:5], r.y, r.u, strict=False):
        state, _ = of.step(state, float(t), y, u)
    one = tuple(chosen_runs(s, np.array([1])) for s in state)
    _, alone = of.step(one, float(r.t[5]), r.y[5, 1:], r.u[5, 1:])
    _, both = of.step(state, float(r.t[5]), r.y[5], r.u[5])
    close([alone], [NetworkDecision(*(v[1:] for v in both))])


def test_sensors_and_hypotheses_share_the_rates_of_the_network() -> None:
    of = banks()
    tested = sum("since the start" not in name for name in of.process_hypotheses)
    for bank in of.banks:
        of_sensor, of_hypothesis = 1e-3 / len(of.sensors), 1e-5 / tested
        assert bank.false_alarm == pytest.approx(of_sensor * len(bank.plant.sensors), rel=rounding(operations=10))
        assert bank.process_false_alarm == pytest.approx(of_hypothesis * len(bank.model.states), rel=rounding(operations=10))


def test_wrong_shapes_and_rates_are_errors() -> None:
    of, r = banks(), usual()
    state = of.init((2,), -1.0)
    with pytest.raises(ValueError, match=r"y has shape \(2, 31\), u \(2, 10\); expected \(2, 32\)"):
        of.step(state, 0.0, r.y[0, :, 1:], r.u[0])
    with pytest.raises(ValueError, match="process_false_alarm"):
        RobustAreas(of.areas, process_false_alarm=0.0)
