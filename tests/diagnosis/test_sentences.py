"""Sentences of a diagnosis: what was wrong, how much, from when to when, whether it is over, and what to check."""

from __future__ import annotations

import json
from dataclasses import replace
from datetime import datetime
from zoneinfo import ZoneInfo

import numpy as np
import pytest
from process_bank import ProcessBank
from toy_plants import tanks

from fusion_sfdia.common.clock import Clock
from fusion_sfdia.detectors import registry
from fusion_sfdia.diagnosis.changes import Change
from fusion_sfdia.diagnosis.events import Event, OperationEvent, ProcessEvent, UndecidedEvent, UnnamedEvent
from fusion_sfdia.diagnosis.sentences import Wording, by_importance, counted, sentence, size_of, wordings
from fusion_sfdia.live.lines import change_line
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Sensor

NIGHT = Clock(datetime(2026, 3, 1, 2, 7, tzinfo=ZoneInfo("Europe/Amsterdam")))
WORDS = {
    "TT04": Wording("sensor", "TT04", "Mixed-air temperature"),
    "l1": Wording("sensor", "l1", check="Tap the float"),
    "outlet": Wording("parameter", "outlet", high=5e-4),
    "error of inflow": Wording("input", "inflow", "flow of the pump", low=-1e-3, high=1e-3),
    "equation of level": Wording("state", "level", "the tank"),
}
TT04 = Event("TT04", 0.0, 6720.0, 1.5, "K", False, fault="bias", low=1.3, high=1.7, sigmas=5.0, confidence=1.0)
OUTLET = ProcessEvent("outlet", 0.0, 6720.0, -3e-5, "m2.5/s", True, sd=5e-6, nominal=6e-4)
INFLOW = ProcessEvent("error of inflow", 0.0, 6720.0, 1e-4, "m3/s", False, sd=1e-5, nominal=0.0)


def test_a_sensor_is_told_as_a_technician_would() -> None:
    assert sentence(TT04, WORDS, NIGHT) == (
        "Mixed-air temperature TT04 read 1.5 K (1.3 to 1.7) too high from 2026-03-01 02:07 to 03:59; it reads as expected "
        "again. Check the sensor's wiring or calibration."
    )
    low = replace(TT04, hypothesis="l1", size=-1.5, low=-1.7, high=-1.3, open=True, confidence=0.6, alternatives=("TT04",))
    assert sentence(low, WORDS, NIGHT) == (
        "Sensor l1 probably has read 1.5 K (1.3 to 1.7) too low since 2026-03-01 02:07; the error persists. "
        "It may be mixed-air temperature TT04 instead. Tap the float."
    )
    assert sentence(TT04, {}, Clock()).startswith("Sensor TT04 read 1.5 K (1.3 to 1.7) too high from 0 s to 6720 s")


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ("drift", "drifted until it read 1.5 K (1.3 to 1.7) too high from"),
        ("freeze", "was stuck at one value from"),
        ("noise", "was noisy, by a standard deviation of 1.5 K (1.3 to 1.7), from"),
        ("spikes", "had spikes of 1.5 K (1.3 to 1.7) from"),
        ("dropout", "gave no readings from"),
        ("", "read 1.5 K (1.3 to 1.7) too high from"),
    ],
)
def test_each_kind_of_fault_has_its_words(fault: str, said: str) -> None:
    assert f"TT04 {said}" in sentence(replace(TT04, fault=fault), WORDS, NIGHT)


def test_an_event_that_was_not_seen_to_end_may_still_be_there() -> None:
    assert "; whether it is over is not known. " in sentence(TT04, WORDS, NIGHT, ended=False)
    closed = replace(OUTLET, hypothesis="equation of level", nominal=np.nan, open=False)
    assert sentence(closed, WORDS, NIGHT).startswith("Something that the model leaves out lowered the tank from")


def test_a_fault_found_again_after_a_pause_is_not_said_to_be_unknown() -> None:
    again = replace(TT04, start=7260.0, end=9000.0, open=True)
    assert "; it has been wrong again since 2026-03-01 04:08. " in sentence(TT04, WORDS, NIGHT, ended=False, after=(again,))
    other = replace(INFLOW, start=6780.0, end=7200.0, open=False)
    said = sentence(TT04, WORDS, NIGHT, ended=False, after=(other,))
    assert " explained the readings, and whether it is over is not known. " in said


