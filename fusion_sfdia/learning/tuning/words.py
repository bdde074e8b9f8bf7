"""What tuning has found, for people, and what of it they should doubt."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from fusion_sfdia.common.rate import Rate
from fusion_sfdia.learning.commissioning.commission import Commissioning
from fusion_sfdia.learning.tuning.tail import Threshold
from fusion_sfdia.learning.tuning.tuned import Tuned

CHANGED = 0.2  # of a sensor's stated sigma: a change that is printed
FAR, COLOURED, WRONG, WIDE, UNSURE = 3.0, 0.15, 1.5, 2.0, 1.5  # beyond which a figure is remarked on
ABSURD = 10.0  # times the error that the plant as stated expects: together with one of the next, of a wrong unit, our choice
HUGE = 100.0  # standard errors of a window: the mean of a disturbance


def as_text(tuned: Tuned) -> str:
    """The result in lines: rate and thresholds, what was learnt, how well it predicts, delays."""
    q, d = tuned.quality, tuned.document
    achieved = q["achieved"]
    low, high = q["threshold_interval"]
    judged = "blocks that were not learnt" if "commissioned" in d else "each half with thresholds of the other"
    runs = f", in {q['runs']} runs" if q["runs"] > 1 else ""
    lines = [
        f"{tuned.detector_name} on {d['plant']['name']}, {q['samples']} healthy samples after {q['settle']} to settle{runs}",
        f"false alarms: {tuned.rate} stated, {q['expected_above']:.3g} samples in alarm expected in this log",
        f"  thresholds times {tuned.threshold_scale:.3g}, 95 % interval {low:.3g} to {high:.3g}, {q['threshold']}",
        f"  {judged}: {achieved['rate']} ({achieved['low']} to {achieved['high']}), "
        f"{achieved['samples_above']} samples in {achieved['alarms']} alarms",
    ]
    if "monitor" in q:
        m = q["monitor"]
        lines.append(
            f"  half of it is the model's, judged above, half the monitor's, of its sensors and {len(d['further'])} further "
            f"channels: {m['rate']:.2g} ({m['low']:.2g} to {m['high']:.2g}) of rows that were not learnt"
        )
    if q["expected_above"] < 1:
        lines.append(
            "  this rate cannot be counted on so short a log: it follows from the tail of the scores; a log of "
            f"{1 / float(d['detector']['per_sample']):.0f} samples or more would show one"
        )
    lines.append(f"learnt: {', '.join(q['learnt']) or 'nothing, the plant predicts this log as it is'}")
    lines += [f"  {line}" for line in _learnt(d)]
    return "\n".join([*lines, *_predictions(q, d), *(f"note: {remark}" for remark in q["remarks"])])


def _predictions(q: dict[str, Any], d: dict[str, Any]) -> list[str]:
    """How well the plant predicts, and the delays, where that was counted."""
    if "nis" not in q:
        return []
    lines = [
        f"predictions: NIS {q['nis']:.3f} (1 if right), was {q['nis_before']:.3f}",
        f"  whiteness: {100 * q['coloured']:.1f} % of autocorrelations outside their 95 % bands (5 if white), was "
        f"{100 * q['coloured_before']:.1f} %",
        f"delay of a bias, {q['delays']}:",
    ]
    for name in ("delay_3", "delay_10"):
        size, one = name.removeprefix("delay_"), q[name]
        lines.append(
            f"  {size} sigma: median {_delay(one['median'])}, worst sensor {_delay(one['worst'])}, "
            f"{100 * one['found']:.0f} % detected"
        )
    if late := [s for s, row in d["sensors"].items() if row["delay_10"] == float("inf")]:
        lines.append(
            f"  10 sigma of {', '.join(late[:8])}{f' and {len(late) - 8} more' * (len(late) > 8)} is not detected in time"
        )
    return lines


def _delay(seconds: float) -> str:
    return "not in time" if seconds == float("inf") else f"{seconds:g} s"


def _learnt(d: dict[str, Any]) -> list[str]:
    lines = [
        f"{name}: {row['value']:.5g} +- {row['sd']:.2g}, stated {row['stated']:.5g} +- {row['stated_sd']:.2g}"
        + (f" {row['unit']}" if row["unit"] != "1" else "")
        for name, row in d.get("parameters", {}).items()
        if abs(row["value"] - row["stated"]) > row["stated_sd"] or row["sd"] < row["stated_sd"] / 2
    ]
    lines += [
        f"{name}: {row['value']:.5g}, stated {row['stated']:.5g} +- {row['stated_sd']:.2g}"
        + (f" {row['unit']}" if row["unit"] != "1" else "")
        for name, row in d.get("commissioned", {}).items()
    ]
    lines += [f"process noise of states in {unit}: times {f:.3g}" for unit, f in d.get("process_noise", {}).items()]
    for name, row in d["sensors"].items():
        if abs((factor := row["sigma"] / row["stated"]) - 1) > CHANGED:
            lines.append(f"noise of {name}: {'quieter' if factor < 1 else 'noisier'} than stated, times {factor:.3g}")
    lines += [
        f"readings of {name}: in steps of {row['resolution']:.3g} {row['unit']}"
        for name, row in d["sensors"].items()
        if "resolution" in row
    ]
    lines += [
        f"noise of {name}: {100 * row['slow_share']:.0f} % of it slow, time constant {row['slow_time_constant']:.3g} s"
        for name, row in d["sensors"].items()
        if "slow_share" in row
    ]
    lines += [
        f"disturbance {i}: moves {one['moves']}; time constant {one['time_constant']:.3g} s"
        for i, one in enumerate(d.get("disturbance", []), start=1)
    ]
    return lines if len(lines) <= 20 else [*lines[:20], f"and {len(lines) - 20} more, see the file"]


def remarks(found: Commissioning, figures: Mapping[str, Any], limit: Threshold, rate: Rate) -> list[str]:
    """What a user should know before relying on a tuned plant; figures: of its quality, by name. rate: as stated."""
    away = {}
    if found.parameters is not None:
        size = np.abs(found.parameters.value - found.parameters.prior) / found.parameters.prior_sd
        away = {name: float(a) for name, a in zip(found.parameters.names, size, strict=True) if a > FAR}
    said = [
        f"{name} is {a:.1f} of its stated deviations off: the model may lack something, or a fault be hidden in it"
        for name, a in away.items()
    ]
    largest = max((abs(d.mean) for d in found.disturbances), default=0.0)
    if figures["nis_before"] > ABSURD**2 and (away or largest > HUGE):
        learnt = [f"{name} {a:.1f} of its stated deviations off" for name, a in away.items()]
        learnt += [f"a lasting disturbance of {largest:.3g} of its standard errors"] * (largest > HUGE)
        said.insert(
            0,
            "check the units of inputs and sensors: the plant as stated errs "
            f"{np.sqrt(figures['nis_before']):.2g} times as much as it expects (NIS, root), and this log is predicted only "
            f"with {', '.join(learnt)}, which is unlikely for the plant that was stated",
        )
    if figures["coloured"] > COLOURED:
        said.append(
            f"{100 * figures['coloured']:.0f} % of the autocorrelations of the prediction errors are outside their bands: the "
            "model lacks something, or a slow fault is in the log"
        )
    if not 1 / WRONG < figures["nis"] < WRONG:
        said.append(f"prediction errors are {np.sqrt(figures['nis']):.2g} times as large as the model expects (NIS, root)")
    achieved = figures["achieved"]
    if achieved["low"] != "0" and Rate.of(achieved["low"]).count > rate.count:
        said.append(
            f"with thresholds of one half of the log there are {achieved['rate']} in the other, where {rate} is stated: what "
            "is learnt in one half does not hold in the other. Give a log with all of its operation, or declare what is not "
            "known of the model (`uncertainty`), so that it is learnt"
        )
    if found.first_error > FAR**2:
        said.append(
            f"runs begin {np.sqrt(found.first_error):.2g} times as far from the plant's x0 as it expects (NIS, root), and no "
            "other start explains it: the first samples of a log may be in alarm. Begin logs when the plant has settled, or "
            "state x0 and initial_cov so that they hold where logs begin"
        )
    if limit.scale > WIDE:
        said.append(f"thresholds are {limit.scale:.2g} times those of a right model: small faults are not seen")
    if limit.high > UNSURE * limit.low:
        said.append("the threshold is uncertain by more than a factor of 1.5: a longer log would settle it")
    return said
