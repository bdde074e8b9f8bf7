"""Structural residuals: structure against the toolbox, residuals on the truth, diagnoses, limits, bad input."""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from scipy.stats import betabinom
from structural_plants import PLANTS, plant_of
from toy_plants import chain

from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.detector import run
from fusion_sfdia.detectors.named import FALSE_ALARM
from fusion_sfdia.detectors.state import leaves
from fusion_sfdia.detectors.structural_residuals.structural_residuals import (
    StructuralResiduals,
    isolable,
    reads,
    selected,
    usable,
)
from fusion_sfdia.detectors.structural_residuals.structure import Residual, computable, residual_of, structural_model
from fusion_sfdia.diagnosis.simulate import simulate
from fusion_sfdia.learning.builders import healthy_data
from fusion_sfdia.models.two_tanks.plant import GAIN, INFLOW, LEVEL, NOISE, Tanks, two_tanks
from fusion_sfdia.plant.discretise import discretise
from fusion_sfdia.plant.modules import Modules
from fusion_sfdia.plant.physics import Physics
from fusion_sfdia.plant.plant import Plant, Structure
from fusion_sfdia.plant.signals import Sensor, Signal

toolbox = pytest.importorskip("faultdiagnosistoolbox", reason="structural residuals need faultdiagnosistoolbox")


@cache
def detector_of(name: str) -> StructuralResiduals:
    detector = registry.detector("structural-residuals", plant_of(name))
    assert isinstance(detector, StructuralResiduals)
    return detector


def test_a_residual_of_two_tanks_by_hand() -> None:
    """Level 1 by its balance with the flow read, corrected by its own readings."""
    plant, c = two_tanks(swing=0.5), Tanks()
    residual = Residual("level_1", ("level_1",), (), ("level_1", "flow_12"), feedback=True)
    assert residual in usable(plant)
    recording = simulate(plant, 50, [3])
    found = StructuralResiduals(plant, (residual,), np.ones(1)).trace(recording.y, recording.u_of_runs)[:, 0, 0]
    level, read, flow = LEVEL, None, INFLOW
    lam = np.exp(-GAIN * plant.dt)
    for k in range(50):
        y, u, now = recording.y[k, 0, 0], recording.u[k, 0], recording.y[k, 0, 2]
        rise = (u - (flow + now) / 2) / c.area
        level = level + plant.dt * rise if read is None else lam * level + (1 - lam) / GAIN * (rise + GAIN * read)
        # a hundred roundings of numbers of 100 sigma
        assert found[k] == pytest.approx((y - level) / (NOISE * LEVEL), abs=1e4 * np.finfo(float).eps)
        read, flow = y, now


@pytest.mark.parametrize("name", PLANTS)
def test_at_rest_a_residual_is_zero_and_depends_only_on_the_readings_it_uses(name: str) -> None:
    plant = plant_of(name)
    residuals = usable(plant)
    detector = StructuralResiduals(plant, residuals, np.ones(len(residuals)))
    truth = (
        np.array([plant.structure.modules.nominal[s.measures] for s in plant.sensors])
        if plant.structure.modules
        else np.empty(0)
    )
    u = np.tile(plant.input_at(0.0), (12, 1))
    y = np.tile(truth, (12, 1))
    # the engine's equilibrium is solved to 1e-12 or so, of which 1/0.03 is a sigma; equations magnify by less than 1e3
    assert np.max(np.abs(detector.trace(y, u))) < 1e-6
    noisy = y * (1 + 0.01 * np.random.default_rng(1).standard_normal(y.shape))
    before = detector.trace(noisy, u)
    for i in range(len(plant.sensors)):
        other = noisy.copy()
        other[:, i] += 5 * plant.sensor_sigma[i]
        changed = np.any(detector.trace(other, u) != before, axis=0)
        np.testing.assert_array_equal(changed, reads(plant, residuals)[:, i])


def test_on_a_moving_truth_residuals_vanish_with_the_step() -> None:
    """To first order: the equations are held over a step."""
    largest = []
    for dt in (5.0, 2.5, 1.25):
        plant = replace(two_tanks(swing=0.5), dt=dt)
        recording = simulate(plant, int(1200 / dt), [1], truth="model")
        residuals = usable(plant)
        trace = StructuralResiduals(plant, residuals, np.ones(len(residuals))).trace(recording.signal, recording.u_of_runs)
        largest.append(np.max(np.abs(trace), axis=(0, 1)))
    moves = largest[0] > 1e-9
    algebraic = [i for i, r in enumerate(residuals) if not r.integrated]  # a flow less the root of the level of the same time
    np.testing.assert_array_equal(np.flatnonzero(~moves), algebraic)
    coarse, fine = (np.abs(np.log2(a[moves] / b[moves]) - 1) for a, b in pairwise(largest))
    # the order is 1 but for terms of the next, which halve with the step; what their own next terms may add is small
    assert np.all(fine <= 0.55 * coarse + 1e-4)


