"""The detector of stochastic thresholds: properties of its residuals, bounds of its rules, isolation, missing readings."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import NamedTuple

import numpy as np
import pytest
from chebyshev_runs import ERROR, RUNS, SETTLED, STEPS, WATCHING, decisions, healthy, network, network_areas_of, plant_of
from toy_plants import BOUND, bounded_chain, chain, changed, readings, tanks

from fusion_sfdia.detectors.detector import Decision, run
from fusion_sfdia.detectors.stochastic_thresholds.chebyshev import WITHIN, BoundedReadings, Chebyshev, StepResiduals, explain
from fusion_sfdia.detectors.stochastic_thresholds.monte_carlo import MonteCarlo
from fusion_sfdia.detectors.stochastic_thresholds.threshold_rules import alpha_for, false_alarm_of
from fusion_sfdia.diagnosis.simulate import simulate
from fusion_sfdia.filters.estimators import Extended, Unscented
from fusion_sfdia.models.power_network.plant import power_network
from fusion_sfdia.plant.plant import Plant

Array = np.ndarray


@pytest.mark.parametrize("name", ["chain", "tanks", "network"])
@pytest.mark.parametrize("lam", [0.0, 0.3, 0.9])
@pytest.mark.parametrize("missing", [0.0, 0.3])
def test_the_deviation_dominates_and_the_residual_has_no_mean(name: str, lam: float, missing: float) -> None:
    t, y, u = healthy(name)
    y = np.where(np.random.default_rng(9).random(y.shape) < missing, np.nan, y)
    detector = Chebyshev(plant_of(name), lam=lam, rule="gaussian", alpha=1.0, **WATCHING)
    d = decisions(detector, (t, y, u))
    z = (d.residual / d.threshold)[SETTLED:]
    spread = np.sqrt(np.nanmean(z**2, axis=(0, 1)))
    assert np.all(spread < 1 + ERROR)
    if lam == 0.0 and not missing:
        assert np.all(spread > 1 - ERROR), "without memory and with all readings s is the standard deviation itself"
    # the mean over a run of residuals with a memory varies by at most its deviation: five standard errors of the runs
    assert np.all(np.abs(np.nanmean(z, axis=(0, 1))) < 5 / np.sqrt(RUNS))


def test_sigma_points_are_the_closed_form_where_the_physics_is_linear() -> None:
    t, y, u = (a[:, :20] if a.ndim > 1 else a for a in healthy("chain"))
    y = np.where(np.random.default_rng(3).random(y.shape) < 0.2, np.nan, y)
    closed, points = (decisions(Chebyshev(chain(), moments=m, **WATCHING), (t, y, u)) for m in (Extended(), Unscented()))
    for name in ("estimate", "residual", "threshold", "reconstruction"):
        # sigma points with alpha = 1e-3 magnify roundings of values near 1 by 1e6
        np.testing.assert_allclose(getattr(points, name), getattr(closed, name), rtol=1e-7, atol=1e-7, err_msg=name)


@pytest.mark.parametrize(
    ("rule", "budget"), [("chebyshev", 0.2), ("cantelli", 0.5), ("cantelli-one-sided", 0.3), ("gaussian", 0.05)]
)
def test_each_diagnoser_keeps_its_budget_of_false_alarms(rule: str, budget: float) -> None:
    detector = Chebyshev(network(), rule=rule, false_alarm=budget, **WATCHING)
    d = decisions(detector, healthy("network"))
    alarm = d.scores[SETTLED:] > 1
    owners = np.array([s.owner for s in network().sensors])
    for owner in np.unique(owners):
        rate = np.mean(np.any(alarm[..., owners == owner], axis=-1))
        assert rate <= budget + 5 * np.sqrt(budget / RUNS)  # times in a run correlate, so the number of runs counts
    assert detector.components[owners == "area 4"].tolist() == [7] * 7  # four of its own, three neighbours
    share = false_alarm_of(rule, float(detector.alphas[0])) * detector.components[0]
    assert share == pytest.approx(budget)


def test_a_gaussian_quantile_without_memory_is_exact() -> None:
    d = decisions(Chebyshev(network(), lam=0.0, rule="gaussian", alpha=2.0, **WATCHING), healthy("network"))
    rate, expected = np.mean(d.scores[SETTLED:] > 1), false_alarm_of("gaussian", 2.0)
    assert rate == pytest.approx(expected, abs=5 * np.sqrt(expected / RUNS / 15))  # errors of the areas are nearly independent


def test_as_printed_shared_states_alarm_too_often() -> None:
    """False alarms of angles in B18's setting grow with the number of areas that share them, 4.7 to 16 % of the steps."""
    d = decisions(Chebyshev(network(), mode="paper", **WATCHING), healthy("network"))
    c = decisions(Chebyshev(network(), **WATCHING), healthy("network"))
    angle = np.array([s.measures.startswith("theta") for s in network().sensors])
    printed, corrected = (np.mean(x.scores[SETTLED:] > 1, axis=(0, 1)) for x in (d, c))
    np.testing.assert_array_equal(printed[~angle], corrected[~angle])
    assert printed[angle].min() > 0.03 and printed[angle].max() > 0.14
    assert corrected.max() < 0.012


