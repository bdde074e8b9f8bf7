"""report.html of a diagnosis: one file that needs nothing else, to be forwarded to someone who did not run it.

First what was found, a sentence each, then each finding with its picture; statistics are folded.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fusion_sfdia import __version__
from fusion_sfdia.common.files import atomic_write
from fusion_sfdia.detectors.verdicts import Verdict
from fusion_sfdia.diagnosis.diagnose import Diagnosis
from fusion_sfdia.diagnosis.events import Event
from fusion_sfdia.diagnosis.sentences import KINDS, Words, alike, confidence_of, kind_of, others_of, size_of
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.report.figure_files import figure_svg
from fusion_sfdia.report.log_figures import LONGEST, is_predicted, near, overview, short, shown_sensor, time_line
from fusion_sfdia.report.on_screen import on_screen
from fusion_sfdia.report.page import inline, page_environment, part
from fusion_sfdia.report.plots import panels

MOST_EVENTS = (200, 1000)  # of one finding, and of all together
MOST_SENTENCES = 3  # of one finding; of one with more the first alone, and how many there are
MOST_FIGURES = 32
MOST_LINES = 100  # of the time line
POINTS = (100, 2000, 8000)  # of a line at least and at most, and of all figures together


class About(NamedTuple):
    """Names for people, of the log and of the detector, and what else is to be known of the detector, a line each.

    basis: by what the log is judged, where that is no model. files: whether those of `diagnose` are beside the page.
    """

    log: str
    detector: str
    notes: tuple[str, ...] = ()
    basis: str = ""
    files: bool = True


class Drawn(NamedTuple):
    """A figure of the page. plot: what figures.js needs, see `on_screen`."""

    title: str
    svg: Markup
    caption: str
    plot: str


def write_page(path: Path, plant: Plant, y: NDArray[np.float64], found: Diagnosis, about: About) -> None:
    """Write report.html of readings y (K, N), NaN where missing, whole or not at all; every name and text is escaped."""
    passing, drawable = found.passing, len(found.t) > 1
    # by which it is judged, not what was found in it
    learnt = [line for line in found.of_log if line not in about.notes] if about.basis else []
    lines = [line_drawn(found)] if len(found.events) > 1 else []
    strips = [overview_drawn(plant, y, found)] if found.after is not None and drawable else []
    findings = findings_of(plant, y, found, MOST_FIGURES if drawable else 0)
    page = (
        page_environment()
        .get_template("log_page.html.j2")
        .render(
            css=Markup(part("page.css") + part("log_page.css")),
            figures=Markup(part("figures.js")),
            about=about,
            health=found.health.line if found.health else about.basis or "model not tested",
            verdict=found.verdict,
            headline=f"{found.headline[0].upper()}{found.headline[1:]}.",
            healthy=found.state is Verdict.HEALTHY,
            caution=found.caution,
            samples=len(found.t),
            sensors=len(plant.sensors),
            plant=plant.name,
            when=found.clock.span(float(found.t[0]), float(found.t[-1])),
            zone=found.clock.zone,
            remarks=[line for line in dict.fromkeys((*found.remarks, *about.notes)) if line not in (found.limit, *learnt)],
            learnt=learnt,
            limit=found.limit,
            findings=findings,
            passing=[found.sentence(e) for e in passing[: MOST_EVENTS[0]]],
            hidden=max(0, len(passing) - MOST_EVENTS[0]),
            drawn=sum(f["figure"] is not None for f in findings),
            lines=lines,
            strips=strips,
            version=__version__,
        )
    )
    with atomic_write(path) as file:
        file.write(page)


def findings_of(
    plant: Plant, y: NDArray[np.float64], found: Diagnosis, figures: int, *, open_first: bool = False
) -> list[dict[str, Any]]:
    """The findings of readings y (K, N), the most important first, as texts; the first ones, so many, with a figure.

    open_first: those that still act before those that are over, of each the most important first.
    """
    groups = alike(found.standing)
    least, most, all_of_them = POINTS
    points = min(most, max(least, all_of_them // max(len(groups), 1)))
    rows = min(MOST_EVENTS[0], max(1, MOST_EVENTS[1] // max(len(groups), 1)))
    findings = []
    for k, own in enumerate(sorted(groups, key=lambda own: open_first and not any(e.open for e in own))):
        figure, title = None, _title(found, own)
        if k < figures:
            caption = _caption(own, is_predicted(found, shown_sensor(plant, found, own)))
            figure = _drawn(found, f"f{k}", title, partial(near, plant, y, found, own, points), caption)
        findings.append(_finding(found, own, rows) | {"number": k + 1, "title": title, "figure": figure})
    return findings


def line_drawn(found: Diagnosis) -> Drawn:
    """The time line of the events."""
    caption = "When each was found: on the left what, on the right which kind of fault. Grey: no rows in the log."
    return _drawn(found, "time-line", "Time line", lambda: _time_line(found), caption)


def overview_drawn(plant: Plant, y: NDArray[np.float64], found: Diagnosis) -> Drawn:
    """All sensors over time."""
    caption = (
        "Every sensor: the darker, the further its reading is from what the other sensors and the model predict. "
        "Underlined in orange: a fault. White: no reading. Grey: no rows in the log."
    )
    return _drawn(found, "overview", "All sensors", lambda: overview(plant, y, found), caption)


def _drawn(found: Diagnosis, name: str, title: str, draw: Callable[[], Figure], caption: str) -> Drawn:
    plots: list[str] = []
    svg = figure_svg(name, draw, text="none", laid_out=lambda figure: plots.append(on_screen(figure, found.clock)))
    return Drawn(title, inline(svg, name, title), caption, plots[0])


def _time_line(found: Diagnosis) -> Figure:
    rows = len({(e.kind, e.hypothesis) for e in found.events})
    figure, (axes,) = panels([""], columns=1, width=8.0, height=1.1 + 0.25 * min(max(rows, 4), MOST_LINES))
    time_line(axes, found, MOST_LINES)
    return figure


def _title(found: Diagnosis, own: Sequence[Event]) -> str:
    """Name and kind of a finding."""
    e = own[0]
    w, name = found.words.get(e.hypothesis), short(found, e.hypothesis, LONGEST)
    if e.kind != "sensor" and (w is None or name != w.name):  # words, no tag
        name = f"{name[0].upper()}{name[1:]}"
    return f"{name}: {e.fault or KINDS[e.kind].word}" if e.kind != "undecided" else "Undecided"


def _caption(own: Sequence[Event], predicted: bool) -> str:
    """What the picture of a finding shows beside what its legend states; predicted: see `is_predicted`."""
    which = "the readings" if own[0].kind == "sensor" else "the readings furthest from what is expected"
    when = " at the first of these times" if len(own) > 1 else ""
    off = "their difference from what is expected (grey: the usual range)"
    if not predicted:
        off = "how far they are off, over the limit of an alarm (grey: below it)"
    return f"Top: {which}{when}. Middle: {off}. Bottom: what was found."


def finding_texts(e: Event, words: Words, sentences: Sequence[str], more: str = "") -> dict[str, Any]:
    """What is shown of a finding, by its most important event, where findings are listed."""
    return {
        "open": e.open,
        "kind": e.kind,
        "word": kind_of(e).word,
        "sentences": sentences,
        "more": more,
        "confidence": confidence_of(e),
        "others": ", ".join(others_of(e, words)),
    }


def _finding(found: Diagnosis, own: Sequence[Event], most: int) -> dict[str, Any]:
    """A finding as texts; own: its events, the most important first, of which `most` have a row."""
    first, many = own[0], len(own) > MOST_SENTENCES
    start, end = min(e.start for e in own), max(e.end for e in own)
    more = f"{len(own)} occurrences in all, {found.clock.span(start, end)}; see Numbers." if many else ""
    sentences = [found.sentence(e) for e in (own[:1] if many else own)]
    return finding_texts(first, found.words, sentences, more) | {
        "open": any(e.open for e in own),
        "rows": [_row(found, e) for e in own[:most]],
        "hidden": max(0, len(own) - most),
    }


def _row(found: Diagnosis, e: Event) -> dict[str, str]:
    """An event as texts, with its statistics."""
    return {
        "fault": " or ".join([e.fault, *e.fault_alternatives]) if e.fault else KINDS[e.kind].word,
        "start": found.clock.wall(e.start),
        "end": "end of the log" if e.open else found.clock.wall(e.end),
        "size": size_of(e, found.words),
        "sigmas": f"{abs(e.sigmas):.3g}" if math.isfinite(e.sigmas) and size_of(e, found.words) else "",
        "confidence": confidence_of(e),
        "summary": e.summary(found.clock),
    }
