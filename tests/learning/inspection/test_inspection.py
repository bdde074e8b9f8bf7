"""An inspection names each mistake and each limit of a plant; theory and simulated runs agree on what is found."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from optional_packages import needs_toolbox
from toy_plants import Array, chain, tanks

from fusion_sfdia import Physics, Plant, Sensor, Signal, discretise, inspect, linear_plant, simulate
from fusion_sfdia.detectors.registry import NamedDetector, detector
from fusion_sfdia.learning.inspection.inspection import as_json, as_text
from fusion_sfdia.learning.inspection.stepping import of_start
from fusion_sfdia.plant.augment import augment
from fusion_sfdia.plant.redundancy import redundancy
from fusion_sfdia.plant.uncertainty import Disturbance, Uncertainty
from fusion_sfdia.plants import Numerics, SlowNoise, two_tanks

INFLOW = Signal("inflow", "m/s", nominal=0.01)


def levels(t: float, x: Array, u: Array, dt: float) -> Array:
    """Two tanks in a row with a time constant of 100 s, by Euler's method."""
    upper, lower = x[..., 0], x[..., 1]
    return x + dt * np.stack([u[..., 0] - 0.01 * upper, 0.01 * upper - 0.01 * lower], axis=-1)


def fast(t: float, x: Array, u: Array, dt: float) -> Array:
    """The lower tank empties in 1 s: too fast for Euler's method with a step of 5 s."""
    upper, lower = x[..., 0], x[..., 1]
    return x + dt * np.stack([u[..., 0] - 0.01 * upper, 0.01 * upper - 1.0 * lower], axis=-1)


def timeless(t: float, x: Array, u: Array, dt: float) -> Array:
    return levels(t, x, u, 5.0)


def overflowing(t: float, x: Array, u: Array, dt: float) -> Array:
    """Above 3 m the upper tank overflows."""
    over = np.where(x > 3.0, np.abs(x - 3.0), 0.0)
    return levels(t, x, u, dt) - 0.01 * dt * over


def by_table(t: float, x: Array, u: Array, dt: float) -> Array:
    return levels(t, x, u, dt) - 1e-4 * dt * np.interp(x, [0.0, 1.0, 4.0], [0.0, 1.0, 2.0])


def uncoupled(t: float, x: Array, u: Array, dt: float) -> Array:
    return x + dt * np.stack([u[..., 0] - 0.01 * x[..., 0], -0.01 * (x[..., 1] - 1.0)], axis=-1)


def accumulating(t: float, x: Array, u: Array, dt: float) -> Array:
    """The lower tank has no outlet."""
    return x + dt * np.stack([u[..., 0] - 0.01 * x[..., 0], 0.01 * (x[..., 0] - 1.0)], axis=-1)


def readings(t: float, x: Array, u: Array) -> Array:
    return np.asarray(x[..., [0, 0, 1, 1]])


def of_upper(t: float, x: Array, u: Array) -> Array:
    return np.asarray(x[..., [0, 0]])


def plant(step: Any, output: Any = readings, count: int = 4, **changes: Any) -> Plant:
    given: dict[str, Any] = {"dt": 5.0, "inputs": [INFLOW]}
    return Plant(
        "tanks in a row",
        [Signal(name, "m", nominal=1.0, initial_sigma=0.05, process_sigma=1e-3) for name in ("upper", "lower")],
        [Sensor(f"{name}_{k}", name, "m", sigma=0.01) for name in ("upper", "lower") for k in (1, 2)][:count],
        step=step,
        output=output,
        **given | changes,
    )


def broadcast(t: float, x: Array, u: Array, dt: float) -> Array:
    return np.asarray(x + dt * (u[..., :1] - 0.01 * x[..., :1]))


def test_mistakes_come_first_and_nothing_else_is_examined() -> None:
    found = inspect(plant(broadcast, output=lambda t, x, u: readings(t, x, u)))
    assert found.verdict == "tanks in a row: NOT READY, 2 mistakes to correct"
    one, other = found.mistakes
    assert "a single derivative was broadcast to all states; give one for each, np.stack([...], axis=-1)" in one.text
    assert "use functions of a module, methods or partials, no closures or lambdas" in other.text
    assert found.step is None and not found.detectors
    assert str(found).splitlines()[0] == found.verdict and "Mistakes: correct them first" in str(found)


