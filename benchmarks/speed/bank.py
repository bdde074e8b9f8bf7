"""bench bank: a step of the whole bank against one filter and against filterpy.

step_time of a step of the whole bank (63 filters, mixture, diagnosis), of one with an alarm, which mixes twice, and of a single
filter. speedup with quantity `single` is a ratio of times, bank over one filter; with `filterpy` (model in NumPy, or under the
condition `compiled model`) it is 63 filterpy filters of 62 sensors, without mixture or diagnosis, over the bank.
"""

from __future__ import annotations

from fusion_sfdia.benchmarks.speed.support import against_filterpy
from fusion_sfdia.benchmarks.speed.support.calls import ALARMING, QUIET, Call, repeated_step, time_row, timed, timed_rows
from fusion_sfdia.detectors.kalman_banks.central_filter import CentralFilter
from fusion_sfdia.detectors.kalman_banks.fusing_bank import FusingBank
from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.learning.builders import PAPER_FILTERS
from fusion_sfdia.models.gas_pipeline.plant import gas_pipeline
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.report.results import Row

FILTERPY_TIMED = 3  # of its filters, scaled to all of them: each costs the same
ALARM, COMPILED = "alarm", "compiled model"  # conditions


def measure(seconds: float) -> list[Row]:
    """Banks on the pipeline of 21 nodes and 63 sensors."""
    plant = gas_pipeline()
    rows: list[Row] = []
    for kind, estimator in PAPER_FILTERS.items():
        quiet, alarming = (tuple((level * plant.sensor_sigma).tolist()) for level in (QUIET, ALARMING))
        ours: dict[tuple[str, str], Call] = {
            ("bank", ""): repeated_step(FusingBank(plant, estimator, thresholds=quiet)),
            ("bank", ALARM): repeated_step(FusingBank(plant, estimator, thresholds=alarming)),
            ("one filter", ""): repeated_step(CentralFilter(plant, estimator)),
        }
        theirs = filterpy_banks(kind, plant)
        times = timed({**ours, **{key: call for key, (call, _) in theirs.items()}}, seconds)
        whole, one = times["bank", ""], times["one filter", ""]
        names = ("bank", plant.name, f"fusing-{kind}")
        for q, c in ours:
            rows += timed_rows(*names, q, times[q, c], condition=c)
        for condition in ("", ALARM):
            time = times["bank", condition]
            rows.append(time_row(*names, "single", "speedup", time.best / one.best, time.calls, condition=condition))
        for (q, c), (_, factor) in theirs.items():
            time = times[q, c]
            rows += timed_rows(*names, q, time, factor, condition=c)
            rows.append(time_row(*names, q, "speedup", factor * time.best / whole.best, time.calls, condition=c))
    windows = {"loo-chi2": 1, "loo-glr": 15}
    single = timed({name: repeated_step(LeaveOneOutBank(plant, window=w)) for name, w in windows.items()}, seconds)
    return [*rows, *(row for name, time in single.items() for row in timed_rows("bank", plant.name, name, "bank", time))]


def filterpy_banks(kind: str, plant: Plant) -> dict[tuple[str, str], tuple[Call, float]]:
    """Calls of filterpy filters, each without one sensor, and the factor from those to all; by quantity and condition."""
    u, y = plant.input_at(0.0), plant.output(0.0, plant.x0, plant.input_at(0.0)) + 0.5 * plant.sensor_sigma
    models = {
        ("filterpy", ""): against_filterpy.numpy_model(plant, u),
        ("filterpy", COMPILED): against_filterpy.compiled_model(plant, u),
    }

    def some(model: against_filterpy.Model) -> Call:
        filters = [against_filterpy.step_call(kind, plant, model, y, without=i) for i in range(FILTERPY_TIMED)]
        return lambda: [call() for call in filters]

    return {key: (some(model), len(plant.sensors) / FILTERPY_TIMED) for key, model in models.items()}
