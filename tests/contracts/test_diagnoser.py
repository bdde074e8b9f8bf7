"""`detector(...)`, what Python users begin with: fitted, over a log, row by row, and its result on a page."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import fusion_sfdia as sfdia
from fusion_sfdia.detectors.detector import Detector
from fusion_sfdia.diagnosis.prepared import prepared
from fusion_sfdia.faults import apply_faults
from fusion_sfdia.learning import fit
from fusion_sfdia.logs import check_log, write_log
from fusion_sfdia.logs.loaded_log import LoadedLog
from fusion_sfdia.plants import two_tanks

PLANT = two_tanks()
HEALTHY = sfdia.simulate(PLANT, 400, seeds=[1, 2], process_noise=True)


@pytest.fixture(scope="module")
def log() -> sfdia.Log:
    recording = sfdia.simulate(PLANT, 200, seeds=[3])
    bias = sfdia.Fault("l1", "bias", onset=500.0, length=250.0, magnitude=0.05)
    return sfdia.Log(recording.t, apply_faults(PLANT, recording.t, recording.y, [bias]).y[:, 0], recording.u)


def test_it_is_fitted_at_a_rate_a_day_and_diagnoses_as_the_pieces_do(log: sfdia.Log) -> None:
    fitted = sfdia.detector("limits", PLANT).fit(HEALTHY, false_alarm="172.8/day")  # of 17 280 samples of 5 s
    expected = fit("limits", PLANT, HEALTHY, 1e-2)
    assert PLANT.dt == 5.0 and fitted.detector == expected
    found = fitted.diagnose(log)
    loaded = LoadedLog(log, found.clock, ())
    assert repr(found.events) == repr(prepared(expected, loaded).diagnose()[0].events)
    assert np.array_equal(found.log.y, log.y, equal_nan=True) and found.detector == "limits"


def test_a_name_an_object_a_saved_one_and_itself_give_the_same(log: sfdia.Log, tmp_path: Path) -> None:
    by_name = sfdia.detector("loo-glr", "two-tanks")
    by_name.save(tmp_path / "glr.npz")
    loaded = sfdia.load_detector(tmp_path / "glr.npz", PLANT)
    assert isinstance(loaded, Detector)
    verdicts = {str(sfdia.diagnose(what, log)) for what in (by_name, by_name.detector, loaded, sfdia.detector(loaded))}
    assert verdicts == {str(sfdia.diagnose("loo-glr", log, plant=PLANT))} and "l1" in next(iter(verdicts))


def test_rows_one_after_another_find_what_the_log_shows(log: sfdia.Log) -> None:
    live = sfdia.detector("loo-glr", PLANT).stream()
    samples = [sample for row in zip(*log, strict=True) for sample in live.update(*row)] + [*live.finish()]
    isolated = np.array([sample.decision.isolated for sample in samples])
    assert np.array_equal(isolated, sfdia.diagnose("loo-glr", log, plant=PLANT).decisions.isolated)


def test_a_result_is_drawn_and_reported_in_the_tags_and_units_of_its_file(log: sfdia.Log, tmp_path: Path) -> None:
    write_log(tmp_path / "log.csv", PLANT, *log)
    text = (tmp_path / "log.csv").read_text()
    (tmp_path / "log.csv").write_text(text.replace("l1", "LT-101", 1))
    (tmp_path / "map.toml").write_text('[columns]\n"LT-101" = { sensor = "l1" }\n')
    with pytest.warns(UserWarning, match="inputs taken as acting from their row"):
        found = sfdia.diagnose("loo-glr", tmp_path / "log.csv", plant=PLANT, log_map=tmp_path / "map.toml")
    page = found.report(tmp_path / "x.html").read_text()
    assert "LT-101" in page and "log.csv" in page and "loo-glr" in page
    assert any("LT-101" in axes.get_ylabel() for axes in found.plot(tmp_path / "found.png").axes)
    assert (tmp_path / "found.png").read_bytes().startswith(b"\x89PNG")
    (tmp_path / "found.png").unlink()
    assert {p.name for p in tmp_path.iterdir()} == {"log.csv", "map.toml", "x.html"}
    with pytest.raises(ValueError, match=r"expected a file that ends in \.html"):
        found.report(tmp_path / "folder")


def test_a_rate_that_is_none_and_a_checked_log(log: sfdia.Log, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="a rate of false alarms is 0"):
        sfdia.detector("limits", PLANT).fit(HEALTHY, false_alarm=0)
    write_log(tmp_path / "log.csv", PLANT, *log)
    checked = check_log(tmp_path / "log.csv", PLANT)
    one = sfdia.detector("limits", PLANT)
    assert str(one.diagnose(checked)) == str(one.diagnose(tmp_path / "log.csv"))
    with pytest.raises(ValueError, match="log_map states how a file or a frame is written"):
        one.diagnose(log, log_map="map.toml")
