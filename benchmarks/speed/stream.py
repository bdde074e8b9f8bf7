"""bench stream: a step of one stream, no batch, of loo-glr and robust-glr on every plant.

step_time with quantity `one stream`; with the detector `none` that of the plant's model for one state (`step`, `Jacobian`,
`output`, `output Jacobian`) and of a matrix product of NumPy (`product of 256`). The `ratio` rows are the time of the stream
over that of the model step (condition `model step`: step and Jacobian) and over the matrix product, in the same run.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from fusion_sfdia import registry
from fusion_sfdia.benchmarks.speed.support.calls import Call, repeated_step, time_row
from fusion_sfdia.evaluation.results import Row
from fusion_sfdia.experiments.timing import Timing, best_times

DETECTORS = ("loo-glr", "robust-glr")
STREAM, MODEL_STEP, PRODUCT = "one stream", "model step", "product of 256"


def measure(seconds: float) -> list[Row]:
    """Every plant as it is registered, on healthy readings."""
    rows: list[Row] = []
    for name in registry.plants():
        plant = registry.plant(name)
        x, u, square = plant.x0[None], plant.input_at(0.0)[None], np.random.default_rng(0).standard_normal((256, 256))
        model: dict[str, Call] = {
            "step": partial(plant.step, 0.0, x, u, plant.dt),
            "Jacobian": partial(plant.step_jacobian_at, 0.0, x, u, plant.dt),
            "output": partial(plant.output, plant.dt, x, u),
            "output Jacobian": partial(plant.output_jacobian_at, plant.dt, x, u),
            PRODUCT: partial(np.matmul, square, square),
        }
        streams: dict[str, Call] = {d: repeated_step(registry.detector(d, plant)) for d in DETECTORS}
        times = best_times({**model, **streams}, seconds)
        of_step = Timing(times["step"].best + times["Jacobian"].best, min(times[k].calls for k in ("step", "Jacobian")))
        rows += [time_row("stream", plant, "none", q, "step_time", times[q]) for q in model]
        for detector in DETECTORS:
            time = times[detector]
            rows.append(time_row("stream", plant, detector, STREAM, "step_time", time))
            for what, reference in ((MODEL_STEP, of_step), (PRODUCT, times[PRODUCT])):
                rows.append(time_row("stream", plant, detector, STREAM, "ratio", time, 1 / reference.best, condition=what))
    return rows
