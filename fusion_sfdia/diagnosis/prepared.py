"""The one way from a loaded log to its Diagnosis, for every entrance: command line, Python, frames, arrays and a Watch.

What looks like a fault of a sensor and is none is settled first: a unit that looks wrong, repeats, coarse steps, a period.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fusion_sfdia.common.clock import Clock
from fusion_sfdia.detectors.batch_detector import BatchDetector
from fusion_sfdia.detectors.detector import Decision, Detector, check_reading
from fusion_sfdia.diagnosis.diagnose import Diagnosis, diagnose_run
from fusion_sfdia.diagnosis.lag import explained_by_lag
from fusion_sfdia.logs.check import CHECKED, checked, without_suspects
from fusion_sfdia.logs.loaded_log import LoadedLog, briefly
from fusion_sfdia.logs.regular_sensors import Regularities, regularities
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant


class Prepared(NamedTuple):
    """A log as it is judged, and the detector that does; a `Watch(detector, unread=unread)` judges the rows after it alike.

    unread: sensors of which no reading is used, since they are absent or, the suspects, since their unit looks wrong. of_log:
    what was found in the log and taken into account, a line each.
    """

    detector: Detector
    log: Log
    clock: Clock
    unread: tuple[str, ...]
    suspects: tuple[str, ...]
    of_log: tuple[str, ...]

    def diagnose(
        self, *, gap: int = 3, each: Callable[[Sequence[int]], Iterable[int]] = iter, decisions: Decision | None = None
    ) -> tuple[Diagnosis, Log]:
        """The Diagnosis, see `diagnose_run`, with late sensors explained, and the log that it is of, see `explained_by_lag`.
        decisions: those of the detector on the log, where they are known. ValueError, DiagnosisWarning: as of `diagnose_run`.
        """

        def again(log: Log, decisions: Decision | None = None) -> Diagnosis:
            found = diagnose_run(
                self.detector, log, gap=gap, clock=self.clock, each=each, unread=self.unread, decisions=decisions
            )
            return replace(found, of_log=self.of_log, suspects=self.suspects)

        return explained_by_lag(self.detector, self.log, again(self.log, decisions), again)


def prepared(detector: Detector, loaded: LoadedLog, build: Callable[[Plant], Detector] | None = None) -> Prepared:
    """The log as it is judged, and the detector that judges it. The log is checked, unless it has been, see `checked`; sensors
    of a suspected unit and readings that only repeat the one before are missing in it, and the detector has the noise and the
    periods of coarse and of cyclic sensors.

    build: makes the detector for a plant, where it was not fitted to readings; None where only it itself can be adapted.
    ValueError for a log of other sensors or inputs than the plant has.
    """
    plant = detector.plant
    y, u = (np.zeros(values.shape[1:]) for values in loaded.log[1:])
    check_reading(plant, y, u, ())  # their numbers of sensors and inputs
    loaded = checked(plant, loaded)
    regular = regularities(plant, loaded.log)
    return Prepared(
        with_regularities(detector, regular, build).dated(loaded.clock.start),
        without_suspects(plant, loaded, regular).log,
        loaded.clock,
        (*loaded.absent, *loaded.suspects),
        loaded.suspects,
        briefly(f for f in loaded.findings if f.kind in CHECKED),
    )


def with_regularities(detector: Detector, regular: Regularities, build: Callable[[Plant], Detector] | None = None) -> Detector:
    """The detector on the plant with these periods and resolutions; build: makes it for a plant, where it was not fitted to
    readings of this one.
    """
    plant = regular.of(detector.plant, noise=build is not None or detector.fitted_rate is None)
    if plant is detector.plant:
        return detector
    if build is not None:
        return build(plant)
    return detector.with_sensors_of(plant) if isinstance(detector, BatchDetector) else detector
