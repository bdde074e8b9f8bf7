"""The comparison: its protocol, the common rate of false alarms, what is kept of a run, from end to end."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import binom, chisquare
from toy_plants import chain

from fusion_sfdia.cli.main import main, parser
from fusion_sfdia.common.errors import NotApplicableError
from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.detector import Detector, run
from fusion_sfdia.detectors.kalman_banks.central_filter import CentralFilter
from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.detectors.registry import NamedDetector, NamedPlant
from fusion_sfdia.detectors.registry import detectors as registered_detectors
from fusion_sfdia.detectors.registry import plants as registered_plants
from fusion_sfdia.detectors.silent import silent, silent_score, silent_scores
from fusion_sfdia.detectors.state import leaves
from fusion_sfdia.diagnosis.simulate import Recording, simulate
from fusion_sfdia.learning import builders
from fusion_sfdia.plant.plant import Numerics, Plant
from fusion_sfdia.report.results import Published
from fusion_sfdia.study import cases as of_cases
from fusion_sfdia.study.cases import ComparisonCases
from fusion_sfdia.study.comparison import calibration as comparison_calibration
from fusion_sfdia.study.comparison import protocol
from fusion_sfdia.study.comparison import run as comparison_run
from fusion_sfdia.study.comparison.branches import Branches
from fusion_sfdia.study.comparison.calibration import (
    as_scores,
    calibrated,
    deployed,
    standard_ends,
)
from fusion_sfdia.study.comparison.cell import ComparisonCell, widened
from fusion_sfdia.study.comparison.compare import SCENARIO, Comparison
from fusion_sfdia.study.comparison.conclusions import broken_claims, distinct
from fusion_sfdia.study.comparison.looks import looks
from fusion_sfdia.study.comparison.metric_rows import confusion
from fusion_sfdia.study.comparison.recordings import failing, healthy, mismatched
from fusion_sfdia.study.comparison.records import BranchReadings, in_a_row, until
from fusion_sfdia.study.comparison.subjects import (
    ComparedDetector,
    ComparedPlant,
    Subjects,
    cases_of,
    compared_detector,
    compared_plant,
    plant_of,
)
from fusion_sfdia.study.comparison.summary import gather
from fusion_sfdia.study.comparison.walks import deployed_walk, shares, silent_walk, walk
from fusion_sfdia.study.experiments.runner import run_scenarios
from fusion_sfdia.study.experiments.scenario import adjust

PLANTS, DETECTORS = tuple(registered_plants()), tuple(registered_detectors())
TANKS = compared_plant("two-tanks")
TINY = {
    "plants": "two-tanks",
    "detectors": "limits,loo-chi2",
    "magnitudes": "1,30",
    "settle": "20",
    "window": "6",
    "lengths": "2,9",
    "false_alarm": "0.02",
    "calibration_error": "0.3",
}


def tiny(**changes: str) -> dict[str, Any]:
    return adjust(SCENARIO, TINY | changes)


def results(settings: dict[str, Any], seeds: int = 3, subjects: Subjects = Subjects()) -> list[tuple[Any, Any]]:  # noqa: B008
    comparison = Comparison(subjects)
    return [(task, comparison.work(task)) for task in comparison.tasks(settings, seeds)]


def summarise(settings: dict[str, Any], found: list[tuple[Any, Any]], subjects: Subjects = Subjects()) -> Any:  # noqa: B008
    return Comparison(subjects).summarise(settings, found)


def scores_of(detector: Any, recording: Recording) -> Any:
    return as_scores(silent_scores(detector, recording.t, recording.y, recording.u_of_runs)[1])


def cells_of(settings: dict[str, Any], found: list[tuple[Any, Any]]) -> dict[tuple[str, str], ComparisonCell]:
    return gather(Subjects(), settings, found)[0]


@cache
def cases(plant: str) -> ComparisonCases:
    return cases_of(compared_plant(plant))


def test_conditions_are_each_once_and_the_healthy_one_first() -> None:
    settings = dict(protocol.SETTINGS)
    for plant in PLANTS:
        found = protocol.conditions(settings, cases(plant))
        assert len({c.name for c in found}) == len(found)
        assert found[0].name == protocol.HEALTHY


def test_the_grid_of_faults() -> None:
    """Kind, size in sigma and length in samples of each condition of the tanks, at the default settings, as documented."""
    found = protocol.conditions(dict(protocol.SETTINGS), cases("two-tanks"))
    graded = {(kind, size, 30) for kind in ("bias", "drift", "scale", "noise") for size in (1.0, 3.0, 10.0, 30.0)}
    several = {("two-faults", 10.0, 30), ("three-faults", 10.0, 30)}
    without_size = {(kind, None, 30) for kind in ("none", "freeze", "dropout", "sign", "replay", "process")}
    lengths = {("length", size, length) for size in (3.0, 10.0) for length in (2, 5, 30, 120)}
    expected = graded | several | without_size | lengths
    assert {(c.kind, None if np.isnan(c.sigmas) else c.sigmas, c.length) for c in found} == expected
    assert len(found) == len(expected)


@pytest.mark.parametrize("plant", PLANTS)
def test_segments_of_a_seed_neither_overlap_nor_leave_gaps(plant: str) -> None:
    settings = dict(protocol.SETTINGS)
    lengths = {g: n * settings["window"] for g, n in protocol.segments(settings, cases(plant)).items()}
    for seed in range(20):
        begun = sorted((step, group) for group, step in protocol.onsets(settings, cases(plant), seed).items())
        assert begun[0][0] == protocol.settle_of(settings, cases(plant))
        ends = [step + lengths[group] for step, group in begun]
        assert [step for step, _ in begun[1:]] == ends[:-1]
        assert ends[-1] == protocol.trunk_steps(settings, cases(plant))
    assert all(c.length <= lengths[c.group] for c in protocol.conditions(settings, cases(plant)))
    assert lengths["length"] == 120 and lengths["bias"] == 30


def test_a_kind_of_fault_meets_all_phases() -> None:
    """Each of 12 places is a kind's with probability 1/12 in each of 600 seeds: chi-square of 11 degrees of freedom."""
    settings = tiny(lengths="")
    groups = list(protocol.segments(settings, cases("two-tanks")))
    drawn = [protocol.onsets(settings, cases("two-tanks"), s) for s in range(600)]
    places = np.array([[onset[g] for g in groups] for onset in drawn])
    for of_group in places.T:
        _, counts = np.unique(of_group, return_counts=True)
        assert counts.size == len(groups)
        assert chisquare(counts).pvalue > 1e-5


