"""Tuning on a small linear plant: noise is found, the rate is kept, a file gives the same decisions, bad logs are refused."""

from __future__ import annotations

import inspect
import random
import re
from dataclasses import replace
from datetime import datetime, timedelta, timezone
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from toy_plants import chain, readings

from fusion_sfdia.common.clock import Clock
from fusion_sfdia.common.rate import Rate
from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.detector import run
from fusion_sfdia.diagnosis.simulate import simulate
from fusion_sfdia.learning.tuning.tail import counted
from fusion_sfdia.learning.tuning.tune import HealthySource, tune, within
from fusion_sfdia.learning.tuning.tuned import ModelChangedWarning, Tuned
from fusion_sfdia.learning.tuning.words import as_text
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Signal
from fusion_sfdia.plant.slow_noise import SlowNoise

RATE, STEPS, RUNS = 0.02, 300, 4
PLANT = chain(4, process=0.3)
TRUE_SIGMA = 1.0, 3.0, 0.4, 1.0  # of sensors that all state 1
T = np.arange(0.0, 100.0, 10.0)
ZONE = timezone(timedelta(hours=1))
CLOCK = Clock(datetime(2026, 3, 1, 12, 0, tzinfo=ZONE))


def truth() -> Plant:
    sensors = tuple(replace(s, sigma=sigma) for s, sigma in zip(PLANT.sensors, TRUE_SIGMA, strict=True))
    return replace(PLANT, sensors=sensors)


@cache
def healthy(seed: int = 1, runs: int = RUNS) -> Log:
    t, _, y, u = readings(truth(), STEPS, runs, seed=seed)
    return Log(t, y, u)


@cache
def tuned(detector: str = "loo-glr") -> Tuned:
    return tune(PLANT, healthy(), false_alarm=RATE, detector=detector, made="2026-03-01")


def with_fault(sensor: int, since: int, change: Any) -> Log:
    log = healthy()
    y = log.y.copy()
    y[since:, :, sensor] = change(y[since:, :, sensor])
    return log._replace(y=y)


@pytest.mark.slow
def test_the_noise_of_each_sensor_is_found() -> None:
    found = tuned().plant(PLANT).sensor_sigma
    # relative standard error of a sigma by 1100 samples with half of their freedom: 1 / sqrt(2 * 550)
    np.testing.assert_allclose(found, TRUE_SIGMA, rtol=4 / np.sqrt(1100))
    assert [row["stated"] for row in tuned().document["sensors"].values()] == [1.0] * 4
    assert abs(tuned().quality["nis"] - 1) < 4 * np.sqrt(2 / (RUNS * STEPS * 4)) < 0.3 < abs(tuned().quality["nis_before"] - 1)


@pytest.mark.slow
def test_slow_noise_is_learnt_and_kept_in_the_file(tmp_path: Path) -> None:
    """White logs show none; the noise is stated in the text, and written and read as it is."""
    slow = replace(PLANT.sensors[1], noise=SlowNoise(0.9, 4.0))
    plant = replace(PLANT, sensors=(PLANT.sensors[0], slow, *PLANT.sensors[2:]))
    log = simulate(plant, STEPS, range(RUNS), process_noise=True)
    found = tune(PLANT, log, false_alarm=RATE, detector="loo-glr")
    found.write(tmp_path / "tuned.toml")
    kept = [s.noise for s in Tuned.read(tmp_path / "tuned.toml").plant(PLANT).sensors]
    assert kept[1] is not None and kept[0] is None and kept[2:] == [None, None]
    assert kept == [s.noise for s in found.plant(PLANT).sensors]
    assert re.search(r"^  noise of s1: \d+ % of it slow, time constant \S+ s$", as_text(found), re.MULTILINE)
    assert all(s.noise is None for s in tuned().plant(PLANT).sensors)