def test_an_integrator_of_noise_is_corrected_or_not_used() -> None:
    plant = plant_of("two-tanks")
    fed_back = {frozenset(r.read) for r in usable(plant) if r.feedback}  # whose outflow is read
    lower = frozenset({"level_2", "flow_out"})
    assert fed_back == {frozenset({"level_1", "flow_12"}), lower, lower | {"flow_12"}, lower | {"level_1"}}
    drifting = gauge()
    assert [r.target for r in computable(drifting)] == ["flow", "gauge", "gauge"]
    assert [r.target for r in usable(drifting)] == ["flow"]


def gauge() -> Plant:
    """A tank filled and emptied by pumps, of whose level there is a gauge alone: nothing makes its integral forget."""
    equations = {
        "level": lambda inflow, flow, c: inflow - flow,
        "flow": lambda inflow, c: 1.0 * inflow,
        "gauge": lambda level, c: 2.0 * level,
    }
    physics = Physics(
        name="gauge",
        states=(Signal("level", "m", 1.0, 0.0, 2.0),),
        inputs=(Signal("inflow", "m/s", 1.0, 0.0, 2.0),),
        algebraic=(Signal("flow", "m/s", 1.0), Signal("gauge", "m", 2.0)),
        f=lambda t, x, z, u, c: u - z[..., :1],
        phi=lambda t, x, z, u, c: np.stack([np.broadcast_to(u[..., 0], x[..., 0].shape), 2 * x[..., 0]], axis=-1),
        parameters=None,
    )
    sensors = [Sensor(v, v, "m", sigma=0.01) for v in ("flow", "gauge")]
    plant = discretise(physics, sensors, dt=1.0, x0=np.ones(1), initial_cov=np.ones(1), process_cov=np.ones(1))
    nominal = {"level": 1.0, "flow": 1.0, "gauge": 2.0}
    modules = Modules(equations, np.zeros(1), nominal, None, ("inflow",), {v: v for v in equations}, {"level": 1.0})
    return replace(plant, structure=Structure(modules=modules))


def test_false_alarms_are_as_rare_as_asked_for() -> None:
    detector = detector_of("two-tanks")
    recording = simulate(detector.plant, 200, range(100, 150), truth="model")
    _, d = run(detector, detector.init((50,)), recording.t, recording.y, recording.u_of_runs)
    # the limits' rate is Beta(rate M, M) distributed for M exchangeable samples; of neighbours in time half count
    samples = healthy_data(detector.plant).y[1::2, :, 0].size / 2
    law = betabinom(d.alarm.size, FALSE_ALARM * samples, (1 - FALSE_ALARM) * samples)
    assert law.ppf(0.001) <= d.alarm.sum() <= law.ppf(0.999)


@pytest.mark.parametrize("name", PLANTS)
def test_a_bias_is_isolated_where_the_structure_allows(name: str) -> None:
    detector, plant = detector_of(name), plant_of(name)
    n = len(plant.sensors)
    recording = simulate(plant, 40, [7], truth="model")
    y = np.repeat(recording.y, n, axis=1)
    y[20:, np.arange(n), np.arange(n)] += 30 * plant.sensor_sigma
    u = np.repeat(recording.u_of_runs, n, axis=1)
    _, d = run(detector, detector.init((n,)), recording.t, y, u)
    assert d.alarm[20:].all()
    told_apart = isolable(reads(plant, detector.residuals)).all(axis=1)
    named = d.isolated[20]
    assert not named[~np.eye(n, dtype=bool)].any() and not np.diagonal(named)[~told_apart].any()
    if name == "two-tanks":
        assert np.diagonal(named).all()
        size = np.diagonal(d.fault_size[20]) / plant.sensor_sigma
        np.testing.assert_allclose(size, 30, atol=4)  # the bound of the noise of a reading; the computed value has none
        error = (d.reconstruction[-1] - recording.signal[-1, 0]) / plant.sensor_sigma
        assert np.all(np.abs(error) <= 4) and np.all(np.abs(np.diagonal(error)) < 1e-9)


def test_readings_at_which_the_equations_have_no_value_contradict_them() -> None:
    detector, plant = detector_of("marine-engine"), plant_of("marine-engine")
    torque = plant.sensor_index("S(2){3}")
    recording = simulate(plant, 20, [7])
    y = recording.y[:, 0].copy()
    y[10:, torque] *= -2
    state, d = run(detector, detector.init(), recording.t, y, recording.u)
    assert d.isolated[10:, torque].all() and d.isolated.sum() == 10 and np.all(np.isfinite(d.residual))
    assert all(np.all(np.isfinite(a)) for a in leaves(state))


