"""A commissioned model and a monitor beside it: one verdict a row, on a log with more channels than the model has sensors."""

from __future__ import annotations

from dataclasses import fields
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from further_channels import TANKS, signals, wider
from numpy.typing import NDArray
from toy_plants import tanks
from wrong_laws import DT, drift, tank_cascade

from fusion_sfdia.detectors.detector import stack
from fusion_sfdia.detectors.verdicts import Verdict
from fusion_sfdia.diagnoser import detector
from fusion_sfdia.diagnosis.simulate import simulate
from fusion_sfdia.diagnosis.watch import Watch
from fusion_sfdia.learning.frozen_model.frozen_bank import FrozenBank
from fusion_sfdia.learning.model_and_monitor import ModelAndMonitor, Said, merged, with_further
from fusion_sfdia.learning.tuning.tune import tune
from fusion_sfdia.learning.tuning.tuned import Tuned
from fusion_sfdia.learning.tuning.words import as_text
from fusion_sfdia.logs.reading import load_log
from fusion_sfdia.plant.gaps import bridged
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.signals import Signal
from fusion_sfdia.report.log_figures import near

Array = NDArray[Any]

PLANT = tanks()
N = len(PLANT.sensors)
FURTHER = (Signal("scale", "kg"), Signal("both", "kg"), Signal("lamp", "1"))


@cache
def recorded(seed: int, steps: int = 900) -> Log:
    """A scale below a tank, one below both, and a lamp that is always on."""
    found = simulate(PLANT, steps, [seed], process_noise=True)
    rng, y = np.random.default_rng(seed), found.y[:, 0]
    more = np.stack([40 * y[:, 0], 25 * (y[:, 0] + y[:, 1]), np.ones(steps)], axis=1)
    return Log(found.t, np.concatenate([y, more + rng.standard_normal(more.shape) * [0.1, 0.1, 0.0]], axis=1), found.u)


@cache
def tuned() -> Tuned:
    return tune(PLANT, recorded(1, 700), false_alarm=0.01, further=FURTHER)


def with_bias(log: Log, i: int, rows: slice, size: float) -> Log:
    y = log.y.copy()
    y[rows, i] += size
    return log._replace(y=y)


SENSORS = ("a", "b", "zone")  # the model has the first two
PROCESS = ("fouling", "together", "outside")
NAMES = (*SENSORS, *PROCESS)


def held(text: str) -> Array:
    return np.isin(NAMES, text.split())


def said(text: str, judges: str) -> Said:
    """Of a text such as "a", "a?" (suspected), "fouling" or "outside"."""
    words = text.split()
    suspect = held(" ".join(w[:-1] for w in words if w.endswith("?")))
    named, process = (held(" ".join(w for w in words if w in of)) for of in (SENSORS, ("fouling", "together")))
    return Said(named, process, suspect, held(judges), "outside" in words, {"fouling?", "together?"} & {*words} != set())


@pytest.mark.parametrize(
    ("model", "monitor", "holds", "suspected"),
    [
        ("", "", "", ""),
        ("a", "a", "a", ""),
        ("a", "", "a", ""),
        ("a", "a? b?", "a", ""),
        ("a", "a? together?", "a", ""),
        ("a", "b", "", "a b"),
        ("a", "a zone", "a zone", ""),
        ("a", "zone", "", "a zone"),
        ("a", "b? zone?", "", "a b zone"),
        ("a", "together", "", "a together"),
        ("a", "outside", "a", ""),
        ("", "zone", "zone", ""),
        ("a? fouling?", "a", "", "a fouling"),
        ("a? b?", "a", "a", ""),
        ("fouling", "a", "", "a fouling"),
        ("fouling", "zone", "", "zone fouling"),
        ("outside", "zone", "", "zone outside"),
        ("fouling", "", "fouling", ""),
        ("fouling", "together", "fouling", ""),
        ("fouling", "zone? together?", "fouling", ""),
        ("fouling", "a? b?", "", "a b fouling"),
        ("a? fouling?", "a? b?", "", "a"),
        ("a? fouling?", "b? zone?", "", "a b zone fouling"),
        ("a? fouling?", "together", "", "a fouling together"),
        ("", "together", "together", ""),
        ("outside", "together", "together", ""),
        ("outside", "", "outside", ""),
        ("", "outside", "outside", ""),
    ],
)
def test_what_both_say_together(model: str, monitor: str, holds: str, suspected: str) -> None:
    found, suspect = merged(said(model, "a b"), said(monitor, "a b zone"), held("outside"))
    np.testing.assert_array_equal(found, held(holds))
    np.testing.assert_array_equal(suspect, held(suspected))


