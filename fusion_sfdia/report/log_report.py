"""The files of a diagnosis: events, scores, reconstructed readings, a report, and a figure of what was isolated."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable, Sequence
from contextlib import nullcontext
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fusion_sfdia.common.errors import warn
from fusion_sfdia.common.files import all_or_none, atomic_write, locked
from fusion_sfdia.common.plain_text import cell, plain
from fusion_sfdia.detectors.detector import Detector
from fusion_sfdia.detectors.storage import require_detector
from fusion_sfdia.detectors.verdicts import Verdict
from fusion_sfdia.diagnosis.diagnose import Diagnosis, present
from fusion_sfdia.diagnosis.events import ProcessEvent, open_questions
from fusion_sfdia.diagnosis.prepared import prepared
from fusion_sfdia.diagnosis.sentences import alike
from fusion_sfdia.logs.check import check_log
from fusion_sfdia.logs.loaded_log import LoadedLog
from fusion_sfdia.logs.log_map import LogMap
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.report.figure_files import write_figure
from fusion_sfdia.report.log_figures import (
    LONGEST,
    broken,
    process_size,
    short,
    thinned,
    time_axis,
    time_line,
)
from fusion_sfdia.report.log_page import About, write_page
from fusion_sfdia.report.log_units import LogUnits, with_brackets
from fusion_sfdia.report.plots import legend_above, panels, time_series
from fusion_sfdia.report.progress import progress
from fusion_sfdia.report.sample_tables import SUFFIXES, reconstructed, require_tables, scores, write_rows

FILES = ("report.html", "events.csv", "reconstructed.csv", "scores.csv", "diagnosis.svg", "diagnosis.png")
OWN_FILE = "monitor.txt"  # beside them, of a monitor
OF_BEFORE = (
    *FILES,
    OWN_FILE,
    *(f"{n}{s}" for n in ("reconstructed", "scores") for s in SUFFIXES),
)  # what a diagnosis in the same folder may have left
MOST_PANELS = 6
SHOWN = 3  # findings that are the same but for their times and sizes, as text
UNNAMED = About("a log", "a detector")


def diagnose_log(
    data: Path,
    detector: Detector,
    out: Path,
    *,
    log_map: LogMap | Path | None = None,
    read: LoadedLog | None = None,
    absent_sensors: bool = False,
    other_columns: bool = False,
    nominal_inputs: bool = False,
    force: bool = False,
    held: bool = False,
    detector_name: str = "",
    build: Callable[[Plant], Detector] | None = None,
    suffix: str = ".csv",
) -> Diagnosis:
    """Diagnose a log with a detector and write FILES into the folder `out`; detector_name: for the report.

    A bar shows the progress on a terminal. suffix: as of `write_diagnosis`.

    log_map: how the log is written, see `load_log`. read: what `check_log` has found, where it was called already. build: makes
    the detector anew, see `prepared`. held: whether the caller has `locked` the folder.
    Raises ValueError naming the file where the log does not fit (see load_log), and where the folder is not free or another
    process writes into it; warns of what reading the log found, and as `diagnose_run` does.
    """
    require_detector(detector)
    require_apart(data, out)
    require_tables(suffix)
    plant = detector.plant
    given = {"absent_sensors": absent_sensors, "other_columns": other_columns, "nominal_inputs": nominal_inputs}
    with nullcontext() if held else locked(out, force=force):
        loaded = check_log(data, plant, log_map, **given) if read is None else read
        for remark in loaded.brief:
            warn(f"{data}: {remark}")
        judged = prepared(detector, loaded, build)
        try:
            found, log = judged.diagnose(each=progress)
        except ValueError as error:
            raise ValueError(f"{data}: {error}") from error
        with all_or_none(out, instead_of=OF_BEFORE) as new:
            about = About(data.name, detector_name or type(detector).__name__)
            write_diagnosis(new, plant, log.y, log.u, found, about, LogUnits(plant, loaded.columns), suffix)
    return found


def require_apart(data: Path, out: Path) -> None:
    """Raise ValueError for a log that is one of the files which a diagnosis writes or removes in its folder."""
    if data.resolve() in {(out / name).resolve() for name in OF_BEFORE}:
        raise ValueError(f"{data} is among the files that a diagnosis writes into {out}; name another folder by --out")


def files(suffix: str) -> list[str]:
    """FILES, with another suffix of the tables with a row a sample."""
    return [f.replace(".csv", suffix) if f in ("reconstructed.csv", "scores.csv") else f for f in FILES]


def as_text(found: Diagnosis, detector: str) -> str:
    """The diagnosis for people: what was found in a few words, a sentence each, the most important first; then how it is to be
    taken, what limits the detector, and whether the model fits, unless a change of the process explains that it does not.
    Of what happened more than `SHOWN` times, those alone and how often, and until when.
    """
    lines = [f"{len(found.t)} readings by {detector}: {found.headline}"]
    more = {id(own[SHOWN - 1]): own[SHOWN:] for own in alike(found.findings) if len(own) > SHOWN + 1}
    left = {id(e) for own in more.values() for e in own}
    for e in found.findings:
        if id(e) not in left:
            lines.append(f"  {found.sentence(e)}")
        if own := more.get(id(e)):
            first, last = found.clock.at(min(e.start for e in own)), found.clock.at(max(e.end for e in own))
            lines.append(f"  The same happened {len(own)} times more between {first} and {last}: they are in events.csv.")
    lines += [line for line in (found.caution, *found.remarks) if line]
    lines += [found.health.line] if found.health and not found.is_explained_by_the_process else []
    return "\n".join(lines)


def write_diagnosis(
    out: Path,
    plant: Plant,
    y: NDArray[np.float64],
    u: NDArray[np.float64],
    found: Diagnosis,
    about: About = UNNAMED,
    shown_in: LogUnits | None = None,
    suffix: str = ".csv",
) -> None:
    """Write FILES into the folder: y (K, N) the readings as they came, u (K, m) the inputs.

    shown_in: the names and units of all but events.csv, which has those of the plant. suffix: of the tables with a row a
    sample, see `write_rows`.
    """
    header, rows = found.table()
    write_table(out / "events.csv", header, rows)
    taken, of_log = present(y, found.decisions), shown_in or LogUnits(plant, ())
    for name, table in (("reconstructed", reconstructed(y, u, found, of_log)), ("scores", scores(found, of_log))):
        write_rows(out / f"{name}{suffix}", len(found.t), table)
    if shown_in is not None:
        plant, taken, found = shown_in.plant, shown_in.readings(taken), shown_in.diagnosis(found)
    write_figure(out, "diagnosis", lambda: draw(plant, taken, found))
    write_page(out / "report.html", plant, taken, found, about)


def write_table(path: Path, header: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Write a table as CSV, whole or not at all; texts as they are shown, numbers in full."""
    with atomic_write(path) as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(map(_cell, header))
        table.writerows(map(_cell, row) for row in rows)


