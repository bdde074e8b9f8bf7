"""A table and a page of many units: what was found in the log of each, and which differ from the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote

from markupsafe import Markup

from fusion_sfdia import __version__
from fusion_sfdia.common.files import atomic_write
from fusion_sfdia.report.log_report import write_table
from fusion_sfdia.report.page import page_environment, part

COLUMNS = ("unit", "state", "verdict", "events")


class UnitRow(NamedTuple):
    """A unit: its name, log, state and verdict in words, the part of its log that was learnt, and its events in words; or the
    error that ended its diagnosis.
    """

    unit: str
    log: str
    state: str = ""
    verdict: str = ""
    learnt: str = ""
    events: tuple[str, ...] = ()
    error: str = ""

    @property
    def cells(self) -> tuple[str, ...]:
        """Under `COLUMNS`."""
        return (
            (self.unit, "failed", self.error, "")
            if self.error
            else (self.unit, self.state, self.verdict, str(len(self.events)))
        )


def write_units(
    table: Path, page: Path, rows: Sequence[UnitRow], different: Sequence[Any], reports: Mapping[str, str] | None = None
) -> None:
    """Write the table, a row a unit, and the page, whole or not at all; those with something to say first on the page.

    reports: of units that have one its path from the page on.
    """
    header = ("unit", "log", "state", "verdict", "learnt", "events", "differs", "error")
    said = {d.unit: str(d) for d in different}
    write_table(table, header, ((*r[:5], "; ".join(r.events), said.get(r.unit, ""), r.error) for r in rows))
    order = sorted(rows, key=lambda r: (not r.error, r.state == "healthy", r.unit))
    text = page_environment().from_string(part("units.html.j2")).render(
        css=Markup(part("page.css")), rows=order, different=[str(d) for d in different], version=__version__,
        states=sorted({r.state for r in rows if not r.error}), reports={u: quote(path) for u, path in (reports or {}).items()},
    )  # fmt: skip
    with atomic_write(page) as file:
        file.write(text)
