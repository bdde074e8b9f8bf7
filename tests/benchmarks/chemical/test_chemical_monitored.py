"""Monitoring of the chemical plant learnt from one healthy recording: what the other one, which sets nothing, says of it."""

from pathlib import Path

import numpy as np
import pytest

from fusion_sfdia.benchmarks.chemical.monitored import SCENARIO, monitored_summary
from fusion_sfdia.benchmarks.chemical.support.monitoring import BEFORE, LENGTHS, METHODS, ONSETS, cases, monitored, with_faults
from fusion_sfdia.plant.log import Log
from fusion_sfdia.report.scenario_sentences import pick

TASK = {"measurements": [7, 23], "size": 10.0}


@pytest.mark.parametrize("kind", LENGTHS)
def test_faults_are_of_the_stated_size_where_they_are_active(kind: str) -> None:
    rng = np.random.default_rng(0)
    log = Log(180.0 * np.arange(960), rng.standard_normal((960, 41)), rng.standard_normal((960, 11)))
    sigma = {"reading": np.arange(1.0, 42.0), "noise": np.full(41, 0.5)}
    faulty, active = with_faults(TASK, log, sigma, kind)
    assert faulty.y.shape == (BEFORE + LENGTHS[kind], len(cases(TASK)), 41) and len(cases(TASK)) == 2 * 2 * len(ONSETS)
    for b, case in enumerate(cases(TASK)):
        change = faulty.y[:, b] - log.y[case.onset - BEFORE : case.onset + LENGTHS[kind]]
        size = np.abs(change[:, case.position])
        assert not change[:, np.arange(41) != case.position].any() and not size[:BEFORE].any()
        assert size[-1] == pytest.approx(10 * sigma[case.sigma][case.position])
        assert np.array_equal(active[:, b, case.position], size > 0)
        assert size[BEFORE] == pytest.approx(size[-1] / (1 if kind == "bias" else LENGTHS[kind]))


def test_a_measurement_that_the_plant_has_not_is_refused() -> None:
    with pytest.raises(ValueError, match="measurements has 42"):
        SCENARIO.tasks({**SCENARIO.settings, "measurements": (42,)}, 1)


@pytest.mark.long
def test_the_bank_keeps_its_rate_and_names_large_biases_and_drifts(shared_fixtures: Path) -> None:
    """Aims that were set beforehand: three times the stated rate, 0.9 of the samples of biases, 0.8 of the runs of drifts."""
    folder = shared_fixtures / "tep_braatz"
    if not folder.is_dir():
        pytest.skip("needs the recordings in ../shared/fixtures/tep_braatz, next to the checkout")
    settings = {**SCENARIO.settings, "data": str(folder)}
    (task,) = (t for t in SCENARIO.tasks(settings, 1) if METHODS[t["detector"]] == "bank")
    rows = monitored_summary(settings, [(task, monitored(task))]).rows
    of = {"quantity": "all", "condition": "sigma of the reading"}
    (alarms,) = pick(rows, metric="alarm_probability", condition="d00_te")
    (biases,) = pick(rows, metric="exact_isolation", **of)
    (drifts,) = pick(rows, metric="drift_isolation_probability", **of)
    assert alarms.value <= 3 * settings["false_alarm"]
    assert biases.value >= 0.9 and biases.n == 30
    assert drifts.value >= 0.8
