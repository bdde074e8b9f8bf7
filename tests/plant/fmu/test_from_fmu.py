"""FMUs of the two tanks as plants: the same numbers and the same decisions as the plant of this package."""

from __future__ import annotations

import copy
import gc
import pickle
import tempfile
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import MakeFmu

from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.detector import Decision, run
from fusion_sfdia.detectors.kalman_banks.central_filter import CentralFilter
from fusion_sfdia.detectors.kalman_banks.particle_filter import ParticleFilter
from fusion_sfdia.diagnosis.simulate import Recording, simulate
from fusion_sfdia.filters.estimators import Ensemble
from fusion_sfdia.learning.checks.plants import check_plant
from fusion_sfdia.models.two_tanks.plant import two_tanks
from fusion_sfdia.plant.fmu.from_fmu import from_fmu
from fusion_sfdia.plant.plant import Plant

DIRECTIONAL = {2: 'providesDirectionalDerivative="true"', 3: 'providesDirectionalDerivatives="true"'}
STEPPED = 'canHandleVariableCommunicationStepSize="true" canGetAndSetFMUstate="true"'
STEPPED_3 = STEPPED.replace("FMUstate", "FMUState")
CASES = {
    "model exchange 2.0": (2, "ModelExchange", DIRECTIONAL[2]),
    "model exchange 3.0": (3, "ModelExchange", DIRECTIONAL[3]),
    "without derivatives": (2, "ModelExchange", ""),
    "co-simulation 2.0": (2, "CoSimulation", STEPPED),
    "co-simulation 3.0": (3, "CoSimulation", STEPPED_3),
}
X = np.array([[[1.0, 1.0]], [[1.2, 0.8]], [[0.5, 0.6]]])  # (3, 1, 2)
U = np.array([[6e-4], [5e-4]])  # (2, 1)


def stated() -> dict[str, Any]:
    """What two_tanks states beside its equations."""
    plant = two_tanks()
    own = plant.uncertainty
    return {
        "sensors": {
            s.name: {k: getattr(s, k) for k in ("measures", "sigma", "bound", "owner", "quantity")} for s in plant.sensors
        },
        "initial_sigma": 0.01,
        "process_sigma": 0.001,
        "unknown": {p.name: {k: getattr(p, k) for k in ("sd", "rate", "treatment")} for p in own.parameters},
        "input_errors": dict(own.inputs),
    }


@pytest.fixture(scope="module", params=CASES)
def plant(request: pytest.FixtureRequest, fmu: MakeFmu) -> Plant:
    made = from_fmu(fmu(*CASES[request.param]), **stated())
    return replace(made, uncertainty=replace(made.uncertainty, at_rest=True))  # as two_tanks


@pytest.fixture(scope="module")
def exchanged(fmu: MakeFmu) -> Plant:
    return from_fmu(fmu(*CASES["model exchange 2.0"]), **stated())


@pytest.fixture(scope="module")
def faulty() -> Recording:
    """A run of 120 readings; level_1 reads 6 cm too much from the 41st on."""
    recording = simulate(two_tanks(), 120, seeds=[3])
    recording.y[40:, 0, 0] += 0.06
    return recording


def test_signals_are_those_of_the_description(exchanged: Plant) -> None:
    own = two_tanks()
    for what in ("states", "inputs"):
        for ours, theirs in zip(getattr(exchanged, what), getattr(own, what), strict=True):
            assert (ours.name, ours.unit, ours.nominal, ours.low, ours.high) == (
                *(theirs.name, theirs.unit, theirs.nominal, theirs.low, theirs.high),
            )
    assert exchanged.sensors == tuple(replace(s, meaning="") for s in own.sensors)
    assert exchanged.dt == own.dt and exchanged.numerics.max_dt == own.numerics.max_dt
    assert np.array_equal(exchanged.initial_cov, own.initial_cov) and np.array_equal(exchanged.process_cov, own.process_cov)


def test_step_and_output_of_batches_are_those_of_the_plant(plant: Plant) -> None:
    """Both sum the same few terms, in double precision."""
    own = two_tanks()
    assert np.allclose(plant.step(0.0, X, U, 5.0), own.step(0.0, X, U, 5.0), rtol=1e-14, atol=0)
    assert np.allclose(plant.output(5.0, X, U), own.output(5.0, X, U), rtol=1e-14, atol=0)
    check_plant(plant)


