"""bench network: a step of all diagnosers of a network, by its areas, on one thread.

The reference of the ratios is `numpy.copyto` of as many bytes as the step reads and writes: the time in which they could be
moved at all. For more than 10 000 areas processor time, as a longer step is interrupted on a busy machine.
"""

from __future__ import annotations

from functools import partial
from time import perf_counter, thread_time

import numpy as np

from fusion_sfdia.benchmarks.network.scale import DETECTOR, LONG, network_of, stepping
from fusion_sfdia.benchmarks.speed.support.calls import time_row, timed, timed_rows
from fusion_sfdia.models.power_network.diagnosis import network_areas
from fusion_sfdia.report.results import Row

AREAS = (15, 1500, 150_000, 1_500_000)
COPY = "copy of its arrays"


def measure(seconds: float) -> list[Row]:
    """Networks of four sizes; the largest takes 3 GB."""
    rows = []
    for areas in AREAS:
        step, arrays = stepping(network_areas(network_of(areas), named=False))
        moved = sum(a.nbytes for a in arrays)
        half = np.ones(moved // 16)  # copyto reads one half and writes the other
        copy = partial(np.copyto, np.empty_like(half), half)
        clock = thread_time if areas > LONG else perf_counter
        time = timed({"step": step}, seconds, COPY, copy, clock)["step"]
        rows += timed_rows("network", "power-network", DETECTOR, f"{areas} areas", time)
        rows.append(time_row("network", "power-network", DETECTOR, f"{areas} areas", "peak_memory", float(moved), 1))
    return rows
