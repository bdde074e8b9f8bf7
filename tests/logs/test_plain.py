"""Files of plain numbers are read at once; any other is left to the reader that names what is wrong."""

from __future__ import annotations

import os
import threading
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from fusion_sfdia.logs import plain
from fusion_sfdia.logs.cell_tables import read_table
from fusion_sfdia.logs.log_map import PLAIN_MAP
from fusion_sfdia.logs.plain import plain_lines, shortened


def plain_table(path: Path) -> tuple[list[str], np.ndarray] | None:
    with path.open("rb") as file:
        return plain.plain_table(file)


def file_of(folder: Path, text: str) -> Path:
    path = folder / "log.csv"
    path.write_bytes(text.encode())
    return path


@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize("block", [7, 1 << 20])
def test_plain_numbers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, end: str, block: int) -> None:
    """The numbers that Python reads, to the bit; blocks may end within a line and within its end."""
    monkeypatch.setattr(plain, "BLOCK", block)
    values = np.random.default_rng(0).standard_normal((50, 3)) * 10.0 ** np.arange(-8, 16, 8)
    values[3, 1] = np.nan
    lines = [",".join("" if np.isnan(v) else repr(v) for v in row) for row in values.tolist()]
    found = plain_table(file_of(tmp_path, end.join(['time,"a, b",c [m]', *lines]) + end))
    assert found is not None and found[0] == ["time", "a, b", "c [m]"]
    np.testing.assert_array_equal(found[1], values)
    again = plain_table(file_of(tmp_path, end.join(["time,a,c", *lines])))  # without an end of the last line
    assert again is not None and len(again[1]) == 50


@pytest.mark.parametrize(
    "rows",
    [
        *("1,2\n3\n", "1,2,3\n", "1,2\n\n3,4\n", "1,2\n,\n", "1,nan\n", "1,bad\n", '1,"2"\n', "1,1e999\n", "1,1-2\n"),
        *("1, 2\n", "", "\n", "1,2\r3,4\n", "2024-01-01,1\n"),
    ],
)
def test_what_needs_a_closer_look(tmp_path: Path, rows: str) -> None:
    assert plain_table(file_of(tmp_path, "time,a\n" + rows)) is None


@pytest.mark.parametrize("header", ["time\n", "time,\n", '"time,a\n'])
def test_headers_that_need_one(tmp_path: Path, header: str) -> None:
    assert plain_table(file_of(tmp_path, header + "1,2\n")) is None


@pytest.mark.parametrize("number", ["+1.5", ".5", "5.", "007", "-0.0", "1E+05", "123456789012345678901234", "4.9e-324", ""])
def test_numbers_as_python_reads_them(tmp_path: Path, number: str) -> None:
    """Also those that JSON does not know, beside empty cells at both ends of a row and next to each other."""
    found = plain_table(file_of(tmp_path, f"time,a,b,c\n1,{number},,\n,,,2\n"))
    assert found is not None
    expected = [[1.0, float(number or "nan"), np.nan, np.nan], [np.nan, np.nan, np.nan, 2.0]]
    assert found[1].tobytes() == np.array(expected).tobytes()


def test_a_table_is_read_into_place(tmp_path: Path) -> None:
    """Beside the numbers no more memory than a few blocks take as text and as Python's numbers."""
    path = file_of(tmp_path, "time,a,b,c\n" + "1.25,2.5,,3.75\n" * 200_000)
    tracemalloc.start()
    found = plain_table(path)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert found is not None and most < found[1].nbytes + 32 * plain.BLOCK
    assert found[1].shape == (200_000, 4) and all(column.flags.c_contiguous for column in found[1].T)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
def test_a_table_is_read_from_a_pipe(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    writer = threading.Thread(target=pipe.write_text, args=("time,a\n1,2\n3,4\n",))
    writer.start()
    found = read_table(pipe, PLAIN_MAP)
    writer.join()
    np.testing.assert_array_equal(np.column_stack(found.columns), [[1, 2], [3, 4]])


def test_lines_are_read_back() -> None:
    """As few digits as give the same bits, empty cells for NaN; infinity, which JSON does not know, as Python writes it."""
    values = np.random.default_rng(1).integers(0, 2**63, (5000, 2)).view(float)
    values[np.isinf(values)] = np.nan
    again = [[float(cell or "nan") for cell in line.split(",")] for line in plain_lines(values)]
    np.testing.assert_array_equal(again, values)
    assert plain_lines(np.array([[0.1, np.nan, -0.0], [np.nan, 1e22, 3.0]])) == ["0.1,,-0.0", ",1e+22,3.0"]
    assert plain_lines(np.array([[np.inf, np.nan, -np.inf]])) == ["inf,,-inf"]
    assert plain_lines(np.empty((0, 2))) == []


def test_shortened_is_the_nearest_decimal() -> None:
    values = np.random.default_rng(2).standard_normal(5000) * 10.0 ** np.random.default_rng(3).integers(-15, 20, 5000)
    values[:4] = 0.0, np.nan, np.inf, 9.9999
    np.testing.assert_array_equal(shortened(values, 4), [float(f"{v:.4g}") for v in values])
