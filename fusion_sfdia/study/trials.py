"""Trials: simulated recordings with drawn faults, diagnosed by a detector, kept as the arrays that the metrics need."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.random_streams import stream
from fusion_sfdia.detectors.detector import Decision, Detector, run
from fusion_sfdia.diagnosis.fault_draws import FaultRange, draw_faults
from fusion_sfdia.diagnosis.fault_effects import apply_faults
from fusion_sfdia.diagnosis.simulate import Recording, simulate
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.study.estimation_metrics import measured_states

Array = NDArray[Any]
Arrays = dict[str, Array]

# of a faulty sensor: its reconstruction by the detector, its reading, and its reading without the fault
READINGS = ("accommodated", "faulty", "healthy")


@dataclass(frozen=True)
class Faulted:
    """Recordings with their faults: readings y (K, B, N), active (K, B, N) bool, size (K, B, N), and the recording."""

    recording: Recording
    y: Array
    active: Array
    size: Array


def faulted(
    plant: Plant,
    steps: int,
    seeds: Sequence[int],
    faults: str | FaultRange | None,
    quantity: str | None,
    *,
    count: int = 1,
    truth: Plant | str = "model",
    to_states: Callable[[Array], Array] | None = None,
    process_noise: bool = False,
    settle: int = 30,
) -> Faulted:
    """Simulate one run a seed with `count` random faults at once in each, none for faults=None.

    Their onset is after `settle` samples and early enough for a fault of 40 samples to end within the run.
    """
    recording = simulate(
        plant, steps, seeds, truth=truth, to_states=to_states, process_noise=process_noise,
        start="sampled" if process_noise else "nominal",
    )  # fmt: skip
    return with_faults(plant, recording, faults, quantity, count=count, settle=settle)


def with_faults(
    plant: Plant,
    recording: Recording,
    faults: str | FaultRange | None,
    quantity: str | None,
    *,
    count: int = 1,
    settle: int = 30,
) -> Faulted:
    """A recording with random faults in its readings, as of `faulted`."""
    if faults is None:
        nothing = np.zeros(recording.y.shape)
        return Faulted(recording, recording.y, nothing.astype(bool), nothing)
    lists = []
    for s in recording.seeds:
        rng = stream(s, "faults")
        onset = int(rng.integers(settle + 1, max(settle + 1, recording.t.size - 40), endpoint=True)) * plant.dt
        lists.append(draw_faults(faults, plant, rng, window=(onset, onset), count=count, quantity=quantity))
    changed = apply_faults(plant, recording.t, recording.y, lists, [int(s) for s in recording.seeds], signal=recording.signal)
    return Faulted(recording, changed.y, changed.active, changed.size)


def decide(detector: Detector, data: Faulted, *, covariance: bool = False, seed: int = 0) -> Decision:
    """Run a detector over the recordings as one batch."""
    recording = data.recording
    runs = data.y.shape[1]
    start = detector.init((runs,), float(recording.t[0]) - detector.plant.dt, seed)
    return run(detector, start, recording.t, data.y, recording.u_of_runs, covariance=covariance)[1]


def outcome(plant: Plant, data: Faulted, decision: Decision) -> Arrays:
    """Arrays of a trial: the truth and the decisions of a detector, small enough to keep.

    residual, score (K, B, Q): the largest |residual| and |residual| / threshold in each quantity. alarm (K, B).
    isolated, active (K, B, N) packed into bits. square_error (K, B, Q): mean over the states read by the quantity's
    sensors. reading_square_error (K, B, 3): mean over the faulty sensors for READINGS, NaN where none is. size_error (K, B):
    relative error of the isolated fault's size, NaN where there is none. diverged, guarded (B,).
    """
    groups = list(plant.quantities.values())
    scores, residual = decision.scores, np.nan_to_num(np.abs(decision.residual), nan=0.0)
    error = np.full((*scores.shape[:2], len(groups)), np.nan)
    if data.recording.x is not None:
        with np.errstate(over="ignore"):  # of a run that has diverged, which is counted as such
            square = (decision.estimate - data.recording.x) ** 2
        read = measured_states(plant)
        for q, quantity in enumerate(plant.quantities):
            error[..., q] = square[..., read[quantity]].mean(axis=-1)
    found = data.active & decision.isolated[..., : len(plant.sensors)] & np.isfinite(data.size) & (data.size != 0)
    off = np.where(found, np.abs(decision.fault_size / np.where(found, data.size, 1.0) - 1), 0.0)
    count = found.sum(axis=-1)
    return {
        "residual": np.stack([residual[..., members].max(axis=-1) for members in groups], axis=-1),
        "score": np.stack([scores[..., members].max(axis=-1) for members in groups], axis=-1),
        "alarm": decision.alarm,
        "isolated": np.packbits(decision.isolated[..., : len(plant.sensors)], axis=-1),
        "active": np.packbits(data.active, axis=-1),
        "square_error": error,
        "reading_square_error": _reading_errors(decision, data),
        "size_error": np.where(count > 0, np.sum(off, axis=-1) / np.maximum(count, 1), np.nan),
        "diverged": decision.diverged.any(axis=0),
        "guarded": decision.guarded.mean(axis=0),
    }


def _reading_errors(decision: Decision, data: Faulted) -> Array:
    """Mean over the faulty sensors of the squared error of READINGS against the noise-free signal (K, B, 3)."""
    faulty = data.active.sum(axis=-1)[..., None]
    readings = np.stack([decision.reconstruction, data.y, data.recording.y], axis=-1)
    square = (readings - data.recording.signal[..., None]) ** 2
    total = np.where(data.active[..., None], square, 0.0).sum(axis=-2)
    return np.where(faulty > 0, total / np.maximum(faulty, 1), np.nan)


def unpack(arrays: Arrays, what: str, sensors: int) -> Array:
    """Return isolated or active (K, B, N) as bool."""
    return np.unpackbits(arrays[what], axis=-1, count=sensors).astype(bool)


def join(parts: Sequence[Arrays]) -> Arrays:
    """Return the trials of several tasks as one: runs side by side (the axis of seeds is the last but what is per sensor)."""
    axes = {"diverged": 0, "guarded": 0}
    return {name: np.concatenate([p[name] for p in parts], axis=axes.get(name, 1)) for name in parts[0]}
