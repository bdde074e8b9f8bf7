"""Adaptive thresholds: no false alarms, agreement with the compiled driver, missing readings, rejected settings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from engine_runs import BOUND, DETECTOR, ENGINE, healthy, judge, recording_of
from toy_plants import changed

from fusion_sfdia.derivatives.equation import argument_names
from fusion_sfdia.detectors.adaptive_thresholds.adaptive_threshold import AdaptiveThreshold
from fusion_sfdia.detectors.detector import run
from fusion_sfdia.diagnosis.simulate import Recording, simulate
from fusion_sfdia.models.marine_engine.modules import OBSERVER_BOUNDS
from fusion_sfdia.models.marine_engine.published import K22_OBSERVER_BOUNDS
from fusion_sfdia.plant.modules import Modules, ObserverBound


def load_step(steps: int, runs: int) -> Recording:
    """From full load to 80 % after half a second."""
    return simulate(ENGINE, steps, range(runs), truth="model", inputs=lambda t: np.array([1.0 if t < 0.5 else 0.8]))


def for_load_steps() -> AdaptiveThreshold:
    """An envelope as wide as the step's whole transient, and p_receiver's drift in it."""
    signal = simulate(ENGINE, 3000, [0], truth="model", inputs=lambda t: np.array([1.0 if t < 0.5 else 0.8])).signal[:, 0]
    ends = zip(signal.min(axis=0) - 2.5 * BOUND, signal.max(axis=0) + 2.5 * BOUND, strict=True)
    return AdaptiveThreshold(
        ENGINE,
        envelope={s.measures: (float(a), float(b)) for s, (a, b) in zip(ENGINE.sensors, ends, strict=True)},
        drift={"p_receiver": 0.04},
    )


def test_corners_enclose_the_engine_over_the_envelope() -> None:
    """Ten thousand points in boxes of the noise's size, anywhere in the envelope."""
    rng = np.random.default_rng(1)
    m = ENGINE.structure.modules
    assert m is not None
    settings = DETECTOR._settings
    centre = DETECTOR.nominal + (settings.half_width - settings.bound) * rng.uniform(-1, 1, (100, 10))
    u = np.ones((100, 1))
    given = [np.array(a) for a in (centre[:, :3], np.zeros((100, 3)), centre, centre, u)]
    for a in given:
        a.flags.writeable = False  # as those of a run are: it is compiled for each type of arguments
    _, _, lower, upper = DETECTOR._monitor(*given, 0.01, settings)
    for _ in range(100):
        at = dict(zip(m.equations, (centre + settings.bound * rng.uniform(-1, 1, centre.shape)).T, strict=True))
        for k, (name, function) in enumerate(list(m.equations.items())[3:]):
            names = function.__code__.co_varnames[: function.__code__.co_argcount - 1]
            value = function(*(at[a] for a in names), m.parameters)
            assert np.all((lower[:, k] <= value) & (value <= upper[:, k])), name


def test_the_compiled_driver_is_the_same_source() -> None:
    assert ENGINE.structure.modules is not None
    plain = AdaptiveThreshold(changed(ENGINE, modules=replace(ENGINE.structure.modules, monitor=None)))
    recording = healthy(60, 3)
    y = recording.y.copy()
    y[20:30, 1, ::3] = np.nan
    y[40:, 2, 3] -= 3.8e4
    for drift in ({"p_receiver": 0.0}, {"p_receiver": 0.04}, {}):
        one, other = (judge(replace(d, drift=drift), y, recording) for d in (DETECTOR, plain))
        np.testing.assert_allclose(one.residual, other.residual, rtol=1e-12, atol=1e-9)
        np.testing.assert_allclose(one.threshold, other.threshold, rtol=1e-12)


def test_thresholds_in_noise_bounds() -> None:
    """Of the observers of "valid": 1.017, 2.3 (2.2 had the readings of one instant sufficed) and 2.01."""
    recording = healthy(400, 4)
    ratio = (judge(DETECTOR, recording.y, recording).threshold / BOUND)[50:].mean(axis=(0, 1))
    np.testing.assert_allclose(ratio[[0, 7]], [1.017, 2.009], atol=2e-3)
    assert 2.2 < ratio[4] < 2.5 and ratio[8] == pytest.approx(1.0, rel=1e-9)


