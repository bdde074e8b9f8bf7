"""Published results of the marine engine: scenarios, detection times, indicators, fault sizes, signature matrices.

K24: Kougiatsos and Reppa 2024, sec. VII, Fig. 4 and 5, Tables I to VI. K22: Kougiatsos, Negenborn and Reppa 2022, sec. 5,
Fig. 3, Tables 1 to 3. Sources name figure, table or section and no page: our text of the papers has no pages.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from fusion_sfdia.models.marine_engine.modules import GAINS, OBSERVER_BOUNDS
from fusion_sfdia.plant.modules import ObserverBound
from fusion_sfdia.report.results import Published

K24, K22 = "Kougiatsos 2024", "Kougiatsos 2022"
PAPERS = {"K24": K24, "K22": K22}


class PublishedOffset(NamedTuple):
    """A permanent offset of a sensor from its onset (s) on, in the sensor's unit."""

    sensor: str
    onset: float
    magnitude: float


class Experiment(NamedTuple):
    """A published run: faults, length (s), noise bound over the nominal value, and when modules fired (s)."""

    faults: tuple[PublishedOffset, ...]
    duration: float
    noise: float
    fired: Mapping[str, float]
    source: str

    def first_alarm(self, module: str) -> Published | None:
        """When a module fired (s); None for one that was silent."""
        return Published(self.fired[module], self.source) if module in self.fired else None


THREE_FAULTS = Experiment(
    (
        PublishedOffset("S(2){3}", 20.0, -3.8e4),
        PublishedOffset("S(3){1}", 45.0, 5e4),
        PublishedOffset("S(4){2}", 70.0, 8.0),
    ),  # N m, Pa, K
    100.0,  # s, not stated; the axes of Fig. 4 were not available. Our choice by P^E, see tests/study/test_diagnosis_metrics.py
    0.05,
    {"M(2,3)": 20.0, "M(3,1)": 45.06, "M(3,3)": 69.9, "M(4,2)": 70.01},
    f"{K24}, Fig. 4 and sec. VII, one run",
)
TWO_FAULTS = Experiment(
    (PublishedOffset("S(3){1}", 10.0, 5e4), PublishedOffset("S(4){2}", 20.0, 8.0)),
    60.0,
    0.03,
    {"M(3,1)": 10.0, "M(4,2)": 20.0, "M(3,2)": 22.1, "M(4,3)": 25.3},
    f"{K22}, Fig. 3 and sec. 5, one run",
)

# percent, mean of 100 runs of THREE_FAULTS and half-width of its 95 % interval
ISOLATION_PERFORMANCE, ISOLATION_HALF_WIDTH = Published(51.16, f"{K24}, sec. VII, +- 0.81"), 0.81
EXONERATION_PERFORMANCE, EXONERATION_HALF_WIDTH = Published(57.83, f"{K24}, sec. VII, +- 2.93"), 2.93

_TABLE_V = {
    "M(1,1)": 5.06,
    "M(2,1)": 20.36, "M(2,2)": 14.06, "M(2,3)": 63.68,
    "M(3,1)": 5.0, "M(3,2)": 50.8, "M(3,3)": 11.37,
    "M(4,1)": 4.88, "M(4,2)": 0.03, "M(4,3)": 68.97,
}  # fmt: skip


def minimum_fault(module: str) -> Published:
    """Table V: smallest detectable fault of the module's sensor at 5 % noise, percent, we take it of the nominal value."""
    return Published(_TABLE_V[module], f"{K24}, Table V")


class Delay(NamedTuple):
    """Table VI, s: mean of the detection delay, None where a run missed the fault, and its range; None where not given."""

    mean: float | None
    shortest: float | None
    longest: float | None


# by faulty sensor and noise level; of its own module, and of the first of the other modules. Fig. 5 has no numbers
DELAYS = {
    "S(1){1}": {
        "local": {level: Delay(0.0, 0.0, 0.01) for level in (0.02, 0.04, 0.06, 0.08, 0.1)},
        "neighbours": {0.02: Delay(10.52, 0.0, 32.81), 0.04: Delay(None, 59.04, None), 0.06: Delay(None, 89.36, None)},
    },
    "S(2){3}": {  # "0-0.01 sec [0 s" spans an unknown number of columns in the text at hand, the last of them is "-"
        "local": {0.02: Delay(0.0, 0.0, 0.01)},
        "neighbours": {0.02: Delay(14.83, 0.15, 59.67), 0.04: Delay(None, 59.11, None), 0.06: Delay(None, 74.48, None)},
    },
}
DELAYS_SOURCE = f"{K24}, Table VI"

