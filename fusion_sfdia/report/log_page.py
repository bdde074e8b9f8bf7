"""report.html of a diagnosis: one file that needs nothing else, for a colleague who did not run it."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fusion_sfdia import __version__
from fusion_sfdia.common.files import atomic_write
from fusion_sfdia.diagnosis.diagnose import Diagnosis
from fusion_sfdia.diagnosis.events import Event, ProcessEvent, with_spread, with_unit
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.report.figure_files import figure_svg
from fusion_sfdia.report.log_figures import overview, time_line, zoom
from fusion_sfdia.report.page import inline, page_environment, part
from fusion_sfdia.report.plots import panels

MOST_EVENTS = 200
MOST_ZOOMS = 24


class About(NamedTuple):
    """Names for people, of the log and of the detector, and what else is to be known of the detector, a line each.

    basis: by what the log is judged, where that is no model.
    """

    log: str
    detector: str
    notes: tuple[str, ...] = ()
    basis: str = ""


class Drawn(NamedTuple):
    """A figure of the page."""

    title: str
    svg: Markup
    caption: str


def write_page(path: Path, plant: Plant, y: NDArray[np.float64], found: Diagnosis, about: About) -> None:
    """Write report.html of readings y (K, N), NaN where missing, whole or not at all; every name and text is escaped."""
    shown = found.events[:MOST_EVENTS]
    lines, strips = [], []
    if found.events:
        caption = "When each was found: on the left what, on the right which kind of fault. Grey: no rows in the log."
        lines = [_drawn("time-line", "Time line", lambda: _time_line(found), caption)]
    if found.after is not None and len(found.t) > 1:
        caption = (
            "Every sensor: the darker, the further its reading is from what the other sensors and the model predict. "
            "Underlined in orange: a fault. White: no reading. Grey: no rows in the log."
        )
        strips = [_drawn("overview", "All sensors", lambda: overview(plant, y, found), caption)]
    grouped = _by_sensor(found, plant) if found.after is not None and len(found.t) > 1 else {}
    zooms = [
        _drawn(f"zoom-{k}", f"{name}: {_extents(own)}", partial(zoom, plant, y, found, own), _caption(found, own))
        for k, (name, own) in enumerate(list(grouped.items())[:MOST_ZOOMS])
    ]
    page = (
        page_environment()
        .from_string(part("log_page.html.j2"))
        .render(
            css=Markup(part("page.css")),
            about=about,
            health=_sentence(found.health.line if found.health else about.basis or "model not tested"),
            suspect=found.health.suspect if found.health else not about.basis,
            verdict=f"{found.verdict}.",
            samples=len(found.t),
            sensors=len(plant.sensors),
            plant=plant.name,
            start=found.clock.at(float(found.t[0])),
            end=found.clock.at(float(found.t[-1])),
            remarks=[*found.remarks, *about.notes],
            events=[_row(found, e) for e in shown],
            hidden=len(found.events) - len(shown),
            lines=lines,
            strips=strips,
            zooms=zooms,
            unseen=max(0, len(grouped) - MOST_ZOOMS),
            version=__version__,
        )
    )
    with atomic_write(path) as file:
        file.write(page)


def _drawn(name: str, title: str, draw: Callable[[], Figure], caption: str) -> Drawn:
    return Drawn(title, inline(figure_svg(name, draw), name, title), caption)


def _time_line(found: Diagnosis) -> Figure:
    rows = len({(e.kind, e.hypothesis) for e in found.events})
    figure, (axes,) = panels([""], columns=1, width=9.6, height=1.1 + 0.25 * min(max(rows, 4), 10))
    time_line(axes, found)
    return figure


def _by_sensor(found: Diagnosis, plant: Plant) -> dict[str, list[Event]]:
    """The events of each sensor that can be drawn from near, in order of time, the sensor with the largest first."""
    grouped: dict[str, list[Event]] = {}
    for e in found.events:
        if e.kind == "sensor" and e.hypothesis in plant.sensor_names:
            grouped.setdefault(e.hypothesis, []).append(e)
    sizes = {name: max(map(_sigmas, own)) for name, own in grouped.items()}
    return {name: grouped[name] for name in sorted(grouped, key=lambda name: -sizes[name])}


def _sigmas(event: Event) -> float:
    """The size in standard deviations, 0 where it is not known."""
    return abs(event.sigmas) if math.isfinite(event.sigmas) else 0.0


def _extents(events: list[Event]) -> str:
    """Kinds and number of events, in words, those of the largest first."""
    kinds = ", ".join(dict.fromkeys(e.fault or "fault" for e in sorted(events, key=_sigmas, reverse=True)))
    return kinds if len(events) == 1 else f"{kinds}, {len(events)} times"


def _caption(found: Diagnosis, events: list[Event]) -> str:
    largest = max(events, key=_sigmas).told(found.clock)
    return f"{largest}." if len(events) == 1 else f"{largest}; and {len(events) - 1} smaller."


def _sentence(text: str) -> str:
    return f"{text[0].upper()}{text[1:]}."


def _row(found: Diagnosis, e: Event) -> dict[str, Any]:
    """An event as texts."""
    known, interval = math.isfinite(e.size), ""
    size = with_unit(f"{e.size:.4g}", e.unit) if known else ""
    if isinstance(e, ProcessEvent) and known:
        value, sd = with_spread(e.size, e.sd)
        size = f"{with_unit(value, e.unit)} +- {sd}"
    if known and math.isfinite(e.low):
        interval = f"{e.low:.4g} to {e.high:.4g}"
    kinds = {"process": "process or model", "outside": "not learnt", "undecided": "cannot tell", "other": "other fault"}
    return {
        "what": e.hypothesis,
        "fault": " or ".join([e.fault, *e.fault_alternatives]) if e.fault else kinds.get(e.kind, "not named"),
        "start": found.clock.at(e.start),
        "end": "end of the log" if e.open else found.clock.at(e.end),
        "size": size,
        "interval": interval,
        "sigmas": f"{abs(e.sigmas):.3g}" if math.isfinite(e.sigmas) else "",
        "confidence": _probability(e.confidence),
        "alternatives": ", ".join(e.alternatives),
    }


def _probability(p: float) -> str:
    if not math.isfinite(p):
        return ""
    return "> 0.99" if p > 0.99 else f"{p:.2f}"
