"""From a log of readings to a table of events, whatever the detector and whoever made the data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.detector import Decision, Detector, run

Array = NDArray[Any]


@dataclass(frozen=True)
class Event:
    """A hypothesis (mostly a sensor) held true from start to end (s); size in the sensor's unit, its median over the event.

    open: whether it was still held true at the end of the data.
    """

    hypothesis: str
    start: float
    end: float
    size: float
    unit: str
    open: bool


@dataclass(frozen=True)
class Diagnosis:
    """Events in order of their start, and the Decisions (time first) behind them with the times (K,)."""

    events: tuple[Event, ...]
    decisions: Decision
    t: Array


def diagnose(detector: Detector, t: Array, y: Array, u: Array, *, gap: int = 3) -> Diagnosis:
    """Run a detector over t (K,), y (K, N), u (K, m), NaN where missing, and gather what it isolated into events.

    Events of one hypothesis less than `gap` samples apart are one. ValueError where shapes or times do not fit.
    """
    t, y, u = np.asarray(t, dtype=float), np.asarray(y, dtype=float), np.asarray(u, dtype=float)
    if t.ndim != 1 or y.shape[:1] != t.shape or u.shape[:1] != t.shape or y.ndim != 2 or u.ndim != 2:
        raise ValueError(f"t {t.shape}, y {y.shape}, u {u.shape} do not fit; wanted (K,), (K, sensors), (K, inputs)")
    if not t.size:
        raise ValueError("there are no readings: t is empty; pass at least one time")
    first = float(t[0]) - (
        detector.plant.dt if len(t) < 2 or detector.plant.fixed_dt else min(detector.plant.dt, float(t[1] - t[0]))
    )
    _, decisions = run(detector, detector.init((), first), t, y, u)
    units = [s.unit for s in detector.plant.sensors] + [""] * (len(detector.hypotheses) - len(detector.plant.sensors))
    events = [
        Event(name, float(t[a]), float(t[b]), _median(decisions.fault_size[a : b + 1, i]), units[i], b == len(t) - 1)
        for i, name in enumerate(detector.hypotheses)
        for a, b in spans(decisions.isolated[:, i], gap)
    ]
    return Diagnosis(tuple(sorted(events, key=lambda e: (e.start, e.hypothesis))), decisions, t)


def spans(held: Array, gap: int = 1) -> list[tuple[int, int]]:
    """Return first and last index of each run of True in held (K,); runs fewer than `gap` samples apart are joined."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], held, [False]]).astype(int)))
    joined: list[tuple[int, int]] = []
    for a, b in zip(edges[::2].tolist(), (edges[1::2] - 1).tolist(), strict=True):
        if joined and a - joined[-1][1] - 1 < gap:
            joined[-1] = (joined[-1][0], b)
        else:
            joined.append((a, b))
    return joined


def _median(sizes: Array) -> float:
    known = sizes[np.isfinite(sizes)]
    return float(np.median(known)) if known.size else float("nan")
