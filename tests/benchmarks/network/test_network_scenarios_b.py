"""Scenarios of the power network's residuals: laws of noise, counts of alarms, and each scenario from tasks to figures."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from fusion_sfdia import registry
from fusion_sfdia.benchmarks.network.consensus import ALONE, alone, consensus_work, copies, network, theory
from fusion_sfdia.benchmarks.network.detectors import SETTLE, delays
from fusion_sfdia.benchmarks.network.false_alarms import counts, one_shock
from fusion_sfdia.benchmarks.network.plug import MANNERS, changes, switched
from fusion_sfdia.benchmarks.network.plug import watch as watch_switches
from fusion_sfdia.benchmarks.network.support.claims import ALPHAS, bound, verdict
from fusion_sfdia.benchmarks.network.support.innovations import chi_square, innovations, standardised
from fusion_sfdia.benchmarks.network.support.plug_figures import JOINS, LEAVES
from fusion_sfdia.benchmarks.network.support.residuals import CORRECTED, MEMORYLESS, draw_of, groups, owners, watch
from fusion_sfdia.core.random_streams import stream
from fusion_sfdia.evaluation.results import Row
from fusion_sfdia.models.power_network.diagnosis import network_areas
from fusion_sfdia.models.power_network.model import network_model
from fusion_sfdia.models.power_network.operation import Switch
from fusion_sfdia.models.power_network.simulation import run_network
from fusion_sfdia.report.content import Summary
from fusion_sfdia.report.plots import style

TINY: dict[str, dict[str, Any]] = {
    "network/false-alarms": {"steps": 110, "shock_steps": 500, "laws": ("gaussian",), "shocks": ("three-point 90",)},
    "network/consensus": {"steps": 40},
    "network/plug": {},
    "network/detectors": {},
}
SEEDS = {"network/false-alarms": 10}  # the rule "conformal" needs 999 samples for one in a thousand: 10 runs of 101
SEEDS |= {"network/consensus": 4, "network/plug": 3, "network/detectors": 6}


def summary(name: str, **changes: Any) -> Summary:
    scenario = registry.scenario(name)
    settings = {**scenario.settings, **TINY[name], **changes}
    return scenario.summarise(settings, [(t, scenario.work(t)) for t in scenario.tasks(settings, SEEDS[name])])


@pytest.mark.parametrize("name", TINY)
def test_a_scenario_runs_to_its_rows_and_figures(name: str) -> None:
    found = summary(name)
    assert found.rows and {r.scenario for r in found.rows} == {name}
    assert all(r.low <= r.value <= r.high for r in found.rows if np.isfinite(r.low))
    assert len({(r.detector, r.fault, r.quantity, r.metric) for r in found.rows}) == len(found.rows)
    for figure in found.figures:
        with style():
            assert figure.draw().axes
    assert not [text for text in (*found.highlights, *found.remarks) if "unknown" in text or "nan" in text]


@pytest.mark.parametrize("law", ["gaussian", "three-point 2"])
def test_laws_of_noise_have_mean_0_and_variance_1(law: str) -> None:
    n = 200_000
    x = draw_of(law)(stream(0, "law"), (n,))
    # standard errors: of the mean 1/sqrt(n), of the variance sqrt((kurtosis - 1)/n) with kurtosis 3 and size^2 = 4
    assert abs(x.mean()) < 4 / np.sqrt(n)
    assert abs(x.var() - 1) < 4 * np.sqrt(3 / n)


def test_student_draws_are_scaled_to_variance_1() -> None:
    x = draw_of("student-t")(stream(0, "law"), (200_000,))
    # the fourth moment is infinite, so quantiles instead: 0.9 of t with 3 degrees of freedom is 1.6377 (tables), over sqrt(3)
    above = np.mean(x > 1.6377 / np.sqrt(3))
    assert abs(above - 0.1) < 4 * np.sqrt(0.1 * 0.9 / x.size)


def test_an_unknown_law_is_refused() -> None:
    with pytest.raises(ValueError, match="unknown law 'cauchy'; known: gaussian, student-t, three-point SIZE"):
        draw_of("cauchy")


def test_groups_tell_each_component_once() -> None:
    model = network_model()
    found = groups(model)
    assert np.all(np.sum(list(found.values()), axis=0) == 1)
    assert {k: int(v.sum()) for k, v in found.items()} == {
        "theta, 2 sharers": 4, "theta, 3 sharers": 21, "theta, 4 sharers": 24, "omega": 15, "p_m": 15, "p_v": 15,
    }  # fmt: skip
    assert list(np.bincount(owners(model))) == [4 + k for k in np.diff(model.network.topology.start)]


def test_alarms_in_a_row_are_counted_by_component_and_by_area() -> None:
    z = np.zeros((6, 1, 3))  # two components of area 0, one of area 1
    z[1:4, 0, 0] = 3.0
    z[4, 0, 1] = -6.0
    found = counts(z, np.array([[True, True, False], [False, False, True]]), np.array([0, 0, 1]))
    assert found["row"][0, ALPHAS.index(2.0)].tolist() == [4, 2, 1]
    assert found["chances"][0].tolist() == [18, 15, 12]
    assert found["beyond"][0, :, ALPHAS.index(5.0)].tolist() == [1.0, 0.0]
    assert found["confirmed"][0].tolist() == [True, True]
    z[2, 0, 0] = 0.0
    z[2, 0, 1] = 3.0
    assert counts(z, np.ones((1, 3), bool), np.array([0, 0, 1]))["confirmed"][0].tolist() == [False, True]


def test_a_claim_is_kept_broken_or_undecided() -> None:
    def counted(quantity: str, low: float, high: float) -> Row:
        return Row("network/false-alarms", "power-network", "chebyshev", "none", quantity, "rate", low, low, high)

    three = counted("3 in a row, alpha 5, lit, gaussian", 1e-4, 2e-4)
    assert bound(three) == pytest.approx(5.0**-6) and verdict(three, bound(three)) == "no"
    single = counted("theta, 4 sharers, alpha 2, lit, gaussian", 0.1, 0.3)
    assert bound(single) == 0.25 and verdict(single, bound(single)) == "undecided"
    assert verdict(single, 0.3) == "yes"


def test_one_shock_ends_one_row_of_alarms() -> None:
    alpha = 10.0
    found = one_shock(list(range(20)), 20_000)
    for j, q in enumerate((1, 2, 3)):
        p = (1 - 0.3) ** 2 * 0.3 ** (2 * q - 2) / alpha**2  # of a shock
        expected = p * found["chances"][:, j].sum()
        # another one changes the count where it is within 17 steps (0.3^17 is the margin of its size, 1e-9)
        margin = 4 * np.sqrt(expected) + 17 * p * expected
        assert abs(found["row"][:, ALPHAS.index(alpha), j].sum() - expected) < margin


def quiet(t: float) -> np.ndarray[Any, Any]:
    return np.zeros(15)


def test_the_theory_of_consensus_is_the_corrected_threshold_without_memory() -> None:
    areas = network({"noise": "small", "worse": 4.0})
    *_, (_, last) = watch(areas, run_network(network_model(noise="small"), 3, [0], loads=quiet), MEMORYLESS)
    deviation = np.concatenate([last.deviation[0, :, 0], last.deviation_shared[0]])
    np.testing.assert_allclose(np.sum(list(theory(areas, "corrected", 0.0).values()), axis=0), deviation**2, rtol=1e-12)


def test_one_reading_alone_is_consensus_where_all_others_are_worthless() -> None:
    areas = network({"noise": "lit", "worse": 1e12})
    moments = list(run_network(network_model(), 20, [0, 1], loads=quiet))
    found = list(alone(areas, moments, CORRECTED.lam))
    agreed = [s.residual[..., 0] for _, s in watch(areas, moments, CORRECTED)]
    # the others' weight is 1e-12 of residuals of at most 1
    np.testing.assert_allclose(np.stack(found)[..., :15], np.stack(agreed), atol=1e-11)


@pytest.mark.parametrize("weights", [ALONE, "corrected", "paper"])
def test_theory_and_simulation_agree_on_the_variance_of_residuals(weights: str) -> None:
    task = {"noise": "small", "readings": "unequal", "worse": 16.0, "steps": 150, "seeds": list(range(20))}
    areas = network(task)
    runs = consensus_work(task)[f"{weights} 0.3"] / 141
    expected = np.sum(list(theory(areas, weights, 0.3).values()), axis=0)
    for mask in copies(areas).values():
        per_run = runs[:, mask].mean(axis=1)
        margin = 4.5 * per_run.std(ddof=1) / np.sqrt(20)  # standard errors over 20 runs, 6 groups: by luck 1 in 1000
        assert abs(per_run.mean() - expected[mask].mean()) < margin


def numbered(who: Any) -> list[int]:
    return [int(i) + 1 for i in np.flatnonzero(who)]


def test_a_change_reaches_neighbours_and_the_copies_that_others_hold_of_their_angles() -> None:
    model = network_model(unplugged=("15",))
    for event, near, beyond in ((LEAVES, [3, 4, 5, 13], [2, 6, 12, 14]), (JOINS, [14, 15], [13])):
        found = changes(model, event)
        assert all(numbered(found[what]) == near for what in ("model", "weights", "thresholds"))
        assert numbered(found["copies"]) == beyond


def test_diagnosers_that_are_replugged_follow_a_change_without_a_trace() -> None:
    model = network_model()
    quietly = list(run_network(model, 30, [0, 1], loads=quiet, switches=[Switch(20.0, unplug=("4",))]))
    # residuals are those of the noise alone: without its switch the same noise gives the same in an area far from it
    still = list(run_network(model, 30, [0, 1], loads=quiet))
    with_switch, without = (list(watch_switches(model, m, MANNERS[0])) for m in (quietly, still))
    np.testing.assert_allclose(with_switch[-1].residual[:, 8], without[-1].residual[:, 8], atol=1e-12)
    opened = np.isnan(quietly[-1].shared[0])
    assert opened.sum() == 6 and not with_switch[-1].residual_shared[:, opened].any()


def test_the_letter_of_the_paper_keeps_the_spring_of_an_open_tie() -> None:
    before, now = (network_areas(network_model(unplugged=away)) for away in ((), ("4",)))
    by_letter = switched(before, now, MANNERS[1])
    assert np.array_equal(by_letter.matrices, before.matrices) and np.array_equal(by_letter.slope, now.slope)
    assert switched(before, now, MANNERS[0]) is now and switched(before, now, MANNERS[2]) is before


def test_innovations_are_white_and_of_the_covariance_they_claim() -> None:
    runs, steps = 20, 60
    model = network_model(unplugged=("15",))
    found = innovations(model, run_network(model, steps, range(runs), loads=quiet))
    mine = owners(model) == 3
    assert found.sensors.size == 92  # area 15 and its one neighbour read each other's angles no more
    per_run = chi_square(found, mine)[SETTLE:].mean(axis=0)
    margin = 4.5 * per_run.std(ddof=1) / np.sqrt(runs)  # standard errors
    assert abs(per_run.mean() - mine.sum()) < margin
    z = standardised(found, mine)[SETTLE:]
    lag = np.mean(z[1:] * z[:-1])
    # z_k z_(k-1) of white z has variance 1, sensors correlated at worst wholly
    assert abs(lag) < 4.5 / np.sqrt(runs * (steps - SETTLE))


def test_a_delay_counts_from_the_onset_to_the_first_alarm_after_it() -> None:
    statistic = np.zeros((20, 3))
    onset = SETTLE + 5.0
    statistic[5, 0] = statistic[2, 1] = 9.0  # the reading at the onset is not yet changed
    statistic[6, 0] = statistic[9, 1] = 9.0
    delay, seen = delays(statistic, 1.0, onset)
    assert delay.tolist() == [1.0, 4.0, 14.0] and seen.tolist() == [True, True, False]
