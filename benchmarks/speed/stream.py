"""bench stream: a step of one stream, no batch, of loo-glr and robust-glr on every plant.

step_time with quantity `one stream`; with the detector `none` that of the plant's model for one state (`step`, `Jacobian`,
`output`, `output Jacobian`) and of a matrix product of NumPy (`product of 256`). The `ratio` rows are the time of the stream
over that of the model step (condition `model step`: step and Jacobian) and over the matrix product, in the same run.
"""

from __future__ import annotations

from functools import partial

from fusion_sfdia.benchmarks.speed.support.calls import PRODUCT, Call, repeated_step, time_row, timed, timed_rows
from fusion_sfdia.detectors import registry
from fusion_sfdia.report.results import Row

DETECTORS = ("loo-glr", "robust-glr")
STREAM, MODEL_STEP = "one stream", "model step"


def measure(seconds: float) -> list[Row]:
    """Every plant as it is registered, on healthy readings."""
    rows: list[Row] = []
    for name in registry.plants():
        plant = registry.plant(name)
        x, u = plant.x0[None], plant.input_at(0.0)[None]
        model: dict[str, Call] = {
            "step": partial(plant.step, 0.0, x, u, plant.dt),
            "Jacobian": partial(plant.step_jacobian_at, 0.0, x, u, plant.dt),
            "output": partial(plant.output, plant.dt, x, u),
            "output Jacobian": partial(plant.output_jacobian_at, plant.dt, x, u),
        }
        streams: dict[str, Call] = {d: repeated_step(registry.detector(d, plant)) for d in DETECTORS}
        times = timed({**model, **streams}, seconds)
        step = times["step"].best + times["Jacobian"].best
        for quantity in model:
            rows += timed_rows("stream", plant.name, "none", quantity, times[quantity])
        rows.append(time_row("stream", plant.name, "none", PRODUCT, "step_time", times["step"].base, times["step"].calls))
        for detector in DETECTORS:
            time = times[detector]
            rows += timed_rows("stream", plant.name, detector, STREAM, time)
            over_step = time._replace(base=step, reference=MODEL_STEP)
            rows += timed_rows("stream", plant.name, detector, STREAM, over_step)[1:]
    return rows
