"""bench growth: how the work of a step grows with sensors, nodes, areas and seeds, counted and not timed.

Each workload is counted at three sizes in a process of its own, with its compiled code left in Python (see `support.counting`).
`growth` rows are exponents p of size^p, with what is counted as condition. One above that of `CASES` is an algebraic mistake: a
loop where arrays stood, a matrix of everything with everything, a product in the wrong order.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

from fusion_sfdia.benchmarks.speed.support.counting import CallWork, counted, growth
from fusion_sfdia.benchmarks.speed.support.processes import printed
from fusion_sfdia.common.run_statistics import NOTHING
from fusion_sfdia.report.results import Row, row_of

Call = Callable[[], object]

ABOVE = 0.15  # of an exponent over its expected value, for what is of lower order
COMMAND = (
    "from fusion_sfdia.benchmarks.speed.support.counting import install; install(); "
    "from fusion_sfdia.benchmarks.speed.growth import print_growth; print_growth()"
)


def sensors(detector: str, size: int) -> Call:
    """A step of a detector on so many coupled states, each with a sensor."""
    from fusion_sfdia.benchmarks.speed.support.calls import repeated_step
    from fusion_sfdia.benchmarks.speed.support.coupled import coupled
    from fusion_sfdia.detectors import registry

    return repeated_step(registry.detector(detector, coupled(size)), noise=False)  # which may have its own branches


def nodes(size: int) -> Call:
    """A step and an update of an ensemble of a pipeline of so many intervals between nodes, all of them read."""
    from fusion_sfdia.benchmarks.speed.scaling import ensemble_calls
    from fusion_sfdia.models.gas_pipeline.plant import gas_pipeline

    return ensemble_calls(gas_pipeline(nodes=size + 1, substeps=1, dt=1.0), members=2)[0]


def areas(size: int) -> Call:
    """A step of all diagnosers of a network of so many areas."""
    from fusion_sfdia.benchmarks.network.scale import network_of, stepping
    from fusion_sfdia.models.power_network.diagnosis import network_areas

    return stepping(network_areas(network_of(size), named=False))[0]


def seeds(size: int) -> Call:
    """The work of a comparison of one detector on one plant with so many seeds."""
    from fusion_sfdia.benchmarks.speed.support.coupled import coupled
    from fusion_sfdia.study.comparison.compare import scenario_of
    from fusion_sfdia.study.comparison.protocol import SETTINGS
    from fusion_sfdia.study.comparison.subjects import Subjects, compared_plant

    plant = compared_plant(coupled(2))
    scenario = scenario_of(Subjects(plants={plant.name: plant}))
    chosen = {"plants": (plant.name,), "detectors": ("limits",), "faults": ("bias",), "magnitudes": (10.0,), "lengths": ()}
    short = {"settle": 1, "window": 2, "false_alarm": 0.4, "calibration_error": 0.9}
    none = {"mismatch_cases": False, "process_faults": False}
    tasks = scenario.tasks({**SETTINGS, **chosen, **short, **none}, size)
    return lambda: [scenario.work(task) for task in tasks]


class Workload(NamedTuple):
    """A workload at a size, twice and four times that size, and the exponents that are expected of it."""

    detector: str
    quantity: str
    call: Callable[[int], Call]
    size: int
    expected: CallWork


CASES = (
    Workload("loo-glr", "sensors", partial(sensors, "loo-glr"), 16, CallWork(0, 3, 2)),
    Workload("robust-glr", "sensors", partial(sensors, "robust-glr"), 16, CallWork(0, 3, 2)),
    Workload("fusing-enkf", "nodes", nodes, 6, CallWork(0, 1, 1)),
    Workload("chebyshev:corrected", "areas", areas, 10, CallWork(0, 1, 1)),
    Workload("limits", "seeds", seeds, 5, CallWork(1, 1, 1)),
)


def print_growth(cases: Sequence[Workload] = CASES) -> None:
    """Print the exponents of all cases as JSON, in a process in which `install` was called."""
    found = []
    for case in cases:
        one, two, four = (counted(case.call(factor * case.size)) for factor in (1, 2, 4))
        exponents = CallWork(*map(growth, one, two, four))
        found.append(exponents._replace(memory=growth(0, two.memory, four.memory))._asdict())  # a largest value: no sum
    print(json.dumps(found))


def measure(seconds: float) -> list[Row]:
    """The exponents of all cases. Nothing is timed: the seconds have no effect."""
    rows = []
    for case, exponents in zip(CASES, printed(COMMAND), strict=True):
        for what, exponent in exponents.items():
            found = NOTHING._replace(value=exponent, n=3)
            rows.append(row_of("-", "bench/growth", case.detector, "none", case.quantity, "growth", found, condition=what))
    return rows


def excessive(rows: Sequence[Row]) -> list[str]:
    """A sentence for each exponent of `growth` rows above what is expected."""
    limits = {(c.detector, c.quantity): c.expected._asdict() for c in CASES}
    sentences = []
    for row in rows:
        if row.metric == "growth":
            limit = limits[row.detector, row.quantity][row.condition]
            if not row.value <= limit + ABOVE:
                sentences.append(
                    f"{row.detector}: {row.condition} grow with {row.quantity}^{row.value:.2f}; expected an exponent of {limit}"
                )
    return sentences
