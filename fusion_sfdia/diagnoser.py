"""Detectors from Python: by name, fitted to healthy readings, run over a log or row by row; results to plot and report."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from fusion_sfdia.common.errors import warn
from fusion_sfdia.common.rate import Rate
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

    Attributes
    ----------
    detector : Detector
        To be stepped, as `run` and `Watch` take it.
    name : str
        Shown in reports.
    build : NamedDetector or None
        Makes the detector for another plant; None for an object.
    fitted : bool
        Whether `fit` has fitted it to readings of this plant.

    Examples
    --------
    >>> from fusion_sfdia import detector, simulate
    >>> from fusion_sfdia.plants import two_tanks
    >>> plant = two_tanks()
    >>> healthy = simulate(plant, 300, seeds=range(4), process_noise=True)
    >>> limits = detector("limits", plant).fit(healthy, false_alarm=0.01)
    >>> limits.name, limits.fitted
    ('limits', True)
    >>> limits.diagnose(simulate(plant, 50, seeds=[9])).decisions.isolated.shape
    (50, 4)
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

        Parameters
        ----------
        healthy : file, frame, Log, Recording, tuple or None
            A file or a frame, which `load_log` reads with log_map; what `load_log` or `check_log` read; a Log, a Recording or a
            tuple t (K,), y (K, ..., N), u (K, ..., m), also of several runs side by side; None for simulated runs.
        false_alarm : str or float, default "1/day"
            "1/day", "2/hour", or a rate per sample over all sensors.
        log_map : LogMap, str or Path, optional
            How a file or frame is written, or the file that states it.

        Returns
        -------
        Diagnoser
            A new one; this one stays as it is.

        Raises
        ------
        ValueError
            Where the readings do not fit, look misread or are too few for the rate.
        NotApplicableError
            As the detector raises it.
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

        The same log has the same Diagnosis in each of the forms below, and on the command line. Time stamps give events their
        wall-clock times. Sensors whose unit `check_log` suspects, and readings that only repeat the one before, are taken as
        missing; sensors that are coarse or cyclic, which the plant does not state, have more noise, or a period
        (`Diagnosis.of_log` states what was found, `Diagnosis.suspects` the former).

        Parameters
        ----------
        *data : file, frame, Log, Recording or arrays
            A file or a frame, which `load_log` reads with log_map; what `load_log` or `check_log` read; a Log, a Recording of
            one run, or t (K,) in s, y (K, N), u (K, m), see `as_log`.
        gap : int, default 3
            Samples without a verdict after which an event closes.
        log_map : LogMap, str or Path, optional
            How a file or frame is written, or the file that states it.

        Returns
        -------
        Result
            The events, the Decisions behind them and the readings.

        Raises
        ------
        ValueError
            Where the data do not fit.

        Warns
        -----
        DiagnosisWarning
            For limits of the diagnosis that the events do not show.
        """
        one = data[0] if len(data) == 1 else None
        source = Path(one).name if isinstance(one, str | Path) else "a log"
        if not isinstance(one := _loaded(self.plant, one, log_map), LoadedLog):
            one = LoadedLog(one_run(as_log(self.plant, *data)), SECONDS, ())
        build = None if self.fitted or self.build is None else partial(registry.detector, self.build)
        found, log = prepared(self.detector, one, build).diagnose(gap=gap)
        return Result.of(found, plant=self.plant, detector=self.name, log=log, columns=one.columns, source=source)

    def stream(self, **settings: Any) -> Watch:
        """The detector over rows as they come; `Watch.update` takes a row.

        Rows are in the units of the plant; sensors that are not read are named by `unread`.

        Parameters
        ----------
        **settings
            Those of `Watch`.

        Returns
        -------
        Watch
            Before its first row.

        Examples
        --------
        >>> from fusion_sfdia import detector, simulate
        >>> recording = simulate(detector("robust-glr", "two-tanks").plant, 5, seeds=[1])
        >>> watch = detector("robust-glr", "two-tanks").stream(gap=5)
        >>> [len(watch.update(t, y[0], u)) for t, y, u in zip(recording.t, recording.y, recording.u)]
        [0, 2, 1, 1, 1]
        """
        return Watch(self.detector, **settings)

    def save(self, path: str | Path) -> None:
        """Write the detector to a file; `load_detector` reads it.

        Parameters
        ----------
        path : str or Path
            The .npz file to write.

        Raises
        ------
        ValueError
            As `save_detector` does.
        """
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

    Parameters
    ----------
    what : str, class, callable, Detector, NamedDetector or Diagnoser
        A registered name, a class or a function that builds a detector, which need the plant; or a Detector that is built
        already, such as `load_detector` returns it.
    plant : Plant or str, optional
        An object or a name.

    Returns
    -------
    Diagnoser
        The detector, its plant and its name.

    Raises
    ------
    ValueError
        Where names are unknown, `what` is no detector, or the plant is missing or given twice.
    NotApplicableError
        Where the plant lacks what the method needs.

    Examples
    --------
    >>> from fusion_sfdia import detector
    >>> from fusion_sfdia.detectors import RobustBank
    >>> from fusion_sfdia.plants import two_tanks
    >>> detector("robust-glr", "two-tanks").plant.sensor_names
    ('l1', 'l2', 'q12', 'q2')
    >>> detector(RobustBank(two_tanks(), false_alarm=1e-4)).detector.false_alarm
    0.0001
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
    """Diagnose recorded readings: `detector(what, plant).diagnose(*data)`, see there.

    Parameters
    ----------
    what : str, class, callable, Detector, NamedDetector or Diagnoser
        As of `detector`.
    *data : file, frame, Log, Recording or arrays
        As of `Diagnoser.diagnose`.
    plant : Plant or str, optional
        As of `detector`.
    gap : int, default 3
        Samples without a verdict after which an event closes.
    log_map : LogMap, str or Path, optional
        How a file or frame is written, or the file that states it.

    Returns
    -------
    Result
        The events, the Decisions behind them and the readings.

    Raises
    ------
    ValueError
        As `detector` and `Diagnoser.diagnose` do.

    Examples
    --------
    >>> from fusion_sfdia import Fault, Log, diagnose, simulate
    >>> from fusion_sfdia.faults import apply_faults
    >>> from fusion_sfdia.plants import two_tanks
    >>> plant = two_tanks()
    >>> healthy = simulate(plant, 100, seeds=[1])
    >>> readings = apply_faults(plant, healthy.t, healthy.y, [Fault("l1", "bias", onset=300.0, magnitude=0.08)])
    >>> diagnose("robust-glr", Log(healthy.t, readings.y[:, 0], healthy.u), plant=plant).verdict
    'sensor l1'
    """
    return detector(what, plant).diagnose(*data, gap=gap, log_map=log_map)
