from __future__ import annotations

import json
from dataclasses import replace
from datetime import datetime
from zoneinfo import ZoneInfo

import numpy as np
import pytest
from diagnosis_schema import require_described
from process_bank import ProcessBank
from toy_plants import Array, readings, tanks

from fusion_sfdia.common.clock import Clock
from fusion_sfdia.diagnosis.diagnose import Diagnosis, diagnose_run
from fusion_sfdia.diagnosis.events import Event
from fusion_sfdia.logs.columns import Source
from fusion_sfdia.logs.conversion import conversion
from fusion_sfdia.logs.loaded_log import Finding, LoadedLog
from fusion_sfdia.plant.log import Log
from fusion_sfdia.report.document import as_json
from fusion_sfdia.report.log_page import About
from fusion_sfdia.report.log_units import LogUnits

NEVER = 10**6
PLANT = tanks()
T, _, Y, U = readings(PLANT, 40, 1, seed=0)
BIASED = Y[:, 0] + 20 * PLANT.sensor_sigma * np.outer(T > 100, np.arange(4) == 2)  # q12 from 105 s on
NIGHT = Clock(datetime(2026, 3, 29, 1, 59, tzinfo=ZoneInfo("Europe/Amsterdam")))  # a minute before summer time
FLOW = Source("FI12.PV [m3/h]", "q12", 2, False, "m3/h", conversion("m3/h", "m3/s"))


def found(y: Array, clock: Clock = NIGHT, **settings: object) -> Diagnosis:
    bank = replace(ProcessBank(PLANT, accept=(9, NEVER), doubt=(2, 6), between=(0, 5), false_alarm=1e-6), **settings)
    return diagnose_run(bank, Log(T, y, U[:, 0]), clock=clock)


def written(diagnosis: Diagnosis, *columns: Source) -> str:
    read = LoadedLog(Log(T, BIASED, U[:, 0]), diagnosis.clock, (Finding("rows", "", 40, "40 rows"),), columns=columns)
    return as_json(diagnosis, LogUnits(PLANT, columns), read, About("plant.csv", "process-bank"))


def undecided_of(diagnosis: Diagnosis) -> Event:
    return next(e for e in diagnosis.events if e.kind == "undecided")


def test_every_kind_of_event_is_as_the_schema_describes() -> None:
    diagnosis = found(BIASED)
    document = require_described(written(diagnosis, FLOW))
    assert (document["state"], document["verdict"]) == (diagnosis.state, diagnosis.verdict)
    assert document["health"]["suspect"] and document["health"]["text"] == diagnosis.health.line  # type: ignore[union-attr]
    assert document["headline"] == "1 faulty sensor, 1 process change, 1 unresolved alarm"
    assert document["caution"] == diagnosis.caution != ""
    sensor, process, undecided = document["events"]
    assert not any(e["passing"] for e in document["events"])
    resolved = replace(
        diagnosis, events=[diagnosis.events[0], replace(undecided_of(diagnosis), start=0.0, end=5.0, open=False)]
    )
    assert [e["passing"] for e in require_described(written(resolved))["events"]] == [False, True]
    assert process["kind"] == "process" and process["sd"] > 0 and process["in_log"] is None
    assert undecided["suspects"] == ["l1", "error of inflow"] and undecided["size"] is None
    assert (sensor["kind"], sensor["hypothesis"], sensor["open"]) == ("sensor", "q12", True)


def test_a_sensor_has_its_rows_its_times_and_what_the_log_calls_it() -> None:
    event = require_described(written(found(BIASED), FLOW))["events"][0]
    assert T[event["start_row"]] == event["start"] == 105.0 and T[event["end_row"]] == event["end"] == T[-1]
    assert event["start_time"] == "2026-03-29T03:00:45+02:00"
    assert event["text"].startswith(
        "Flow between the tanks FI12.PV has read 0.432 m3/h (0.421 to 0.443) too high since 2026-03-29"
    )
    of_log = event["in_log"]
    assert (of_log["tag"], of_log["unit"]) == ("FI12.PV", "m3/h")
    for name in ("size", "low", "high"):
        assert of_log[name] == pytest.approx(3600 * event[name], rel=1e-12)
    sensors = require_described(written(found(BIASED), FLOW))["sensors"]
    assert sensors[2] == {"name": "q12", "unit": "m3/s", "tag": "FI12.PV", "unit_in_log": "m3/h"}
    assert sensors[0] == {"name": "l1", "unit": "m", "tag": None, "unit_in_log": None}


@pytest.mark.filterwarnings("ignore:no readings of")
def test_without_a_wall_clock_times_are_null_and_unknown_numbers_too() -> None:
    text = written(found(np.full_like(BIASED, np.nan), Clock()))
    document = require_described(text)
    assert document["state"] == "blind" and document["readings"]["judged"] == 0
    assert document["readings"]["start_time"] is None and document["health"]["nis"] is None
    json.loads(text, parse_constant=lambda word: pytest.fail(f"{word} is not JSON"))