@pytest.mark.slow
def test_coarse_readings_are_learnt_as_such(tmp_path: Path) -> None:
    """In steps of three sigma most readings are equal: a step is no spike, and equal readings are not frozen."""
    t, _, y, u = readings(PLANT, STEPS, RUNS, seed=5)
    y[..., 2] = 3.0 * np.rint(y[..., 2] / 3.0)
    found = tune(PLANT, Log(t, y, u), false_alarm=RATE, detector="loo-glr")
    found.write(tmp_path / "tuned.toml")
    assert re.search(r"^  readings of s2: in steps of 3 ", as_text(found), re.MULTILINE)
    for plant in (found.plant(PLANT), Tuned.read(tmp_path / "tuned.toml").plant(PLANT)):
        assert [s.resolution for s in plant.sensors] == [0, 0, pytest.approx(3.0, rel=1e-9), 0]
        assert plant.sensor_sigma[2] > 3.0 / np.sqrt(12)
    y[200, 1, 2] += 30.0
    with pytest.raises(ValueError, match="'s2' contradicts all others"):
        tune(PLANT, Log(t, y, u), false_alarm=RATE, detector="loo-glr")
    t, _, y, u = readings(PLANT, STEPS, RUNS, seed=5)
    y[..., 2] = 5.0 * np.rint(y[..., 2] / 5.0)  # nine of ten are equal: a change is no spike, but errors come and go
    with pytest.raises(ValueError, match=r"not stationary: .* the error of sensor 's2'"):
        tune(PLANT, Log(t, y, u), false_alarm=RATE, detector="loo-glr")


@pytest.mark.slow
def test_fresh_readings_alarm_at_the_stated_rate() -> None:
    detector = tuned().detector(PLANT)
    assert detector.fitted_rate == RATE
    from fusion_sfdia.detectors.silent import silent, silent_scores

    scale = tuned().threshold_scale
    _, scores = silent_scores(silent(replace(detector, threshold_scale=1.0)), *healthy(2, 12))
    count = counted([scores[50:]], scale)
    assert count.low < 1.5 * RATE and count.high > RATE / 1.5  # the log itself leaves a factor of 1.5, see below
    low, high = tuned().quality["threshold_interval"]
    assert counted([scores[50:]], high).low < RATE < counted([scores[50:]], low).high


@pytest.mark.slow
def test_a_file_gives_the_same_decisions_to_the_bit(tmp_path: Path) -> None:
    tuned().write(tmp_path / "tuned.toml")
    again = Tuned.read(tmp_path / "tuned.toml")
    assert again.document == tuned().document
    with pytest.warns(ModelChangedWarning):
        again.plant(replace(PLANT, step=lambda t, x, u, dt: 0.9 * x))
    log = with_fault(1, 100, lambda y: y + 12.0)
    one, two = (run(d, d.init((RUNS,)), log)[1] for d in (tuned().detector(PLANT), again.detector(PLANT)))
    for name, value in vars(one).items():
        if value is not None:
            np.testing.assert_array_equal(value, getattr(two, name), err_msg=name)
    assert one.isolated[120, :, 1].all()


@pytest.mark.slow
def test_a_detector_that_learns_is_kept_beside_the_file(tmp_path: Path) -> None:
    found = tuned("limits")
    found.write(tmp_path / "tuned.toml")
    again = Tuned.read(tmp_path / "tuned.toml")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["tuned.npz", "tuned.toml"]
    one, two = (run(d, d.init((RUNS,)), healthy(3))[1] for d in (found.detector(PLANT), again.detector(PLANT)))
    np.testing.assert_array_equal(one.scores, two.scores)
    assert RATE / 3 < np.mean(one.score > 1) < 3 * RATE


@pytest.mark.slow
def test_the_text_states_rates_noise_and_delays() -> None:
    text = as_text(tuned())
    for line in (
        r"^loo-glr on chain, \d+ healthy samples after \d+ to settle, in 4 runs$",
        r"^false alarms: 0\.02 stated",
        r"^  noise of s1: noisier than stated, times (2\.9|3)",
        r"^  noise of s2: quieter than stated, times 0\.",
        r"^predictions: NIS (0\.9|1\.0)",
        r"^delay of a bias, simulated: biases added to these readings, 3 onsets a sensor, within 60 s:$",
        r"^  10 sigma: median [0-3] s, worst sensor .*, 100 % detected$",
    ):
        assert re.search(line, text, re.MULTILINE), f"{line}\n{text}"
    small, large = (tuned().quality[f"delay_{size}"] for size in (3, 10))
    assert large["median"] <= small["median"] and small["found"] <= large["found"] == 1