@pytest.mark.parametrize(
    ("constants", "expected"),
    [(OBSERVER_BOUNDS, [1.1, 1.926, 1.711]), (K22_OBSERVER_BOUNDS, [6.0, 242.5, 321.0])],
    ids=["K24", "K22"],
)
def test_published_thresholds_in_noise_bounds(constants: dict[str, ObserverBound], expected: list[float]) -> None:
    """Settled, (10) is E (1 + rho Lambda / xi) + d with E = rho_d d / xi_d + rho lambda_h d_chi / xi; slopes by differences."""
    paper = replace(DETECTOR, observer_bounds=constants)
    settled = paper._published(np.zeros((1, 3)), np.array([100.0]))[0]  # 100 s are 100 / xi_d at least
    found = 1 + settled / DETECTOR._bound[:3]
    np.testing.assert_allclose(found, expected, rtol=3e-4)  # their digits
    m = ENGINE.structure.modules
    assert m is not None
    at = {**m.nominal, "fuel_setting": 1.0}
    bound = dict(zip(m.equations, DETECTOR._bound, strict=True))
    for state, ratio in zip(m.states, found, strict=True):
        h, c = m.equations[state], constants[state]

        def rate(moved: dict[str, float], h: Callable[..., float] = h) -> float:
            return h(*((at | moved)[a] for a in argument_names(h) if a != "c"), m.parameters)

        slope = {v: abs(rate({v: at[v] * 1.0001}) - rate({v: at[v] * 0.9999})) / (2e-4 * at[v]) for v in m.equations}
        effect = c.rho_d * bound[state] / c.xi_d + c.rho / c.xi * sum(slope[v] * bound[v] for v in m.equations if v != state)
        # differences err by 1e-8 of curvature that is of order 10 at most, of a part of the threshold
        assert ratio == pytest.approx(1 + effect * (1 + c.rho * slope[state] / c.xi) / bound[state], rel=1e-6)


def test_healthy_readings_never_alarm() -> None:
    recording = healthy(2000, 25)  # half a million module-samples; ten million in the slow test
    d = judge(DETECTOR, recording.y, recording)
    assert not d.alarm.any() and d.scores.max() <= 1.0


@pytest.mark.long
def test_ten_million_healthy_module_samples_raise_no_alarm() -> None:
    recording = simulate(ENGINE, 10_000, range(100, 200), truth="model")
    d = judge(DETECTOR, recording.y, recording)
    assert d.scores.size >= 10_000_000 and not d.alarm.any()


def test_a_faulty_torque_sensor_is_among_the_isolated() -> None:
    recording = healthy(300, 5)
    y = recording.y.copy()
    y[100:, :, 3] -= 3.8e4
    d = judge(DETECTOR, y, recording)
    assert not d.alarm[:100].any() and d.isolated[101:, :, 3].all() and not d.isolated[:, :, [6, 7, 8, 9]].any()


def test_missing_readings_widen_and_never_alarm() -> None:
    recording = healthy(300, 5)
    y = recording.y.copy()
    y[50:150, :, 1::2] = np.nan
    y[200] = np.nan
    d = judge(DETECTOR, y, recording)
    assert not d.alarm.any() and np.isnan(d.residual[60, :, 1::2]).all() and np.isfinite(d.reconstruction).all()


def test_unsuitable_plants_and_settings_are_rejected() -> None:
    assert ENGINE.structure.modules is not None
    modules: Modules = ENGINE.structure.modules
    with pytest.raises(ValueError, match="does not state its scalar equations"):
        AdaptiveThreshold(changed(ENGINE, modules=None))
    with pytest.raises(ValueError, match="observer of fuel has the gain -100"):
        replace(modules, gains={**modules.gains, "fuel": -100.0})
    with pytest.raises(ValueError, match="margins has nothing"):
        AdaptiveThreshold(ENGINE, margins={"nothing": 0.1})
    with pytest.raises(ValueError, match="have no noise bound"):
        sensors = tuple(replace(s, bound=None, sigma=s.noise_sigma) for s in ENGINE.sensors)
        AdaptiveThreshold(replace(ENGINE, sensors=sensors))
    doubled = changed(
        ENGINE,
        sensors=(*ENGINE.sensors, replace(ENGINE.sensors[3], name="spare")),
        output=lambda t, x, u: (y := ENGINE.output(t, x, u))[..., [*range(y.shape[-1]), 3]],
        output_jacobian=None,
        finer=None,
    )
    with pytest.raises(ValueError, match=r"sensors S.2..3., spare all read torque"):
        AdaptiveThreshold(doubled)
    with pytest.raises(ValueError, match="bounds is 'corner'; known: corners, inclusion, sivia"):
        AdaptiveThreshold(ENGINE, bounds="corner")
    with pytest.raises(ValueError, match="drift has torque"):
        AdaptiveThreshold(ENGINE, drift={"torque": 0.1})
    with pytest.raises(ValueError, match="envelope has nothing"):
        AdaptiveThreshold(ENGINE, envelope={"nothing": (0.0, 1.0)})
    with pytest.raises(ValueError, match="nominal value of torque is 0, which gives no range; give envelope"):
        _ = AdaptiveThreshold(changed(ENGINE, modules=replace(modules, nominal={**modules.nominal, "torque": 0.0}))).ends
    with pytest.raises(ValueError, match="envelope of torque is not a finite range"):
        _ = AdaptiveThreshold(ENGINE, envelope={"torque": (5e4, 4e4)}).slopes