def _cell(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return repr(float(value)) if isinstance(value, float) else cell(plain(str(value))) if isinstance(value, str) else str(value)


def draw(plant: Plant, y: NDArray[np.float64], found: Diagnosis) -> Figure:
    """Readings and reconstruction of the sensors with events, largest first; without events, of the first sensor.

    Of a detector that tests the process, too, first what was found with all events on a time line, and how far the process is
    from the model by each accepted hypothesis; of the sensors also those that are suspected.
    """
    process = list(dict.fromkeys(e.hypothesis for e in found.events if isinstance(e, ProcessEvent)))[:MOST_PANELS]
    verdict = [fill(found.headline, 60)] if found.process_hypotheses and found.events else []
    names = _sensors(plant, found)[:MOST_PANELS] or [plant.sensor_names[0]]
    titles = [*verdict, *(short(found, name, LONGEST) for name in process), *(_title(name, found) for name in names)]
    figure, axes = panels(titles, columns=1, width=9.5, height=2.6)
    for axis, name in zip(axes[-len(names) :], names, strict=True):
        i = plant.sensor_index(name)
        spans = [(e.start, e.end) for e in found.events if e.hypothesis == name]
        made = found.decisions.reconstruction[:, i]
        shown = np.union1d(thinned(y[:, i]), thinned(made))
        t, (reading, remade) = broken(found.t[shown], (y[shown, i], made[shown]), found.gaps)
        series = {"reading": reading, "reconstructed": remade}
        label = with_brackets(name, plant.sensors[i].unit)
        time_series(axis, t, series, ylabel=label, spans=spans, at=time_axis(found))
        for patch in axis.patches:
            patch.set_label("fault")
    if verdict:
        time_line(axes[0], found)
        for axis, name in zip(axes[1:], process, strict=False):
            process_size(axis, found, name)
        for axis in axes[1:]:
            axis.set_xlim(axes[0].get_xlim())
    for axis in axes:
        if legend := axis.get_legend():
            legend.remove()
    legend_above(figure)
    return figure


def _title(name: str, found: Diagnosis) -> str:
    count = sum(e.hypothesis == name and e.kind != "undecided" for e in found.events)
    if not found.events:
        healthy = found.state is Verdict.HEALTHY and not found.process_hypotheses
        return f"{name}: {'no sensor was isolated' if healthy else found.verdict}"
    return f"{name}: {count} event{'s' * (count != 1)}" if count or not found.process_hypotheses else f"{name}: not isolated"


def _sensors(plant: Plant, found: Diagnosis) -> list[str]:
    """Sensors with events, the largest in units of its noise first, and then those that are suspected in the end."""
    sigma = dict(zip(plant.sensor_names, plant.sensor_sigma, strict=True))
    size: dict[str, float] = {}
    for e in found.events:
        if e.hypothesis in sigma:
            size[e.hypothesis] = max(size.get(e.hypothesis, 0.0), abs(e.size) / sigma[e.hypothesis])
    suspects = [name for e in open_questions(found.events, found.t) for name in e.suspects if name in sigma]
    return list(dict.fromkeys([*sorted(size, key=lambda name: -size[name]), *suspects]))
