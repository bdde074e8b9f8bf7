"""How often faults are named as what they are: simulated faults of every kind, diagnosed, in a table of confusions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fusion_sfdia.common.random_streams import stream
from fusion_sfdia.detectors.detector import Detector
from fusion_sfdia.diagnosis.diagnose import diagnose_run
from fusion_sfdia.diagnosis.fault_effects import apply_faults
from fusion_sfdia.diagnosis.fault_kinds import KINDS
from fusion_sfdia.diagnosis.faults import WITHOUT_MAGNITUDE, Fault
from fusion_sfdia.diagnosis.simulate import simulate
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant

SAMPLES, ONSET = 160, 60  # of a log, and before a fault
LENGTH = (40, 70)  # samples of a fault
SIZE = (6.0, 20.0)  # of a fault, over the sigma of the sensor
RISE = (0.4, 1.0)  # of the length of a drift
SHARE = (0.1, 0.3)  # of the samples, with a spike
OTHERS = ("not named", "not found")


class KindTrial(NamedTuple):
    """A fault, as what it was named (a kind, or one of OTHERS), whether the 95 % interval of its size holds the true one (None
    without an interval), and how many other sensors had an event.
    """

    fault: Fault
    named: str
    covered: bool | None
    others: int


def drawn(kind: str, plant: Plant, seed: int) -> Fault:
    """A fault of a kind on a random sensor, of random size, length and shape."""
    rng = stream(seed, "fault kinds", KINDS.index(kind))
    i, samples = int(rng.integers(len(plant.sensors))), int(rng.integers(*LENGTH))
    size = float(rng.uniform(*SIZE) * plant.sensor_sigma[i]) * float(rng.choice([-1.0, 1.0]))
    magnitude = 0.0 if kind in WITHOUT_MAGNITUDE else size if kind in ("bias", "drift") else abs(size)
    length, rise, share = samples * plant.dt, float(rng.uniform(*RISE)), float(rng.uniform(*SHARE))
    return Fault(
        plant.sensor_names[i],
        kind,
        ONSET * plant.dt,
        length,
        magnitude,
        rise=rise * length if kind == "drift" else None,
        probability={"spikes": share, "dropout": float(rng.choice([0.7, 1.0]))}.get(kind, 1.0),
    )


def kind_trials(detector: Detector, seeds: Sequence[int]) -> list[KindTrial]:
    """Diagnose one fault of each of KINDS for each seed, each in a log of its own of 160 samples, from the 60th on.

    The fault counts as what the longest event of its sensor while it acts is named.
    """
    plant = detector.plant
    recording = simulate(plant, SAMPLES, seeds)
    found = []
    for run, seed in enumerate(seeds):
        for kind in KINDS:
            fault = drawn(kind, plant, seed)
            y = apply_faults(plant, recording.t, recording.y[:, [run]], [fault], seed).y[:, 0]
            events = diagnose_run(detector, Log(recording.t, y, recording.u_of_runs[:, run])).events
            sensors = [e for e in events if e.kind == "sensor"]
            own = [e for e in sensors if e.hypothesis == fault.sensor]
            acting = [e for e in own if e.end >= fault.onset and e.start < fault.onset + fault.length]
            best = max(acting, key=lambda e: e.end - e.start, default=None)
            covered = None
            if best is not None and best.fault == kind and kind not in WITHOUT_MAGNITUDE and np.isfinite(best.low):
                size = abs(fault.magnitude) if kind in ("noise", "spikes") else fault.magnitude
                covered = best.low <= size <= best.high or (kind == "spikes" and best.low <= -size <= best.high)
            named = OTHERS[1] if best is None else best.fault or OTHERS[0]
            found.append(KindTrial(fault, named, covered, len({e.hypothesis for e in sensors} - {fault.sensor})))
    return found


def confusion(trials: Sequence[KindTrial]) -> list[list[int]]:
    """How often a fault of each of KINDS (rows) was named as each of KINDS and OTHERS (columns)."""
    named = (*KINDS, *OTHERS)
    table = [[0] * len(named) for _ in KINDS]
    for trial in trials:
        table[KINDS.index(trial.fault.kind)][named.index(trial.named)] += 1
    return table