def test_a_load_step_raises_no_alarm_and_errors_keep_their_bounds() -> None:
    """Noise at the ends of its range, which uniform noise rarely reaches: of one sign in a run, or of random signs."""
    detector, recording = for_load_steps(), load_step(700, 40)
    rng = np.random.default_rng(3)
    sign = rng.choice([-1.0, 1.0], recording.y.shape)
    sign[:, ::2] = sign[0, ::2]
    extreme = recording.signal + 0.999999 * BOUND * sign
    assert recording.x is not None
    for y in (recording.y, extreme):
        d = judge(detector, y, recording)
        assert not d.alarm.any()
        error = np.abs(d.estimate - recording.x)
        assert np.all(error <= (d.threshold - BOUND)[..., [0, 4, 7]] * (1 + 1e-9))


@pytest.mark.parametrize("value", [0.0, -1e5, 1e10], ids=str)
def test_a_broken_sensor_is_isolated_and_affects_nothing_else(value: float) -> None:
    """Where an equation has no value at the readings, they are moved into the envelope, for that equation."""
    recording = healthy(300, 5)
    plain = AdaptiveThreshold(changed(ENGINE, modules=replace(ENGINE.structure.modules, monitor=None)))  # type: ignore[type-var]
    for i, steps in ((7, 300), (3, 200)):  # observers forget 1e10 in fewer steps
        y = recording.y[:steps].copy()
        y[100:120, :, i] = value
        latched = judge(DETECTOR, y, recording_of(recording, steps))
        assert latched.isolated[100:, :, i].all() and not latched.alarm[:100].any()
        d = judge(replace(DETECTOR, latch=False), y, recording_of(recording, steps))
        assert not d.diverged.any() and np.isfinite(d.estimate).all() and not d.alarm[-30:].any()
        if value > 0:  # the middle of 1 and 1e10, less half their distance, is not 1
            continue
        other = judge(replace(plain, latch=False), y[:125], recording_of(recording, 125))
        np.testing.assert_allclose(other.threshold, d.threshold[:125], rtol=1e-9)


def test_a_latched_module_stays_fired_and_agents_exonerate_their_own_sensors() -> None:
    recording = healthy(300, 5)
    y = recording.y[:200].copy()
    y[100:110, :, 3] -= (
        3.8e4  # of the torque: the air path does not fire and exonerates T_charge, which the module of the torque reads, too
    )
    short = recording_of(recording, 200)
    latched, free = judge(DETECTOR, y, short), judge(replace(DETECTOR, latch=False), y, short)
    np.testing.assert_array_equal(latched.residual, free.residual)
    assert latched.isolated[101:, :, 3].all() and free.isolated[101:110, :, 3].all() and not free.isolated[115:].any()
    alone = judge(replace(DETECTOR, agents=False), y, short)
    assert np.all(latched.isolated <= alone.isolated) and alone.isolated.sum() > latched.isolated.sum()


def test_a_batch_of_two_axes_equals_a_batch_of_one() -> None:
    recording = healthy(60, 3)
    y, u = recording.y[:20], np.broadcast_to(recording.u[:20, None], (20, 3, 1))
    _, flat = run(DETECTOR, DETECTOR.init((3,)), recording.t[:20], y, u)
    _, nested = run(DETECTOR, DETECTOR.init((3, 1)), recording.t[:20], y[:, :, None], u[:, :, None])
    np.testing.assert_array_equal(nested.threshold[:, :, 0], flat.threshold)
    np.testing.assert_array_equal(nested.isolated[:, :, 0], flat.isolated)


def test_the_published_threshold_depends_on_the_time_since_its_start() -> None:
    """However many readings there were: 30 steps of 1 ms end as 3 of 10 ms do, to the last one's noise."""
    paper = replace(DETECTOR, observer_bounds=OBSERVER_BOUNDS)
    y, u = healthy(60, 3).y[0, 0], np.ones(1)
    ends = []
    for times in (np.arange(1, 31) * 1e-3, np.arange(1, 4) * 1e-2):
        _, d = run(paper, paper.init(t=5.0), 5.0 + times, np.tile(y, (len(times), 1)), np.tile(u, (len(times), 1)))
        ends.append(d.threshold[-1, [0, 4, 7]])
    np.testing.assert_allclose(ends[0], ends[1], rtol=1e-9)
