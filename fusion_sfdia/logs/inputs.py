"""The inputs of a log: held where missing, known and within their limits where a reading needs them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.log import require_within_limits
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.logs.columns import Source
from fusion_sfdia.logs.findings import Finding, counted
from fusion_sfdia.logs.log_map import AT_THE_SAMPLE, LogMap
from fusion_sfdia.logs.mix_ups import input_mix_up
from fusion_sfdia.logs.order import Rows

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


def before_the_first(rows: Rows, inputs: Sequence[Source], log_map: LogMap) -> Array:
    """The rows (K,) at the beginning where an input has had no value yet, which holding cannot fill."""
    early = np.zeros(rows.t.shape, dtype=bool)
    if log_map.hold > 0:
        for c in inputs:
            known = np.isfinite(rows.values[c.title])
            early |= np.arange(rows.t.size) <= (int(np.argmax(known)) if known.any() else -1)
    return early


def require_known(where: str, rows: Rows, c: Source, u: Array, plant: Plant, needed: Array, log_map: LogMap) -> None:
    """Raise ValueError, which names the row, for an input that is missing or beyond its limits in a row that is needed."""
    own = rows.rows if log_map.inputs != AT_THE_SAMPLE else np.concatenate([rows.rows[:1], rows.rows[:-1]])
    values = u[:, c.position]
    for k in np.flatnonzero(np.isnan(values) & needed)[:1]:
        text = "''; expected a finite number: an input must be known; " + (
            f"it is missing for longer than hold, {log_map.hold:g} s"
            if log_map.hold
            else "state hold in a map, for how long it keeps its last value (s)"
        )
        raise ValueError(f"{where}, row {own[k]}, column {c.title}: {text}")
    signal, usual = plant.inputs[c.position], float(np.median(values[needed])) if needed.any() else np.nan
    try:
        require_within_limits(where, plant, signal, values[needed], own[needed])
    except ValueError as error:
        mixed = None if signal.low <= usual <= signal.high else input_mix_up(values[needed], signal)
        hint = f": {c.name} {mixed.text}, as its nominal value is {signal.nominal:g}" if mixed else ""
        raise ValueError(f"{error}{hint}") from error


def timing(at_the_sample: bool) -> Finding:
    """The finding on when the inputs of a row act."""
    if at_the_sample:
        kind = "inputs shifted"
        text = 'inputs taken as acting from their row until the next (inputs = "at the sample", as historians log them)'
    else:
        kind = "inputs"
        text = 'inputs taken as having acted until their row (inputs = "until the sample", as simulate writes them)'
    return Finding(kind, "", 0, text)
