"""A page of a watch for a browser on this machine: its state, the last hours in figures, and what was found."""

from __future__ import annotations

import json
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from fusion_sfdia import __version__
from fusion_sfdia.common.arguments import number
from fusion_sfdia.detectors.detector import Decision, stack
from fusion_sfdia.detectors.verdicts import Conclusion, Verdict
from fusion_sfdia.diagnosis.changes import Change
from fusion_sfdia.diagnosis.device_health import DeviceHealth
from fusion_sfdia.diagnosis.diagnose import Diagnosis
from fusion_sfdia.diagnosis.events import Event, listed
from fusion_sfdia.diagnosis.sentences import by_importance, sentence, wordings
from fusion_sfdia.diagnosis.watch import Sample, Watch
from fusion_sfdia.live.status import Answer, Status
from fusion_sfdia.logs.columns import Source
from fusion_sfdia.report.log_page import finding_texts, findings_of, line_drawn, overview_drawn
from fusion_sfdia.report.log_units import LogUnits
from fusion_sfdia.report.page import page_environment, part

HOURS = 4.0
MOST_ROWS, MOST_EVENTS, MOST_FIGURES = 4000, 100, 6
POLL = 5.0  # s between two requests of a browser
SHARE = 10.0  # so many times as long as it took to draw the figures, they stay
STATES = {  # letter and words of NAMUR NE 107, the most severe first
    DeviceHealth.FAILURE: ("F", "Failure"),
    DeviceHealth.CHECK_FUNCTION: ("C", "Check function"),
    DeviceHealth.OFF_SPEC: ("S", "Out of specification"),
    DeviceHealth.MAINTENANCE_REQUIRED: ("M", "Maintenance required"),
    DeviceHealth.NORMAL: ("", "Normal"),
}
HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data:; "
    "connect-src 'self'; frame-ancestors 'none'",
}


class Kept(NamedTuple):
    """A row as it is kept: its time (s), readings (N,), and Decision without a covariance."""

    t: float
    y: NDArray[np.float64]
    decision: Decision


