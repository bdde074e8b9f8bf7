"""What a diagnosis means for the device: the states of NAMUR NE 107, by the enumeration of OPC UA for Devices."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.detectors.detector import Decision, ProcessHypothesis
from fusion_sfdia.detectors.verdicts import ALL_FAR, TOO_MANY, Conclusion, Verdict
from fusion_sfdia.diagnosis.events import EVEN, Event
from fusion_sfdia.diagnosis.slow_sensors import UNDECIDED
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

WITHIN = 3.0  # standard deviations of a sensor's noise: an error up to there is within what the plant states of the sensor
UNHEARD = UNDECIDED  # samples without a reading that could be judged, as many as a slow sensor may repeat its value


class DeviceHealth(IntEnum):
    """The states of NAMUR NE 107 with the numbers of DeviceHealthEnumeration (OPC 10000-100, OPC UA for Devices, 4.5.4).

    Attributes
    ----------
    NORMAL
        The reading is valid.
    FAILURE
        F: it is not, the signal is lost.
    CHECK_FUNCTION
        C: it cannot be relied on for the time being.
    OFF_SPEC
        S: its error is larger than stated.
    MAINTENANCE_REQUIRED
        M: it is valid still, and will not stay so.

    Examples
    --------
    >>> from fusion_sfdia.events import DeviceHealth
    >>> DeviceHealth.OFF_SPEC.value
    3
    """

    NORMAL = 0
    FAILURE = 1
    CHECK_FUNCTION = 2
    OFF_SPEC = 3
    MAINTENANCE_REQUIRED = 4


def health_of(event: Event) -> DeviceHealth | None:
    """The state of a sensor on which such an event stands; None of an event that says nothing about a sensor.

    A sensor that is silent or frozen has failed. One that is isolated with a probability below a half, and the suspects of an
    undecided event, are to be checked, and so is every sensor in operation that is outside of what was learnt. A bias or a
    drift within `WITHIN` standard deviations of the sensor's noise asks for maintenance; a larger one, one of unknown size,
    and a fault of which the kind is not known yet, is out of specification, as noise is. Spikes leave the readings between
    them valid: maintenance.
    """
    if event.kind in ("undecided", "outside"):
        return DeviceHealth.CHECK_FUNCTION
    if event.kind != "sensor":
        return None
    if event.fault in ("dropout", "freeze"):
        return DeviceHealth.FAILURE
    if event.confidence < EVEN:
        return DeviceHealth.CHECK_FUNCTION
    small = event.fault in ("bias", "drift") and abs(event.sigmas) <= WITHIN
    return DeviceHealth.MAINTENANCE_REQUIRED if small or event.fault == "spikes" else DeviceHealth.OFF_SPEC


def sensor_health(
    plant: Plant,
    decision: Decision,
    conclusion: Conclusion,
    recent: Iterable[Decision],
    standing: Mapping[str, DeviceHealth],
    tested: Sequence[ProcessHypothesis] = (),
) -> tuple[DeviceHealth, ...]:
    """The state of each sensor after a sample.

    recent: Decisions of the samples until this one, the last first. standing: states by sensor on which an event stands, see
    `health_of`. tested: the detector's hypotheses about the process. Any other sensor is NORMAL where it is judged, and
    CHECK_FUNCTION where it is not: nothing was judged at all or for `UNHEARD` samples of it, its threshold is infinite, all are
    far from the model or more disagree with it than can be isolated, operation is outside of what was learnt, whether or not a
    sensor is isolated as well, or an alarm that nothing explains is its own or may be.
    """
    verdict, reason = conclusion
    if verdict is Verdict.BLIND or reason in (ALL_FAR, TOO_MANY) or _is_outside(decision, verdict, tested):
        found = [DeviceHealth.CHECK_FUNCTION] * len(plant.sensors)
    else:
        doubtful = ~_judged(decision)
        for before, _ in zip(recent, range(UNHEARD), strict=False):
            if not doubtful.any():
                break
            doubtful &= ~_judged(before)
        doubtful |= decision.absurd
        if decision.suspect is not None:
            doubtful |= decision.suspect[: doubtful.size]
        if verdict is Verdict.UNDECIDED:
            doubtful |= decision.scores > 1
        found = [DeviceHealth.CHECK_FUNCTION if d else DeviceHealth.NORMAL for d in doubtful.tolist()]
    for name, state in standing.items():
        found[plant.sensor_index(name)] = state
    return tuple(found)


def _is_outside(decision: Decision, verdict: Verdict, tested: Sequence[ProcessHypothesis]) -> bool:
    """Whether operation is as in no healthy log, or an input beyond its limits, which a verdict on a sensor does not say."""
    accepted = () if decision.process is None else zip(tested, decision.process, strict=True)
    named = any(holds and h.of_operation for h, holds in accepted)
    return verdict is Verdict.OUTSIDE or named or bool(np.any(decision.absurd_input))


def _judged(decision: Decision) -> Array:
    return np.asarray(np.isfinite(decision.residual) & np.isfinite(decision.threshold))
