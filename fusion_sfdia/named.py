"""Detectors by name: diagnose recorded readings, and fit to healthy ones, with any registered detector."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from fusion_sfdia import registry
from fusion_sfdia.builders import healthy_data
from fusion_sfdia.core.detector import OWN_CLASS, Detector
from fusion_sfdia.core.log import as_log, is_frame, one_run
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.detectors import FALSE_ALARM
from fusion_sfdia.evaluation.diagnose import SECONDS, Diagnosis
from fusion_sfdia.evaluation.loaded_log import prepared
from fusion_sfdia.logs.findings import LoadedLog
from fusion_sfdia.logs.log_map import LogMap
from fusion_sfdia.logs.reading import load_log


def diagnose(
    detector: Detector | str | Callable[[Plant], Detector],
    *data: Any,
    plant: Plant | str | None = None,
    gap: int = 3,
    log_map: LogMap | str | Path | None = None,
) -> Diagnosis:
    """Run a detector over recorded readings and collect what it isolates into events, see `diagnose_run`.

    detector: an object; or a registered name, a class or a function that builds one, which needs its plant, an object or a
    name. data: a file or a pandas frame, which `load_log` reads with log_map; what `load_log` or `check_log` read; a Log, a
    Recording of one run, or t (K,), y (K, N), u (K, m), see `as_log`. The same log has the same Diagnosis in each of these
    forms, and on the command line. Time stamps give events their wall-clock times; sensors whose unit `check_log` suspects,
    and readings that only repeat the one before, are taken as missing; sensors that are coarse or cyclic, which the plant does
    not state, have more noise, or a period (`Diagnosis.of_log` states what was found, `Diagnosis.suspects` the former).
    ValueError where names are unknown, the first argument is no detector or the data do not fit; DiagnosisWarning for limits
    of the diagnosis that the events do not show.
    """
    if isinstance(detector, str | type | registry.NamedDetector) or not isinstance(detector, Detector):
        if not isinstance(detector, str | registry.NamedDetector) and not callable(detector):
            raise ValueError(
                f"the first argument is of type {type(detector).__name__}; expected a detector or its name: "
                f"diagnose('kf-chi2', t, y, u, plant=plant); {OWN_CLASS}"
            )
        if plant is None:
            name = registry.find_detector(detector).name
            lacks = f"{name!r} is a name, which" if isinstance(detector, str) else f"{name} is not built: it"
            raise ValueError(f"detector {lacks} needs its plant; pass plant=..., a Plant or a name")
        build: Callable[[Plant], Detector] | None = partial(registry.detector, detector)
        detector = registry.detector(detector, registry.plant(plant))
    elif plant is not None and plant is not detector.plant:
        raise ValueError(
            f"plant is given together with a detector, which has its own, {detector.plant.name!r}; leave plant out"
        )
    else:
        build = None
    one = data[0] if len(data) == 1 else None
    if isinstance(one, str | Path) or is_frame(one):
        one = load_log(one, detector.plant, log_map)
        for remark in one.brief:
            warnings.warn(remark, stacklevel=2)
    elif log_map is not None:
        raise ValueError("log_map states how a file or a frame is written; expected one of them, or no log_map")
    loaded = one if isinstance(one, LoadedLog) else LoadedLog(one_run(as_log(detector.plant, *data)), SECONDS, ())
    return prepared(detector, loaded, build).diagnose(gap=gap)[0]


def fit(name: str, plant: Plant | str, healthy: Any = None, false_alarm: float = FALSE_ALARM, **unknown: Any) -> Detector:
    """The registered detector of that name, fitted to healthy readings; one that does not learn gets its thresholds from them.

    The counterpart of `BatchDetector.fit` for names. healthy: as `as_log` takes it; None for simulated runs of the plant,
    enough for the rate, with the seeds on which registered detectors are fitted. false_alarm: per step over all sensors.
    ValueError for unknown names and any other setting, and where the readings do not fit or are too few; NotApplicableError
    as the detector raises it.
    """
    if unknown:
        raise ValueError(
            f"fit has no settings {', '.join(unknown)}; it has healthy and false_alarm: build the detector's class with its "
            "own settings and call its fit_thresholds"
        )
    plant, named = registry.plant(plant), registry.find_detector(name)
    if named.learns:
        return named.build(plant, healthy=healthy, false_alarm=false_alarm)
    detector = registry.detector(named, plant)
    return detector.fit_thresholds(healthy_data(plant, false_alarm) if healthy is None else healthy, false_alarm)
