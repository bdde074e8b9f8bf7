"""What a watch found, as JSON: one line an event, and one a sample."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.clock import Clock
from fusion_sfdia.core.detector import Decision
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.live.changes import Change
from fusion_sfdia.live.watch import Sample

Array = NDArray[Any]


def change_line(change: Change, clock: Clock) -> str:
    """{"event": "opened", "id": 1, "t": 30.0, "kind": "sensor", "hypothesis": "p_3", ...}: an event by its fields."""
    found = {"event": change.what, "id": change.id, **_when(change.t, clock)}
    if change.event is None:
        return _json({**found, "reason": change.reason})
    event = change.event
    stamps = {} if clock.start is None else {"start_time": clock.at(event.start), "end_time": clock.at(event.end)}
    known = {name: v for name, v in asdict(event).items() if name == "size" or (v not in ("", ()) and v == v)}
    return _json({**found, "kind": event.kind, **known, **stamps})


def sample_line(sample: Sample, plant: Plant, hypotheses: tuple[str, ...], clock: Clock) -> str:
    """{"event": "sample", "t": 30.0, "score": 0.7, "alarm": false, "isolated": [], "values": {...}, "sigma": {...}}."""
    d = sample.decision
    value, sigma = validated(plant, sample)
    found = {"event": "sample", **_when(sample.t, clock), "score": float(d.score), "alarm": bool(d.alarm)}
    flags = {name: bool(np.any(getattr(d, name))) for name in ("diverged", "guarded", "capped")}
    found |= {"isolated": [hypotheses[i] for i in np.flatnonzero(d.isolated)], **flags}
    for what, numbers in (("values", value), ("sigma", sigma)):
        found[what] = dict(zip(plant.sensor_names, map(float, numbers), strict=True))
    return _json(found)


def validated(plant: Plant, sample: Sample) -> tuple[Array, Array]:
    """The validated readings (N,) and their standard deviations (N,), in sensor units.

    A reading that is used is itself, with the noise of its sensor; one that is missing or isolated is what the method expects,
    with sigma^2 = H P H' of the estimate, NaN where the method has no covariance P.
    """
    d = sample.decision
    replaced = np.isnan(sample.y) | (d.reconstruction != sample.y)
    sigma = plant.sensor_sigma
    if replaced.any():
        expected = np.full_like(sigma, np.nan)
        if d.covariance is not None:
            h = plant.output_jacobian_at(sample.t, d.estimate, sample.u)
            expected = np.sqrt(np.maximum(np.sum((h @ d.covariance) * h, axis=-1), 0.0))
        sigma = np.where(replaced, expected, sigma)
    return d.reconstruction, np.where(np.isfinite(d.reconstruction), sigma, np.nan)


def sensor_verdicts(plant: Plant, y: Array, d: Decision) -> list[str]:
    """Of each sensor "isolated", "suspected", "missing" or "healthy"; "no verdict" where the estimate has diverged."""
    count = len(plant.sensors)
    suspect = np.zeros(count, bool) if d.suspect is None else d.suspect[:count]
    found = np.where(np.isnan(y), "missing", "healthy")
    found = np.where(suspect, "suspected", found)
    found = np.where(d.isolated[:count], "isolated", found)
    return list(map(str, np.where(d.diverged, "no verdict", found)))


def _when(t: float, clock: Clock) -> dict[str, Any]:
    return {"t": t} if clock.start is None else {"t": t, "time": clock.at(t)}


def _json(found: dict[str, Any]) -> str:
    return json.dumps({name: _finite(value) for name, value in found.items()}, ensure_ascii=False)


def _finite(value: Any) -> Any:
    """A value for JSON, in which infinities and NaN are null."""
    if isinstance(value, dict):
        return {name: _finite(v) for name, v in value.items()}
    return None if isinstance(value, float) and not np.isfinite(value) else value
