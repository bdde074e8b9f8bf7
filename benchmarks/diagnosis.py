"""The files of a diagnosis: events, reconstructed readings, and a figure of what was isolated."""

from __future__ import annotations

import csv
import os
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fusion_sfdia.benchmarks.plots import panels, time_series, write_figure
from fusion_sfdia.diagnose import Diagnosis, Event
from fusion_sfdia.logs import write_log
from fusion_sfdia.plant import Plant
from fusion_sfdia.storage import atomic_write

FILES = ("events.csv", "reconstructed.csv", "diagnosis.svg", "diagnosis.png")
MOST_PANELS = 6


def require_free(out: Path, *, force: bool) -> None:
    """Raise ValueError where the folder is a file, cannot be written to, or holds something and force is not given."""
    if out.exists() and not out.is_dir():
        raise ValueError(f"{out} is a file; name a folder for the diagnosis with --out")
    if out.exists() and any(out.iterdir()) and not force:
        raise ValueError(f"{out} is already used; name another folder with --out, or overwrite with --force")
    nearest = next(p for p in (out.absolute(), *out.absolute().parents) if p.exists())
    if not nearest.is_dir() or not os.access(nearest, os.W_OK):
        raise ValueError(f"cannot write into {out} ({nearest} is not a folder to write to); name another folder with --out")


def write_diagnosis(out: Path, plant: Plant, y: NDArray[np.float64], u: NDArray[np.float64], found: Diagnosis) -> None:
    """Write FILES into the folder: y (K, N) the readings as they came, u (K, m) the inputs."""
    with atomic_write(out / "events.csv") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(("sensor", "start_s", "end_s", "size", "unit", "open"))
        for e in found.events:
            table.writerow((e.hypothesis, repr(e.start), repr(e.end), repr(e.size), e.unit, str(e.open).lower()))
    write_log(out / "reconstructed.csv", plant, found.t, found.decisions.measured, u)
    write_figure(out, "diagnosis", lambda: draw(plant, y, found))


def draw(plant: Plant, y: NDArray[np.float64], found: Diagnosis) -> Figure:
    """Readings and reconstruction of the sensors with events, largest first; without events, of the first sensor."""
    names = _by_size(plant, found.events)[:MOST_PANELS] or [plant.sensor_names[0]]
    figure, axes = panels([_title(name, found.events) for name in names], columns=1, width=9.5, height=2.6)
    for axis, name in zip(axes, names, strict=True):
        i = plant.sensor_index(name)
        spans = [(e.start, e.end) for e in found.events if e.hypothesis == name]
        series = {"reading": y[:, i], "reconstructed": found.decisions.measured[:, i]}
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
