"""bench model: step_time of the pipeline's step and Jacobian, compiled and in NumPy, of one state and per state of a batch."""

from __future__ import annotations

from functools import partial

import numpy as np

from fusion_sfdia.benchmarks.speed.support.against_filterpy import numpy_model
from fusion_sfdia.benchmarks.speed.support.calls import Call, timed, timed_rows
from fusion_sfdia.models.gas_pipeline.plant import gas_pipeline
from fusion_sfdia.report.results import Row

BATCHES = (40, 127)  # members, and sigma points of 63 states


def measure(seconds: float) -> list[Row]:
    """The pipeline of 21 nodes: one step of 10 s, its Jacobian, and batches."""
    plant = gas_pipeline()
    u, x = plant.input_at(0.0), plant.x0
    in_numpy = numpy_model(plant, u)
    calls: dict[tuple[str, str], tuple[Call, int]] = {  # by quantity and condition: the call, its states
        ("step", ""): (partial(plant.step, 0.0, x, u, plant.dt), 1),
        ("Jacobian", ""): (partial(plant.step_jacobian_at, 0.0, x, u, plant.dt), 1),
        ("step", "NumPy"): (partial(in_numpy.step, x), 1),
        ("Jacobian", "NumPy"): (partial(in_numpy.jacobian, x), 1),
    }
    for size in BATCHES:
        many = np.repeat(x[None], size, axis=0)
        calls["step", f"per state of {size}"] = (partial(plant.step, 0.0, many, u, plant.dt), size)
        calls["step", f"NumPy, per state of {size}"] = (partial(in_numpy.step, many), size)
    times = timed({key: call for key, (call, _) in calls.items()}, seconds)
    return [
        row
        for (q, c), (_, size) in calls.items()
        for row in timed_rows("model", plant.name, "none", q, times[q, c], 1 / size, condition=c)
    ]
