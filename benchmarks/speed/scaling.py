"""bench scaling: how time and memory grow with sensors and nodes; those of areas are in `bench network`, of workers in its own.

- `5 sensors` to `500 sensors`: a step of one stream of as many coupled states (see `support.coupled`);
- `21 nodes` to `2001 nodes`: predict and update of an ensemble on finer pipelines, every node read, and the model's part of it
  (condition `model`); at 201 nodes also the extended bank of 603 filters, and one of them (`one filter`).

peak_memory is that of NumPy's arrays in addition to those of the plant. The compiled model holds one more ensemble.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.benchmarks.speed.support.calls import (
    QUIET,
    Call,
    peak_memory,
    repeated_step,
    time_row,
    timed,
    timed_rows,
)
from fusion_sfdia.benchmarks.speed.support.coupled import coupled
from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.kalman_banks.central_filter import CentralFilter
from fusion_sfdia.detectors.kalman_banks.fusing_bank import FusingBank
from fusion_sfdia.filters import enkf
from fusion_sfdia.filters.estimators import Extended
from fusion_sfdia.filters.gaussian import sample
from fusion_sfdia.models.gas_pipeline.plant import gas_pipeline
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.report.results import Row

Array = NDArray[Any]

SENSORS = (5, 16, 50, 160, 500)
DETECTORS = ("loo-glr", "robust-glr")
NODES = (21, 81, 201, 801, 2001)
BANK_NODES = (201,)


def measure(seconds: float) -> list[Row]:
    """Banks of more and more sensors, the ensemble filter on finer and finer pipelines, the extended bank on one of them."""
    rows: list[Row] = []
    for sensors in SENSORS:
        plant = coupled(sensors)
        calls: dict[str, Call] = {name: repeated_step(registry.detector(name, plant)) for name in DETECTORS}
        for name, time in timed(calls, seconds).items():
            rows += timed_rows("scaling", plant.name, name, f"{sensors} sensors", time)
    for nodes in NODES:
        plant = gas_pipeline(nodes=nodes)
        rows += timed_with_memory(plant, "fusing-enkf", f"{nodes} nodes", *ensemble_calls(plant), "model", seconds)
    for nodes in BANK_NODES:
        plant = gas_pipeline(nodes=nodes)
        whole = repeated_step(FusingBank(plant, Extended(), thresholds=tuple((QUIET * plant.sensor_sigma).tolist())))
        one = repeated_step(CentralFilter(plant, Extended()))
        rows += timed_with_memory(plant, "fusing-ekf", f"{nodes} nodes", whole, one, "one filter", seconds)
    return rows


def timed_with_memory(
    plant: Plant, detector: str, where: str, whole: Call, other: Call, name: str, seconds: float
) -> list[Row]:
    """Time and memory of a call, and the time of another call."""
    names = ("scaling", plant.name, detector, where)
    rows = [time_row(*names, "peak_memory", peak_memory(whole), 1)]
    for condition, time in timed({"": whole, name: other}, seconds).items():
        rows += timed_rows(*names, time, condition=condition)
    return rows


def ensemble_calls(plant: Plant, members: int = enkf.EnKFSettings().size) -> tuple[Call, Call]:
    """Predict and update of an ensemble without any matrix of all states, and the model's step of it alone."""
    settings, rng = enkf.EnKFSettings(members), np.random.default_rng(0)
    u = plant.input_at(0.0)
    ensemble = plant.x0 + sample(plant.initial_cov, rng, (settings.size,))
    y = plant.output(0.0, plant.x0, u) + sample(plant.sensor_cov, rng)

    def advance(states: Array) -> Array:
        return plant.step(0.0, states, u, plant.dt)

    def step() -> Array:
        ahead = enkf.predict(ensemble, advance, plant.process_cov, rng)
        return enkf.update(settings, ahead, lambda s: plant.output(0.0, s, u), y, plant.sensor_cov, rng)

    return step, lambda: advance(ensemble)