def test_jacobians_are_those_of_the_plant(plant: Plant, request: pytest.FixtureRequest) -> None:
    """Directional derivatives to rounding. Central differences err by eps^(2/3) times third derivatives; those of
    co-simulation, as wide as a tolerance of 1e-6 asks for, by 1e-4 sigma^2 of them: 1e-8.
    """
    exact = "model exchange" in request.node.callspec.params["plant"]
    own, theta = two_tanks(), 1.05 * two_tanks().uncertainty.nominal
    tolerance = 1e-14 if exact else 1e-8
    for ours, theirs in (
        (plant.step_jacobian_at(0.0, X, U, 5.0), own.step_jacobian_at(0.0, X, U, 5.0)),
        (plant.output_jacobian_at(0.0, X, U), own.output_jacobian_at(0.0, X, U)),
    ):
        assert np.max(np.abs(ours - theirs)) <= tolerance
    assert (plant.uncertainty.step_jacobian is None) == (request.node.callspec.params["plant"] == "without derivatives")
    if (by_all := plant.uncertainty.step_jacobian) is None:
        return
    of_readings, theirs_of = plant.uncertainty.output_jacobian, own.uncertainty
    assert of_readings and theirs_of.step_jacobian and theirs_of.output_jacobian
    for ours, theirs in (
        (by_all(0.0, X, U, 5.0, theta), theirs_of.step_jacobian(0.0, X, U, 5.0, theta)),
        (of_readings(0.0, X, U, theta), theirs_of.output_jacobian(0.0, X, U, theta)),
    ):
        assert ours.shape == theirs.shape
        assert np.max(np.abs(ours - theirs) / np.maximum(1.0, np.abs(theirs))) <= 1e-8  # parameters by differences


def decided(name: str, plant: Plant, recording: Recording) -> Decision:
    detector = registry.detector(name, plant)
    return run(detector, detector.init((1,)), recording.t, recording.y, recording.u_of_runs)[1]


@pytest.fixture(scope="module", params=["loo-glr", "robust-glr"])
def by_the_plant(request: pytest.FixtureRequest, faulty: Recording) -> tuple[str, Decision]:
    return request.param, decided(request.param, two_tanks(), faulty)


@pytest.mark.slow
def test_decisions_are_those_of_the_plant(plant: Plant, by_the_plant: tuple[str, Decision], faulty: Recording) -> None:
    name, theirs = by_the_plant
    ours = decided(name, plant, faulty)
    assert theirs.isolated[:, 0, 0].sum() > 60 and not theirs.isolated[:40].any()
    for what in ("isolated", "process", "suspect"):
        assert np.array_equal(getattr(ours, what), getattr(theirs, what))