def test_two_that_each_only_one_can_judge_are_two_faults() -> None:
    found, suspect = merged(said("a", "a b"), said("zone", "b zone"), held("outside"))
    np.testing.assert_array_equal(found, held("a zone"))
    assert not suspect.any()


def test_a_further_channel_has_a_name_of_its_own() -> None:
    for name in (PLANT.sensor_names[0], PLANT.inputs[0].name):
        with pytest.raises(ValueError, match=f"sensors, inputs and further channels of plant 'two-tanks'.*{name}"):
            with_further(PLANT, (Signal(name),))
    with pytest.raises(ValueError, match="further channels are judged beside 'frozen-model', not 'robust-glr'; leave detector"):
        tune(PLANT, recorded(1), further=FURTHER, detector="robust-glr")
    assert with_further(PLANT, ()) is PLANT and with_further(PLANT, FURTHER).modelled == N


def test_both_are_learnt_and_the_rate_is_shared() -> None:
    found, built = tuned(), tuned().detector(PLANT)
    assert isinstance(built, ModelAndMonitor) and built.plant.sensor_names[N:] == tuple(s.name for s in FURTHER)
    assert str(found.rate) == "0.01" and built.model.fitted_rate == 0.005
    assert found.monitor is not None and found.monitor.rate.count == 0.005
    assert "monitor: lamp never moved when healthy; any other reading is reported" in found.quality["remarks"]
    assert "half the monitor's, of its sensors and 3 further channels" in as_text(found)


def test_a_fault_of_either_is_found_by_rows_and_at_once(tmp_path: Path) -> None:
    tuned().write(tmp_path / "tuned.toml")
    built = Tuned.read(tmp_path / "tuned.toml").detector(PLANT)
    log = with_bias(recorded(2, 160), N, slice(60, 90), 6.0)
    log = with_bias(log, 1, slice(120, 160), 12 * PLANT.sensor_sigma[1])
    log = log.rows(np.r_[:50, 55:160])  # with a gap
    log.y[40:43] = np.nan
    whole = detector(built).diagnose(log)
    state, rows = built.init((), 0.0), []
    track, _ = bridged(built.plant, log)
    at_once = built.steps(state, track.t, track.y, track.u)
    assert at_once is not None
    for t, y, u in zip(track.t.tolist(), track.y, track.u, strict=True):
        state, decision = built.step(state, t, y, u)
        rows.append(decision)
    for own in fields(by_rows := stack(rows)):
        one, two = (getattr(d, own.name) for d in (by_rows, at_once[1]))
        if one is not None:  # products of other shapes round differently
            np.testing.assert_allclose(one, two, rtol=1e-9, atol=1e-9, err_msg=own.name)
    after, ahead = (built.step(s, float(track.t[-1]) + PLANT.dt, log.y[-1], log.u[-1])[1] for s in (state, at_once[0]))
    np.testing.assert_array_equal(after.isolated, ahead.isolated)
    named = {e.hypothesis: e for e in whole.events if e.kind == "sensor"}
    assert {"scale", PLANT.sensor_names[1]} <= set(named)
    assert named["scale"].size == pytest.approx(6.0, rel=0.1)
    for name, label in (("scale", "over its"), (PLANT.sensor_names[1], "difference")):
        lower = near(built.plant, log.y, whole, [named[name]]).axes[1]
        assert lower.get_ylabel().startswith(label) and np.isfinite(lower.lines[0].get_ydata()).any()
    assert whole.health is not None and whole.health.sensors == N