@pytest.mark.parametrize(
    ("check", "said"), [("tap the float", "Tap the float."), ("pH: clean it", "pH: clean it."), ("Tap it!", "Tap it!")]
)
def test_what_to_check_is_a_sentence(check: str, said: str) -> None:
    assert sentence(TT04, WORDS | {"TT04": WORDS["TT04"]._replace(check=check)}, NIGHT).endswith(f" {said}")


def test_a_fault_that_another_finding_follows_is_not_said_to_be_over() -> None:
    def now(*after: Event, fault: str = "bias") -> str:
        return sentence(replace(TT04, fault=fault), WORDS, NIGHT, after=after).partition("; ")[2].partition(". ")[0]

    later, names = {"start": 6780.0, "end": 7200.0}, ("l1", "TT04")
    undecided = UndecidedEvent("l1 or TT04", 6780.0, 7200.0, np.nan, "", True, names)
    assert now(undecided) == "since 2026-03-01 04:00 it cannot be told whether it or sensor l1 is at fault"
    over = replace(undecided, open=False)
    assert now(over) == (
        "from 2026-03-01 04:00 to 04:07 it could not be told whether it or sensor l1 was at fault, and after 2026-03-01 04:07 "
        "it reads as expected again"
    )
    assert now(over, fault="freeze") == "its reading changes again"  # which is seen
    again = replace(TT04, start=7260.0, end=9000.0, open=True)
    inflow = "from 2026-03-01 04:00 to 04:07 an error of the recorded flow of the pump explained the readings"
    assert now(replace(INFLOW, **later), again) == f"{inflow}, and it has been wrong again since 2026-03-01 04:08"
    unfit = UnnamedEvent("none", 6780.0, 7200.0, np.nan, "", True)
    assert now(unfit) == "since 2026-03-01 04:00 the process has not fitted the model"
    assert now(replace(unfit, open=False), fault="noise").endswith(
        "did not fit the model, and after 2026-03-01 04:07 it is quiet again"
    )
    assert now(replace(OUTLET, **later)) == "since 2026-03-01 04:00 a change of outlet has explained the readings"
    other = replace(TT04, hypothesis="l1", alternatives=("TT04",), open=True, **later)
    assert now(other) == "since 2026-03-01 04:00 sensor l1 has been taken to be at fault"
    assert now(OperationEvent("none", 6780.0, 7200.0, np.nan, "", True)).endswith("has been unlike any healthy log")
    alone = replace(undecided, suspects=("TT04",))
    assert now(alone) == "it may still be wrong since 2026-03-01 04:00"


@pytest.mark.parametrize(("size", "sigmas"), [(0.0, 0.0), (1e-3, 0.003), (np.nan, np.nan)])
def test_a_size_of_none_is_not_printed(size: float, sigmas: float) -> None:
    text = sentence(replace(TT04, size=size, sigmas=sigmas), WORDS, NIGHT)
    assert text.startswith("Mixed-air temperature TT04 gave wrong readings from") and "(" not in text


def test_the_process_is_described_by_what_differs() -> None:
    assert sentence(OUTLET, WORDS, NIGHT) == (
        "Outlet has been 5.0 % (3.4 to 6.6) below its value in the model since 2026-03-01 02:07; no single sensor fault "
        "explains this. Check this part of the plant."
    )
    text = "Flow of the pump (inflow): the actual value was 1.0e-04 m3/s (8e-05 to 1.2e-04) above the recorded one from"
    assert sentence(INFLOW, WORDS, NIGHT).startswith(text)
    level = replace(OUTLET, hypothesis="equation of level", nominal=np.nan)
    text = sentence(level, WORDS, NIGHT)
    assert text.startswith("Something that the model leaves out has lowered the tank since") and "equation" not in text


def test_a_change_of_the_process_in_whose_place_sensors_were_named_is_said_to_have_seemed_so() -> None:
    instead = (TT04, replace(TT04, hypothesis="l1"))
    text = (
        "seemed to be the cause from 2026-03-01 02:07 to 03:59; faults of mixed-air temperature TT04 and sensor l1 explain the"
    )
    assert sentence(replace(OUTLET, open=False), WORDS, NIGHT, after=instead) == f"Outlet {text} readings better."
    assert sentence(INFLOW, WORDS, NIGHT, after=instead) == f"The recorded flow of the pump {text} readings better."


