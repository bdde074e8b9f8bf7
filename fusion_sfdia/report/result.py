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

    Attributes
    ----------
    plant : Plant
        Of the detector.
    detector : str
        Its name.
    log : Log
        As it was judged.
    columns : tuple of Source
        Of the file or frame, whose tags and units `plot` and `report` show.
    source : str
        Name of the file, for the report.
    basis : str
        By what it was judged, where that is no model.
    misread : tuple of str
        Of which sensors the unit looks wrong though they were judged, and why, a line each; also in `of_log`.

    Notes
    -----
    The other attributes are those of `Diagnosis`.

    Examples
    --------
    >>> from fusion_sfdia import diagnose, simulate
    >>> from fusion_sfdia.plants import two_tanks
    >>> plant = two_tanks()
    >>> recording = simulate(plant, 30, seeds=[1])
    >>> result = diagnose("kf-chi2", recording, plant=plant)
    >>> result.detector, result.log.y.shape
    ('kf-chi2', (30, 4))
    """

    plant: Plant
    detector: str
    log: Log
    columns: tuple[Source, ...] = ()
    source: str = "a log"
    basis: str = ""
    misread: tuple[str, ...] = ()

    @classmethod
    def of(cls, found: Diagnosis, **readings: Any) -> Result:
        """The result of a Diagnosis and its readings.

        Parameters
        ----------
        found : Diagnosis
            What was found.
        **readings
            The further fields.

        Returns
        -------
        Result
            Both together.
        """
        return cls(**{f.name: getattr(found, f.name) for f in fields(found)}, **readings)

    def plot(self, path: str | Path | None = None) -> Figure:
        """Readings and reconstructions of the sensors that have events (of the first sensor if none has) as a Figure.

        Parameters
        ----------
        path : str or Path, optional
            A file to save it in, such as "found.png", in the format of its ending.

        Returns
        -------
        Figure
            Not shown.
        """
        from fusion_sfdia.report.log_report import draw

        figure = draw(*self._shown())
        if path is not None:
            figure.savefig(path)
        return figure

    def report(self, path: str | Path) -> Path:
        """Write the report as one HTML file, whole or not at all, and return its path.

        Parameters
        ----------
        path : str or Path
            A file that ends in .html.

        Returns
        -------
        Path
            Of the file.

        Raises
        ------
        ValueError
            For another suffix.
        """
        from fusion_sfdia.report.log_page import About, write_page

        if (path := Path(path)).suffix != ".html":
            raise ValueError(f"report: {path} has another suffix; expected a file that ends in .html")
        write_page(path, *self._shown(), About(self.source, self.detector, self.misread, self.basis, files=False))
        return path

    def _shown(self) -> tuple[Plant, Any, Diagnosis]:
        """Plant, readings and diagnosis in the tags and units of the log."""
        from fusion_sfdia.report.log_units import LogUnits

        units, y = LogUnits(self.plant, self.columns), present(self.log.y, self.decisions)
        return units.plant, units.readings(y), units.diagnosis(self)