@pytest.mark.parametrize("plant", PLANTS)
def test_all_sensors_take_turns_in_an_order_of_each_kind(plant: str) -> None:
    of, settings = plant_of(compared_plant(plant)), dict(protocol.SETTINGS)
    everyone = list(range(len(of.sensors)))
    orders = {}
    for c in protocol.conditions(settings, cases(plant)):
        turns = [protocol.sensors_of(of, c, seed) for seed in everyone]
        if c.kind in (*protocol.GRADED, *protocol.UNGRADED, *protocol.ATTACKS, protocol.LENGTH):
            orders.setdefault(c.group, tuple(one[0] for one in turns))
            assert [one[0] for one in turns] == list(orders[c.group])  # sizes and lengths share the sensor
        if c.kind not in (protocol.HEALTHY, protocol.PROCESS, protocol.PUBLISHED):
            for place in zip(*turns, strict=True):
                assert sorted(place) == everyone
            assert all(len(set(one)) == len(one) for one in turns)
    assert len(set(orders.values())) > len(orders) // 2  # four sensors have 24 orders


def test_so_many_healthy_samples_that_the_rate_is_set_to_its_error() -> None:
    settings = protocol.SETTINGS | {"calibration_error": 1 / 6}
    for plant in PLANTS:
        samples = protocol.calibration_runs(settings, cases(plant), 8) * protocol.judged_steps(settings, cases(plant))
        exceeding = samples * settings["false_alarm"]
        assert 1 / np.sqrt(exceeding) <= settings["calibration_error"]  # of a Poisson number
        one_less = exceeding - protocol.judged_steps(settings, cases(plant)) * settings["false_alarm"]
        assert 1 / np.sqrt(one_less) > settings["calibration_error"]
        assert protocol.stated_error(settings, samples) == pytest.approx(1 / np.sqrt(exceeding))
    assert protocol.calibration_runs(settings | {"calibration_error": 0.9}, cases("two-tanks"), 8) == protocol.LEAST_RUNS


def test_without_a_set_error_each_seed_has_calibration_runs_of_its_own() -> None:
    settings, of = dict(protocol.SETTINGS), cases("two-tanks")
    assert [protocol.calibration_runs(settings, of, seeds) for seeds in (1, 8, 24)] == [protocol.LEAST_RUNS, 24, 72]
    tasks = SCENARIO.tasks(settings, 30)  # in two blocks of seeds, with one threshold
    assert {task["all_seeds"] for task in tasks} == {30}
    with pytest.raises(ValueError, match=r"calibration_error is 1e-05; expected at least 0\.001, or 0"):
        SCENARIO.tasks(settings | {"calibration_error": 1e-5}, 8)