def test_a_copy_and_another_process_open_their_own(exchanged: Plant, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    expected = exchanged.step(0.0, X, U, 5.0)
    for copied in (copy.deepcopy(exchanged), pickle.loads(pickle.dumps(exchanged))):
        assert np.array_equal(copied.step(0.0, X, U, 5.0), expected)
    del copied
    for method in ("fork", "spawn"):  # a forked process has a copy of the memory of an open FMU
        with ProcessPoolExecutor(1, get_context(method)) as pool:
            assert np.array_equal(pool.submit(exchanged.step, 0.0, X, U, 5.0).result(), expected)
    assert np.array_equal(exchanged.step(0.0, X, U, 5.0), expected)  # not closed by the processes that ended
    gc.collect()
    assert not [p for p in tmp_path.iterdir() if p.name.startswith("fusion-sfdia-fmu")]


def test_folders_go_with_the_plant(fmu: MakeFmu, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    plants = [from_fmu(fmu(*CASES[case]), **stated()) for case in ("model exchange 3.0", "co-simulation 2.0")]
    plants += [pickle.loads(pickle.dumps(plants[0]))]
    for plant in plants:
        plant.step(0.0, X, U, 5.0)
    assert len(list(tmp_path.iterdir())) == 3
    del plants, plant
    gc.collect()
    assert not list(tmp_path.iterdir())


def test_a_changed_file_is_refused_in_another_process(fmu: MakeFmu, tmp_path: Path) -> None:
    path = tmp_path / "tanks.fmu"
    path.write_bytes(fmu(*CASES["model exchange 2.0"]).read_bytes())
    sent = pickle.dumps(from_fmu(path, **stated()))
    path.write_bytes(fmu(*CASES["without derivatives"]).read_bytes())
    with pytest.raises(ValueError, match="not there any more, or another file; expected that of which the plant was made"):
        pickle.loads(sent).step(0.0, X, U, 5.0)


def test_rows_without_a_result_are_nan(exchanged: Plant) -> None:
    """The FMU discards levels below 0, and fails below -1; it goes on after both."""
    x = np.array([[1.0, 1.0], [-0.5, 1.0], [np.nan, 1.0]])
    assert np.array_equal(np.isnan(exchanged.step(0.0, x, U[0], 5.0)).all(axis=1), [False, True, True])
    with pytest.raises(ArithmeticError, match=r"TwoTanks.* fails: fmi2GetDerivatives failed with status 3 \(error\)"):
        exchanged.step(0.0, np.array([-2.0, 1.0]), U[0], 5.0)
    assert np.array_equal(exchanged.step(0.0, X, U, 5.0), two_tanks().step(0.0, X, U, 5.0))


def test_times_before_the_start_of_the_fmu_are_its_start(plant: Plant) -> None:
    """A detector begins one step before the first reading; these FMUs fail at times below 0."""
    assert np.array_equal(plant.step(-5.0, X, U, 5.0), plant.step(0.0, X, U, 5.0))


def test_substeps_follow_each_other(exchanged: Plant, fmu: MakeFmu) -> None:
    """Three substeps and three steps of a third are the same operations, but for the rounding of dt / 3."""
    fine = from_fmu(fmu(*CASES["model exchange 2.0"]), **stated(), substeps=3)
    x, f = X, np.eye(2)
    for _ in range(3):
        f = exchanged.step_jacobian_at(0.0, x, U, 5.0 / 3) @ f
        x = exchanged.step(0.0, x, U, 5.0 / 3)
    assert np.allclose(fine.step(0.0, X, U, 5.0), x, rtol=1e-14)
    assert np.allclose(fine.step_jacobian_at(0.0, X, U, 5.0), f, rtol=0, atol=1e-14)


def test_derivatives_of_sensors_that_are_no_outputs_are_differences(fmu: MakeFmu) -> None:
    """FMI has directional derivatives of outputs alone; d(der level_1) / d level_1 = -outlet_1 / (2 area sqrt(level_1))."""
    noise = {"initial_sigma": 0.01, "process_sigma": 0.001}
    plant = from_fmu(fmu(*CASES["model exchange 2.0"]), sensors={"der(level_1)": 1e-5, "level_2": 0.01}, **noise)
    assert plant.numerics.step_jacobian is None and plant.numerics.output_jacobian is None
    expected = [[-6e-4 / 0.1, 0.0], [0.0, 1.0]]
    assert np.allclose(plant.output_jacobian_at(0.0, X[0, 0], U[0]), expected, rtol=0, atol=1e-8)


def test_threads_take_turns(exchanged: Plant) -> None:
    x = np.linspace(0.5, 1.5, 200)[:, None] + np.zeros(2)
    expected = exchanged.step(0.0, x, U[0], 5.0)
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda k: exchanged.step(0.0, np.roll(x, k, axis=0), U[0], 5.0), range(8)))
    for k, of_thread in enumerate(found):
        assert np.array_equal(of_thread, np.roll(expected, k, axis=0))


def test_complex_numbers_are_refused(exchanged: Plant) -> None:
    with pytest.raises(TypeError, match="real numbers"):
        exchanged.step(0.0, X + 0j, U, 5.0)


def test_shares_are_of_the_nominal_value(fmu: MakeFmu) -> None:
    """Of the flows, which state none, of their value at the start."""
    plant = from_fmu(
        fmu(*CASES["model exchange 3.0"]),
        sensors=0.01,
        initial_sigma=0.02,
        process_sigma={"level_1": 1e-3, "level_2": 2e-3},
        dt=2.0,
        start_values={"level_1": 1.44, "outlet_1": 5e-4},
    )
    assert plant.sensor_names == ("level_1", "level_2", "flow_12", "flow_out") and plant.dt == 2.0
    assert np.allclose(plant.sensor_sigma, [0.01, 0.01, 0.01 * 5e-4 * 1.2, 0.01 * 6e-4], rtol=1e-14)
    assert np.array_equal(plant.x0, [1.44, 1.0]) and plant.sensors[2].quantity == "VolumeFlowRate"
    assert np.allclose(plant.initial_cov, 0.02**2) and np.allclose(plant.process_cov, [1e-6, 4e-6])


def test_co_simulation_is_a_truth_and_carries_ensembles(fmu: MakeFmu) -> None:
    plant, own = from_fmu(fmu(*CASES["co-simulation 2.0"]), **stated()), two_tanks()
    by_fmu = simulate(own, 20, seeds=[1, 2], truth=replace(plant, uncertainty=own.uncertainty))
    assert np.allclose(by_fmu.y, simulate(own, 20, seeds=[1, 2], truth="model").y, rtol=1e-12)
    for detector in (ParticleFilter(plant, size=20), CentralFilter(plant, estimator=Ensemble())):
        _, decision = detector.step(detector.init((2,)), 5.0, by_fmu.y[0], by_fmu.u[0])
        assert np.isfinite(decision.estimate).all()
