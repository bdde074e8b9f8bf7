"""Running power networks: loads, faults, switches, controllers, closed-loop runs."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from fusion_sfdia.models.power_network.control import BY_ANGLE, BY_SPEED, PredictiveControl, generation_control
from fusion_sfdia.models.power_network.model import NOISE_VARIANCE, NetworkModel, network_model
from fusion_sfdia.models.power_network.operation import AreaFault, Switch, conditions, load_profile
from fusion_sfdia.models.power_network.parameters import LoadStep, generate_network, load_steps
from fusion_sfdia.models.power_network.simulation import Moment, run_network

MODEL = network_model()
RNG = np.random.default_rng(5)
X = 0.1 * RNG.standard_normal((15, 4))
LOAD, REFERENCE = 0.2 * RNG.standard_normal((2, 15))
LOADS = load_profile(MODEL, load_steps("1"))


def test_loads_are_the_sums_of_their_steps() -> None:
    assert not LOADS(4.9).any()
    assert LOADS(5.0)[0] == 0.15
    assert LOADS(39.0)[2] == 0.12 and abs(LOADS(40.0)[2]) < 1e-15
    assert LOADS(40.0)[3] == 0.28
    with pytest.raises(ValueError, match="unknown node '16'"):
        load_profile(MODEL, [LoadStep(1.0, "16", 0.1)])


def test_what_each_fault_does() -> None:
    def step(*faults: AreaFault) -> np.ndarray:
        return conditions(MODEL, faults)(10.0).step(X, REFERENCE, LOAD)

    slow = step(AreaFault("governor", "4", 1000.0))
    assert np.array_equal(slow, MODEL.altered("4", governor_time=1000.0).step(X, REFERENCE, LOAD))
    opposite, less = REFERENCE.copy(), LOAD.copy()
    opposite[4] *= -1
    less[6] -= 0.1
    assert np.array_equal(step(AreaFault("input-gain", "5", -1.0)), MODEL.step(X, opposite, LOAD))
    assert np.array_equal(step(AreaFault("load-loss", "7", 0.1)), MODEL.step(X, REFERENCE, less))
    every = step(AreaFault("governor", "4", 1000.0), AreaFault("input-gain", "5", -1.0), AreaFault("load-loss", "7", 0.1))
    rows = {int(i) for i in np.flatnonzero(np.any(every != MODEL.step(X, REFERENCE, LOAD), axis=1))}
    assert rows == {3, 4, 6}  # in one step, neighbours held


def test_events_act_from_their_time_until_their_end() -> None:
    at = conditions(MODEL, [AreaFault("input-gain", "5", 2.0, onset=10.0, end=12.0)], [Switch(11.0, unplug=("4",))])
    assert [float(at(t).gain[4]) for t in (9.0, 10.0, 11.0, 12.0)] == [1, 2, 2, 1]
    assert [bool(at(t).known.network.plugged[3]) for t in (10.0, 11.0, 20.0)] == [True, False, False]
    assert at(11.0) is at(11.5)


def test_a_fault_is_in_the_truth_and_not_in_what_is_known() -> None:
    now = conditions(MODEL, [AreaFault("governor", "4", 1000.0, onset=5.0)], [Switch(8.0, unplug=("4",))])(9.0)
    assert now.true.area_model("4").A[3, 3] == -1e-3 and now.known.area_model("4").A[3, 3] == -10
    assert np.array_equal(now.true.side_slope, now.known.side_slope)


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ({"kind": "turbine"}, "unknown fault 'turbine' of area 4; known: governor, input-gain, load-loss"),
        ({"value": 0.0}, "positive for a time constant"),
        ({"value": float("inf")}, "finite"),
        ({"kind": "input-gain", "value": 1.0}, "a value of 1 is no fault"),
        ({"kind": "load-loss", "value": 0.0}, "a value of 0 is no fault"),
        ({"onset": 3.0, "end": 3.0}, "onset before the end"),
    ],
)
def test_faults_that_are_none(fault: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        AreaFault(**({"kind": "governor", "area": "4", "value": 1.0} | fault))  # type: ignore[arg-type]


def test_events_that_do_not_fit() -> None:
    twice = [AreaFault("load-loss", "4", 0.1, end=9.0), AreaFault("load-loss", "4", 0.2, onset=8.0)]
    for faults, switches, message in (
        ([AreaFault("governor", "16", 1.0)], [], "unknown node '16'"),
        (twice, [], "overlap in time"),
        ([], [Switch(5.0, unplug=("4",)), Switch(9.0, unplug=("4",))], "'4' is unplugged already"),
        ([], [Switch(5.0)], "name at least one"),
    ):
        with pytest.raises(ValueError, match=message):
            conditions(MODEL, faults, switches)


def spectral_radius(model: NetworkModel) -> float:
    f, by_reference, _ = model.matrices
    n = len(model.names)
    gain = np.zeros((n, 4 * n))
    gain[np.arange(n), 4 * np.arange(n)], gain[np.arange(n), 4 * np.arange(n) + 1] = -BY_ANGLE, -BY_SPEED
    return float(np.abs(np.linalg.eigvals(f + by_reference @ gain)).max())


def test_generation_control_is_stable() -> None:
    # without it the common angle is an integrator
    assert np.abs(np.linalg.eigvals(MODEL.matrices[0])).max() == pytest.approx(1.0, abs=1e-9)
    assert spectral_radius(MODEL) == pytest.approx(0.9624, abs=5e-5)
    assert spectral_radius(network_model(discretisation="exact")) == pytest.approx(0.9557, abs=5e-5)
    assert spectral_radius(network_model(unplugged=["4"])) < 1
    for seed in range(10):
        assert spectral_radius(network_model(generate_network(15, seed))) < 1
    assert spectral_radius(network_model(generate_network(60, 0))) < 1


def closed_loop(control: object, steps: int = 90, model: NetworkModel = MODEL, **settings: object) -> list[Moment]:
    settings = {"loads": LOADS, "seeds": [0], "process_noise": False} | settings
    return list(run_network(model, steps, control=control, **settings))  # type: ignore[arg-type]


def test_references_stay_within_their_limits() -> None:
    limit = MODEL.parameters.reference_limit
    heavy = load_profile(MODEL, [LoadStep(1.0, "4", 2.0), LoadStep(1.0, "9", -2.0)])
    moments = closed_loop(generation_control, 20, loads=heavy)
    references = np.abs([m.reference for m in moments])
    assert np.all(references <= limit) and references[-1, 0, 3] == limit[3]


def test_predictive_control_keeps_the_limits_and_balances_the_loads() -> None:
    pytest.importorskip("osqp", reason="the predictive controller needs osqp")
    control = PredictiveControl()
    x = np.zeros((1, 15, 4))
    model, largest = MODEL, 0.0
    for k in range(150):  # readings without noise, so the angles' limits can be kept
        reference = control(model, x, LOADS(float(k)))
        assert np.all(np.abs(reference) <= model.parameters.reference_limit)
        x = model.step(x, reference, LOADS(float(k)))
        largest = max(largest, float(np.abs(x[..., 0]).max()))
    assert largest < 0.1
    assert x[0, :, 2] == pytest.approx(LOADS(150.0), abs=1e-3)
    # an angle beyond its limit comes back to it, at a cost above that of the reference
    x = np.zeros((1, 15, 4))
    x[0, 3, 0] = 0.2
    assert control(model, x, np.zeros(15))[0, 3] < 0


def test_predictive_control_is_set_up_anew_where_the_model_changed() -> None:
    pytest.importorskip("osqp", reason="the predictive controller needs osqp")
    control = PredictiveControl()
    control(MODEL, X, LOAD)
    before = dict(control._problems)
    control(MODEL.switched(unplug=["4"]), X, LOAD)
    assert {name for name in before if control._problems[name] is not before[name]} == {"3", "4", "5", "13"}
    with pytest.raises(ValueError, match="horizon is 0"):
        PredictiveControl(horizon=0)


def test_predictive_control_says_what_it_could_not_solve() -> None:
    pytest.importorskip("osqp", reason="the predictive controller needs osqp")
    with pytest.raises((ArithmeticError, ValueError)):
        PredictiveControl()(MODEL, np.full((15, 4), np.nan), LOAD)


def test_a_run_depends_on_its_own_seed_alone() -> None:
    alone = closed_loop(generation_control, 20, seeds=[7], process_noise=True)
    beside = closed_loop(generation_control, 20, seeds=[3, 7], process_noise=True)
    for a, b in zip(alone, beside, strict=True):
        assert np.array_equal(a.y[0], b.y[1]) and np.array_equal(a.x[0], b.x[1]) and np.array_equal(a.u[0], b.u[1])


def test_noise_has_the_stated_variances() -> None:
    moments = closed_loop(generation_control, 400, seeds=range(5), process_noise=True, loads=lambda t: np.zeros(15))
    read = np.array([m.own - m.x for m in moments])
    disturbed = np.array(
        [after.x - before.condition.step(before.x, after.reference, after.load) for before, after in pairwise(moments)]
    )
    for error, variance in ((read, np.array(NOISE_VARIANCE)), (disturbed, MODEL.process_cov)):
        samples = error.reshape(-1, 4)
        spread = 5 * np.sqrt(2 / len(samples))  # five standard errors
        assert samples.var(axis=0) == pytest.approx(variance, rel=spread)
    shared = np.array([m.shared - m.x[..., MODEL.network.topology.neighbour, 0] for m in moments])
    assert shared.var() == pytest.approx(NOISE_VARIANCE[0], rel=5 * np.sqrt(2 / shared.size))


def test_open_ties_are_not_read() -> None:
    model = network_model(unplugged=["15"])
    moments = closed_loop(generation_control, 12, model=model, switches=[Switch(10.0, plug_in=("15",))])
    at = model.network.topology
    with_15 = (at.node == 14) | (at.neighbour == 14)
    for m in moments:
        assert np.array_equal(np.isnan(m.shared[0]), with_15 if m.t < 10 else np.zeros(34, bool))
        assert np.all(np.isfinite(m.own)) and m.y.shape == (1, 94) and m.u.shape == (1, 30)


def test_an_unplugged_area_runs_by_itself() -> None:
    model = network_model(unplugged=["15"])
    others = load_profile(model, [LoadStep(2.0, "14", 0.3)])
    silent = np.zeros(15)
    x = np.zeros((15, 4))
    for k in range(10):
        x = model.step(x, silent, others(float(k)))
    assert not x[14].any() and np.abs(x[13]).max() > 0.01


def test_the_faults_of_the_paper_show_in_their_area() -> None:
    """Scenario 1, a governor that has stopped, and scenario 2, a reference of the wrong sign, each in its own valve first."""
    for scenario, fault in (
        ("1", AreaFault("governor", "4", 1000.0, onset=35.0)),
        ("2", AreaFault("input-gain", "5", -1.0, 45.0)),
    ):
        loads = load_profile(MODEL, load_steps(scenario))
        i, first = MODEL.network.topology.index(fault.area), int(fault.onset) + 1
        healthy, faulty = (closed_loop(generation_control, 60, loads=loads, faults=f) for f in ([], [fault]))
        shift = np.abs([a.x - b.x for a, b in zip(healthy, faulty, strict=True)])[:, 0]
        assert not shift[:first].any()
        assert np.argmax(shift[first].max(axis=1)) == i
        assert shift[55, i, 3] > 5 * np.sqrt(NOISE_VARIANCE[3])


def test_runs_that_do_not_fit() -> None:
    for settings, message in (({"seeds": []}, "at least one"), ({"steps": -1}, "steps is -1")):
        with pytest.raises(ValueError, match=message):
            closed_loop(generation_control, **settings)  # type: ignore[arg-type]
