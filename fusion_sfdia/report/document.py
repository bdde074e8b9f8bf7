"""A diagnosis as JSON for other programs; `diagnosis.schema.json` beside this file states what each name means."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Any

import numpy as np

from fusion_sfdia.common.numerals import for_json
from fusion_sfdia.detectors.verdicts import judged
from fusion_sfdia.diagnosis.diagnose import Diagnosis
from fusion_sfdia.diagnosis.events import Event
from fusion_sfdia.logs.loaded_log import LoadedLog
from fusion_sfdia.report.log_page import About
from fusion_sfdia.report.log_units import LogUnits

FORMAT = 1  # another number where a name goes or changes its meaning; names may be added


def as_json(found: Diagnosis, shown_in: LogUnits, read: LoadedLog, about: About) -> str:
    """A diagnosis in the units of the plant, in which sensors also have their tags and sizes in the units of the log."""
    d, t, clock, health, in_log = found.decisions, found.t, found.clock, found.health, shown_in.diagnosis(found)
    shown = dict(zip(map(id, found.events), in_log.events, strict=True))
    passing = set(map(id, found.passing))
    document = {
        "format": FORMAT,
        "log": about.log,
        "detector": about.detector,
        "state": str(found.state),
        "verdict": found.verdict,
        "headline": found.headline,
        "caution": found.caution,
        "remarks": found.remarks,
        "health": None
        if health is None
        else {
            "text": health.line,
            "suspect": health.suspect,
            "cautious": health.cautious,
            **health._asdict(),
            "visible": health.visible._asdict(),
        },
        "diverged": bool(np.any(d.diverged)),
        "readings": {
            "count": len(t),
            "judged": int(np.sum(judged(d))),
            "start": float(t[0]),
            "end": float(t[-1]),
            "start_time": clock.iso(float(t[0])),
            "end_time": clock.iso(float(t[-1])),
        },
        "gaps": [g._asdict() | {"start_time": clock.iso(g.start), "end_time": clock.iso(g.end)} for g in found.gaps],
        "log_misread": read.misread,
        "log_findings": [asdict(f) for f in read.findings],
        "sensors": [
            {
                "name": name,
                "unit": unit,
                "tag": shown_in.tags.get(name),
                "unit_in_log": s.unit if name in shown_in.tags else None,
            }
            for name, unit, s in zip(shown_in.own, shown_in.units, shown_in.plant.sensors, strict=True)
        ],
        "events": [
            _event(found, e, shown[id(e)], shown_in) | {"passing": id(e) in passing, "text": in_log.sentence(shown[id(e)])}
            for e in found.findings
        ],
    }
    return json.dumps(for_json(document), indent=2, allow_nan=False)


def _event(found: Diagnosis, e: Event, shown: Event, shown_in: LogUnits) -> dict[str, Any]:
    """An event by its fields, its rows, and what it is in the log, None of what is no sensor with a column."""
    first, last = np.searchsorted(found.t, [e.start, e.end]).tolist()
    tag = shown_in.tags.get(e.hypothesis) if e.kind == "sensor" else None
    sizes = {name: getattr(shown, name) for name in ("unit", "size", "low", "high")}
    rows = {"start_row": first, "end_row": last}
    return {**e.fields(found.clock), **rows, "in_log": None if tag is None else {"tag": tag, **sizes}}
