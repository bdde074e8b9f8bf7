"""What tuning has found, for people."""

from __future__ import annotations

from typing import Any

from fusion_sfdia.learning.tuning.tuned import Tuned

CHANGED = 0.2  # of a sensor's stated sigma: a change that is printed


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
