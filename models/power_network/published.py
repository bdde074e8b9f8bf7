"""Results of single runs in Boem et al. 2018 ("B18"), sec. VIII: when faults were detected, isolated and accommodated.

Times of the single run in their figures; the text at hand has no pages. VIII-B states "at time t = 62 s the fault is detected"
and, a few lines on, "detection at t = 48 s (after 3 alarms), isolation and reconfiguration (at t = 61 s and t = 67 s)". 48 s
agrees with its Fig. 5; 62 s contradicts it.
"""

from __future__ import annotations

from typing import NamedTuple

from fusion_sfdia.models.power_network.operation import AreaFault
from fusion_sfdia.report.results import Published

B18 = "Boem 2018"


class PublishedScenario(NamedTuple):
    """A published scenario: the fault, and when (s) it was detected, isolated and accommodated in the run that is shown."""

    fault: AreaFault
    loads: str
    detected: float
    isolated: float | None
    reconfigured: float | None
    source: str

    def delay(self, time: float | None) -> Published | None:
        """From the onset to a published time, s."""
        return None if time is None else Published(time - self.fault.onset, self.source)

    def at(self, time: float | None) -> Published | None:
        """A published time, s."""
        return None if time is None else Published(time, self.source)


GOVERNOR = PublishedScenario(
    AreaFault("governor", "4", 1000.0, onset=35.0), "1", 43.0, None, None, f"{B18}, sec. VIII-A, one run"
)
SIGN_FLIP = PublishedScenario(
    AreaFault("input-gain", "5", -1.0, onset=45.0), "2", 48.0, 61.0, 67.0, f"{B18}, sec. VIII-B, one run"
)
PLUGGED_IN = 70.0  # s: area 15, sec. VIII-A
ATTACKS: tuple[tuple[str, AreaFault | None], ...] = (  # sec. VIII-B: "-u, 2u and 10u"
    ("-u", AreaFault("input-gain", "5", -1.0)),
    ("2u", AreaFault("input-gain", "5", 2.0)),
    ("10u", AreaFault("input-gain", "5", 10.0)),
)
DETERMINISTIC_MISSES = Published(1.0, f"{B18}, sec. VIII-A and Fig. 4, one run")
