"""Process faults of the engine."""

from __future__ import annotations

import numpy as np
import pytest

from fusion_sfdia.diagnosis.simulate import simulate
from fusion_sfdia.models.marine_engine.faults import PROCESS_FAULTS, EngineFault, parameter_schedule
from fusion_sfdia.models.marine_engine.parameters import engine_parameters
from fusion_sfdia.models.marine_engine.plant import marine_engine

C = engine_parameters()
PLANT = marine_engine()
SIGNS = {  # at rest after a fault of 10 %, of the torque, p_receiver, p_charge and T_charge
    "turbine-fouling": (1, 1, 1, 0),  # a narrow turbine dams up the gas and so charges more
    "compressor-fouling": (-1, -1, -1, 0),
    "injector-loss": (-1, -1, -1, 0),
    "intercooler-fouling": (1, 1, 1, 1),  # the same heat in less air: a hotter receiver
    "heavy-propeller": (1, -1, -1, 0),  # slower: more work a cycle, since more burns at constant volume, and less gas
}


@pytest.mark.parametrize("kind", PROCESS_FAULTS)
def test_a_process_fault_acts_from_its_onset(kind: str) -> None:
    times = np.arange(1, 4101) * PLANT.dt
    faulty = marine_engine(process_faults=[EngineFault(kind, 0.1, onset=0.5)])
    recording = simulate(PLANT, times, [0], truth=faulty)
    before = recording.signal[times < 0.495, 0]
    np.testing.assert_allclose(before, np.broadcast_to(before[0], before.shape), rtol=1e-10)
    change = recording.signal[-1, 0] / before[0] - 1
    picks = [PLANT.sensor_index(name) for name in ("S(2){3}", "S(3){1}", "S(4){1}", "S(4){2}")]
    assert tuple(np.sign(np.where(np.abs(change[picks]) < 1e-9, 0.0, change[picks]))) == SIGNS[kind]
    assert np.abs(change).max() > 0.01
    assert np.any(recording.y != recording.signal)


def test_a_fault_grows_to_its_severity() -> None:
    fault = EngineFault("injector-loss", 0.2, onset=10.0, rise=4.0)
    assert [fault.severity_at(t) for t in (9.99, 10.0, 11.0, 14.0, 100.0)] == [0.0, 0.0, 0.05, 0.2, 0.2]
    at = parameter_schedule(C, [fault, EngineFault("turbine-fouling", 0.1)])
    assert at(11.0).full_injection == pytest.approx(0.95 * C.full_injection)
    assert at(11.0).turbine_area == pytest.approx(0.9 * C.turbine_area)
    assert at(11.0)._replace(full_injection=C.full_injection, turbine_area=C.turbine_area) == C
    assert parameter_schedule(C, [])(0.0) is C


def test_bad_process_faults_are_named() -> None:
    with pytest.raises(ValueError, match="unknown process fault 'rust'; known: turbine-fouling"):
        EngineFault("rust", 0.1)
    for severity in (0.0, 1.0, np.nan):
        with pytest.raises(ValueError, match=r"turbine-fouling: severity is .*; expected above 0 and below 1"):
            EngineFault("turbine-fouling", severity)
    with pytest.raises(ValueError, match=r"rise -1\.0 s; expected finite, rise at least 0"):
        EngineFault("turbine-fouling", 0.1, rise=-1.0)
