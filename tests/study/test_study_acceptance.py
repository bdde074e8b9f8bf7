"""The scenario `acceptance`: its limits, what is measured, one check in full; in `make test-long` all items with few runs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fusion_sfdia.detectors import registry
from fusion_sfdia.plant.log import Log
from fusion_sfdia.report.plots import style
from fusion_sfdia.study import acceptance as a
from fusion_sfdia.study.error_protocol import ErrorTrial, rest_of, trial
from fusion_sfdia.study.experiments.scenario import Arrays, Settings, Task, adjust
from fusion_sfdia.study.truths import Variation, varied

BIAS = a.BY_NAME["bias-10"]
EVERY = list(a.checks())


def check(item: str, case: str, plant: str = a.TANKS) -> a.Check:
    (found,) = (c for c in EVERY if (c.item, c.plant, c.name) == (item, plant, case))
    return found


def test_each_check_stands_once_and_has_a_limit() -> None:
    keys = [(c.item, c.plant, c.name) for c in EVERY]
    assert len(set(keys)) == len(keys) and all(c.limits for c in EVERY)
    assert {c.item for c in EVERY} == set(a.ITEMS) - {"P7"}


def test_the_limits_are_those_of_the_list() -> None:
    """As printed: shares of rows or runs, "at least" as negative numbers."""
    assert check("P1", "ar-0.8", a.PIPELINE).limits == {a.FALSE: 0.01} and check("P1", "outliers").limits == {a.FALSE: 0.05}
    assert check("P1", "ar-0.8", a.ENGINE)[3:7] == (400, 0, 640, 370)
    assert check("P2", "bias-3").limits == {a.EXACT: -0.8, a.AUC: pytest.approx(-0.863)}
    assert check("P2", "drift-10", a.NETWORK).limits == {a.EXACT: -0.6}
    assert check("P2", "process fault: leak, ar-0.8").limits == {a.FOUND: -0.9, a.FALSE: 0.02}
    slow = {a.short(c.case) for c in EVERY if c.item == "P2" and c.name.endswith(", ar-0.8") and c.case.stated}
    assert slow == {"leak", "injector-loss", "governor", "input-gain"}
    assert check("P3", "all-unknowns-off").limits == {a.EVER: 0.0} and check("P3", "all-unknowns-off").times * a.SEEDS == 96
    assert {tuple(c.limits.items()) for c in EVERY if c.item == "P4"} == {((a.EXACT, -0.85), (a.LATCHED, 0.05))}
    assert {c.limits[a.FALSE] for c in EVERY if c.item in ("P5", "P9")} == {0.02}
    assert {tuple(c.limits.items()) for c in EVERY if c.item == "P6"} == {((a.EXACT, -0.8), (a.NAMED, 0.0))}
    assert check("P8", "drift-10, after 600 rows of as-stated").limits == {a.EXACT: pytest.approx(-0.72)}
    assert check("P8", "process fault: injector-loss, after 600 rows of as-stated", a.ENGINE).limits[a.DELAY] == 4
    assert check("P8", "bias-under-ar-0.8, after 600 rows of ar-0.8").limits == {a.EXACT: -0.95}


def made_up() -> tuple[list[ErrorTrial], a.Seen]:
    """Two runs of 60 rows and 2 sensors: the first sensor fails in rows 20 to 30, in the second run the process differs too."""
    faulty = np.zeros((60, 2), bool)
    faulty[20:30, 0] = True
    differs = np.zeros((60, 2), bool)
    differs[10:, 1] = True
    log = Log(np.arange(60.0), np.zeros((60, 2)), np.zeros((60, 0)))
    made = [ErrorTrial(log, faulty, differs[:, b]) for b in range(2)]
    isolated = np.repeat(faulty[:, None], 2, axis=1)
    isolated[20:25, 0] = False  # half of the first fault is missed
    isolated[5:10, 1, 1] = True  # a healthy sensor, in rows that are not judged, and in the last rows
    isolated[54:, 1, 1] = True
    isolated[30:45, 0, 0] = True  # within the grace after a repair
    named = np.zeros((60, 2), bool)
    named[2:4, 1] = named[17:23, 1] = True  # too early, then 7 rows after the change
    return made, a.Seen(isolated, named, np.where(isolated.any(axis=-1), 2.0, 0.5))


@pytest.mark.parametrize(
    ("metric", "value"),
    [
        (a.FALSE, 6 / 100),
        (a.EXACT, 15 / 20),
        (a.NAMED, 3 / 20),
        (a.FOUND, 1 / 2),
        (a.LATCHED, 1 / 2),
        (a.EVER, 1.0),
    ],
)
def test_shares_are_of_the_rows_or_runs_that_they_name(metric: str, value: float) -> None:
    made, found = made_up()
    one = check("P1", "ar-0.5")._replace(rows=60, judged=10, limits={metric: 0.0})
    assert a.measured(one, made, found)[metric].value == pytest.approx(value)


def test_a_process_that_is_never_named_is_late_without_end() -> None:
    made, found = made_up()
    one = check("P1", "ar-0.5")._replace(rows=60, judged=10, limits={a.DELAY: 0.0, a.AUC: 0.0})
    assert a.measured(one, made, found)[a.DELAY].value == np.inf
    assert a.measured(one, made[1:], a.Seen(*(of[:, 1:] for of in found)))[a.DELAY].value == 7
    # scores are 2 in 15 of 20 faulty rows, and in 15 + 6 of the 80 healthy ones that are judged
    assert a.measured(one, made, found)[a.AUC].value == pytest.approx(0.75 * (59 / 80) + (0.75 * 21 + 0.25 * 59) / 160)


def test_a_cause_begins_and_lasts_as_stated() -> None:
    plant = registry.plant(a.TANKS)
    late = check("P4", "inflow -10 %, bias of 10 sigma 3 rows later")
    made = trial(plant, late.case, 4, 90, 40, 20)
    assert np.array_equal(np.flatnonzero(made.faulty.any(axis=-1)), np.arange(40, 60))
    assert np.array_equal(np.flatnonzero(made.process), np.arange(37, 90))
    step = trial(plant, a.BY_NAME["process-then-bias-5"], 4, 90, 40, 20)
    assert np.array_equal(np.flatnonzero(step.faulty.any(axis=-1)), np.arange(40, 60))
    assert np.array_equal(np.flatnonzero(step.process), np.arange(35, 55))


def test_at_rest_is_where_a_plant_stays() -> None:
    """Levels (inflow / outlet)^2 of the outlets that are off."""
    plant = registry.plant(a.TANKS)
    found = rest_of(varied(plant, [Variation("outlet_1", 6e-5), Variation("outlet_2", -6e-5)]))
    nominal = {p.name: p.nominal for p in plant.uncertainty.parameters}
    levels = (plant.input_at(0.0)[0] / np.array([nominal["outlet_1"] + 6e-5, nominal["outlet_2"] - 6e-5])) ** 2
    np.testing.assert_allclose(found, levels, rtol=1e-6)


def test_the_house_rests_under_its_usual_power_and_its_meter_reads_that() -> None:
    house = a.house()
    u = np.array([[a.POWER_USUAL]])
    np.testing.assert_allclose(house.step(0.0, house.x0[None], u, house.dt)[0], house.x0, rtol=1e-12)
    np.testing.assert_array_equal(house.output(0.0, house.x0[None], u)[0], [*house.x0, a.POWER_USUAL])
    made = a.trials(check("P6", "meter-24", a.HOUSE), house, 0, 2)
    assert all(one.faulty[100:160, 2].all() and not one.faulty[:, :2].any() for one in made)


def test_two_biases_of_two_tanks_are_judged_in_full() -> None:
    """One check as the scenario makes it; seeds below 1000."""
    one, plant = check("P4", "two-biases"), registry.plant(a.TANKS)
    made = a.trials(one, plant, 3, 1)
    found = a.measured(one, made, a.seen(registry.detector(a.DETECTOR, plant), made))
    assert found[a.EXACT].value >= 0.85 and found[a.LATCHED].value == 0


def results(**changes: str) -> list[tuple[Task, Arrays]]:
    """Arrays as of `work`, made up: each limit is just met, but the second of each item is missed by far."""
    found = []
    for task in a.tasks(settings(**changes), 24):
        same = [
            c
            for c in EVERY
            if (c.item, c.plant, c.log, c.log_rows) == tuple(task[k] for k in ("item", "plant", "log", "log_rows"))
        ]
        rows = [(c.name, m, limit) for c in same for m, limit in c.limits.items()]
        value = np.array([abs(limit) for *_, limit in rows])
        if task["plant"] == a.NETWORK:
            value = value + np.sign([limit for *_, limit in rows]) * 0.5
        found.append((task, {
            "condition": np.array([r[0] for r in rows]), "metric": np.array([r[1] for r in rows]), "value": value,
            "low": value - 0.1, "high": value + 0.1, "n": np.full(len(rows), 24), "limit": np.array([r[2] for r in rows]),
        }))  # fmt: skip
    return found


def settings(**changes: str) -> Settings:
    return adjust(a.SCENARIO, changes)


def test_a_verdict_compares_value_and_limit() -> None:
    summary = a.summarise(settings(), results())
    assert len(summary.rows) == sum(len(c.limits) for c in EVERY)
    verdicts = {a.verdict(r) for r in summary.rows if r.plant != a.NETWORK and np.isfinite(r.value)}
    assert verdicts == {"met"} and {a.verdict(r) for r in summary.rows if r.plant == a.NETWORK} == {"missed"}
    totals, missed, every = summary.tables
    assert len(totals.rows) == len(a.ITEMS) and len(missed.rows) < len(every.rows) == len(summary.rows)
    assert any("earlier" in remark for remark in summary.remarks)
    with style():
        assert not summary.every_figure


def test_unknown_items_and_plants_are_refused(tmp_path: Path) -> None:
    for change in ({"items": "P10"}, {"plants": "two-tank"}):
        with pytest.raises(ValueError, match=r"known:|did you mean"):
            a.tasks(settings(**change), 2)
    with pytest.raises(ValueError, match="expected a folder with a checkout"):
        a.tasks(settings(earlier=str(tmp_path)), 2)
    (tmp_path / "fusion_sfdia").mkdir()
    (tmp_path / "fusion_sfdia" / "__init__.py").touch()
    assert [t["item"] for t in a.tasks(settings(items="P7", plants=a.TANKS, earlier=str(tmp_path)), 2)] == ["P7"]


# missed in the committed run, with the reasons that docs/results/when-the-model-is-wrong.md states
KNOWN = {
    (a.PIPELINE, "cross-talk"),
    (a.TANKS, "process fault: leak, ar-0.8"),
    (a.NETWORK, "process fault: input-gain"),
    (a.NETWORK, "process fault: input-gain, ar-0.8"),
    *((a.TANKS, case.name) for case in a.two_causes()),
}


@pytest.mark.long
@pytest.mark.parametrize("item", [item for item in a.ITEMS if item not in ("P7", "P8")])
def test_the_acceptance_list_holds_with_few_runs(item: str) -> None:
    """No limit is outside of the 95 % interval of six runs, but those that are missed with many."""
    tasks = a.tasks(settings(items=item, first_seed="900000"), 6)
    rows = a.rows_of([(task, a.work(task)) for task in tasks])
    assert {(r.plant, r.condition) for r in rows if a.verdict(r) == "missed"} <= KNOWN
