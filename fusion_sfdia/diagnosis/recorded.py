"""Diagnose recorded readings in any form, by a detector or the name of one."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.detector import OWN_CLASS, Detector
from fusion_sfdia.diagnosis.diagnose import SECONDS, Diagnosis
from fusion_sfdia.diagnosis.prepared import prepared
from fusion_sfdia.logs.as_log import as_log
from fusion_sfdia.logs.frames import is_frame
from fusion_sfdia.logs.loaded_log import LoadedLog
from fusion_sfdia.logs.log_map import LogMap
from fusion_sfdia.logs.reading import load_log
from fusion_sfdia.plant.log import one_run
from fusion_sfdia.plant.plant import Plant


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