class LivePage:
    """What the page shows, which any thread may ask for: the watch calls `taken` and `changed`, a server `answer`.

    hours: how far back it goes, on the clock of the rows. Of these at most MOST_ROWS are kept, evenly in time, and of the
    events those that stand and the last that ended, MOST_EVENTS in all. One thread draws at a time, without the lock that the
    watch needs, and no more than a `SHARE`-th of the time. now: seconds of a clock. ValueError for hours that are no positive
    number.
    """

    def __init__(self, watch: Watch, status: Status, hours: float = HOURS, now: Callable[[], float] = time.monotonic) -> None:
        self.span = 3600.0 * number("hours", hours)
        if not 0 < self.span < np.inf:
            raise ValueError(f"the page goes back {hours} hours; expected a positive number")
        self.watch, self.status, self.now = watch, status, now
        self.plant, self.words, self.environment = watch.detector.plant, wordings(watch.detector), page_environment()
        self.shown_in = LogUnits(self.plant, ())
        self.rows: deque[Kept] = deque(maxlen=MOST_ROWS)
        self.events = dict(watch.findings.changes.open_events())
        self.lock = threading.Condition()
        self.drawing, self.drawn, self.fresh_until = False, {"findings": "", "figures": ""}, -np.inf

    def show_in(self, columns: Sequence[Source]) -> None:
        """From now on show tags and units of the columns from which the rows come, in place of the plant's."""
        self.shown_in = LogUnits(self.plant, columns)

    def taken(self, samples: tuple[Sample, ...]) -> None:
        """Rows that were diagnosed."""
        with self.lock:
            for s in samples:
                if not self.rows or s.t >= self.rows[-1].t + self.span / MOST_ROWS:
                    self.rows.append(Kept(s.t, s.y, replace(s.decision, covariance=None)))
                while self.rows[0].t < s.t - self.span:
                    self.rows.popleft()

    def changed(self, change: Change) -> None:
        """What a row changes."""
        if change.event is None:
            return
        with self.lock:
            self.events[change.id] = change.event
            for i in [i for i, e in self.events.items() if not e.open]:
                if self.events[i].end < change.t - self.span or len(self.events) > MOST_EVENTS:
                    del self.events[i]

    def answer(self, path: str) -> Answer | None:
        """The page at "/", and what changes of it at "/parts", as JSON; None of anything else."""
        if path == "/parts":
            return Answer("application/json", json.dumps(self.parts(), ensure_ascii=False), HEADERS)
        if path != "/":
            return None
        texts = {name: Markup(part(name)) for name in ("page.css", "log_page.css", "figures.js", "live_page.js")}
        page = self.environment.get_template("live_page.html.j2").render(
            plant=self.plant.name,
            hours=f"{self.span / 3600:g}",
            css=texts["page.css"] + texts["log_page.css"],
            scripts=texts["figures.js"] + texts["live_page.js"],
            poll=POLL,
            parts={name: Markup(text) for name, text in self.parts().items()},
            version=__version__,
        )
        return Answer("text/html; charset=utf-8", page, HEADERS)

    def parts(self) -> dict[str, str]:
        """The parts of the page, each as HTML by the id of its element."""
        with self.lock:
            self.lock.wait_for(lambda: not self.drawing)
            if self.now() < self.fresh_until:
                return {"state": self._state()} | self.drawn
            self.drawing, rows, events = True, list(self.rows), list(self.events.values())
        drawn, began = None, self.now()
        try:
            drawn = self._drawn(rows, events)
        finally:
            with self.lock:
                self.drawing, self.drawn = False, drawn or self.drawn
                self.fresh_until = self.now() + max(POLL / 2, SHARE * (self.now() - began))
                self.lock.notify_all()
        return {"state": self._state()} | self.drawn

    def _state(self) -> str:
        """The lamp, and the states of the sensors."""
        report = self.status.report()
        health = {self.shown_in.tags.get(name, name): state for name, state in report.device_health.items()}
        lamp = _lamp(report.conclusion, health)
        sensors = [(name, state.name, *STATES[state]) for state in STATES for name, own in health.items() if own is state]
        return self._rendered("state", report=report, lamp=lamp, sensors=[s for s in sensors if s[1] != "NORMAL"])

    def _drawn(self, rows: list[Kept], events: list[Event]) -> dict[str, str]:
        """Findings and figures of rows."""
        if not rows:
            stands = [
                finding_texts(e, self.words, [sentence(e, self.words, self.watch.clock)]) | {"number": k + 1, "figure": None}
                for k, e in enumerate(by_importance([e for e in events if e.open]))
            ]
            return {"findings": self._rendered("findings", acting=stands, over=[]), "figures": ""}
        t, y = np.array([row.t for row in rows]), np.stack([row.y for row in rows])
        shown = tuple(replace(e, end=float(t[-1])) if e.open else e for e in events if e.open or e.end >= t[0])
        decisions, tested = stack([row.decision for row in rows]), self.watch.detector.process_hypotheses
        of_plant, shown_in = Diagnosis(shown, decisions, t, tested, self.watch.clock, words=self.words), self.shown_in
        plant, y, found = shown_in.plant, shown_in.readings(y), shown_in.diagnosis(of_plant)
        findings = findings_of(plant, y, found, MOST_FIGURES if len(rows) > 1 else 0, open_first=True)
        acting, over = ([f for f in findings if f["open"] is acts] for acts in (True, False))
        whole = [line_drawn(found)] if shown else []
        whole += [overview_drawn(plant, y, found)] if len(rows) > 1 else []
        return {
            "findings": self._rendered("findings", acting=acting, over=over),
            "figures": self._rendered("figures", findings=findings, whole=whole),
        }

    def _rendered(self, name: str, **values: Any) -> str:
        """A part of the page by the macro of its name."""
        template = self.environment.get_template("live_parts.html.j2")
        return str(getattr(template.module, name)(**values))


def _lamp(conclusion: Conclusion, health: Mapping[str, DeviceHealth]) -> tuple[str, str, str]:
    """Class, letter and words of the lamp: the most severe state by NE 107 with the sensors that have it, which need not be
    those of the first finding, or that the process has changed.
    """
    worst = next((state for state in STATES if state in health.values()), DeviceHealth.NORMAL)
    if worst is DeviceHealth.NORMAL:
        process = conclusion.verdict is Verdict.PROCESS
        return ("PROCESS", "P", "Process change") if process else (worst.name, *STATES[worst])
    letter, words = STATES[worst]
    names = [name for name, own in health.items() if own is worst]
    return (worst.name, letter, f"{words}: {'all sensors' if len(names) == len(health) else listed(names)}")
