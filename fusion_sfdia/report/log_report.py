"""The files of a diagnosis: events, reconstructed readings, and a figure of what was isolated."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fusion_sfdia.core.detector import Detector
from fusion_sfdia.core.files import all_or_none, atomic_write, require_free
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.evaluation.diagnose import Diagnosis, Event, diagnose_run
from fusion_sfdia.evaluation.logs import read_log, write_log
from fusion_sfdia.report.plots import panels, time_series, write_figure

FILES = ("events.csv", "reconstructed.csv", "diagnosis.svg", "diagnosis.png")
MOST_PANELS = 6


def diagnose_log(
    data: Path,
    detector: Detector,
    out: Path,
    *,
    absent_sensors: bool = False,
    other_columns: bool = False,
    nominal_inputs: bool = False,
    force: bool = False,
) -> Diagnosis:
    """Diagnose a log with a detector and write FILES into the folder `out`.

    Raises ValueError naming the file where the log does not fit (see read_log), and where the folder is not free; warns as
    `diagnose_run` does.
    """
    require_free(out, force=force)
    plant = detector.plant
    log = read_log(data, plant, absent_sensors=absent_sensors, other_columns=other_columns, nominal_inputs=nominal_inputs)
    try:
        found = diagnose_run(detector, log)
    except ValueError as error:
        raise ValueError(f"{data}: {error}") from error
    with all_or_none(out) as new:
        write_diagnosis(new, plant, log.y, log.u, found)
    return found


def as_text(found: Diagnosis, detector: str) -> str:
    """The events for people."""
    count = len(found.events)
    lines = [f"{len(found.t)} readings, {count} event{'s' * (count != 1)} by {detector}"]
    for e in found.events:
        end = "end of the log" if e.open else f"{e.end:g} s"
        lines.append(f"  {e.hypothesis}: {e.start:g} s to {end}, size {e.size:.4g} {e.unit}")
    return "\n".join(lines)


def write_diagnosis(out: Path, plant: Plant, y: NDArray[np.float64], u: NDArray[np.float64], found: Diagnosis) -> None:
    """Write FILES into the folder: y (K, N) the readings as they came, u (K, m) the inputs."""
    with atomic_write(out / "events.csv") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(("sensor", "start_s", "end_s", "size", "unit", "open"))
        for e in found.events:
            table.writerow((e.hypothesis, repr(e.start), repr(e.end), repr(e.size), e.unit, str(e.open).lower()))
    write_log(out / "reconstructed.csv", plant, found.t, found.decisions.reconstruction, u)
    write_figure(out, "diagnosis", lambda: draw(plant, np.where(found.decisions.absurd, np.nan, y), found))


def draw(plant: Plant, y: NDArray[np.float64], found: Diagnosis) -> Figure:
    """Readings and reconstruction of the sensors with events, largest first; without events, of the first sensor."""
    names = _by_size(plant, found.events)[:MOST_PANELS] or [plant.sensor_names[0]]
    figure, axes = panels([_title(name, found.events) for name in names], columns=1, width=9.5, height=2.6)
    for axis, name in zip(axes, names, strict=True):
        i = plant.sensor_index(name)
        spans = [(e.start, e.end) for e in found.events if e.hypothesis == name]
        series = {"reading": y[:, i], "reconstructed": found.decisions.reconstruction[:, i]}
        time_series(axis, found.t, series, ylabel=f"{name} [{plant.sensors[i].unit}]", spans=spans)
        handles, labels = axis.get_legend_handles_labels()
        axis.legend(handles, ["isolated" if label == "fault acts" else label for label in labels], fontsize=8)
    return figure


def _title(name: str, events: tuple[Event, ...]) -> str:
    return f"{name}: " + (f"{sum(e.hypothesis == name for e in events)} event(s)" if events else "no sensor was isolated")


def _by_size(plant: Plant, events: tuple[Event, ...]) -> list[str]:
    """Sensors with events, the largest in units of its noise first."""
    sigma = dict(zip(plant.sensor_names, plant.sensor_sigma, strict=True))
    size: dict[str, float] = {}
    for e in events:
        if e.hypothesis in sigma:
            size[e.hypothesis] = max(size.get(e.hypothesis, 0.0), abs(e.size) / sigma[e.hypothesis])
    return sorted(size, key=lambda name: -size[name])