@pytest.mark.parametrize(
    ("made", "about", "text"),
    [
        (plant(fast), "step", "a step of 5 s is unstable: an error grows by 4 in each, .* of lower, decays in 1 s; if lower"),
        (plant(timeless), "step", r"it ignores dt: .* or state Numerics\(fixed_dt=True\)"),
        (plant(overflowing), "step", r"abs \(test_inspection.py:\d+\): the complex step is wrong .* write np.where\(x < 0"),
        (plant(overflowing), "step", r"where \(test_inspection.py:\d+\): its slope jumps"),
        (plant(by_table), "step", r"interp \(test_inspection.py:\d+\): it takes no complex numbers.* fit a polynomial"),
        (plant(levels, dt=60.0), "step", r"one step of 60 s and two of 30 s differ by .* times the process noise in"),
        (plant(levels), "step", r"state Numerics\(max_dt=\d+\), and longer gaps are divided"),
        (plant(uncoupled, of_upper, 2), "observability", "1 of 2 states are not determined by any reading: lower; "),
        (plant(levels, of_upper, 2), "redundancy", "1 of 2 sensors may be isolated at once: half of the 2 sensors"),
        (plant(accumulating, readings, 4), "redundancy", r"1 of 4 .*: an error of the estimated lower .* by 2 sensors"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)  # fmt: skip
def test_what_limits_the_diagnosis_is_stated_with_its_cure(made: Plant, about: str, text: str) -> None:
    found = [f for f in inspect(made, simulated=False).findings if f.about == about]
    assert any(re.search(text, f.text) for f in found), found


def test_what_has_to_be_learnt_from_the_same_sensors_leaves_fewer_that_may_fail() -> None:
    made = two_tanks()
    found = inspect(made, simulated=False).readings
    assert found is not None
    assert (found.redundancy.faults, found.learning.faults) == (2, redundancy(augment(made)).faults) == (2, 1)
    assert "1 while the declared unknowns are to be learnt, too: an error of the estimated outlet_2" in str(
        inspect(made, simulated=False)
    )
    known = replace(made, uncertainty=Uncertainty())
    alone = inspect(known, simulated=False).readings
    assert alone is not None and alone.learning == alone.redundancy


def test_a_stated_limit_is_not_asked_for() -> None:
    stated = plant(levels, numerics=Numerics(max_dt=60.0))
    assert not any("max_dt" in f.text for f in inspect(stated, simulated=False).findings)


def stiff(substeps: int, t: float, x: Array, u: Array, dt: float) -> Array:
    """The lower tank empties in 2 s, by Euler's method in so many substeps."""
    for _ in range(substeps):
        x = x + dt / substeps * np.stack([u[..., 0] - 0.01 * x[..., 0], 0.005 * x[..., 0] - 0.5 * x[..., 1] + 0.495], axis=-1)
    return x


def slope(t: float, x: Array, z: Array, u: Array, c: object) -> Array:
    return np.stack([u[..., 0] - 0.01 * x[..., 0], 0.005 * x[..., 0] - 0.5 * x[..., 1] + 0.495], axis=-1)


def of_step_in(substeps: int, own: bool) -> list[str]:
    """What is remarked on the substeps of a step of own code, or of `discretise`, but not how long they take."""
    made = plant(partial(stiff, substeps), process_cov=np.full(2, 1e-12))
    physics = Physics("tanks", made.states, slope, made.inputs)
    sensors = [replace(s, measures=s.name[:5]) for s in made.sensors]
    found = made if own else discretise(physics, sensors, dt=5.0, process_cov=np.full(2, 1e-18), substeps=substeps)
    texts = [f.text for f in inspect(found, simulated=False).findings]
    return [text for text in texts if "substeps" in text and "rows a second" not in text]


@pytest.mark.parametrize("own", [True, False], ids=["own code", "discretise"])
def test_the_substeps_that_are_named_count_from_those_of_the_plant_and_suffice(own: bool) -> None:
    """A step that has substeps is asked for more of them only where its own error is above a tenth of the process noise."""
    count = 5
    (text,) = of_step_in(count, own)
    assert "the fastest mode, of lower, decays in 2 s; " in text
    number = int(re.search(r"take (\d+) times" if own else r"substeps=(\d+)", text)[1])  # type: ignore[index]
    more = number * count if own else number
    assert more > count and not of_step_in(more, own)


def test_a_nominal_state_in_another_unit_is_seen_by_its_movement() -> None:
    """A level of 1000 mm in place of 1 m: the other falls and rises by far more than is not known of the start."""
    made = plant(levels)
    wrong = replace(made, x0=np.array([1000.0, 1.0]), states=tuple(replace(s, nominal=0.0) for s in made.states))
    (start,) = [f.text for f in inspect(wrong, simulated=False).remarks if f.about == "start"]
    assert start.startswith("with the usual inputs the nominal state is not steady: upper moves by -50 m in a step of 5 s")


@pytest.mark.parametrize("off", [0.0, 7.0, 7.2])
def test_a_rounded_nominal_state_counts_as_steady(off: float) -> None:
    """x0 off by so many initial sigma, without process noise: up to 5 sqrt 2 are no remark, both levels being uncertain."""
    made = replace(plant(levels), x0=np.array([1.0, 1.0 + off * 0.05]), process_cov=np.zeros(2))
    assert len(list(of_start(made))) == (off > 5 * np.sqrt(2))


def counter(sensors: int) -> Plant:
    """A sum of a flow, read by `sensors` sensors, and the flow with two."""
    names = [*(f"sum_{k}" for k in range(1, sensors + 1)), "flow_1", "flow_2"]
    return linear_plant(
        "counter",
        np.array([[1.0, 1.0], [0.0, 0.9]]),
        np.array([[1.0, 0.0]] * sensors + [[0.0, 1.0]] * 2),
        [Sensor(name, name[:-2], sigma=0.1) for name in names],
        dt=1.0,
        states=(
            Signal("sum", initial_sigma=0.1, process_sigma=0.01),
            Signal("flow", initial_sigma=0.1, process_sigma=0.05),
        ),
    )


def test_a_sensor_that_is_never_used_again_on_its_own_is_listed() -> None:
    found = inspect(counter(1), detectors=["loo-glr"], sensors=["sum_1"])
    assert found.kept_out == ("sum_1",)
    assert "never on their own: sum_1" in str(found)
    needed = [
        f
        for f in found.remarks
        if f.about == "sum_1"
        and "only this sensor determines sum: the figures on its faults take the plant as modelled" in f.text
    ]
    assert len(needed) == 1
    assert inspect(counter(2), simulated=False).kept_out == ()


def test_a_detector_whose_alarms_latch_is_named_with_readmit() -> None:
    found = inspect(tanks(), detectors=["adaptive-threshold", "loo-glr"], sensors=["q2"])
    latching, other = found.detectors
    assert latching.kept_out == ("q2",) and other.kept_out == ()
    assert any(f.about == "q2" and "state = detector.readmit(state, sensor)" in f.text for f in found.remarks)


def test_a_detector_that_isolates_fewer_sensors_than_the_plant_allows_is_named() -> None:
    found = inspect(plant(levels), detectors=["kf-chi2", "loo-glr", "pca"], sensors=["upper_1"])
    assert [of.most_faults for of in found.detectors] == [1, 2, 3]
    assert "at once, at most: kf-chi2 1, loo-glr 2, pca 3" in str(found)
    (limited,) = [f for f in found.remarks if "at once, where the plant allows 2" in f.text]
    assert limited.about == "kf-chi2" and "isolates at most 1 sensor" in limited.text


def test_theory_and_simulation_agree_on_the_tanks() -> None:
    found = inspect("two-tanks", detectors=["loo-glr", "robust-glr"])
    assert not found.mistakes and found.verdict == "two-tanks: ready for diagnosis"
    theory = found.theory
    assert theory is not None
    assert np.all(theory.bias < 3), "a bias of 3 sigma shows in 60 samples"
    for of in found.detectors:
        for sensor in theory.sensors:
            bias, drift = of.best(sensor, "bias"), of.best(sensor, "drift")
            assert bias is not None and drift is not None
            assert (
                bias.size == (3.0 if of.detector == "loo-glr" else bias.size) <= 10.0
            )  # noise is learnt before it is believed
            assert 1 <= bias.delay <= 30 and drift.delay <= 60
        assert of.healthy < 0.05 and of.kept_out == ()
    frozen = [of.best(s, "freeze") for of in found.detectors[1:] for s in theory.sensors]
    assert all(trial is not None for trial in frozen), "robust-glr tests for readings that are too quiet"


def test_what_a_detector_cannot_do_is_stated() -> None:
    (found,) = inspect(plant(levels), detectors=["structural-residuals"], sensors=["upper_1"]).detectors
    assert "does not state its scalar equations" in found.left_out
    text = as_text(inspect(plant(levels), detectors=["structural-residuals"], sensors=["upper_1"]))
    assert "simulated for" not in text and "structural-residuals: plant 'tanks in a row'" in " ".join(text.split())


@needs_toolbox
def test_the_pattern_of_the_equations_tells_what_sizes_cannot() -> None:
    pair = inspect(plant(uncoupled, of_upper, 2), simulated=False).structure
    assert pair is not None and pair.groups == ()
    row = inspect(plant(levels), simulated=False).structure
    assert row is not None and row.undetectable == () and row.groups == ()


def test_a_healthy_log_shows_noise_that_is_stated_wrongly() -> None:
    made = plant(levels)
    noisier = replace(made, sensors=tuple(replace(s, sigma=0.03 if s.name == "lower_2" else s.sigma) for s in made.sensors))
    log = simulate(noisier, 300, seeds=[7], process_noise=True)
    found = inspect(made, log, simulated=False)
    assert found.healthy is not None and found.healthy.samples == 300
    assert any(f.about == "lower_2" and "differ from their predictions by" in f.text for f in found.remarks)
    right = inspect(made, simulate(made, 300, seeds=[7], process_noise=True), simulated=False)
    assert not [f for f in right.remarks if "healthy" in f.text]


def test_slow_noise_is_stated_and_raises_what_can_be_detected() -> None:
    made = plant(levels)
    slow = replace(made, sensors=tuple(replace(s, noise=SlowNoise(0.5, 40.0)) for s in made.sensors))
    found, white = (inspect(p, detectors=["loo-glr"], sensors=["upper_1"], simulated=False) for p in (slow, made))
    assert ", 50 % slow (40 s)" in as_text(found) and " % slow" not in as_text(white)
    assert found.theory is not None and white.theory is not None
    assert (found.theory.bias > 2 * white.theory.bias).all()


def test_json_has_all_of_it_and_no_infinity() -> None:
    found = inspect(plant(levels), detectors=["loo-glr"], sensors=["upper_1"])
    text = json.dumps(as_json(found), allow_nan=False)
    back = json.loads(text)
    assert back["ready"] is True and back["verdict"] == found.verdict
    assert {t["kind"] for t in back["detectors"][0]["trials"]} == {"bias", "drift", "freeze"}
    assert set(back["theory"]) == {"samples", *found.plant.sensor_names}


def test_names_that_are_unknown_are_refused() -> None:
    with pytest.raises(ValueError, match="unknown sensor 'x9' of plant 'chain'"):
        inspect(chain(3), sensors=["x9"])
    with pytest.raises(ValueError, match="unknown detector 'loo-grl'"):
        inspect(chain(3), detectors=["loo-grl"])


def test_a_log_is_predicted_along_the_disturbances_that_tuning_has_learnt() -> None:
    ramp = Disturbance("leak", state=np.array([0.0, 0.005]), reading=np.zeros(4), sd=1.0, time_constant=500.0)
    made = replace(plant(levels), uncertainty=Uncertainty(disturbances=(ramp,)))
    log = simulate(made, 300, seeds=[7], truth=augment(made), process_noise=True)
    within, without = (inspect(p, log, simulated=False).healthy for p in (made, plant(levels)))
    assert within is not None and without is not None
    assert abs(within.white.nis - 1) < 4 * np.sqrt(2 / (280 * 4)) < without.white.nis - 1


def test_the_tuned_detector_stands_in_place_of_the_registered_one() -> None:
    made = plant(levels)
    deaf = NamedDetector("loo-glr", "as tuned", lambda of: replace(detector("loo-glr", of), threshold_scale=1e6))
    log = simulate(made, 300, seeds=[7], process_noise=True)
    found = inspect(made, log, detectors=["kf-chi2", "loo-glr"], sensors=["upper_1"], tuned=deaf)
    assert [t.detector for t in found.detectors] == ["loo-glr", "kf-chi2"]
    assert max(t.found for t in found.detectors[0].trials) == 0 < max(t.found for t in found.detectors[1].trials)
    assert found.healthy is not None and found.healthy.detector == "loo-glr" and found.healthy.events == ()
