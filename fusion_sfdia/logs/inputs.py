"""The inputs of a log: held where missing, known and within their limits where a reading needs them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.logs.columns import Source, split_title
from fusion_sfdia.logs.loaded_log import Finding, counted, others
from fusion_sfdia.logs.log_map import AT_THE_SAMPLE, LogMap
from fusion_sfdia.logs.mix_ups import input_mix_up
from fusion_sfdia.logs.problems import Problems
from fusion_sfdia.logs.time_order import LogRows
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]


def held(t: Array, values: Array, name: str, log_map: LogMap, findings: list[Finding]) -> Array:
    """An input (K,) whose missing values are the last before, for as long as the map allows."""
    missing = np.isnan(values)
    if not missing.any() or log_map.hold == 0:
        return values
    last = np.maximum.accumulate(np.where(missing, -1, np.arange(t.size)))
    filled = missing & (last >= 0)
    filled[filled] = t[filled] - t[last[filled]] <= log_map.hold
    if count := int(np.sum(filled)):
        findings.append(Finding("held", name, count, f"{counted(count, f'{name} value')} held"))
    return np.where(filled, values[np.maximum(last, 0)], values)


def before_the_first(rows: LogRows, inputs: Sequence[Source], log_map: LogMap) -> Array:
    """The rows (K,) at the beginning where an input has had no value yet, which holding cannot fill."""
    early = np.zeros(rows.t.shape, dtype=bool)
    if log_map.hold > 0:
        for c in inputs:
            known = np.isfinite(rows.values[c.title])
            early |= np.arange(rows.t.size) <= (int(np.argmax(known)) if known.any() else -1)
    return early


def require_known(problems: Problems, rows: LogRows, c: Source, u: Array, plant: Plant, needed: Array, log_map: LogMap) -> None:
    """Add to problems an input that is missing or beyond its limits in rows that are needed."""
    own = rows.rows if log_map.inputs != AT_THE_SAMPLE else np.concatenate([rows.rows[:1], rows.rows[:-1]])
    values, signal = u[:, c.position], plant.inputs[c.position]
    missing = np.flatnonzero(np.isnan(values) & needed)
    if missing.size:
        cure = (
            f"it is missing for longer than hold, {log_map.hold:g} s"
            if log_map.hold
            else "state hold in a map, for how long it keeps its last value (s)"
        )
        text = f"''{others(missing.size)}; expected a finite number: an input must be known; {cure}"
        problems.add("inputs", text, row=int(own[missing[0]]), column=c.title, count=missing.size)
    beyond = needed & ((values < signal.low) | (values > signal.high))
    if beyond.any():
        usual = float(np.nanmedian(values[needed]))
        mixed = None if signal.low <= usual <= signal.high else input_mix_up(values[needed & np.isfinite(values)], signal)
        hint = f": {c.name} {mixed.text}, as its nominal value is {signal.nominal:g}" if mixed else ""
        k, count = int(np.argmax(beyond)), int(beyond.sum())
        limits = f"plant {plant.name!r} holds from {signal.low:g} to {signal.high:g} {signal.unit}"
        text = f"{values[k]:g} {signal.unit}{others(count)}; {limits}; correct the input or convert its unit{hint}"
        problems.add("inputs", text, row=int(own[k]), column=split_title(c.title)[0], count=count)


def timing(at_the_sample: bool) -> Finding:
    """The finding on when the inputs of a row act."""
    if at_the_sample:
        kind = "inputs shifted"
        text = 'inputs taken as acting from their row until the next (inputs = "at the sample", as historians log them)'
    else:
        kind = "inputs"
        text = 'inputs taken as having acted until their row (inputs = "until the sample", as simulate writes them)'
    return Finding(kind, "", 0, text)