def test_the_sizes_of_a_kind_share_the_sensor_and_err_by_their_sigmas() -> None:
    settings, plant = dict(protocol.SETTINGS), plant_of(TANKS)
    signal = np.broadcast_to(plant.output(0.0, plant.x0, np.array([6e-4])), (30, 4))
    for condition in protocol.conditions(settings, cases("two-tanks")):
        chosen = protocol.sensors_of(plant, condition, seed=1)
        faults = protocol.faults_of(plant, condition, 1, 100.0, signal)
        assert [f.sensor for f in faults] == [plant.sensor_names[i] for i in chosen]
        sigma = plant.sensor_sigma[chosen]
        if condition.kind in ("bias", "length", "drift", "noise", "two-faults", "three-faults"):
            np.testing.assert_allclose([f.magnitude for f in faults], condition.sigmas * sigma)
            assert all(f.length == condition.length * plant.dt for f in faults)
        if condition.kind == "scale":  # the signal is steady, so that the factor is an offset
            np.testing.assert_allclose((faults[0].magnitude - 1) * signal[0, chosen], condition.sigmas * sigma)
        if condition.kind == "sign":
            assert [(f.kind, f.magnitude) for f in faults] == [("scale", -1.0)]


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("detectors", "loo-chi", "did you mean 'loo-chi2'"),
        ("faults", "bias,bias", "each value once"),
        ("magnitudes", "0,3", "a number from 1e-06"),
        ("window", "1", "a whole number from 2 "),
        ("lengths", "0,3", "a whole number from 1 "),
        ("false_alarm", "1", "a number from 1e-06 to 0.5"),
    ],
)
def test_settings_that_do_not_fit(key: str, value: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        SCENARIO.tasks(tiny(**{key: value}), 1)


def test_scores_of_a_silent_detector_are_those_over_its_own_thresholds() -> None:
    found = calibrated(TANKS, compared_detector("kf-chi2"), 20, 50, 10, 0.02)  # it accuses and latches nothing
    recording = healthy(TANKS, 30, (0, 1))
    nominal = scores(found.detector, recording)
    np.testing.assert_allclose(scores_of(silent(found.detector), recording), nominal)
    np.testing.assert_allclose(scores(deployed(found), recording) * found.scale, nominal)


def scores(detector: Detector, recording: Recording) -> NDArray[np.float64]:
    start = detector.init((recording.y.shape[1],), float(recording.t[0]) - detector.plant.dt)
    return run(detector, start, recording.t, recording.y, recording.u_of_runs)[1].score


def test_thresholds_are_set_to_the_rate_on_healthy_data_and_keep_it_on_others() -> None:
    rate, steps, seeds = 0.02, 100, 10
    found = calibrated(TANKS, compared_detector("kf-chi2"), 20, steps, seeds, rate)
    assert (found.scores > found.scale).mean() <= rate
    assert (found.scores >= found.scale).mean() >= rate
    assert found.ends[0] < found.scale < found.ends[1]
    fresh = healthy(TANKS, 20 + steps, tuple(range(50, 60)))
    alarms = (scores(deployed(found), fresh)[20:] > 1).sum()
    # the rate that an order statistic of n samples sets has mean `rate`, deviation sqrt(rate / n): samples nearly independent
    n, deviation = fresh.y[20:, :, 0].size, np.sqrt(rate / (steps * seeds))
    assert alarms <= binom.ppf(0.999, n, rate + 3 * deviation)
    assert alarms >= binom.ppf(0.001, n, max(rate - 3 * deviation, 0.0))


def test_the_ends_of_a_threshold_are_a_standard_error_of_its_order_statistic_away() -> None:
    """Exponential scores: the quantile exceeded by a share p of n has the deviation 1 / sqrt(n p) (its density there is p)."""
    rng, rate = np.random.default_rng(0), 0.02
    healthy_scores = rng.exponential(size=(500, 60))
    scale = float(np.quantile(healthy_scores, 1 - rate))
    low, high = standard_ends(healthy_scores, scale, rate)
    error = scale * np.log(high / low) / 2
    # a bootstrap of a quantile from 600 exceedances errs by (600)^(-1/4) = 20 % at most times, one of 200 draws by 5 % besides
    assert error == pytest.approx(1 / np.sqrt(healthy_scores.size * rate), rel=3 * np.hypot(0.05, 600**-0.5) + 0.2)


def test_what_sets_thresholds_what_is_learnt_from_and_what_is_judged_share_no_seed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Seeds as they reach the simulation: fitting within `build`, calibration within `calibrated`, the rest is judged."""
    used: dict[str, set[int]] = {"fitted": set(), "calibrated": set(), "judged": set()}
    phase = ["judged"]

    def spy(function: Any, *, fitting: bool) -> Any:
        def simulate(plant: Plant, steps: int, seeds: Any, **options: Any) -> Recording:
            used["fitted" if fitting else phase[0]].update(seeds)
            found: Recording = function(plant, steps, seeds, **options)
            return found

        return simulate

    def watched(*arguments: Any) -> Any:
        phase[0] = "calibrated"
        found = calibrated.__wrapped__(*arguments)
        phase[0] = "judged"
        return found

    monkeypatch.setattr(of_cases, "simulate", spy(of_cases.simulate, fitting=False))
    monkeypatch.setattr(builders, "simulate", spy(builders.simulate, fitting=True))
    monkeypatch.setattr(comparison_run, "calibrated", watched)
    healthy.cache_clear()
    comparison_run.usual_material.cache_clear()
    comparison_run.mismatch_material.cache_clear()
    settings = tiny(detectors="limits,fusing-ekf")
    results(settings)
    assert used["judged"] == {0, 1, 2}
    assert len(used["calibrated"]) == protocol.calibration_runs(settings, cases("two-tanks"), 3)
    assert len(used["fitted"]) >= 20
    assert not used["judged"] & (used["fitted"] | used["calibrated"])
    assert not used["fitted"] & used["calibrated"]


def test_readings_are_simulated_once_for_all_detectors(monkeypatch: pytest.MonkeyPatch) -> None:
    simulated: list[Any] = []
    simulate = of_cases.simulate
    monkeypatch.setattr(of_cases, "simulate", lambda *a, **k: simulated.append(k) or simulate(*a, **k))
    for cached in (healthy, comparison_run.usual_material, comparison_run.mismatch_material):
        cached.cache_clear()
    counts = []
    for name in ("limits", "loo-chi2", "loo-glr"):
        results(tiny(detectors=name))
        counts.append(len(simulated))
    assert counts[0] == counts[1] == counts[2] > 0


@pytest.mark.parametrize("name", ["loo-glr", "adaptive-threshold"])
def test_branches_in_one_pass_are_those_run_one_after_the_other(name: str) -> None:
    """Oracle: each run alone, along the healthy trunk as silent, then over its own readings as deployed."""
    settings = tiny(detectors=name, false_alarm="0.023")
    (task,) = SCENARIO.tasks(settings, 2)
    recording, found, labels = comparison_run.usual_material(TANKS, comparison_run.of_all_detectors(task))
    plant, settle = plant_of(TANKS), protocol.settle_of(settings, cases("two-tanks"))
    found_calibration = calibrated(TANKS, compared_detector(name), 20, 50, 10, 0.023)
    quiet, loud = silent(found_calibration.detector), deployed(found_calibration)
    seen = silent_walk(quiet, recording, found, {r.onset for r in found.runs} | {settle})
    alarms, outcomes = deployed_walk(loud, found_calibration.scale, recording, found, seen, settle, trunk=True)
    assert {r.length for r in found.runs} == {6, 9}  # several are under way at once
    assert set(seen.reaches(found_calibration.scale, found)) == {True, False}  # some are those of the silent detector
    np.testing.assert_array_equal(seen.reaches(np.inf, found), False)
    for r, first in zip(found.runs, found.rows, strict=True):
        state = quiet.init((1,), 0.0)
        for k in range(r.onset):
            state, _ = quiet.step(state, float(recording.t[k]), recording.y[k, [r.b]], recording.u_of_runs[k, [r.b]])
        rows, t = slice(first, first + r.length), recording.t[r.onset : r.onset + r.length]
        y, u = found.readings.y[rows, None], found.readings.u[rows, None]
        as_silent, as_deployed = run(quiet, state, t, y, u)[1], run(loud, state, t, y, u)[1]
        # products of matrices of a batch may round differently: 1e-9 of a threshold is far below any distance to it
        np.testing.assert_allclose(seen.runs[rows], as_scores(silent_score(as_silent))[:, 0], rtol=1e-9, atol=1e-9)
        np.testing.assert_array_equal(outcomes.alarm[rows], as_deployed.alarm[:, 0])
        np.testing.assert_array_equal(outcomes.isolated[rows], as_deployed.isolated[:, 0, : len(plant.sensors)])
        np.testing.assert_allclose(outcomes.reconstruction[rows], as_deployed.reconstruction[:, 0], rtol=1e-9)
        np.testing.assert_allclose(outcomes.scores[rows], as_deployed.scores[:, 0], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(outcomes.fault_size[rows], as_deployed.fault_size[:, 0, : len(plant.sensors)], rtol=1e-9)
    np.testing.assert_allclose(seen.trunk, scores_of(quiet, recording), rtol=1e-9, atol=1e-9)
    state = seen.states[settle]
    on_trunk = run(loud, state, recording.t[settle:], recording.y[settle:], recording.u_of_runs[settle:])[1]
    np.testing.assert_array_equal(alarms[settle:], on_trunk.alarm)
    long, short = (next(x for x in labels if x.condition.name == f"bias-30-sigma-{n}-samples") for n in (9, 2))
    assert long.members == short.members  # the short one is its beginning


def test_runs_that_alarm_are_stepped_apart_from_those_that_share_covariances() -> None:
    plant = chain(16)  # so many sensors that their covariance is inverted once for all runs
    u = np.empty(0)
    F, H = plant.step_jacobian_at(0.0, plant.x0, u, plant.dt), plant.output_jacobian_at(0.0, plant.x0, u)
    constant = Numerics(step_jacobian=lambda t, x, u, dt: F, output_jacobian=lambda t, x, u: H)
    plant = replace(plant, numerics=constant)
    recording = simulate(plant, 12, range(4))
    recording.y[6:9, 2, 0] += 100 * plant.sensor_sigma[0]
    recording.y[8, 0, 1] = np.nan
    detector = LeaveOneOutBank(plant, window=1)
    start = detector.init((4,), float(recording.t[0]) - plant.dt)
    nothing = BranchReadings(*(np.empty((0, a.shape[-1])) for a in (recording.u_of_runs, *[recording.y] * 5)))
    seen = list(walk(detector, recording, Branches((), nothing, np.arange(0)), states={0: start}))
    assert [(step.k, step.numbers.tolist()) for step in seen if step.k in (6, 7, 9)] == [
        (6, [0, 1, 2, 3]), (7, [0, 1, 3]), (7, [2]), (9, [1, 3]), (9, [2, 0]),
    ]  # fmt: skip
    assert [shares(step.state) for step in seen if step.k in (6, 7, 9)] == [True, True, False, True, False]
    _, at_once = run(detector, start, recording)
    for step in seen:
        np.testing.assert_array_equal(step.decision.isolated, at_once.isolated[step.k, step.numbers])
        for name in ("estimate", "residual", "reconstruction"):  # of numbers of order 1, sums of 16
            found, expected = getattr(step.decision, name), getattr(at_once, name)[step.k, step.numbers]
            np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)


def test_runs_of_a_calibration_in_parts_have_the_bits_of_all_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    quiet, recording = silent(registry.detector("loo-glr", plant_of(TANKS))), healthy(TANKS, 25, tuple(range(5)))
    at_once, batches = comparison_calibration.scores_of(quiet, recording), []
    monkeypatch.setattr(comparison_calibration, "CACHE", 2 * sum(a.nbytes for a in leaves(quiet.init((1,)))))
    monkeypatch.setattr(
        comparison_calibration, "silent_scores", lambda *given: batches.append(given[2].shape[1]) or silent_scores(*given)
    )
    assert np.array_equal(comparison_calibration.scores_of(quiet, recording), at_once)
    assert batches == [2, 2, 1]


def test_an_interval_contains_how_uncertain_the_threshold_is() -> None:
    settings = tiny(detectors="limits", mismatch_cases="no", process_faults="no")
    cell = cells_of(settings, results(settings))["two-tanks", "limits"]
    alone, whole = cell.exact(cell.rows_of("bias-1-sigma")), cell.of(ComparisonCell.exact, "bias-1-sigma")
    low, high = (cell.exact(cell.rows_of("bias-1-sigma", threshold=sign)).value for sign in (-1, 1))
    more = (1.959964 * abs(high - low) / 2) ** 2
    assert whole.value == alone.value
    assert whole.high - whole.value == pytest.approx(np.sqrt((alone.high - alone.value) ** 2 + more), abs=1e-7)
    assert widened(alone, 0.0) == pytest.approx(alone)
    assert cell.of(ComparisonCell.exact, "freeze") == cell.exact(cell.rows_of("freeze"))  # not tried with other thresholds
    assert cell.ends[0] < cell.scale < cell.ends[1]
    rates = [(cell["trunk"] > end).mean() for end in cell.ends]
    assert rates[0] >= cell.matched.value >= rates[1] and cell.rate_error == pytest.approx((rates[0] - rates[1]) / 2)


def test_cells_that_repeat_count_once_among_the_claims() -> None:
    settings = tiny(
        detectors="adaptive-threshold,virtual-sensors,limits", faults="bias", mismatch_cases="no", process_faults="no"
    )
    cells = list(cells_of(settings, results(settings, seeds=2)).values())
    assert [c.detector for c in distinct(cells)] == ["adaptive-threshold", "limits"]
    [claims] = broken_claims(cells)
    assert (
        "of 2 pairs of plant and detector that claim a rate of false alarms keep it within the interval, 1 more repeat another"
        in claims
    )


def test_every_detector_sees_the_same_readings() -> None:
    first, second = (arrays for _, arrays in results(tiny()))
    for name in ("condition", "mismatch", "sensor", "raw", "noise", "faulty", "all_raw"):
        np.testing.assert_array_equal(first[name], second[name])


def test_the_same_task_has_the_same_bits_but_for_times() -> None:
    task = SCENARIO.tasks(tiny(detectors="fusing-enkf", mismatch_cases="no", faults="bias,noise"), 2)[0]
    first, second = SCENARIO.work(task), SCENARIO.work(task)
    assert {k for k in first if not np.array_equal(first[k], second[k], equal_nan=first[k].dtype.kind == "f")} <= {
        "step_seconds",
        "batch_seconds",
        "step_bytes",
    }


def test_large_faults_are_detected_isolated_and_replaced() -> None:
    settings = tiny(detectors="loo-chi2")
    cells, reasons = gather(Subjects(), settings, results(settings))
    cell = cells["two-tanks", "loo-chi2"]
    assert not reasons
    rows = cell.rows_of("bias-30-sigma")
    assert cell.detected(rows).value == 1.0
    assert cell.exact(rows).value > 0.9
    assert cell.gain(rows).value < 0.1  # of 30 sigma not three are left
    assert cell.detected(cell.rows_of("none")).value <= 1.0
    np.testing.assert_allclose(cell["raw"][rows], 900, rtol=0.3)  # (30 +- 4)^2 at most: noise is bounded by 4 sigma
    samples = confusion(cell)
    assert samples.shape[1] == 3 * (4 + 2)  # runs: seeds, four kinds whose sizes share noise and sensor, replay and sign
    assert samples.sum() == pytest.approx(6 * 3 * (2 * 4 + 2))  # window, seeds, two sizes of four kinds, replay and sign
    assert cell["right"][cell.rows_of("dropout")].sum() == 0  # what is missing is not isolated


def refusing(error: Exception) -> Subjects:
    def build(of: Plant) -> Detector:
        raise error

    detector = ComparedDetector("broken", "", NamedDetector("broken", "it raises", build))
    return Subjects(detectors={"broken": detector})


def test_a_detector_that_is_not_applicable_is_reported_with_its_reason() -> None:
    settings, subjects = tiny(detectors="broken"), refusing(NotApplicableError("the plant has no wings; give it some"))
    summary = summarise(settings, results(settings, 1, subjects), subjects)
    assert not summary.rows
    assert "the plant has no wings" in summary.remarks[0]


@pytest.mark.parametrize("error", [ValueError, ModuleNotFoundError, TypeError])
def test_any_other_error_of_a_construction_is_an_error_of_the_run(error: type[Exception]) -> None:
    with pytest.raises(error, match="not aligned"):
        results(tiny(detectors="broken"), 1, refusing(error("shapes (3,) and (4,) not aligned")))


@pytest.mark.parametrize("plant", PLANTS)
def test_mismatch_cases_change_what_is_read_and_not_its_noise(plant: str) -> None:
    subject = compared_plant(plant)
    of, usual = plant_of(subject), healthy(subject, 62, (3,))
    assert cases_of(subject).mismatch
    for case in cases_of(subject).mismatch:
        changed = mismatched(subject, case, 62, (3,), 52 * of.dt)
        np.testing.assert_array_equal(changed.t, usual.t)
        noise = changed.y - changed.signal  # as usual, and within its bounds, but for rounding
        np.testing.assert_allclose(noise / of.sensor_sigma, (usual.y - usual.signal) / of.sensor_sigma, atol=1e-6)
        error = np.abs(changed.signal - usual.signal)[-1, 0] / of.sensor_sigma
        assert error.max() > 0.1, case.name


@pytest.mark.parametrize("plant", PLANTS)
def test_process_faults_begin_at_their_onset(plant: str) -> None:
    subject = compared_plant(plant)
    of, usual = plant_of(subject), healthy(subject, 30, (3,))
    assert cases_of(subject).process_faults
    for fault in cases_of(subject).process_faults:
        # the 20th reading is at 20 dt: what is algebraic shows there
        changed = failing(subject, fault, 30, (3,), (20 - 1e-6) * of.dt)
        np.testing.assert_array_equal(changed.y[:19], usual.y[:19])
        assert np.any(changed.signal[20] != usual.signal[20]), fault.name


@pytest.mark.slow
def test_from_end_to_end_with_any_number_of_workers(tmp_path: Path) -> None:
    changes = TINY | {
        "plants": "two-tanks,marine-engine",
        "detectors": "limits,kf-chi2,adaptive-threshold",
        "faults": "bias,dropout",
    }
    one, _ = (
        run_scenarios([SCENARIO], tmp_path / str(workers), seeds=2, changes=changes, workers=workers) for workers in (1, 2)
    )
    assert not one.failures
    assert (tmp_path / "1" / "metrics.csv").read_bytes() == (tmp_path / "2" / "metrics.csv").read_bytes()
    assert {r.detector for r in one.rows} == {"limits", "kf-chi2", "adaptive-threshold"}
    assert {p.name for p in (tmp_path / "1" / "figures").glob("*.png")} == {
        f"comparison-{name}.png"
        for name in (
            "loss",
            "overview",
            *(
                f"{p}-{f}"
                for p in ("two-tanks", "marine-engine")
                for f in ("example", "roc", "magnitudes", "confusion", "others", "mismatch", "cost")
            ),
        )
    }
    ranks = [r for r in one.rows if r.metric == "rank"]
    assert {r.plant for r in ranks} == {"two-tanks", "marine-engine", "all plants"}
    assert {r.value for r in ranks if r.plant == "two-tanks"} == {1.0}  # two seeds show no difference


def test_without_options_all_is_compared() -> None:
    chosen = parser().parse_args(["compare"])
    assert (chosen.set, chosen.full) == ([], False)


@pytest.mark.usefixtures("undrawn")
def test_on_the_command_line(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    few = [f"--set={k}={v}" for k, v in TINY.items() if k not in ("plants", "detectors")]
    code = main(["compare", "--plants", "two-tanks", "--detectors", "limits", "--faults", "bias", "--seeds", "1",
                 "--workers", "1", "--out", str(tmp_path / "out"), *few])  # fmt: skip
    out, err = capsys.readouterr()
    assert (code, err) == (0, "")
    assert "metrics.csv" in out
    code = main(["compare", "--plants", "two-tank", "--out", str(tmp_path / "none")])
    _, err = capsys.readouterr()
    assert code == 2
    assert "did you mean 'two-tanks'" in err


def test_faults_of_the_papers_have_their_sizes() -> None:
    pipeline, engine = (plant_of(compared_plant(name)) for name in ("gas-pipeline", "marine-engine"))
    settings = dict(protocol.SETTINGS)
    signal = np.ones((30, len(pipeline.sensors)))
    for condition in protocol.conditions(settings, cases("gas-pipeline")):
        if condition.kind == protocol.PUBLISHED:
            low, high = (0.6, 0.9) if condition.name.startswith("strong") else (0.2, 0.4)
            faults = [protocol.faults_of(pipeline, condition, s, 60.0, signal)[0] for s in range(20)]
            assert len({f.sensor for f in faults}) == 20
            assert all(f.relative and low <= abs(f.magnitude) <= high and f.length == 30 * pipeline.dt for f in faults)
            assert {np.sign(f.magnitude) for f in faults} == {-1, 1}
    offsets = [c for c in protocol.conditions(settings, cases("marine-engine")) if c.kind == protocol.PUBLISHED]
    made = [protocol.faults_of(engine, c, 5, 1.0, signal)[0] for c in offsets]
    assert [(f.sensor, f.magnitude) for f in made] == [("S(2){3}", -3.8e4), ("S(3){1}", 5e4), ("S(4){2}", 8.0)]
    assert [c for c in protocol.conditions(settings, cases("two-tanks")) if c.kind == protocol.PUBLISHED] == []


def test_what_is_published_stands_beside_ours() -> None:
    settings = tiny(plants="marine-engine", detectors="adaptive-threshold,limits", faults="published", mismatch_cases="no")
    found = [r for r in summarise(settings, results(settings)).rows if r.published is not None]
    assert {r.detector for r in found} == {"adaptive-threshold"}
    assert [(r.fault, round(float(r.published or 0), 9)) for r in found] == [
        ("torque-offset", 0.0),
        ("receiver-pressure-offset", 0.06),
        ("charge-temperature-offset", 0.01),
    ]
    pipeline, network = cases("gas-pipeline"), cases("power-network")
    assert pipeline.published_accuracy("fusing-ekf", "weak-bias", "pressure") == Published(0.45, "Shaheen 2024, Table VI")
    assert pipeline.published_accuracy("loo-glr", "weak-bias", "pressure") is None
    delay = network.published_delay("chebyshev:paper", "governor")
    assert delay is not None and (delay.until, delay.value.value) == ("confirmed", 8.0)
    assert network.published_delay("chebyshev", "governor") is None
    assert cases("two-tanks").published_accuracy("fusing-ekf", "weak-bias", "pressure") is None


def test_what_latches_is_reported_as_deployed_on_healthy_readings() -> None:
    settings = tiny(
        detectors="limits,adaptive-threshold", faults="bias", mismatch_cases="no", process_faults="no", false_alarm="0.1"
    )
    cells = cells_of(settings, results(settings))
    limits, latching = cells["two-tanks", "limits"], cells["two-tanks", "adaptive-threshold"]
    assert limits.deployed.value == limits.matched.value  # it forgets
    assert latching.deployed.value > latching.matched.value > 0
    silent = latching["trunk"] > latching.scale
    assert latching.deployed.value == pytest.approx(np.maximum.accumulate(silent, axis=0).mean())  # it does not


def test_a_piece_that_failed_costs_its_detector_the_ranks_and_no_other() -> None:
    settings = tiny(detectors="limits,kf-chi2", faults="bias", mismatch_cases="no", process_faults="no")
    done = [
        (task | {"seeds": [s]}, SCENARIO.work(task | {"seeds": [s]})) for task in SCENARIO.tasks(settings, 1) for s in (0, 1)
    ]
    summary = summarise(settings, done[:-1])
    assert {r.detector for r in summary.rows if r.metric == "auc"} == {"limits", "kf-chi2"}
    assert {r.detector for r in summary.rows if r.metric == "rank"} == {"limits"}
    assert any("Left out of the ranks" in remark and "kf-chi2 on two-tanks" in remark for remark in summary.remarks)


@pytest.mark.usefixtures("registrations")
def test_a_plant_and_a_detector_of_ones_own_are_in_rows_and_report() -> None:
    plant = ComparedPlant("chain", "", NamedPlant("chain", "tanks in a row", chain))
    mine = NamedDetector("mine", "one filter", lambda of: CentralFilter(of, false_alarm=0.01), "state estimate only")
    subjects = Subjects({"chain": plant}, {"mine": ComparedDetector("mine", "", mine)})
    settings = tiny(plants="chain", detectors="mine,limits", faults="bias,dropout,published")
    found = summarise(settings, results(settings, subjects=subjects), subjects)
    assert {(r.plant, r.detector) for r in found.rows} == {("chain", "mine"), ("chain", "limits")}
    chapter, glossary = found.chapters
    assert glossary.tables[1].rows[0] == ("mine", "state estimate only", "one filter")
    assert chapter.title == "chain" and chapter.text[0].startswith("Tanks in a row; 12 states, 12 sensors")
    for figure in found.every_figure:
        assert figure.draw().axes, figure.name
    nominal = [r for r in found.rows if r.metric == "claimed_false_alarm_probability" and r.detector == "mine"]
    assert [r.value for r in nominal] == [0.01]


def test_alarms_in_a_row_are_counted_by_hand() -> None:
    alarm = np.array([[1, 1, 0, 1, 1, 1, 1], [0, 1, 1, 1, 0, 0, 0], [1, 1, 0, 1, 1, 0, 1]], bool).T
    assert until(in_a_row(alarm, 3)).tolist() == [5, 3, np.inf]
    assert until(alarm).tolist() == [0, 1, 0]


def test_a_plant_to_which_no_detector_applies_is_reported() -> None:
    settings = tiny(plants="two-tanks,gas-pipeline", detectors="virtual-sensors", faults="bias", mismatch_cases="no")
    tasks = [t for t in SCENARIO.tasks(settings, 1)]
    found = summarise(settings, [(t, SCENARIO.work(t)) for t in tasks])
    assert [c.name for c in found.chapters] == ["two-tanks", "words"]
    assert any(r.startswith("No detector ran on gas-pipeline: plant 'gas-pipeline'") for r in found.remarks)


def test_an_error_while_readings_are_judged_is_no_refusal(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(self: Any, *arguments: Any) -> Any:
        raise ValueError("operands could not be broadcast")

    monkeypatch.setattr(CentralFilter, "_judge", broken)
    settings = tiny(detectors="kf-chi2", false_alarm="0.03")  # not as calibrated before
    with pytest.raises(ValueError, match="broadcast"):
        results(settings, seeds=1)


def test_every_detector_has_a_look_of_its_own() -> None:
    compared = list(registry.compared_detectors())
    found = looks(compared)
    assert len({(look["color"], look["linestyle"]) for look in found.values()}) == len(compared)
    assert len({(look["color"], look["marker"]) for look in found.values()}) == len(compared)


def test_memory_of_a_step_is_what_it_holds_at_most_and_that_of_a_state_its_arrays() -> None:
    class Wasteful:
        """A run has a state of three numbers; a step fills 100 000 others and forgets them."""

        plant = plant_of(TANKS)

        def init(self, batch: tuple[int, ...], t: float) -> tuple[NDArray[np.float64]]:
            return (np.zeros((*batch, 3)),)

        def step(self, state: Any, t: float, y: Any, u: Any) -> tuple[Any, None]:
            np.ones(100_000).sum()
            return state, None

    found = comparison_run.cost(Wasteful(), healthy(TANKS, 5, (3,)))  # type: ignore[arg-type]
    assert found["state_bytes"] == 3 * 8
    assert 800_000 <= found["step_bytes"] < 810_000  # the numbers, and some objects around them


def test_without_faults_of_a_size_nothing_is_said_of_them() -> None:
    settings = tiny(faults="dropout", mismatch_cases="no", process_faults="no")
    found = summarise(settings, results(settings, seeds=2))
    lines = [*found.highlights, *found.remarks, *(line for chapter in found.chapters for line in chapter.text)]
    assert not [line for line in (*lines, *(figure.caption for figure in found.every_figure)) if "nan" in line.lower()]
    assert [table.title for table in found.tables] == []
