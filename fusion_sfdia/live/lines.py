"""What a watch found, as JSON: one line an event, and one a sample."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.clock import Clock
from fusion_sfdia.common.numerals import for_json
from fusion_sfdia.detectors.detector import Detector
from fusion_sfdia.detectors.verdicts import Verdict, far_off
from fusion_sfdia.diagnosis.changes import Change
from fusion_sfdia.diagnosis.device_health import DeviceHealth
from fusion_sfdia.diagnosis.sentences import Words
from fusion_sfdia.diagnosis.watch import Sample
from fusion_sfdia.live.status import Report
from fusion_sfdia.plant.model_errors import RAISED
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]


def change_line(change: Change, clock: Clock, words: Words) -> str:
    """{"event": "opened", "id": 1, "t": 30.0, "alarm_id": 1, "device_health": "FAILURE", ...}: an event by its fields, and in a
    sentence as "text".
    """
    found: dict[str, Any] = {"event": change.what, "id": change.id, **_when(change.t, clock)}
    found |= {} if change.alarm is None else {f"alarm_{name}": value for name, value in change.alarm._asdict().items()}
    found |= {} if change.device_health is None else {"device_health": change.device_health.name}
    if change.event is None:
        return _json({**found, "reason": change.reason})
    fields = change.event.fields(clock) | {"text": change.sentence(words, clock)}
    known = {name: v for name, v in fields.items() if name == "size" or (v not in ("", (), None) and v == v)}
    return _json({**found, **known})


def sample_line(sample: Sample, plant: Plant, hypotheses: tuple[str, ...], clock: Clock) -> str:
    """{"event": "sample", "t": 30.0, "verdict": "healthy", "score": 0.7, "alarm": false, "isolated": [], "values": {...}, ...}.

    Of a row that was not judged score and alarm are null, and a reason is stated.
    """
    d, concluded = sample.decision, sample.conclusion
    value, sigma = validated(plant, sample)
    blind = concluded.verdict is Verdict.BLIND
    found: dict[str, Any] = {"event": "sample", **_when(sample.t, clock), "verdict": str(concluded.verdict)}
    found |= {"reason": concluded.reason} if concluded.reason else {}
    found |= {"score": None if blind else float(d.score), "alarm": alarm(sample)}
    flags = {name: bool(np.any(getattr(d, name))) for name in ("diverged", "guarded", "capped")}
    found |= {"isolated": [hypotheses[i] for i in np.flatnonzero(d.isolated)], **flags}
    for what, numbers in (("values", value), ("sigma", sigma)):
        found[what] = dict(zip(plant.sensor_names, map(float, numbers), strict=True))
    found["device_health"] = named_health(plant, sample.device_health)
    return _json(found)


def named_health(plant: Plant, states: Sequence[DeviceHealth]) -> dict[str, str]:
    """The state of each sensor by NAMUR NE 107, {"l1": "OFF_SPEC", ...}."""
    return {name: state.name for name, state in zip(plant.sensor_names, states, strict=True)}


def alarm(sample: Sample) -> bool | None:
    """Whether a row is in alarm; None where that is not known: not judged, or "cannot tell" while no residual is in alarm."""
    verdict = sample.verdict
    if verdict in (Verdict.HEALTHY, Verdict.SENSOR, Verdict.PROCESS):
        return verdict is not Verdict.HEALTHY
    return True if verdict is not Verdict.BLIND and sample.decision.alarm else None


def verdict_text(detector: Detector, sample: Sample) -> str:
    """The verdict on a row in a line: "l1, q2", "none isolated", "process", "cannot tell: ...", "no verdict: ..."."""
    d, concluded = sample.decision, sample.conclusion
    isolated = ", ".join(h for h, i in zip(detector.hypotheses, d.isolated, strict=True) if i)
    if concluded.verdict is Verdict.HEALTHY:
        return "none isolated"
    if concluded.verdict is Verdict.BLIND:
        return f"{concluded.text}; isolated before: {isolated}" if isolated else concluded.text
    tested = () if d.process is None else zip(detector.process_hypotheses, d.process, strict=True)
    process = ", ".join(h.name for h, i in tested if i)
    parts = [f"process or model: {process}" if process else "", concluded.text if concluded.reason else "", isolated]
    return "; ".join(part for part in parts if part)


def results(detector: Detector, sample: Sample, write: Mapping[str, Any]) -> list[tuple[str, float | str | bool | None]]:
    """The addresses in the table `write` of a bridge, each with what belongs there of a sample; NaN for a number that is not
    known, None for an alarm of which that is so. What a `Report` has, the health of sensors, is not among them.

    write: of some sensors {name of `tables.OF_SENSOR`: address}, and the addresses "verdict" and "alarm" of the whole.
    """
    plant = detector.plant
    value, sigma = validated(plant, sample)
    verdicts = sensor_verdicts(plant, sample)
    whole: dict[str, Any] = {"alarm": alarm(sample), "verdict": verdict_text(detector, sample)}
    found: list[tuple[str, float | str | bool | None]] = []
    for name, where in write.items():
        if isinstance(where, str):
            found.append((where, whole[name]))
        else:
            i = plant.sensor_index(name)
            of_sensor: dict[str, Any] = {"value": float(value[i]), "sigma": float(sigma[i]), "verdict": verdicts[i]}
            found += [(address, of_sensor[what]) for what, address in where.items() if what in of_sensor]
    return found


def health_results(report: Report, write: Mapping[str, Any]) -> list[tuple[str, DeviceHealth]]:
    """The addresses of the health of sensors in the table `write` of a bridge, each with that of a report."""
    health = report.device_health
    return [(where["health"], health[name]) for name, where in write.items() if isinstance(where, dict) and "health" in where]


def validated(plant: Plant, sample: Sample) -> tuple[Array, Array]:
    """The validated readings (N,) and their standard deviations (N,), in sensor units.

    A reading that is used is itself, with the noise of its sensor; one that is missing or isolated is what the method expects,
    with sigma^2 = H P H' of the estimate, NaN where the method has no covariance P, or the model no Jacobian H there.
    """
    d = sample.decision
    replaced = np.isnan(sample.y) | (d.reconstruction != sample.y)
    sigma = plant.sensor_sigma
    if replaced.any():
        expected = np.full_like(sigma, np.nan)
        if d.covariance is not None and np.all(np.isfinite(d.estimate)):
            with suppress(*RAISED), np.errstate(all="ignore"):
                h = plant.output_jacobian_at(sample.t, d.estimate, sample.u)
                expected = np.sqrt(np.maximum(np.sum((h @ d.covariance) * h, axis=-1), 0.0))
        sigma = np.where(replaced, expected, sigma)
    return d.reconstruction, np.where(np.isfinite(d.reconstruction), sigma, np.nan)


def sensor_verdicts(plant: Plant, sample: Sample) -> list[str]:
    """Of each sensor "isolated", "suspected", "missing" or "healthy"; "no verdict" of one that was not judged, and of those not
    isolated where all are far from the model or more disagree with it than can be isolated.
    """
    d, count = sample.decision, len(plant.sensors)
    suspect = np.zeros(count, bool) if d.suspect is None else d.suspect[:count]
    blind = sample.verdict is Verdict.BLIND
    unsure = blind or sample.verdict is Verdict.OUTSIDE or bool(far_off(d)) or bool(np.any(d.capped))
    known = np.isfinite(d.residual) & np.isfinite(d.threshold)
    found = np.where(known & (not unsure), "healthy", "no verdict")
    found = np.where(suspect, "suspected", found)
    found = np.where(np.isnan(sample.y), "missing", found)
    found = np.where(d.isolated[:count], "isolated", found)
    return list(map(str, np.where(np.isnan(sample.y), "missing", "no verdict") if blind else found))


def _when(t: float, clock: Clock) -> dict[str, Any]:
    return {"t": t} if clock.start is None else {"t": t, "time": clock.iso(t)}


def _json(found: dict[str, Any]) -> str:
    return json.dumps(for_json(found), ensure_ascii=False)