def test_conformal_thresholds_from_healthy_readings() -> None:
    t, y, u = healthy("tanks")
    detector = Chebyshev(tanks(), **WATCHING).fit_thresholds((t, y[:, :200], u[:, :200]), false_alarm=0.04, warm_up=5)
    assert detector.rule == "conformal"
    rate = np.mean(decisions(detector, (t, y[:, 200:], u[:, 200:])).scores[5:] > 1, axis=(0, 1))
    assert np.all(rate <= 0.01 + 5 * np.sqrt(0.01 / 100)) and np.mean(rate) > 0.005
    with pytest.raises(ValueError, match="give at least"):
        detector.fit_thresholds((t, y[:, :1], u[:, :1]), false_alarm=1e-3)
    with pytest.raises(ValueError, match="t is empty"):
        detector.fit_thresholds((t[:0], y[:0], u[:0]))
    # of one run, with or without an axis of runs; products of a batch may round differently
    alone, of_one = (
        detector.fit_thresholds((t, a, b), false_alarm=0.9, warm_up=5) for a, b in ((y[:, 0], u[:, 0]), (y[:, :1], u[:, :1]))
    )
    np.testing.assert_allclose(alone.alphas, of_one.alphas, rtol=1e-9)


@pytest.mark.parametrize("name", ["tanks", "network"])
def test_a_run_in_a_batch_has_the_bits_it_has_alone(name: str) -> None:
    t, y, u = (a[:, :4] if a.ndim > 1 else a for a in healthy(name))
    y = y.copy()
    y[20:30, 1, 0] += 100 * plant_of(name).sensor_sigma[0]
    y[12, 2, :] = np.nan
    y[15, 3, 1] = np.nan
    detector = Chebyshev(plant_of(name), alpha=5.0)
    together, square = (
        decisions(detector, (t, y, u)),
        decisions(detector, (t, y.reshape(STEPS, 2, 2, -1), u.reshape(STEPS, 2, 2, -1))),
    )
    for i in range(4):
        alone = decisions(detector, (t, y[:, i], u[:, i]))
        for f in fields(Decision):
            one, many, grid = (getattr(x, f.name) for x in (alone, together, square))
            if one is not None:
                np.testing.assert_array_equal(one, many[:, i], err_msg=f.name)
                np.testing.assert_array_equal(one, grid[:, i // 2, i % 2], err_msg=f.name)


@pytest.mark.parametrize("name", ["chain", "tanks", "network"])
def test_a_period_without_readings_has_no_lasting_effect(name: str) -> None:
    t, y, u = (a[:, :5] if a.ndim > 1 else a for a in healthy(name))
    y = y.copy()
    y[8:30] = np.nan
    d = decisions(Chebyshev(plant_of(name), alpha=5.0), (t, y, u))
    assert np.all(np.isfinite(d.estimate)) and np.all(np.isfinite(d.reconstruction)) and not d.alarm.any()
    if name == "network":  # the levels of the others run to rest, and are then known better than from one reading
        assert np.all(d.threshold[30] > d.threshold[9])
    left = 0.3**9  # of the memory; what stands for the readings is as it was
    assert np.all(d.threshold[39] <= d.threshold[7] * 1.01 + left * d.threshold[30])


def test_one_diagnoser_follows_unmeasured_states() -> None:
    plant = chain(6, sensors=4)  # sums of neighbours: no state is read directly
    t, _, y, u = readings(plant, 60, RUNS, seed=4)
    d = decisions(Chebyshev(plant, lam=0.0, rule="gaussian", alpha=1.0, moments=Extended(), **WATCHING), (t, y, u))
    z = (d.residual / d.threshold)[20:]
    np.testing.assert_allclose(np.sqrt(np.mean(z**2, axis=(0, 1))), 1.0, atol=ERROR)


def test_a_fault_is_isolated_although_another_residual_is_larger() -> None:
    """A fault of the first sensor has a ten times larger effect on the second residual, one step later."""
    M = np.array([[[0.5, 0.0], [-10.0, 0.0]]])
    quiet, one = np.zeros((1, 2)), np.ones((1, 2))
    before = StepResiduals(np.array([[2.0, 0.0]]), one, 3 * one)
    now = StepResiduals(np.array([[1.0, 20.0]]), one, 3 * one)
    found = explain(before, now, M, np.zeros((1, 2, 2)), np.array([[True, True]]))
    # as the fault of sensor 2, fresh, 20 would be left unexplained nowhere; of sensor 1 a step ago it fits every residual
    np.testing.assert_array_equal(found.isolated, [[True, False]])
    assert found.size[0, 0] == pytest.approx(2.0, abs=0.1) and 1.7 <= found.low[0, 0] <= found.high[0, 0] <= 2.3
    healthy, both = StepResiduals(quiet, one, 3 * one), StepResiduals(9 * one, one, 3 * one)
    assert not explain(healthy, both, M, np.zeros((1, 2, 2)), one > 0).isolated[0, 0], (
        "it would have no effect on the other residual yet"
    )
    apart = explain(healthy, both, 0 * M, np.zeros((1, 2, 2)), one > 0)
    np.testing.assert_array_equal(apart.isolated, [[True, True]])  # neither reaches the other: two faults
    np.testing.assert_array_equal(apart.size, [[9.0, 9.0]])


@pytest.mark.parametrize("name", ["theta_4", "theta_4@3", "omega_9", "p_v_13", "p_m_1"])
def test_faults_of_every_kind_of_reading_are_isolated_exactly(name: str) -> None:
    plant = power_network(loads=(), noise="small")
    r = simulate(plant, 45, range(20), truth="model", process_noise=True)
    i, y = plant.sensor_index(name), r.y.copy()
    y[25:, :, i] += 40 * plant.sensor_sigma[i]
    d = decisions(Chebyshev(plant, lam=0.0, alpha=5.0), (r.t, y, r.u_of_runs))
    assert np.mean(d.isolated[25:, :, i]) > 0.95 and np.mean(np.delete(d.isolated, i, axis=-1)) < 1e-3
    assert not d.isolated[:25].any()
    size = np.nanmean(d.fault_size[40:, :, i]) / plant.sensor_sigma[i]
    assert size == pytest.approx(40.0, abs=3.0)
    error = (d.reconstruction - r.y)[26:, :, i] / plant.sensor_sigma[i]
    assert np.sqrt(np.mean(error**2)) < 20.0, "the replacement is closer to the truth than the reading"


def test_a_process_fault_isolates_no_sensor() -> None:
    plant = power_network(loads=(), noise="small")
    r = simulate(plant, 30, range(10), truth="model", process_noise=True)
    y = r.y.copy()
    areas = [plant.sensor_index(n) for n in ("omega_4", "p_m_4", "p_v_4")]
    y[20:, :, areas] += 1.0  # three states jump at once
    d = decisions(Chebyshev(plant, lam=0.0, alpha=5.0), (r.t, y, r.u_of_runs))
    assert np.all(d.alarm[20]) and not d.isolated[20].any()


@pytest.mark.parametrize("name", ["chain", "network"])
def test_the_effect_of_a_fault_detected_late_is_removed_from_the_estimate(name: str) -> None:
    """A ramp that the state follows: at its isolation the effect on the estimate in place of the reading is removed."""
    plant = plant_of(name)
    t, y, u = (a[:, :20] if a.ndim > 1 else a for a in healthy(name))
    truth, y = y, y.copy()
    i = plant.sensor_index("theta_6") if name == "network" else 5
    ramp = np.maximum(t - t[9], 0.0) / (t[1] - t[0]) * plant.sensor_sigma[i]
    y[..., i] += ({"chain": 4.5, "network": 3.0}[name] * ramp)[:, None]
    d = decisions(Chebyshev(plant, lam=0.0, alpha=5.0), (t, y, u))
    first = np.argmax(d.isolated[..., i], axis=0)
    assert np.all(np.any(d.isolated[..., i], axis=0)) and np.median(first) > 11, "isolated, and late"
    error = np.array([abs(d.reconstruction[k, b, i] - truth[k, b, i]) for b, k in enumerate(first)])
    bias = np.array([abs(y[k, b, i] - truth[k, b, i]) for b, k in enumerate(first)])
    assert np.median(error) < 0.5 * np.median(bias)


def test_faults_far_from_each_other_are_isolated_at_once() -> None:
    t, y, u = (a[:, :20] if a.ndim > 1 else a for a in healthy("network"))
    y, faulty = y.copy(), [network().sensor_index(n) for n in ("omega_1", "p_v_9", "theta_13@14")]
    for i in faulty:
        y[25:, :, i] += 60 * network().sensor_sigma[i]
    d = decisions(Chebyshev(network(), lam=0.0, alpha=5.0), (t, y, u))
    assert np.mean(np.all(d.isolated[25, :, faulty], axis=0)) > 0.9
    assert np.mean(d.isolated[25:][..., faulty]) > 0.95 and np.mean(np.delete(d.isolated, faulty, axis=-1)) < 1e-3


@pytest.mark.parametrize("name", ["chain", "tanks", "network"])
@pytest.mark.parametrize("bad", [1e300, -1e300, 1e9, 0.0])
def test_implausible_readings_have_no_lasting_effect(name: str, bad: float) -> None:
    t, y, u = (a[:, :20] if a.ndim > 1 else a for a in healthy(name))
    y = y.copy()
    y[5:10] = bad
    y[10:15, :, 0] = bad
    detector = Chebyshev(plant_of(name), lam=0.0, alpha=6.0)
    d = decisions(detector, (t, y, u))
    assert np.all(np.isfinite(d.estimate)) and not d.diverged.any()
    assert np.all(np.sum(d.isolated, axis=-1) <= detector.most_faults)
    slow = (name, bad) in {("chain", 1e9), ("tanks", 0.0)}
    assert np.mean(d.alarm[-1]) <= (1.0 if slow else 0.4), "whose state has followed takes long to return"


def test_an_area_does_not_depend_on_readings_beyond_the_areas_that_share_with_it() -> None:
    plant = network()
    t, y, u = (a[:, :3] if a.ndim > 1 else a for a in healthy("network"))
    near = {"area 4", "area 3", "area 5", "area 13"}
    # beyond: what the neighbours' neighbours read, but for their copies of the angles that area 4 shares
    shared = [s.measures in {f"theta_{i}" for i in (3, 4, 5, 13)} for s in plant.sensors]
    beyond = np.array([s.owner not in near for s in plant.sensors]) & ~np.array(shared)
    other, load = y.copy(), u.copy()
    other[..., beyond] += np.random.default_rng(8).standard_normal(other[..., beyond].shape)
    far = np.array([s.name.split("_")[1] not in {"3", "4", "5", "13"} for s in plant.inputs])
    load[..., far] += 0.3
    mine = np.array([s.owner == "area 4" for s in plant.sensors])
    for mode in ("corrected", "paper"):
        detector = Chebyshev(plant, mode=mode, **WATCHING)
        state = run(detector, detector.init((3,)), t[:20], y[:20], u[:20])[0]
        a = run(detector, state, t[20:22], y[20:22], u[20:22])[1]
        b = run(detector, state, t[20:22], other[20:22], load[20:22])[1]
        for name in ("residual", "threshold"):
            np.testing.assert_array_equal(getattr(a, name)[..., mine], getattr(b, name)[..., mine])
        assert np.all(a.residual[..., beyond] != b.residual[..., beyond])


def test_confirmations_wait() -> None:
    t, y, u = (a[:, :1] if a.ndim > 1 else a for a in healthy("network"))
    y, i = y.copy(), network().sensor_index("p_v_3")
    y[20:, 0, i] += (
        np.linspace(40, 160, 20) * network().sensor_sigma[i]
    )  # growing: the residual of every step exceeds its threshold
    first = [
        int(
            np.argmax(
                np.any(decisions(Chebyshev(network(), lam=0.0, alpha=5.0, confirmations=q), (t, y, u)).isolated[:, 0], -1)
            )
        )
        for q in (1, 3)
    ]
    assert first[0] == 20 and first[1] >= 22


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"alpha": 1.0}, "expected a finite number above 1"),
        ({"alpha": np.nan}, "expected a finite number above 1"),
        ({"alpha": (2.0, 3.0)}, "expected one number or one for each of 4 sensors"),
        ({"false_alarm": 0.0}, "strictly between 0 and 1"),
        ({"false_alarm": 1.5}, "strictly between 0 and 1"),
        ({"alpha": 2.0, "false_alarm": 0.1}, "each determines the other: give one"),
        ({"lam": 1.0}, "lam is 1.0; expected at least 0 and less than 1"),
        ({"lam": -0.1}, "lam is -0.1"),
        ({"mode": "printed"}, "mode is 'printed'; known: corrected, paper"),
        ({"rule": "markov"}, "rule is 'markov'; known: chebyshev"),
        ({"rule": "conformal"}, "needs alpha from healthy data"),
        ({"moments": Unscented}, "estimator is"),
        ({"moments": None}, "estimator is None"),
        ({"confirmations": 0}, "confirmations is 0"),
        ({"max_faults": 4}, "max_faults is 4; plant 'two-tanks' has 4 sensors"),
        ({"plant": None}, "expected a Plant"),
    ],
)
def test_settings_that_do_not_fit(settings: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Chebyshev(**({"plant": tanks()} | settings))


def test_areas_must_be_those_of_the_plant() -> None:
    with pytest.raises(ValueError, match="its areas 60 states and 30 inputs"):
        Chebyshev(changed(tanks(), areas=network_areas_of(network())))
    sensors = tuple(replace(s, owner="area 9") if s.name == "theta_1@2" else s for s in network().sensors)
    with pytest.raises(ValueError, match="a sensor of theta_1 is owned by 'area 9'"):
        Chebyshev(replace(network(), sensors=sensors))
    with pytest.raises(ValueError, match="whole number of at least 2"):
        MonteCarlo(draws=1)


def test_the_rate_that_is_claimed_is_of_all_sensors_and_of_the_limits_as_they_are_scaled() -> None:
    plant = tanks()
    count, healthy = len(plant.sensors), simulate(plant, 400, range(5), truth="model")
    assert Chebyshev(plant, alpha=10.0).claimed_rate == pytest.approx(count / 10**2)
    assert Chebyshev(plant, alpha=10.0, threshold_scale=0.5).claimed_rate == pytest.approx(count / 5**2)
    assert np.isnan(Chebyshev(plant, alpha=1.5).claimed_rate)  # the bound is above 1
    assert Chebyshev(plant, false_alarm=0.01).claimed_rate == pytest.approx(0.01)
    assert Chebyshev(plant).fit_thresholds(healthy, 0.05).claimed_rate == pytest.approx(0.05)
    areas = power_network()
    assert Chebyshev(areas, false_alarm=0.01).claimed_rate == pytest.approx(15 * 0.01)  # of each of 15 diagnosers


def detector(plant: Plant) -> Chebyshev:
    return Chebyshev(plant, lam=0.0, rule="bound", moments=Extended(), accommodate=False)


def test_the_threshold_is_the_effect_of_the_worst_noise() -> None:
    plant = bounded_chain()
    F = plant.step_jacobian_at(0.0, plant.x0, plant.input_at(0.0), plant.dt)
    y = np.zeros((3, 6))
    _, d = run(detector(plant), detector(plant).init(), plant.dt * np.arange(1, 4), y, np.zeros((3, len(plant.inputs))))
    expected = np.abs(F) @ np.full(6, BOUND) + 0.05 + BOUND  # of readings that are each a state: |F| d + w + d
    np.testing.assert_allclose(d.threshold[1:], np.broadcast_to(expected, (2, 6)), rtol=1e-11)  # widened by 1e-12 for rounding


def test_noise_within_its_bounds_never_alarms() -> None:
    plant = bounded_chain()
    rng = np.random.default_rng(3)
    steps, runs = 400, 20
    x = plant.x0 + np.zeros((runs, 6))
    u = np.zeros((steps, runs, len(plant.inputs)))
    y = np.empty((steps, runs, 6))
    for k in range(steps):
        x = plant.step(k * plant.dt, x, u[k], plant.dt) + rng.choice([-0.05, 0.05], size=x.shape)
        y[k] = plant.output((k + 1) * plant.dt, x, u[k]) + rng.choice([-BOUND, BOUND], size=x.shape)
    y[rng.random(y.shape) < 0.2] = np.nan  # a missing reading has the bound from past readings
    one = detector(plant)
    _, d = run(one, one.init((runs,)), plant.dt * np.arange(1, steps + 1), y, u)
    assert 0.99 < d.scores.max() <= 1.0  # noise of two values meets its bounds now and then


def test_sensors_without_a_bound_have_a_bound_in_standard_deviations() -> None:
    plant = chain(6)
    one = detector(plant).diagnoser
    assert isinstance(one, BoundedReadings)
    np.testing.assert_allclose(one._noise, WITHIN * plant.sensor_sigma)


def test_the_rule_bound_takes_no_probability() -> None:
    assert false_alarm_of("bound", 1.0) == 0.0
    with pytest.raises(ValueError, match="has no false alarms; leave"):
        alpha_for("bound", 0.01)
    with pytest.raises(ValueError, match="has no false alarms; leave"):
        Chebyshev(chain(6), rule="bound", false_alarm=0.01)


class Fault(NamedTuple):
    """A hypothesis of a sensor that explains its reach: interval, size, log-likelihood ratio (twice), begun before now."""

    low: float
    high: float
    size: float
    gain: float
    late: bool


def best_faults(i: int, steps: list[tuple[Array, Array, Array]], M: Array, L: Array) -> list[Fault]:
    """The best of the three hypotheses of sensor i as the module's docstring states them, on one run; more where they tie."""
    one = np.eye(len(M))
    lasting = (np.linalg.inv(one - L) @ (one - M))[:, i]
    found = []
    for late, shares in enumerate([(0 * one[i], one[i]), (one[i], (one - M + L)[:, i]), (lasting, lasting)]):
        low, high, square, product = -np.inf, np.inf, 0.0, 0.0
        for share, (residual, deviation, threshold) in zip(shares, steps, strict=True):
            for j in range(len(M)):
                if not (j == i or M[j, i] or L[j, i]) or np.isnan(residual[j]) or np.isinf(threshold[j]):
                    continue
                if share[j] == 0.0:
                    low, high = (low, high) if abs(residual[j]) <= threshold[j] else (np.inf, -np.inf)
                else:
                    ends = (residual[j] - threshold[j]) / share[j], (residual[j] + threshold[j]) / share[j]
                    low, high = max(low, min(ends)), min(high, max(ends))
                square += (share[j] / deviation[j]) ** 2
                product += share[j] * residual[j] / deviation[j] ** 2
        if low <= high and not low <= 0 <= high:
            size = min(max(product / square, low), high)
            found.append(Fault(low, high, size, 2 * size * product - size**2 * square, late > 0))
    most = max((fault.gain for fault in found), default=0.0)
    return [fault for fault in found if fault.gain >= most - 1e-9 * abs(most)]


def test_explanations_equal_those_of_plain_loops() -> None:
    """Two groups of three sensors that share nothing; residuals of one fault, or of one in each group, with noise and gaps."""
    rng, runs, groups = np.random.default_rng(8), 400, np.repeat([0, 1], 3)
    together = groups[:, None] == groups
    M, L = (np.where(together & (rng.random((runs, 6, 6)) < 0.5), rng.uniform(-0.4, 0.4, (runs, 6, 6)), 0.0) for _ in range(2))
    one, suspects = np.eye(6), rng.random((runs, 6)) < 0.9
    lasting = np.linalg.solve(one - L, one - M)
    hypotheses = (0 * lasting, one + 0 * lasting), (one + 0 * lasting, one - M + L), (lasting, lasting)
    deviation, threshold = rng.uniform(0.5, 2.0, (2, runs, 6)), rng.uniform(2.0, 6.0, (2, runs, 6))
    residual = threshold * rng.uniform(-0.6, 0.6, (2, runs, 6))
    for r in range(runs):
        for i in (rng.integers(3), 3 + rng.integers(3))[: 1 + r % 2]:
            shares = hypotheses[rng.integers(3)]
            residual[:, r] += rng.choice([-1, 1]) * rng.uniform(3.0, 15.0) * np.stack([s[r, :, i] for s in shares])
    residual[rng.random(residual.shape) < 0.05] = np.nan
    threshold[rng.random(threshold.shape) < 0.05] = np.inf
    steps = [(residual[k], deviation[k], threshold[k]) for k in (0, 1)]
    found = explain(*(StepResiduals(*step) for step in steps), M, L, suspects)
    explained = late = pairs = 0
    for r in range(runs):
        faults = [best_faults(i, [tuple(a[r] for a in step) for step in steps], M[r], L[r]) for i in range(6)]
        reach = (one != 0) | (M[r] != 0) | (L[r] != 0)
        left = {i: fault for i, fault in enumerate(faults) if fault and suspects[r, i]}
        for i, fault in left.items():
            given = (found.low[r, i], found.high[r, i], found.size[r, i])
            assert any(given == pytest.approx(f[:3], rel=1e-9) and found.late[r, i] == f.late for f in fault), (r, i)
            explained, late = explained + 1, late + fault[0].late
        named = set()
        while left:
            best = max(left, key=lambda i: left[i][0].gain)
            named.add(best)
            left = {i: fault for i, fault in left.items() if not np.any(reach[:, i] & reach[:, best])}
        assert set(np.flatnonzero(found.isolated[r])) == named, r
        pairs += len(named) > 1
    assert explained - late > 30 and late > 100 and pairs > 30


@pytest.mark.parametrize(
    ("before", "now", "late", "low", "high"),
    [
        (0.0, 7.0, False, 4.0, 10.0),  # it begins now, with all of its size
        (10.0, 7.0, True, 7.0, 13.0),  # a step ago: 1 then, 1 - M + L = 0.7 now
        (6.25, 6.25, True, 5.2, 14.8),  # long ago: (1 - M) / (1 - L) = 0.625 at both
    ],
)
def test_a_fault_that_began_before_now_is_late(before: float, now: float, late: bool, low: float, high: float) -> None:
    """A residual with the part M = 0.5 of the last reading and L = 0.2 of the last residual, thresholds of 3."""
    said = (StepResiduals(np.array([[z]]), np.ones((1, 1)), np.full((1, 1), 3.0)) for z in (before, now))
    found = explain(*said, np.array([[[0.5]]]), np.array([[[0.2]]]), np.array([[True]]))
    assert found.isolated.all() and bool(found.late[0, 0]) is late
    assert (found.low[0, 0], found.high[0, 0]) == pytest.approx((low, high))
    assert found.size[0, 0] == pytest.approx({0.0: 7.0}.get(before, 10.0))