def test_a_watch_goes_on_from_its_state_and_anew_after_a_long_gap(tmp_path: Path) -> None:
    built, log = tuned().detector(PLANT), with_bias(recorded(2, 100), N, slice(60, 90), 6.0)

    def watched(watch: Watch, rows: Log) -> list[str]:
        found = [s for t, y, u in zip(*rows, strict=True) for s in watch.update(t, y, u)]
        return [str(s.verdict) for s in (*found, *watch.finish())]

    first, last = log.rows(slice(70)), log.rows(slice(70, None))
    before = watched(watch := Watch(built), first)
    assert {*before[:55]} == {str(Verdict.HEALTHY)} and before[-1] == str(Verdict.SENSOR)
    watch.save(tmp_path / "watch.state")
    later = last._replace(t=last.t + 100_000.0)
    anew = watched(Watch(built), later)
    on, after_gap = (Watch.load(tmp_path / "watch.state", built, longest_gap=1000.0) for _ in range(2))
    assert watched(on, last)[:15] == [str(Verdict.SENSOR)] * 15 and watched(after_gap, later) == anew


def test_a_file_and_its_monitor_fit(tmp_path: Path) -> None:
    tuned().write(path := tmp_path / "tuned.toml")
    text = path.read_text()
    for old, new, error in (
        ("both = {", "twin = {", "its monitor is of the sensors .*'both'.*, the file of .*'twin'.*; tune again"),
        ('monitor = "tuned.sfdia"\n', "", "it has the further channels 'scale', 'both', 'lamp' and names no monitor of them"),
        ("tuned.sfdia", "other.toml", r"monitor is 'other.toml'; expected the name of an .sfdia file in the same folder"),
        ("tuned.sfdia", "../tuned.sfdia", r"monitor is '../tuned.sfdia'; expected the name of an .sfdia file in the same"),
        ("tuned.sfdia", "other.sfdia", "other.sfdia cannot be read"),
    ):
        path.write_text(text.replace(old, new))
        with pytest.raises(ValueError, match=error):
            Tuned.read(path)
    path.write_text(text)
    assert Tuned.read(path).logged_plant(PLANT).sensor_names[N:] == ("scale", "both", "lamp")
    assert isinstance(Tuned.read(path).model_detector(PLANT), FrozenBank)


def test_a_log_without_a_further_channel_is_refused_or_judged_by_the_others() -> None:
    pandas = pytest.importorskip("pandas")
    built, log = tuned().detector(PLANT), recorded(2, 100)
    frame = pandas.DataFrame(np.column_stack([log.t, log.y, log.u]))
    frame.columns = ["time", *built.plant.sensor_names, *(s.name for s in PLANT.inputs)]
    assert detector(built).diagnose(frame).state is Verdict.HEALTHY
    with pytest.raises(ValueError, match="no column for the sensors 'both' of plant 'two-tanks'"):
        detector(built).diagnose(frame.drop(columns="both"))
    read = load_log(frame.drop(columns="both"), built.plant, absent_sensors=True)
    assert [e.hypothesis for e in detector(built).diagnose(read).events if e.kind == "sensor"] == []
    moved = frame.assign(lamp=2.0)
    assert [e.hypothesis for e in detector(built).diagnose(moved).events][:1] == ["lamp (never moved when healthy)"]


@pytest.mark.long
def test_both_find_what_the_model_cannot_and_name_no_sensor_for_a_changed_process() -> None:
    base = tank_cascade()
    law, own = wider(base, TANKS), len(base.sensors)
    built = tune(base.plant(), law.record(3, 301, building=3), further=signals(law), false_alarm=0.01).detector(base.plant())
    count, further, outlet = len(law.sensors), law.sensors[own].name, 2

    def narrower(t: Array) -> Array:
        factor = np.ones((t.size, len(base.parameters)))
        factor[:, outlet] = 1 - 0.15 * np.clip((t / DT - 200) / 100, 0, 1)
        return factor

    cases = {"bias": {"bias": drift(own, count, 200 * DT, 1, 8.0, 10_000)}, "process": {"change": narrower}}
    found = {}
    for k, (name, fault) in enumerate(cases.items()):
        log = law.record(0.3, 310 + k, building=3, **fault)
        decided = built.steps(built.init((), 0.0), log.t, log.y, log.u)
        assert decided is not None
        found[name] = decided[1]
    names = np.array(built.hypotheses)
    assert not found["bias"].isolated[60:200].any()
    assert np.mean(found["bias"].isolated[220:, own]) > 0.9 and not found["bias"].isolated[220:, names != further].any()
    process = found["process"]
    assert process.process is not None and process.suspect is not None
    assert np.mean(process.isolated[220:].any(axis=1)) < 0.05
    assert np.mean((process.process | process.suspect[:, count:])[300:].any(axis=1)) > 0.5
