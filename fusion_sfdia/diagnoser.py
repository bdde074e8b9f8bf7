"""A detector as Python users drive it: by name, fitted to healthy readings, over a log, row by row; and its results to show."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fusion_sfdia.common.rate import Rate
from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.detector import OWN_CLASS, Detector
from fusion_sfdia.detectors.saved_detectors import save_detector
from fusion_sfdia.diagnosis.diagnose import SECONDS, Diagnosis, present
from fusion_sfdia.diagnosis.prepared import prepared
from fusion_sfdia.diagnosis.watch import Watch
from fusion_sfdia.learning.builders import fit
from fusion_sfdia.logs.as_log import as_log
from fusion_sfdia.logs.columns import Source
from fusion_sfdia.logs.frames import is_frame
from fusion_sfdia.logs.loaded_log import LoadedLog
from fusion_sfdia.logs.log_map import LogMap
from fusion_sfdia.logs.reading import load_log
from fusion_sfdia.plant.log import Log, one_run
from fusion_sfdia.plant.plant import Plant

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, repr=False, kw_only=True)
class Result(Diagnosis):
    """A Diagnosis with the readings that it is of.

    plant, detector: that made it, the latter by name. log: as it was judged. columns: of the file or frame, whose tags and
    units `plot` and `report` show. source: where the readings came from, for the report.
    """

    plant: Plant
    detector: str
    log: Log
    columns: tuple[Source, ...] = ()
    source: str = "a log"

    def plot(self) -> Figure:
        """The readings and reconstructions of the sensors with events, as a matplotlib Figure."""
        from fusion_sfdia.report.log_report import draw

        return draw(*self._shown())

    def report(self, path: str | Path) -> Path:
        """Write the report as one HTML file, whole or not at all, and return its path; ValueError for another suffix."""
        from fusion_sfdia.report.log_page import About, write_page

        if (path := Path(path)).suffix != ".html":
            raise ValueError(f"the report is to be written to {path}; expected a file that ends in .html")
        write_page(path, *self._shown(), About(self.source, self.detector))
        return path

    def _shown(self) -> tuple[Plant, Any, Diagnosis]:
        """Plant, readings and diagnosis in the tags and units of the log."""
        from fusion_sfdia.report.log_units import LogUnits

        units, y = LogUnits(self.plant, self.columns), present(self.log.y, self.decisions)
        return units.plant, units.readings(y), units.diagnosis(self)


@dataclass(frozen=True)
class Diagnoser:
    """A detector on its plant; `fusion_sfdia.detector` makes it.

    detector: to be stepped, as `run` and `Watch` take it. name: for people. build: makes it for a plant, None where it was
    built, or fitted to readings, already.
    """

    detector: Detector
    name: str
    build: registry.NamedDetector | None = None

    @property
    def plant(self) -> Plant:
        """The plant of the detector."""
        return self.detector.plant

    def fit(self, healthy: Any, false_alarm: str | float = "1/day", *, log_map: LogMap | str | Path | None = None) -> Diagnoser:
        """The detector fitted to healthy readings of the plant; one that does not learn gets its thresholds from them.

        healthy: as in `diagnose`, also several runs side by side. false_alarm: "1/day", "2/hour", or a probability per sample.
        ValueError where the readings do not fit or are too few for the rate; NotApplicableError as the detector raises it.
        """
        rate = Rate.of(false_alarm).per_sample(self.plant.dt)
        if isinstance(healthy, str | Path) or is_frame(healthy):
            healthy = load_log(healthy, self.plant, log_map).log
        if self.build is None:
            return Diagnoser(self.detector.fit_thresholds(healthy, rate), self.name)
        return Diagnoser(fit(self.build, self.plant, healthy, rate), self.name)

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
        source = str(one) if isinstance(one, str | Path) else "a log"
        if isinstance(one, str | Path) or is_frame(one):
            one = load_log(one, self.plant, log_map)
            for remark in one.brief:
                warnings.warn(remark, stacklevel=2)
        elif log_map is not None:
            raise ValueError("log_map states how a file or a frame is written; expected one of them, or no log_map")
        loaded = one if isinstance(one, LoadedLog) else LoadedLog(one_run(as_log(self.plant, *data)), SECONDS, ())
        build = None if self.build is None else partial(registry.detector, self.build)
        found, log = prepared(self.detector, loaded, build).diagnose(gap=gap)
        own = {f.name: getattr(found, f.name) for f in fields(found)}
        return Result(**own, plant=self.plant, detector=self.name, log=log, columns=loaded.columns, source=source)

    def stream(self, **settings: Any) -> Watch:
        """The detector over rows as they come, see `Watch` for the settings; `Watch.update` takes a row."""
        return Watch(self.detector, **settings)

    def save(self, path: str | Path) -> None:
        """Write the detector to a file, see `save_detector`."""
        save_detector(path, self.detector)


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
        what = what.build or what.detector
    if isinstance(what, str | type | registry.NamedDetector) or not isinstance(what, Detector):
        if not isinstance(what, str | registry.NamedDetector) and not callable(what):
            raise ValueError(
                f"the first argument is of type {type(what).__name__}; expected a detector or its name: "
                f"detector('kf-chi2', plant); {OWN_CLASS}"
            )
        entry = registry.find_detector(what)
        if plant is None:
            lacks = f"{what!r} is a name, which" if isinstance(what, str) else f"{entry.name} is not built: it"
            raise ValueError(f"detector {lacks} needs its plant; pass it, a Plant or a name")
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
    given = what if isinstance(what, Diagnoser) and plant is None else detector(what, plant)
    return given.diagnose(*data, gap=gap, log_map=log_map)
