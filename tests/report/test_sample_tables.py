from __future__ import annotations

from dataclasses import replace
from datetime import datetime
from functools import partial
from pathlib import Path
from zoneinfo import ZoneInfo

import numpy as np
import pandas
import pytest
from toy_plants import readings, tanks

from fusion_sfdia.common.clock import Clock
from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.diagnosis.diagnose import Diagnosis, diagnose_run
from fusion_sfdia.diagnosis.events import GroupEvent, OperationEvent, UndecidedEvent
from fusion_sfdia.diagnosis.quality_flags import FAIL, GOOD, MISSING, NOT_EVALUATED, SUSPECT, quality_flags
from fusion_sfdia.logs.columns import Source
from fusion_sfdia.logs.conversion import conversion
from fusion_sfdia.plant.log import Log
from fusion_sfdia.report.log_units import LogUnits
from fusion_sfdia.report.sample_tables import MOST_ROWS, RowTable, reconstructed, scores, write_rows

PLANT = tanks()
T, _, Y, U = readings(PLANT, 60, 1, seed=0)
BIASED = Y[:, 0] + 20 * PLANT.sensor_sigma * np.outer(T > 200, np.arange(4) == 2)  # q12 from the 41st row on
BIASED[5, 0] = np.nan
NIGHT = Clock(datetime(2026, 3, 29, 1, 59, tzinfo=ZoneInfo("Europe/Amsterdam")))  # a minute before summer time
COLUMNS = (
    Source("=FI12 [m3/h]", "q12", 2, False, "m3/h", conversion("m3/h", "m3/s")),
    Source("FI1", "inflow", 0, True, "l/s", conversion("l/s", "m3/s")),
)
UNITS = LogUnits(PLANT, COLUMNS)


@pytest.fixture(scope="module")
def found() -> Diagnosis:
    return diagnose_run(LeaveOneOutBank(PLANT, false_alarm=1e-6), Log(T, BIASED, U[:, 0]), clock=NIGHT)


def test_flags_follow_the_decisions_and_the_events(found: Diagnosis) -> None:
    flags = quality_flags(PLANT, BIASED, found)
    expected = np.full(BIASED.shape, GOOD)
    expected[5, 0], expected[40:, 2] = MISSING, FAIL
    first = int(np.argmax(np.all(np.isfinite(found.decisions.threshold), axis=1)))
    np.testing.assert_array_equal(flags[first:], expected[first:])
    (event,) = found.events
    perhaps = replace(found, events=(replace(event, confidence=0.3, start=T[20], end=T[22]),))
    assert quality_flags(PLANT, BIASED, perhaps)[20:23, 2].tolist() == [SUSPECT] * 3
    d = found.decisions
    blind = replace(
        found, events=(), decisions=replace(d, residual=np.full_like(d.residual, np.nan), isolated=d.isolated & False)
    )
    assert set(quality_flags(PLANT, BIASED, blind).ravel().tolist()) == {NOT_EVALUATED, MISSING}
    unlike = OperationEvent("operation", T[36], T[42], np.nan, "", False)
    both = quality_flags(PLANT, BIASED, replace(found, events=(event, unlike)))
    assert both[37].tolist() == [NOT_EVALUATED] * 4 and both[41].tolist() == [*[NOT_EVALUATED] * 2, FAIL, NOT_EVALUATED]
    together = GroupEvent("together", T[30], T[32], np.nan, "", False, (PLANT.sensor_names[1],))
    named = replace(event, hypothesis=PLANT.sensor_names[3], start=T[4], end=T[6], open=False)
    may_be = UndecidedEvent("q2 or l2", T[9], T[14], np.nan, "", False, (PLANT.sensor_names[3], PLANT.sensor_names[1]))
    judged = replace(d, residual=np.zeros_like(d.residual), threshold=np.ones_like(d.threshold), isolated=d.isolated & False)
    rows = quality_flags(PLANT, BIASED, replace(found, events=(together, may_be, named), decisions=judged))
    assert rows[30, :3].tolist() == [GOOD, NOT_EVALUATED, GOOD] and rows[33].tolist() == [GOOD] * 4
    assert rows[[3, 5, 7, 10, 30], 3].tolist() == [GOOD, FAIL, NOT_EVALUATED, SUSPECT, NOT_EVALUATED]
    absurd = replace(found, decisions=replace(d, absurd=np.outer(np.arange(60) == 30, np.arange(4) == 1)))
    assert quality_flags(PLANT, BIASED, absurd)[30].tolist() == [GOOD, FAIL, GOOD, GOOD]


@pytest.mark.parametrize("suffix", [".csv", ".xlsx", ".parquet"])
def test_each_kind_of_file_has_the_same_rows(found: Diagnosis, suffix: str, tmp_path: Path) -> None:
    texts = partial(pandas.read_csv, dtype=str)  # pandas 3.0 reads numbers to 13 digits
    read = {".csv": texts, ".xlsx": pandas.read_excel, ".parquet": pandas.read_parquet}[suffix]
    path = tmp_path / f"reconstructed{suffix}"
    write_rows(path, T.size, reconstructed(BIASED, U[:, 0], found, UNITS))
    frame = read(path)
    names = ["l1", "l2", "=FI12", "q2"]
    units = ["l1 [m]", "l2 [m]", "'=FI12 [m3/h]", "q2 [m3/s]"]
    flags = [f"{n} flag" for n in names]
    flags[2] = "'=FI12 flag"
    assert list(frame) == ["time [s]", *units, "FI1 [l/s]", "wall clock", *flags, "replaced"]
    made = found.decisions.reconstruction / np.array([1, 1, 1 / 3600, 1])
    np.testing.assert_allclose(frame[units].astype(float).to_numpy(), made, rtol=1e-15 * 4)
    np.testing.assert_allclose(frame["FI1 [l/s]"].astype(float), 1000 * U[:, 0, 0], rtol=1e-15 * 4)
    at = pandas.to_datetime(frame["wall clock"], utc=True)
    assert (at - at.iloc[0]).dt.total_seconds().tolist() == (T - T[0]).tolist()
    assert str(frame["wall clock"].iloc[-1]) == "2026-03-29 03:04:00+02:00"
    np.testing.assert_array_equal(frame[flags].astype(int).to_numpy(), quality_flags(PLANT, BIASED, found))
    assert frame["replaced"].iloc[-1] == "'=FI12"
    write_rows(tmp_path / f"scores{suffix}", T.size, scores(found, UNITS))
    assert float(read(tmp_path / f"scores{suffix}")["'=FI12 score"].iloc[-1]) > 1


def test_a_sheet_that_is_too_long_is_refused_before_it_is_written(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"a.xlsx: 1048577 rows and 1 columns; .* write .csv or .parquet"):
        write_rows(tmp_path / "a.xlsx", MOST_ROWS, RowTable(["x"], lambda rows: []))
    assert not list(tmp_path.iterdir())
