"""Detectors from Python: by name, fitted to healthy readings, run over a log or row by row; results to plot and report."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from fusion_sfdia.common.rate import Rate
from fusion_sfdia.common.warned import warn
from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.detector import OWN_CLASS, Detector
from fusion_sfdia.detectors.saved_detectors import save_detector
from fusion_sfdia.diagnosis.diagnose import SECONDS
from fusion_sfdia.diagnosis.prepared import prepared
from fusion_sfdia.diagnosis.watch import Watch
from fusion_sfdia.learning.builders import fit
from fusion_sfdia.logs.check import checked
from fusion_sfdia.logs.frames import is_frame
from fusion_sfdia.logs.loaded_log import MISREAD, LoadedLog
from fusion_sfdia.logs.log_forms import as_log
from fusion_sfdia.logs.log_map import LogMap
from fusion_sfdia.logs.reading import load_log
from fusion_sfdia.plant.log import one_run
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.report.result import Result


@dataclass(frozen=True, repr=False)
class Diagnoser:
    """A detector on its plant; `fusion_sfdia.detector` makes it.

    detector: to be stepped, as `run` and `Watch` take it. name: shown in reports. build: makes the detector for another plant;
    None for an object. fitted: whether `fit` has fitted it to readings of this plant.
    """

    detector: Detector
    name: str
    build: registry.NamedDetector | None = None
    fitted: bool = False

    @property
    def plant(self) -> Plant:
        """The plant of the detector."""
        return self.detector.plant

    def __repr__(self) -> str:
        return f"<Diagnoser {self.name} on {self.plant.name}>"

    def fit(self, healthy: Any, false_alarm: str | float = "1/day", *, log_map: LogMap | str | Path | None = None) -> Diagnoser:
        """The detector fitted to healthy readings of the plant; one that does not learn gets its thresholds from them.

        healthy: a file or a frame, which `load_log` reads with log_map; what `load_log` or `check_log` read; a Log, a Recording
        or a tuple t, y, u, also of several runs side by side; None for simulated runs. false_alarm: "1/day", "2/hour", or a
        rate per sample over all sensors. ValueError where the readings do not fit, look misread or are too few for the rate;
        NotApplicableError as the detector raises it.
        """
        rate = Rate.of(false_alarm).per_sample(self.plant.dt)
        if isinstance(loaded := _loaded(self.plant, healthy, log_map, "healthy log: "), LoadedLog):
            loaded = checked(self.plant, loaded)
            if loaded.misread:
                reasons = "; ".join(f.text for f in loaded.findings if f.kind in MISREAD)
                raise ValueError(f"the healthy log looks misread: {reasons}; state in a log_map how it is written")
            loaded = loaded.log
        if self.build is None:
            return replace(self, detector=self.detector.fit_thresholds(loaded, rate), fitted=True)
        return replace(self, detector=fit(self.build, self.plant, loaded, rate), fitted=True)

    def diagnose(self, *data: Any, gap: int = 3, log_map: LogMap | str | Path | None = None) -> Result:
        """Run the detector over recorded readings and collect what it isolates into events, see `diagnose_run`.

        data: a file or a frame, which `load_log` reads with log_map; what `load_log` or `check_log` read; a Log, a Recording of
        one run, or t (K,), y (K, N), u (K, m), see `as_log`. The same log has the same Diagnosis in each of these forms, and on
        the command line. Time stamps give events their wall-clock times; sensors whose unit `check_log` suspects, and readings
        that only repeat the one before, are taken as missing; sensors that are coarse or cyclic, which the plant does not
        state, have more noise, or a period (`Diagnosis.of_log` states what was found, `Diagnosis.suspects` the former).
        ValueError where the data do not fit; DiagnosisWarning for limits of the diagnosis that the events do not show.
        """
        one = data[0] if len(data) == 1 else None
        source = Path(one).name if isinstance(one, str | Path) else "a log"
        if not isinstance(one := _loaded(self.plant, one, log_map), LoadedLog):
            one = LoadedLog(one_run(as_log(self.plant, *data)), SECONDS, ())
        build = None if self.fitted or self.build is None else partial(registry.detector, self.build)
        found, log = prepared(self.detector, one, build).diagnose(gap=gap)
        return Result.of(found, plant=self.plant, detector=self.name, log=log, columns=one.columns, source=source)

    def stream(self, **settings: Any) -> Watch:
        """The detector over rows as they come, see `Watch` for the settings; `Watch.update` takes a row.

        Rows are in the units of the plant; sensors that are not read are named by `unread`.
        """
        return Watch(self.detector, **settings)

    def save(self, path: str | Path) -> None:
        """Write the detector to a file, see `save_detector`."""
        save_detector(path, self.detector)


def _loaded(plant: Plant, given: Any, log_map: LogMap | str | Path | None, what: str = "") -> Any:
    """A file or a frame as it was read, with a warning for each remark; anything else as it is, without a log_map."""
    if isinstance(given, str | Path) or is_frame(given):
        loaded = load_log(given, plant, log_map)
        for remark in loaded.brief:
            warn(f"{what}{remark}")
        return loaded
    if log_map is not None:
        raise ValueError("log_map states how a file or a frame is written; expected one of them, or no log_map")
    return given


def detector(
    what: str | Detector | Callable[[Plant], Detector] | registry.NamedDetector | Diagnoser,
    plant: Plant | str | None = None,
) -> Diagnoser:
    """A detector on a plant, ready to be fitted, to diagnose a log, or to take row after row.

    what: a registered name, a class or a function that builds a detector, which need the plant, an object or a name; or a
    Detector that is built already, such as `load_detector` returns it. ValueError where names are unknown, `what` is no
    detector, or the plant is missing or given twice; NotApplicableError where the plant lacks what the method needs.
    """
    if isinstance(what, Diagnoser):
        if plant is None or plant is what.plant:
            return what
        what = what.detector if what.fitted or what.build is None else what.build
    if isinstance(what, str | type | registry.NamedDetector) or not isinstance(what, Detector):
        if not isinstance(what, str | registry.NamedDetector) and not callable(what):
            raise ValueError(
                f"the first argument is of type {type(what).__name__}; expected a detector or its name: "
                f"detector('kf-chi2', plant); {OWN_CLASS}"
            )
        entry = registry.find_detector(what)
        if plant is None:
            raise ValueError(f"detector {entry.name!r} has no plant yet; pass plant=, a Plant or a name")
        return Diagnoser(registry.detector(entry, registry.plant(plant)), entry.name, entry)
    if plant is not None and plant is not what.plant:
        raise ValueError(f"a plant is given together with a detector, which has its own, {what.plant.name!r}; leave it out")
    return Diagnoser(what, type(what).__name__)


def diagnose(
    what: str | Detector | Callable[[Plant], Detector] | registry.NamedDetector | Diagnoser,
    *data: Any,
    plant: Plant | str | None = None,
    gap: int = 3,
    log_map: LogMap | str | Path | None = None,
) -> Result:
    """Diagnose recorded readings: `detector(what, plant).diagnose(*data)`, see there."""
    return detector(what, plant).diagnose(*data, gap=gap, log_map=log_map)
