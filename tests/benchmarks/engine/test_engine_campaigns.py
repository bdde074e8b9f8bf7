"""The engine's campaigns: noise, sensitivity, load, process."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from rounding import rounding
from smallest_scenarios import smallest

from fusion_sfdia.benchmarks.engine import noise as engine_noise
from fusion_sfdia.benchmarks.engine import process as engine_process
from fusion_sfdia.benchmarks.engine import sensitivity as engine_sensitivity
from fusion_sfdia.benchmarks.engine.support import campaign
from fusion_sfdia.benchmarks.engine.support import process_figures as engine_process_figures
from fusion_sfdia.benchmarks.engine.support.campaign import VALID, first_firings, fork, noise, response, steady_detector, truth
from fusion_sfdia.benchmarks.engine.support.noise_figures import AGENTS, FAULTS, OTHERS, OWN, condition, modules_of, published
from fusion_sfdia.benchmarks.engine.support.trials import BIN, NAMES
from fusion_sfdia.detectors.detector import run
from fusion_sfdia.models.marine_engine.modules import MODULES
from fusion_sfdia.models.marine_engine.plant import SENSORS
from fusion_sfdia.study.scenarios import scenario


def readings(seeds: range, steps: int = 60) -> np.ndarray:
    return truth(1.0).signal[:steps, None] + np.stack(list(noise(steady_detector(VALID).plant, steps, seeds)))


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize("name", ["engine/noise", "engine/sensitivity", "engine/load", "engine/process"])
def test_healthy_runs_have_no_alarm(name: str) -> None:
    rows = smallest(name).summary.rows
    healthy = [r for r in rows if r.detector == VALID and r.metric in ("false_alarms", "runs_with_false_alarm")]
    healthy += [r for r in rows if r.fault == "none" and r.metric == "alarm_at_end"]
    assert healthy and not any(r.value for r in healthy)


@pytest.mark.slow
def test_a_fault_of_two_thresholds_is_detected_at_its_onset() -> None:
    """At full load no noise masks it."""
    delays = [
        r
        for r in smallest("engine/load").summary.rows
        if r.metric == "detection_delay" and r.condition == "constant, detector steady"
    ]
    assert len(delays) == 10 and all(r.value == 0 and r.n == 2 for r in delays)


def test_modules_and_sensors_have_one_order() -> None:
    assert [MODULES[name].variable for name in NAMES] == list(SENSORS.values())
    assert campaign.logic().local.rows == NAMES


def test_noise_of_a_seed_does_not_depend_on_the_others_and_stays_within_its_bounds() -> None:
    plant = steady_detector(VALID).plant
    some = np.stack(list(noise(plant, 1100, [3, 4])))  # over the border of what is drawn at once
    np.testing.assert_array_equal(some[:, 1], np.stack(list(noise(plant, 1100, [4])))[:, 0])
    bound = np.array([s.noise_bound for s in plant.sensors])
    assert np.all(np.abs(some) <= bound)
    # uniform noise over its bound has the variance 1/3, its estimate from n the standard error sqrt((1/5 - 1/9) / n)
    ratio = (some / bound).reshape(-1, bound.size)
    assert np.all(np.abs((ratio**2).mean(axis=0) - 1 / 3) < 4 * np.sqrt((1 / 5 - 1 / 9) / len(ratio)))


def test_first_firings_agree_with_the_decisions() -> None:
    detector, t, u = steady_detector(VALID), truth(1.0).t[:60], truth(1.0).u[:60]
    y = readings(range(3))
    y[30:, 0, 3] -= 3.8e4
    y[40:, 1, 8] += 40.0
    _, found = first_firings(detector, t, u, y)
    start = detector.init((3,), 0.0)
    _, decision = run(detector, start, t, y, np.broadcast_to(u[:, None], (60, 3, 1)))
    beyond = np.abs(decision.residual) > decision.threshold
    np.testing.assert_array_equal(found["beyond"], beyond.sum(axis=0))
    assert np.isfinite(found["first"][0]).any() and np.isinf(found["first"][2]).all()
    for k, time in enumerate(t):
        np.testing.assert_array_equal(campaign.logic().isolated(found["first"] <= time), decision.isolated[k])
    np.testing.assert_allclose(found["threshold"], decision.threshold.mean(axis=0), rtol=1e-12)


def test_runs_forked_at_the_onset_equal_whole_runs() -> None:
    detector, t, u = steady_detector(VALID), truth(1.0).t[:60], truth(1.0).u[:60]
    y = np.repeat(readings(range(2))[:, None], 2, axis=1)
    y[30:, 1, :, 0] *= 1.2
    _, whole = first_firings(detector, t, u, y)
    state, before = first_firings(detector, t[:30], u[:30], y[:30, 0])
    _, after = first_firings(detector, t[30:], u[30:], y[30:], fork(state, 2))
    np.testing.assert_array_equal(np.minimum(before["first"], after["first"]), whole["first"])
    np.testing.assert_array_equal(before["beyond"] + after["beyond"], whole["beyond"])
    assert "trace" not in whole and first_firings(detector, t, u, y, shown=(1, 0))[1]["trace"].shape == (3, 2 * 60 // BIN, 10)
    with pytest.raises(ValueError, match="there are no readings"):
        first_firings(detector, t[:0], u[:0], [])


def test_one_envelope_serves_all_noise_up_to_the_usual() -> None:
    small, usual = steady_detector(VALID, 0.01), steady_detector(VALID)
    assert small.envelope == usual.envelope == pytest.approx(0.15) and steady_detector(VALID, 0.1).envelope == pytest.approx(
        0.25
    )
    np.testing.assert_array_equal(small.slopes.signs, usual.slopes.signs)
    # the part that is not proved over the wider one is negligible at small noise: below 0.1 % of the nominal values
    own = replace(small, envelope=None)
    both = [(d.slopes.unproved[:, :10] @ d._bound) / d.nominal for d in (own, small)]
    assert np.all(both[1] - both[0] < 1e-3)


def test_answers_of_first_firings() -> None:
    first = np.full((4, 10), np.inf)
    first[0, 0], first[1, 0], first[2, 3] = 20.0, 20.5, 25.0
    own, others = response(first, 20.0, [0]), response(first, 20.0, range(1, 10))
    assert own.missed.value == 0.5 and own.delay.value == 0.25 and (own.shortest, own.longest) == (0.0, 0.5)
    assert others.missed.value == 0.75 and others.delay.value == 5.0
    none = response(first, 20.0, [9])
    assert none.missed.value == 1.0 and none.delay.n == 0 and np.isnan(none.shortest)


@pytest.mark.parametrize(
    ("sensor", "group", "level", "metric", "value"),
    [
        ("S(1){1}", OTHERS, 0.02, "detection_delay", 10.52),
        ("S(1){1}", AGENTS, 0.02, "detection_delay", None),
        ("S(2){3}", OTHERS, 0.06, "detection_delay", None),
        ("S(2){3}", OTHERS, 0.06, "detection_delay_shortest", 74.48),
        ("S(2){3}", OWN, 0.07, "missed_detection_rate", 1.0),
        ("S(1){1}", OWN, 0.1, "missed_detection_rate", 0.0),
        ("S(1){1}", AGENTS, 0.02, "missed_detection_rate", 0.0),
        ("S(1){1}", AGENTS, 0.06, "missed_detection_rate", None),
    ],
)
def test_published_of_table_vi(sensor: str, group: str, level: float, metric: str, value: float | None) -> None:
    found = published(sensor, group, level, metric)
    assert (found and found.value) == value
    assert found is None or ("more than" in found.source) == (metric == "detection_delay_shortest")


def test_groups_of_modules() -> None:
    members = {group: [NAMES[i] for i in modules_of("S(2){3}", group)] for group in (OWN, AGENTS, OTHERS)}
    assert members[OWN] == ["M(2,3)"] and set(members[OTHERS]) == set(NAMES) - {"M(2,3)"}
    assert set(members[AGENTS]) == set(NAMES) - {"M(2,1)", "M(2,2)", "M(2,3)"}
    assert modules_of("S(1){1}", AGENTS) == modules_of("S(1){1}", OTHERS)


def test_missed_detections_increase_with_the_noise() -> None:
    """The same draws at rising levels: missed detections and delays increase, within chance (K24, Fig. 5 and Table VI)."""
    one = scenario("engine/noise")
    settings = {**one.settings, "levels": (0.02, 0.04, 0.06, 0.1), "onset": 0.3, "duration": 1.3}
    rows = one.summarise(settings, [(t, one.work(t)) for t in one.tasks(settings, 20)]).rows
    assert {r.value for r in rows if r.metric == "false_alarms"} == {0.0}
    for sensor, size in FAULTS.items():
        for group in (NAMES[modules_of(sensor, OWN)[0]], AGENTS, OTHERS):
            missed = [r for r in rows if r.fault == f"{sensor} +{size:.0%}" and r.metric == "missed_detection_rate"]
            of = {r.condition: r for r in missed if r.quantity == group}
            rates = [of[condition(level)] for level in settings["levels"]]
            assert all(r.n == 20 for r in rates)
            assert all(after.high >= before.low for before, after in pairwise(rates))  # Wilson's 95 % intervals
            if group == AGENTS:
                assert rates[-1].low > rates[0].value
            times = [r for r in rows if r.fault == missed[0].fault and r.metric == "detection_delay" and r.quantity == group]
            whole = [delay for delay, rate in zip(times, rates, strict=True) if rate.value == 0]  # delays of all runs
            assert all(after.high >= before.low for before, after in pairwise(whole))  # Student's 95 % intervals
            if group == OTHERS:
                assert whole[-1].low > whole[0].high
    # Fig. 5: the own module misses no more than the other agents do; their modules are among all others, which may detect more
    by = {(r.fault, r.quantity, r.condition): r.value for r in rows if r.metric == "missed_detection_rate"}
    for (fault, quantity, level), value in by.items():
        if quantity == AGENTS:
            own = NAMES[modules_of(fault.split()[0], OWN)[0]]
            assert by[fault, own, level] <= value and by[fault, OTHERS, level] <= value


def test_faults_of_two_thresholds_are_always_detected() -> None:
    detector, t, u = steady_detector(VALID), truth(1.0).t[:60], truth(1.0).u[:60]
    y = np.repeat(readings(range(5))[:, None], 10, axis=1)
    y[30:] += np.diag(campaign.sizes(detector, 2.0))[:, None]
    first = first_firings(detector, t, u, y)[1]["first"]
    assert np.all(first[np.arange(10), :, np.arange(10)] == t[30])


def test_attacks_change_the_reading_of_the_attacked_sensor_alone() -> None:
    task = {"onset": 0.3, "period": 0.1}
    nominal = truth(1.0).signal[0]
    for kind, sensor in engine_process_figures.attack_cases():
        faults = engine_process.attack(kind, sensor, 0.1 * nominal, nominal, task)
        assert {f.sensor for f in faults} == (set(SENSORS) if sensor == engine_process_figures.ALL else {sensor})
    offset, scaling, sign = (
        engine_process.attack(k, "S(4){1}", 0.1 * nominal, nominal, task)[0] for k in ("offset", "scaling", "sign")
    )
    assert offset.magnitude == pytest.approx((scaling.magnitude - 1) * nominal[7]) and sign.magnitude == -1


def test_a_replay_is_undetectable_at_constant_load_and_detected_during_a_load_step() -> None:
    common = {"detector": VALID, "noise": 0.05, "onset": 0.5, "duration": 3.0, "what": "attack", "size": 2.0, "period": 0.4}
    cases = engine_process_figures.attack_cases()
    replay = [i for i, (kind, _) in enumerate(cases) if kind == "replay"]
    fuel, everyone = cases.index(("replay", "S(1){1}")), cases.index(("replay", engine_process_figures.ALL))
    still = engine_process.process_work({**common, "drive": "constant", "seeds": [0]})["first"]
    moved = engine_process.process_work({**common, "drive": "step", "seeds": [0]})["first"]
    assert np.isinf(still[replay]).all()
    assert np.isfinite(moved[[fuel, everyone]]).any(axis=-1).all()
    assert np.isfinite(still[: len(cases) - 11]).any(axis=-1).all()  # offset, scaling, sign


def test_a_sentence_states_what_a_process_fault_isolates() -> None:
    first = np.full((10, 2, 10), np.inf)
    first[0, :, NAMES.index("M(4,2)")] = 5.0
    first[1, 0, 0] = 5.0  # one run of two is not most
    (sentence,) = engine_process_figures.noticed([0.05, 0.2], first)
    assert sentence == "turbine-fouling of 5% is detected by M(4,2) in most runs; isolated: S(4){2}."


def test_gains_are_those_of_the_designs() -> None:
    task = {"detector": VALID, "level": 0.05, "onset": 0.3, "duration": 0.5, "seeds": [0], "gains": "K22"}
    found = engine_sensitivity.sensitivity_work(task)
    gains = steady_detector(VALID, 0.05, "K22").plant.structure.modules.gains
    assert gains == {"fuel": 1.16, "p_receiver": 445.0, "p_charge": 319.98}
    assert found["detected"].shape == (3, engine_sensitivity.SIZES.size, 1) and not found["beyond"].any()
    assert found["detected"][:, -1].all()  # 5 noise bounds


@pytest.mark.parametrize(
    ("name", "settings", "message"),
    [
        ("engine/noise", {"levels": (0.5,)}, "levels has 0.5"),
        ("engine/noise", {"onset": 50.0}, "onset is 50 s of 40 s"),
        ("engine/noise", {"detector": "loo-glr"}, "detector is 'loo-glr'; known: adaptive-threshold"),
        ("engine/sensitivity", {"gains": ("K25",)}, "gains has K25; known: K24"),
        ("engine/load", {"drives": ("jump",)}, "drives has jump; known: constant"),
        ("engine/load", {"change": 9.0}, "expected this order"),
        ("engine/process", {"drives": ("jump",)}, "drives has jump"),
    ],
)
def test_invalid_settings_are_refused(name: str, settings: dict[str, object], message: str) -> None:
    one = scenario(name)
    with pytest.raises(ValueError, match=message):
        one.tasks({**one.settings, **settings}, 1)


def test_a_campaign_gives_the_same_bits_for_any_division_of_its_seeds() -> None:
    task = {"detector": VALID, "onset": 0.3, "duration": 0.5, "level": 0.05, "sampling": 0.01}
    both = engine_noise.noise_work({**task, "seeds": [5, 6]})["first"]
    alone = engine_noise.noise_work({**task, "seeds": [6]})["first"]
    np.testing.assert_array_equal(both[:, 1:], alone)


def test_biases_that_are_left_out_once_they_are_settled_change_no_result(monkeypatch: pytest.MonkeyPatch) -> None:
    task = {"detector": "adaptive-threshold:calibrated", "level": 0.05, "gains": "K22", "onset": 0.1, "duration": 0.8}
    stepped: list[int] = []
    whole = campaign.first_firings

    def counted(*args: Any) -> Any:
        stepped.append(len(args[4].diverged) if len(args) > 4 else 1)
        return whole(*args)

    monkeypatch.setattr(campaign, "first_firings", counted)
    found = engine_sensitivity.sensitivity_work({**task, "seeds": [0, 1]})
    assert max(stepped[:5]) == 2 * engine_sensitivity.SIZES.size > stepped[-1] > 0
    monkeypatch.setattr(engine_sensitivity, "STRETCH", 1000)
    everything = engine_sensitivity.sensitivity_work({**task, "seeds": [0, 1]})
    assert found["detected"].any()
    for name in ("detected", "beyond"):
        np.testing.assert_array_equal(found[name], everything[name])
    np.testing.assert_allclose(found["threshold"], everything["threshold"], rtol=rounding(1.0, 80))  # of sums in another order
