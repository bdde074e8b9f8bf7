"""Running power networks: loads, faults, switches, controllers, closed-loop runs."""

from __future__ import annotations

import numpy as np
import pytest

from fusion_sfdia.models.power_network.area_model import area_model
from fusion_sfdia.models.power_network.model import network_model
from fusion_sfdia.models.power_network.operation import AreaFault, Switch, load_profile, network_conditions
from fusion_sfdia.models.power_network.parameters import LoadStep, load_steps

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


def test_the_effect_of_each_fault() -> None:
    def step(*faults: AreaFault) -> np.ndarray:
        return network_conditions(MODEL, faults)(10.0).step(X, REFERENCE, LOAD)

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
    at = network_conditions(MODEL, [AreaFault("input-gain", "5", 2.0, onset=10.0, end=12.0)], [Switch(11.0, unplug=("4",))])
    assert [float(at(t).gain[4]) for t in (9.0, 10.0, 11.0, 12.0)] == [1, 2, 2, 1]
    assert [bool(at(t).known.network.plugged[3]) for t in (10.0, 11.0, 20.0)] == [True, False, False]
    assert at(11.0) is at(11.5)


def test_a_fault_changes_the_truth_and_not_the_known_model() -> None:
    now = network_conditions(MODEL, [AreaFault("governor", "4", 1000.0, onset=5.0)], [Switch(8.0, unplug=("4",))])(9.0)
    assert area_model(now.true, "4").A[3, 3] == -1e-3 and area_model(now.known, "4").A[3, 3] == -10
    assert np.array_equal(now.true.side_slope, now.known.side_slope)


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ({"kind": "turbine"}, "unknown fault 'turbine' of area 4; known: governor, input-gain, load-loss"),
        ({"value": 0.0}, "positive for a time constant"),
        ({"value": float("inf")}, "finite"),
        ({"kind": "input-gain", "value": 1.0}, "a value of 1 means no fault"),
        ({"kind": "load-loss", "value": 0.0}, "a value of 0 means no fault"),
        ({"onset": 3.0, "end": 3.0}, "onset before the end"),
    ],
)
def test_fault_values_without_effect_are_refused(fault: dict[str, object], message: str) -> None:
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
            network_conditions(MODEL, faults, switches)
