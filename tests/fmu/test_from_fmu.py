"""FMUs of the two tanks as plants: the same numbers and the same decisions as the plant of this package."""

from __future__ import annotations

import copy
import gc
import pickle
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import MakeFmu

from fusion_sfdia import registry
from fusion_sfdia.checks.plants import check_plant
from fusion_sfdia.core.detector import run
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.evaluation.simulate import Recording, simulate
from fusion_sfdia.fmu.from_fmu import from_fmu
from fusion_sfdia.models.two_tanks.plant import two_tanks

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


def native() -> Plant:
    """The plant of this package, of which the FMUs know all but what is at rest."""
    plant = two_tanks()
    return replace(plant, uncertainty=replace(plant.uncertainty, at_rest=False))


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
    return from_fmu(fmu(*CASES[request.param]), **stated())


@pytest.fixture(scope="module")
def exchanged(fmu: MakeFmu) -> Plant:
    return from_fmu(fmu(*CASES["model exchange 2.0"]), **stated())


@pytest.fixture(scope="module")
def faulty() -> Recording:
    """A run of 120 readings; level_1 reads 6 cm too much from the 41st on."""
    recording = simulate(native(), 120, seeds=[3])
    recording.y[40:, 0, 0] += 0.06
    return recording


def test_signals_are_those_of_the_description(exchanged: Plant) -> None:
    own = two_tanks()
    for what in ("states", "inputs"):
        for ours, theirs in zip(getattr(exchanged, what), getattr(own, what), strict=True):
            assert (ours.name, ours.unit, ours.nominal, ours.low, ours.high) == (
                *(theirs.name, theirs.unit, theirs.nominal, theirs.low, theirs.high),
            )
    assert exchanged.sensors == own.sensors and exchanged.dt == own.dt and exchanged.numerics.max_dt == own.numerics.max_dt
    assert np.array_equal(exchanged.initial_cov, own.initial_cov) and np.array_equal(exchanged.process_cov, own.process_cov)


def test_step_and_output_of_batches_are_those_of_the_plant(plant: Plant) -> None:
    """Both sum the same few terms, in double precision."""
    for ours, theirs in ((plant, native()),):
        assert np.allclose(ours.step(0.0, X, U, 5.0), theirs.step(0.0, X, U, 5.0), rtol=1e-14, atol=0)
        assert np.allclose(ours.output(5.0, X, U), theirs.output(5.0, X, U), rtol=1e-14, atol=0)
    check_plant(plant)


def test_jacobians_are_those_of_the_plant(plant: Plant, request: pytest.FixtureRequest) -> None:
    """Directional derivatives to rounding. Central differences err by eps^(2/3) times third derivatives; those of
    co-simulation, as wide as a tolerance of 1e-6 asks for, by 1e-4 sigma^2 of them: 1e-8.
    """
    exact = "model exchange" in request.node.callspec.params["plant"]
    own, theta = native(), 1.05 * native().uncertainty.nominal
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


@pytest.mark.parametrize("name", ["loo-glr", "robust-glr"])
@pytest.mark.parametrize("case", CASES)
def test_decisions_are_those_of_the_plant(fmu: MakeFmu, faulty: Recording, case: str, name: str) -> None:
    decisions = []
    for plant in (native(), from_fmu(fmu(*CASES[case]), **stated())):
        detector = registry.detector(name, plant)
        decisions.append(run(detector, detector.init((1,)), faulty.t, faulty.y, faulty.u_of_runs)[1])
    theirs, ours = decisions
    assert theirs.isolated[:, 0, 0].sum() > 60 and not theirs.isolated[:40].any()
    assert np.array_equal(ours.isolated, theirs.isolated)
    for what in ("process", "suspect"):
        assert np.array_equal(getattr(ours, what), getattr(theirs, what))


def test_a_copy_and_another_process_open_their_own(exchanged: Plant) -> None:
    expected = exchanged.step(0.0, X, U, 5.0)
    for made in (copy.deepcopy(exchanged), pickle.loads(pickle.dumps(exchanged))):
        assert np.array_equal(made.step(0.0, X, U, 5.0), expected)
    for method in ("fork", "spawn"):  # a forked process has a copy of the memory of an open FMU
        with ProcessPoolExecutor(1, get_context(method)) as pool:
            assert np.array_equal(pool.submit(exchanged.step, 0.0, X, U, 5.0).result(), expected)
    assert np.array_equal(exchanged.step(0.0, X, U, 5.0), expected)  # not closed by the processes that ended


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
    assert np.array_equal(exchanged.step(0.0, X, U, 5.0), native().step(0.0, X, U, 5.0))


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
    plant, own = from_fmu(fmu(*CASES["co-simulation 2.0"]), **stated()), native()
    by_fmu = simulate(own, 20, seeds=[1, 2], truth=replace(plant, uncertainty=own.uncertainty))
    assert np.allclose(by_fmu.y, simulate(own, 20, seeds=[1, 2], truth="model").y, rtol=1e-12)
    detector = registry.detector("particle-filter", plant)
    _, decision = detector.step(detector.init((2,)), 0.0, by_fmu.y[0], by_fmu.u[0])
    assert np.isfinite(decision.estimate).all()