def test_the_diagnosis_is_the_only_smallest_hitting_set() -> None:
    detector = detector_of("marine-engine")
    signatures = reads(detector.plant, detector.residuals)
    fired = np.random.default_rng(2).random((60, len(detector.residuals))) < 0.2
    for pattern, found in zip(fired, detector._diagnosed(fired), strict=True):
        sets = toolbox.MHS([np.flatnonzero(row) for row in signatures[pattern]])
        least = min(len(s) for s in sets)
        smallest = [s for s in sets if len(s) == least]
        expected = set(map(int, smallest[0])) if len(smallest) == 1 and least <= detector.max_faults else set()
        assert set(map(int, np.flatnonzero(found))) == expected


def test_a_missing_reading_leaves_out_the_residuals_that_use_it() -> None:
    plant = plant_of("marine-engine")
    detector = detector_of("marine-engine")
    recording = simulate(plant, 10, [5])
    y = recording.y[:, 0].copy()
    y[4:, 3] = np.nan  # torque
    trace = detector.trace(y, recording.u)
    np.testing.assert_array_equal(np.isnan(trace[-1]), reads(plant, detector.residuals)[:, 3])
    assert np.all(np.isfinite(trace[:4]))
    _, d = run(detector, detector.init(), recording.t, y, recording.u)
    np.testing.assert_array_equal(d.reconstruction[4:, 3], np.full(6, y[3, 3]))  # only its own reading computes it


def test_a_plant_without_equations_and_a_missing_package_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ValueError, match="does not state its scalar equations"):
        registry.detector("structural-residuals", chain(3))
    monkeypatch.setitem(sys.modules, "faultdiagnosistoolbox", None)
    with pytest.raises(ModuleNotFoundError, match=r"fusion-sfdia\[structural\]"):
        registry.detector("structural-residuals", plant_of("two-tanks"))


def test_bad_settings_and_data_are_refused() -> None:
    plant, detector = plant_of("two-tanks"), detector_of("two-tanks")
    y, u = np.ones((10, 3, 4)), np.full((10, 3, 1), INFLOW)
    for residuals, limits, message in (
        ((), np.ones(0), "expected some"),
        (detector.residuals, np.ones(3), "expected 4 positive numbers"),
        (detector.residuals, np.zeros(4), "positive"),
        ((Residual("torque", (), (), ("torque",)),), np.ones(1), "does not measure"),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=message):
            StructuralResiduals(plant, residuals, limits)
    with pytest.raises(ValueError, match="max_faults"):
        replace(detector, max_faults=0)
    for bad_y, bad_u, rate, message in (
        (y, u, 0.0, "false_alarm"), (y[..., :3], u, 0.1, "y has shape"), (y, u[:5], 0.1, "expected .K,"),
        (y, u, 1e-3, "15 complete healthy samples"), (np.full_like(y, np.nan), u, 0.5, "0 complete"),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=message):
            StructuralResiduals.fit(plant, (5.0 * np.arange(1, 11), bad_y, bad_u), rate)
    with pytest.raises(ValueError, match="the healthy readings are not 5 s apart"):
        StructuralResiduals.fit(plant, (6.0 * np.arange(1, 11), y, u), 0.1)
    two = replace(plant, sensors=(plant.sensors[0], replace(plant.sensors[1], measures="level_1"), *plant.sensors[2:]))
    with pytest.raises(ValueError, match="several sensors read level_1"):
        selected(two)


@pytest.mark.parametrize("name", PLANTS)
def test_the_selection_isolates_what_all_usable_residuals_do_by_the_toolbox(name: str) -> None:
    plant = plant_of(name)
    model, sets = structural_model(plant), {}
    for mso in structural_model(plant).MSO():
        if (found := residual_of(plant, mso)) is not None:
            sets[found] = mso
    kept = [replace(r, feedback=False) for r in usable(plant)]
    theirs = model.IsolabilityAnalysisArrs([sets[r] for r in kept])  # 1: not isolable from each other
    chosen = model.IsolabilityAnalysisArrs([sets[replace(r, feedback=False)] for r in selected(plant)])
    np.testing.assert_array_equal(chosen, theirs)
    ours = isolable(reads(plant, selected(plant)))
    assert np.all(np.diagonal(ours))  # each fault is detectable
    np.testing.assert_array_equal(ours, (theirs == 0) | np.eye(len(ours), dtype=bool))
    torque = [s.measures for s in plant.sensors].index("torque") if name == "marine-engine" else 0
    hidden = {"p_cylinder", "T_cylinder", "T_compressor"} if name == "marine-engine" else set()
    assert {plant.sensors[i].measures for i in np.flatnonzero(~ours[:, torque])} == hidden and np.sum(~ours) == len(hidden)
