"""Shared by the pipeline scenarios: tasks, the work of a task, and its arrays."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cache, partial
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.benchmarks.pipeline.support.forks import decisions
from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.detector import Detector
from fusion_sfdia.detectors.kalman_banks.fusing_bank import FEEDBACKS
from fusion_sfdia.diagnosis.fault_draws import PRESETS, FaultRange
from fusion_sfdia.diagnosis.simulate import Recording, simulate
from fusion_sfdia.learning.builders import fusing_bank
from fusion_sfdia.models.gas_pipeline.plant import PROCESS_NOISE, SIGMA, coarse_state, gas_pipeline
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.study.experiments.scenario import Arrays, Settings, Task, seed_blocks
from fusion_sfdia.study.trials import Faulted, outcome, with_faults

Array = NDArray[Any]
Results = Sequence[tuple[Task, Arrays]]

PLANT = "gas-pipeline"
PAPER = ("fusing-ekf", "fusing-ukf", "fusing-enkf")
OURS = ("loo-chi2", "loo-glr")
SINGLE = "kf-chi2"
SENSORS = 63
SETTLE = 30  # samples that are not judged: the filters forget their initial covariance
AFTERMATH = 40  # samples after a fault in which a filter that followed it recovers: not judged where thresholds vary
CHUNK = 25  # runs in one task
# truth: the paper's readings come from the filter's own model ("model"), others may come from a finer grid ("finer")
# process_noise: of the paper's filters, as printed ("nine-tenths" of the sensors' sigma) or "tenth"; ours have OWN
# feedback: of the paper's banks, "federated" or "printed"
COMMON: dict[str, Any] = {
    "steps": 360,
    "snr": "moderate",
    "process_noise": "nine-tenths",
    "feedback": "federated",
    "truth": "model",
}
OWN = "tenth"  # the plant's own process noise

KNOWN = {  # values of the settings that are names
    "snr": tuple(SIGMA),
    "levels": tuple(SIGMA),
    "process_noise": tuple(PROCESS_NOISE),
    "feedback": FEEDBACKS,
    "truth": ("model", "finer"),
    "faults": tuple(PRESETS),
}

STRENGTHS = (["strong-bias", "strong-drift"], ["weak-bias", "weak-drift"])  # of published.FAULTS: what one task has together
NEAR_NOISE: dict[str, tuple[str | FaultRange | None, int]] = {  # faults of a few sigma: name, range, how many at once
    "bias-3-sigma": (FaultRange("bias", (3, 3), "sigmas"), 1),
    "bias-5-sigma": (FaultRange("bias", (5, 5), "sigmas"), 1),
    "drift-3-sigma": (FaultRange("drift", (3, 3), "sigmas", hold=(10, 20)), 1),
    "three-8-sigma": (FaultRange("bias", (8, 8), "sigmas", length=(20, 20)), 3),
    "bias-30-percent": (FaultRange("bias", (0.3, 0.3), "relative"), 1),
}


def initial(detector: str) -> str:
    """P0 of a detector: the paper's identity for its Kalman filters. Its ensemble would leave the gas model with +-1 MPa."""
    return "identity" if detector in ("fusing-ekf", "fusing-ukf") else "noise"


@cache
def detector_on_pipeline(name: str, snr: str, process_noise: str, feedback: str) -> Detector:
    """A named detector on the paper's pipeline, built (and calibrated) once for all tasks of a process."""
    plant = gas_pipeline(snr=snr, process_noise=process_noise, initial=initial(name))
    bank = fusing_bank(plant, name.removeprefix("fusing-"), feedback=feedback) if name in PAPER else None
    return bank or registry.detector(name, plant)


def common(*without: str) -> dict[str, Any]:
    """The settings of COMMON, without some."""
    return {name: value for name, value in COMMON.items() if name not in without}


def grid(**values: Iterable[Any]) -> list[dict[str, Any]]:
    """Every combination of the values, the last name changing fastest, as dictionaries of one value each."""
    return [dict(zip(values, combination, strict=True)) for combination in product(*values.values())]


def steps(settings: Settings) -> int:
    """The length of a run in samples."""
    return int(str(settings["steps"]))


def require_settings(settings: Settings) -> None:
    """Raise ValueError for settings with which no run is possible, before the first run."""
    least = SETTLE + AFTERMATH + 5
    if steps(settings) < least:
        raise ValueError(f"setting steps is {settings['steps']}; a run with a fault needs at least {least} samples")
    for name, known in KNOWN.items():
        for value in np.atleast_1d(np.asarray(settings.get(name, known[0]))):
            if value not in known:
                raise ValueError(f"setting {name} is {str(value)!r}; known: {', '.join(known)}")


def cases(task: Task) -> list[tuple[str, str]]:
    """The cases of a task, each a fault and a quantity: the first axis of the arrays of `trial`."""
    return list(product(task["fault"], task["quantity"]))


def tasks(settings: Settings, cells: Iterable[dict[str, Any]], seeds: int) -> list[Task]:
    """One task per cell and CHUNK runs, with the settings of COMMON; ValueError for settings that `require_settings` refuses.

    The setting process_noise applies to the paper's filters; the other detectors have the plant's own.
    """
    require_settings(settings)
    common = {name: settings[name] for name in COMMON if name in settings}
    own = {"process_noise": OWN}
    return [
        common | (own if cell["detector"] in (*OURS, SINGLE) else {}) | cell | {"seeds": block}
        for cell in cells
        for block in seed_blocks(seeds, CHUNK)
    ]


def trial(task: Task, detector: Detector | None = None, truth: Plant | None = None) -> Arrays:
    """The runs of a task, recordings with the faults of its cases ("none" for healthy), through its detector.

    Arrays as in `outcome`, with an axis of the cases before the others.
    """
    if detector is None:
        detector = detector_on_pipeline(task["detector"], task["snr"], task["process_noise"], task["feedback"])
    if not task["accommodate"]:
        detector = detector.watching()
    plant = detector.plant
    # a truth of more nodes than the filter's model: its states at the filter's nodes
    to_states = partial(coarse_state, stations=len(plant.states) // 3) if isinstance(truth, Plant) else None
    source = task["truth"] if truth is None else truth
    recording = simulate(plant, task["steps"], task["seeds"], truth=source, to_states=to_states)
    data = [_with_fault(plant, recording, *case) for case in cases(task)]
    found = [outcome(plant, d, e) for d, e in zip(data, decisions(detector, data, task["seeds"][0]), strict=True)]
    return {name: np.stack([arrays[name] for arrays in found]) for name in found[0]}


def _with_fault(plant: Plant, recording: Recording, name: str, quantity: str) -> Faulted:
    fault, count = NEAR_NOISE.get(name, (None if name == "none" else name, 1))
    return with_faults(plant, recording, fault, None if quantity == "all" else quantity, count=count, settle=SETTLE)