@pytest.mark.slow
def test_another_plant_is_refused_with_the_reason() -> None:
    state = replace(PLANT.states[0], unit="K") if PLANT.states[0].unit != "K" else Signal("other")
    for other, reason in (
        (replace(PLANT, name="other"), "name 'chain', this one 'other'"),
        (chain(5, process=0.3), "states 4, this one 5; 4 sensors, this one 5, other are s4"),
        (replace(PLANT, dt=2.0, numerics=replace(PLANT.numerics, fixed_dt=False)), "dt 1.0, this one 2.0"),
        (replace(PLANT, states=(state, *PLANT.states[1:])), "other names or units"),
        (truth(), r"sensor 's1' with a stated sigma of 1\.0, this one 3\.0"),
    ):
        with pytest.raises(ValueError, match=f"tuned for another plant than .*{reason}.*; tune again"):
            tuned().plant(other)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("log", "reason"),
    [
        (with_fault(1, 150, lambda y: y + 30.0), "'s1' contradicts all others"),
        (with_fault(0, 100, lambda y: y[:1] + 0 * y), "'s0' shows the same reading 200 times in a row"),
    ],
    ids=["bias", "freeze"],
)
def test_a_log_with_a_fault_is_refused(log: Log, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        tune(PLANT, log, false_alarm=RATE, detector="robust-glr")


def test_times_in_a_log_with_a_gap_are_those_of_its_clock() -> None:
    """The gap cuts runs of 100 samples, of which the last two are frozen across their border."""
    one = Log(*(a[:, 0] for a in (healthy().t[:, None], healthy().y, healthy().u)))
    y = one.y.copy()
    y[180:240, 0] = y[180, 0]
    log = Log(np.where(np.arange(STEPS) < 100, one.t, one.t + 1000), y, one.u)
    sources = [
        HealthySource("january.csv", Clock(datetime(2026, 1, 1))),
        HealthySource("july.csv", Clock(datetime(2026, 7, 1))),
    ]
    frozen = f"until {datetime(2026, 7, 1) + timedelta(seconds=log.t[239])}"
    with pytest.raises(ValueError, match=f"'s0' shows the same reading 60 times .*, {frozen}: it is frozen"):
        tune(PLANT, log, false_alarm=RATE, sources=sources[1:], detector="robust-glr")
    with pytest.raises(ValueError, match=f"'s0' .*, {frozen} of july.csv: it is frozen"):
        tune(PLANT, one, log, false_alarm=RATE, sources=sources, detector="robust-glr")


def test_the_default_detector_is_that_of_the_commands() -> None:
    assert inspect.signature(tune).parameters["detector"].default == registry.COMMISSIONED == "frozen-model"


def test_a_log_that_is_too_short_is_refused_with_the_shortest() -> None:
    with pytest.raises(ValueError, match=r"too short for 1/day .*: 1200 samples .* expected at least 2880 \(48 minutes\)"):
        tune(PLANT, healthy(), false_alarm="1/day", detector="robust-glr")
    with pytest.raises(ValueError, match="no stretch of 40 samples"):
        tune(PLANT, Log(*(a[:30] for a in healthy())), false_alarm=RATE, detector="robust-glr")


@pytest.mark.slow
def test_a_rate_that_the_log_cannot_count_is_extrapolated_and_stated() -> None:
    found = tune(PLANT, healthy(), false_alarm="2/hour", detector="loo-glr")
    assert found.rate == Rate(2.0, "hour")
    assert found.quality["expected_above"] < 1 and "Pareto" in found.quality["threshold"]
    assert "cannot be counted on so short a log" in as_text(found)
    assert found.threshold_scale > tuned().quality["threshold_interval"][1]
    low, high = found.quality["threshold_interval"]
    assert low < found.threshold_scale == 1.0 < high  # lower than the detector's own is not sure


JUNK = (
    "", "x", '"x"', "true", "[]", "{}", "-1", "0", "nan", "inf", "1e300", "1e999", "1979-05-27", "[1, 2]", '"nan"', "1_0",
    "0x10", '"a" = 1', "'", "9" * 30,
)  # fmt: skip


def spoiled(lines: list[str], seed: int) -> list[str]:
    """One mistake in a file: another value, a line too few or too many, the end cut off."""
    rng = random.Random(seed)
    k, kind = rng.randrange(len(lines)), rng.randrange(6)
    if kind < 3 and "=" in lines[k] and not lines[k].startswith("#"):
        key, value = lines[k].split("=", 1)
        old = rng.choice(re.findall(r"[^\s{},=]+(?=\s*[,}])", value) or [value])
        return [*lines[:k], f"{key}={value.replace(old, f' {rng.choice(JUNK)}', 1)}", *lines[k + 1 :]]
    if kind == 4:
        return lines[:k]
    return [
        *lines[:k],
        *([] if kind == 3 else [rng.choice((*JUNK, "[extra]", "[sensors]", "key = 1"))]),
        *lines[k + (kind == 3) :],
    ]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:the model of plant 'chain' has changed")
def test_generated_mistakes_in_a_file_are_refused_in_one_line_or_change_nothing_that_is_used(tmp_path: Path) -> None:
    tuned().write(tmp_path / "right.toml")
    lines, file = (tmp_path / "right.toml").read_text().splitlines(), tmp_path / "spoiled.toml"
    refused = 0
    for seed in range(500):
        file.write_text("\n".join(spoiled(lines, seed)) + "\n")
        try:
            sigma = Tuned.read(file).detector(PLANT).plant.sensor_sigma
            assert np.all((sigma > 0) & (sigma < 1e100)), seed
        except ValueError as error:
            refused += 1
            assert "\n" not in str(error) and len(str(error)) < 500, (seed, error)
    assert refused > 200


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("[plant]\nname = 'a'\n", r"no dt in \[plant\]"),
        ("a = 1\n", r"no \[plant\]"),
        (
            "[plant]\nname='a'\ndt=1.0\ndigest='a'\n[detector]\nname='a'\nthreshold_scale='x'\nfalse_alarm='1/day'\nper_sample=1e-3\n"
            "[sensors]\n[quality]\n",
            "threshold_scale is 'x'; expected a number",
        ),
    ],
)
def test_a_file_of_something_else_is_refused(text: str, reason: str, tmp_path: Path) -> None:
    (tmp_path / "x.toml").write_text(text)
    with pytest.raises(ValueError, match=rf"x\.toml.*{reason}"):
        Tuned.read(tmp_path / "x.toml")


@pytest.mark.parametrize(
    ("between", "first", "last"),
    [
        ("20..50", 20, 50),
        ("..50", 0, 50),
        ("20..", 20, 90),
        ("2026-03-01T12:00:15..2026-03-01 12:01", 20, 60),
        ("2026-03-01T11:00:15Z..45", 20, 40),
    ],
)
def test_a_stretch(between: str, first: float, last: float) -> None:
    inside = T[within(T, between, CLOCK)]
    assert (inside[0], inside[-1]) == (first, last)


@pytest.mark.parametrize(
    ("between", "clock", "reason"),
    [
        ("20-50", CLOCK, r"expected FROM\.\.TO, such as 0\.\.3600 \(s\) or 2026-03-01T"),
        ("200..300", Clock(), r"no reading from 200 to 300; the log goes from 0 s to 90 s"),
        ("a..50", CLOCK, "neither seconds nor such as 2026-03-01T14:20"),
        ("2026-03-01..50", Clock(), "the log has seconds alone"),
        ("2026-03-01T12:00Z..50", Clock(datetime(2026, 3, 1)), "has a zone, those of the log have none"),
    ],
)
def test_what_is_no_stretch_is_refused(between: str, clock: Clock, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        within(T, between, clock)
