"""The tables of a diagnosis with a row a sample, in the tags and units of the log: as CSV, Excel workbook or Parquet."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.clock import Clock, stamp
from fusion_sfdia.common.errors import MissingPackageError
from fusion_sfdia.common.files import atomic_write
from fusion_sfdia.common.plain_text import cell, plain
from fusion_sfdia.detectors.detector import chosen
from fusion_sfdia.diagnosis.diagnose import Diagnosis, present
from fusion_sfdia.diagnosis.quality_flags import quality_flags
from fusion_sfdia.logs.csv_log import quoted, write_lines
from fusion_sfdia.logs.plain import plain_lines, shortened
from fusion_sfdia.report.log_units import LogUnits

Array = NDArray[Any]

DIGITS = 4  # of a score
NEEDS = {".xlsx": ("openpyxl", "excel"), ".parquet": ("pyarrow", "parquet")}  # the package, and our extra that brings it
SUFFIXES = (".csv", *NEEDS)
MOST_ROWS, MOST_COLUMNS = 1_048_576, 16_384  # of a sheet, by the specification of Excel


class RowTable(NamedTuple):
    """Titles and the rows of some samples as blocks side by side: numbers (R, n), or texts (R,)."""

    titles: Sequence[str]
    blocks: Callable[[slice], list[Any]]


def reconstructed(y: Array, u: Array, found: Diagnosis, shown_in: LogUnits) -> RowTable:
    """The readings with what replaces the missing and isolated ones, the inputs, the wall clock, of each sensor its flag, and
    the names of what is replaced; y (K, N) readings as they came, u (K, m), in the units of the plant.
    """
    d, clock, names = found.decisions, found.clock, np.array(shown_in.short)
    replaced = np.isfinite(d.reconstruction) & (d.reconstruction != present(y, d))
    flags = quality_flags(shown_in.of, y, found)
    inputs = shown_in.inputs(u)

    def blocks(rows: slice) -> list[Any]:
        numbers = np.column_stack([found.t[rows], shown_in.readings(d.reconstruction[rows]), inputs[rows]])
        which = [";".join(names[row]) if row.any() else "" for row in replaced[rows]]
        return [numbers, *_wall_clock(clock, found.t[rows]), flags[rows], which]

    wall = [] if clock.start is None else ["wall clock"]
    titles = ["time [s]", *shown_in.titles(inputs=inputs.shape[1] > 0), *wall, *(f"{n} flag" for n in names), "replaced"]
    return RowTable(titles, blocks)


def scores(found: Diagnosis, shown_in: LogUnits) -> RowTable:
    """Of each sample its time, and of each sensor the score and the residual in standard deviations, NaN where unknown."""
    names = shown_in.short

    def blocks(rows: slice) -> list[Any]:
        values, t = chosen(found.decisions, rows).scores, found.t[rows]
        with np.errstate(invalid="ignore"):
            residuals = found.after.error[rows] / found.after.sd[rows] if found.after else np.full(values.shape, np.nan)
        numbers = shortened(np.concatenate([values, residuals], axis=1), DIGITS)
        return [t[:, None], *(_wall_clock(found.clock, t) or [[found.clock.at(s) for s in t.tolist()]]), numbers]

    return RowTable(("time_s", "time", *(f"{n} score" for n in names), *(f"{n} residual [sd]" for n in names)), blocks)


def _wall_clock(clock: Clock, t: Array) -> list[list[Any]]:
    """The column of the wall clock, none where there is none."""
    return [] if clock.start is None else [list(map(clock.moment, t.tolist()))]


def write_rows(path: Path, count: int, table: RowTable) -> None:
    """Write a table of so many rows, whole or not at all, as its suffix states: one of `SUFFIXES`.

    A Parquet file has times with their zone, a workbook, which knows no zones, as texts. ValueError for more rows or columns
    than a sheet has; MissingPackageError without openpyxl or pyarrow.
    """
    if path.suffix == ".csv":
        write_lines(path, table.titles, count, lambda rows: map(",".join, zip(*map(_cells, table.blocks(rows)), strict=True)))
        return
    sheet = path.suffix == ".xlsx"
    if sheet and (count >= MOST_ROWS or len(table.titles) > MOST_COLUMNS):
        raise ValueError(
            f"{path.name}: {count + 1} rows and {len(table.titles)} columns; a sheet has {MOST_ROWS} and {MOST_COLUMNS} at "
            "most: write .csv or .parquet"
        )
    import pandas

    columns: list[Any] = []
    for block in table.blocks(slice(0, count)):
        if isinstance(block, np.ndarray):
            columns += [*block.T]
        else:
            columns.append([_text(v) if sheet or isinstance(v, str) else v for v in block])
    frame = pandas.concat([pandas.Series(c) for c in columns], axis=1)
    frame.columns = [cell(plain(title)) for title in table.titles]
    try:
        with atomic_write(path, "wb") as file:
            frame.to_excel(file, index=False, engine="openpyxl") if sheet else frame.to_parquet(file, engine="pyarrow")
    except ImportError as error:
        raise _missing(path.suffix) from error


def require_tables(suffix: str) -> None:
    """Raise MissingPackageError where the package that writes such files is not installed."""
    if suffix in NEEDS and find_spec(NEEDS[suffix][0]) is None:
        raise _missing(suffix)


def _missing(suffix: str) -> MissingPackageError:
    package, extra = NEEDS[suffix]
    return MissingPackageError(
        f"tables as {suffix} need {package}, which is missing or too old: install fusion-sfdia[{extra}], or write .csv"
    )


def _cells(block: Any) -> list[str]:
    """A block as text, a line a row."""
    if not isinstance(block, np.ndarray):
        return [quoted(value) if isinstance(value, str) else stamp(value) for value in block]
    return plain_lines(block)


def _text(value: Any) -> str:
    return cell(plain(value)) if isinstance(value, str) else stamp(value)