# the design of the observers: gains (1/s) and constants of the threshold (10)
K22_GAINS = {"fuel": 1.16, "p_receiver": 445.0, "p_charge": 319.98}
K22_OBSERVER_BOUNDS = {
    "fuel": ObserverBound(3.0, 2.0, 10.0, 2.0),
    "p_receiver": ObserverBound(1.0, 541.0, 465.0, 2.0),
    "p_charge": ObserverBound(1.0, 301.0, 320.0, 1.0),
}
AT_NOMINAL_SPEED = "K24 (30)"  # the design of K24 with p_6 and T_6 as printed there: at nominal speed for any torque
DESIGNS = {
    "K24": (GAINS, OBSERVER_BOUNDS),
    AT_NOMINAL_SPEED: (GAINS, OBSERVER_BOUNDS),
    "K22": (K22_GAINS, K22_OBSERVER_BOUNDS),
}


class PrintedTable(NamedTuple):
    """A table of one of the papers: the paper's abbreviation, "K24" or "K22", and the table's number as printed."""

    paper: str
    number: str

    @property
    def name(self) -> str:
        """As in "K24 Table I"."""
        return f"{self.paper} {self.number}"

    @property
    def source(self) -> str:
        """As in "Kougiatsos 2024, Table I"."""
        return f"{PAPERS[self.paper]}, {self.number}"


# Signature matrices as printed. f3(2) is the fault of sensor S(2){3}, E(2,3) the residual of module M(2,3). Only single
# faults are printed; a column that is not printed is 0
SIGNATURES = {
    PrintedTable("K24", "Table I"): """
        f1(2)  f2(2)  f3(2)  f1(1)  f1(4)  f2(4)
E(2,1)  *      0      0      *      *      0
E(2,2)  0      *      0      *      *      *
E(2,3)  0      *      *      *      *      *
""",
    PrintedTable("K24", "Table II"): """
        f1(3)  f2(3)  f3(3)  f1(1)  f1(2)  f2(2)  f3(2)  f1(4)  f2(4)
E(3,1)  1      *      0      *      0      0      *      *      *
E(3,2)  *      *      0      *      *      *      *      *      *
E(3,3)  *      *      *      0      0      0      0      0      0
""",
    PrintedTable("K24", "Table III"): """
        f1(4)  f2(4)  f3(4)  f1(1)  f3(2)  f1(3)  f2(3)
E(4,1)  1      *      0      *      *      *      *
E(4,2)  0      *      0      0      0      0      0
E(4,3)  *      *      *      *      *      *      *
""",
    PrintedTable("K24", "Table IV"): """
     f1(1)  f1(2)  f2(2)  f3(2)  f1(3)  f2(3)  f3(3)  f1(4)  f2(4)  f3(4)
E(1)  1      0      0      0      0      0      0      0      0      0
E(2)  *      1      1      1      0      0      0      *      *      0
E(3)  *      *      *      *      1      1      1      *      *      0
E(4)  *      0      0      *      *      *      0      1      1      1
""",
    PrintedTable("K22", "Table 1"): """
        f1(3)  f2(3)  f3(3)  f1(1)  f1(2)  f2(2)  f3(2)  f1(4)  f2(4)
E(3,1)  1      1      0      *      0      0      *      *      *
E(3,2)  *      *      0      *      *      *      *      *      *
E(3,3)  *      *      *      0      0      0      0      0      0
""",
    PrintedTable("K22", "Table 2"): """
        f1(4)  f2(4)  f3(4)  f1(1)  f3(2)  f1(3)  f2(3)
E(4,1)  1      1      0      *      *      *      *
E(4,2)  0      *      0      0      0      0      0
E(4,3)  *      *      *      *      *      *      *
""",
    PrintedTable("K22", "Table 3"): """
     f1(1)  f1(2)  f2(2)  f3(2)  f1(3)  f2(3)  f3(3)  f1(4)  f2(4)  f3(4)
E(1)  1      0      0      0      0      0      0      0      0      0
E(2)  *      1      1      1      0      0      0      *      *      0
E(3)  *      *      *      *      1      1      1      *      *      0
E(4)  *      0      0      *      *      *      0      1      1      1
""",
}


def signatures(table: PrintedTable) -> dict[str, dict[str, str]]:
    """A printed matrix, {row: {column: entry}}, in the order of print."""
    header, *lines = (line.split() for line in SIGNATURES[table].strip().splitlines())
    return {row: dict(zip(header, entries, strict=True)) for row, *entries in lines}
