"""What a detector or a monitor found in a log, with the readings, to plot and to report."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fusion_sfdia.diagnosis.diagnose import Diagnosis, present
from fusion_sfdia.logs.columns import Source
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, repr=False, kw_only=True)
class Result(Diagnosis):
    """A Diagnosis with the readings it was made from.

    plant: of the detector. detector: its name. log: as it was judged. columns: of the file or frame, whose tags and units
    `plot` and `report` show. source: name of the file, for the report. basis: by what it was judged, where that is no model.
    """

    plant: Plant
    detector: str
    log: Log
    columns: tuple[Source, ...] = ()
    source: str = "a log"
    basis: str = ""

    @classmethod
    def of(cls, found: Diagnosis, **readings: Any) -> Result:
        """The result of a Diagnosis and its readings, the further fields."""
        return cls(**{f.name: getattr(found, f.name) for f in fields(found)}, **readings)

    def plot(self) -> Figure:
        """Readings and reconstructions of the sensors with events, without any of the first sensor, as a matplotlib Figure."""
        from fusion_sfdia.report.log_report import draw

        return draw(*self._shown())

    def report(self, path: str | Path) -> Path:
        """Write the report as one HTML file, whole or not at all, and return its path; ValueError for another suffix."""
        from fusion_sfdia.report.log_page import About, write_page

        if (path := Path(path)).suffix != ".html":
            raise ValueError(f"report: {path} has another suffix; expected a file that ends in .html")
        write_page(path, *self._shown(), About(self.source, self.detector, basis=self.basis))
        return path

    def _shown(self) -> tuple[Plant, Any, Diagnosis]:
        """Plant, readings and diagnosis in the tags and units of the log."""
        from fusion_sfdia.report.log_units import LogUnits

        units, y = LogUnits(self.plant, self.columns), present(self.log.y, self.decisions)
        return units.plant, units.readings(y), units.diagnosis(self)