@pytest.mark.parametrize(
    "impossible",
    [
        replace(OUTLET, size=-9.6e-4),  # 160 % below
        replace(OUTLET, size=5.1e-4),  # beyond the limit that the plant states
        replace(OUTLET, size=4e-6),  # below its own standard deviation
        replace(INFLOW, size=2e-3),  # more than the range of the input
    ],
)
def test_a_size_that_cannot_be_is_not_printed(impossible: ProcessEvent) -> None:
    text = sentence(impossible, WORDS, NIGHT)
    assert size_of(impossible, WORDS) == "" and "%" not in text and "m3/s" not in text
    assert "different from the model" in text or "different from the recorded one" in text


def test_what_is_undecided_names_all_suspects_in_words() -> None:
    names = ("l1", "error of inflow", "equation of level", "TT04", "outlet")
    event = UndecidedEvent(" or ".join(names), 0.0, 60.0, np.nan, "", True, names)
    assert sentence(event, WORDS, NIGHT) == (
        "The readings have not shown since 2026-03-01 02:07 whether sensor l1 or the recorded flow of the pump or an "
        "unmodelled effect on the tank or mixed-air temperature TT04 or outlet is at fault. Check them on site, in this order."
    )
    assert sentence(UnnamedEvent("none", 0.0, 60.0, np.nan, "", True), WORDS, NIGHT).startswith("The process has not fitted")


def test_sensors_are_first_then_the_process_then_what_is_undecided() -> None:
    undecided = UndecidedEvent("l1", 0.0, 60.0, np.nan, "", True, ("l1",))
    large, unlikely = replace(TT04, hypothesis="l1", sigmas=-9.0), replace(TT04, confidence=0.3)
    likely = replace(TT04, confidence=0.6, sigmas=20.0)
    given = [undecided, OUTLET, unlikely, likely, TT04, large]
    assert by_importance(given) == [large, TT04, likely, OUTLET, undecided, unlikely]
    assert [sentence(replace(TT04, confidence=p), WORDS, NIGHT).split()[3] for p in (0.49, 0.5)] == ["perhaps", "probably"]
    assert by_importance([undecided, OUTLET], passing=[undecided]) == [OUTLET, undecided]
    brief = replace(TT04, end=TT04.start, sigmas=np.nan)  # as of a monitor, whose sizes have no sigma
    assert by_importance([brief, long := replace(TT04, hypothesis="l1", start=60.0, sigmas=np.nan)]) == [long, brief]
    assert counted([undecided, OUTLET, TT04, large]) == "2 faulty sensors, 1 process change, 1 unresolved alarm"


def test_a_line_of_a_watch_has_the_sentence() -> None:
    line = json.loads(change_line(Change(1, "opened", 0.0, TT04), NIGHT, WORDS))
    assert line["text"] == sentence(TT04, WORDS, NIGHT) and line["hypothesis"] == "TT04"


def test_words_are_what_the_plant_states() -> None:
    plant: Plant = tanks()
    named = replace(plant, sensors=(replace(plant.sensors[0], meaning="Level", check="Look."), *plant.sensors[1:]))
    assert isinstance(named.sensors[0], Sensor)
    words = wordings(ProcessBank(named, accept=(9, 99), false_alarm=1e-6))
    assert words["l1"] == Wording("sensor", "l1", "Level", "Look.") and str(words["l1"]) == "level l1"
    assert words["error of inflow"].part == "input" and words["error of inflow"].name == "inflow"
    robust = wordings(registry.detector("robust-glr", registry.plant("two-tanks")))
    assert str(robust["equation of level_1"]) == "an unmodelled effect on the level of the upper tank"
    assert robust["error of inflow"].high == pytest.approx(2e-3) and robust["leak"].check.startswith("Check the lower tank")


@pytest.mark.parametrize(
    ("start", "end", "said"),
    [
        (0.0, 6720.0, "from 2026-03-01 02:07 to 03:59"),
        (5.0, 125.0, "from 2026-03-01 02:07:05 to 02:09:05"),
        (5.25, 10.0, "from 2026-03-01 02:07:05.25 to 02:07:10"),
        (0.0, 86400.0, "from 2026-03-01 02:07 to 2026-03-02 02:07"),
        (60.0, 60.0, "at 2026-03-01 02:08"),
    ],
)
def test_times_are_as_exact_as_they_are_long(start: float, end: float, said: str) -> None:
    assert NIGHT.span(start, end) == said and NIGHT.zone == "Europe/Amsterdam"
    assert Clock().span(10.0, 1234567.5) == "from 10 s to 1234567.5 s" and Clock().zone == ""
