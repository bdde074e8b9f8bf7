"""Kinds of files by their first bytes: what is read, what is unpacked, and what is named with the cure."""

from __future__ import annotations

import bz2
import gzip
import io
import lzma
import re
import zipfile
import zlib
from collections.abc import Callable
from typing import IO, Any, NamedTuple

from fusion_sfdia.common.arguments import some

START = 4096  # bytes that show the kind
LARGEST = 4 << 30  # bytes of an unpacked file
TEXT, PARQUET, ARROW, WORKBOOK, TDMS, MDF = "text", "Parquet", "Arrow", "Excel workbook", "TDMS", "MDF"
PACKED: dict[str, Callable[[IO[bytes]], Any]] = {
    "gzip": lambda file: gzip.GzipFile(fileobj=file),
    "bzip2": bz2.BZ2File,
    "xz": lzma.LZMAFile,
}

MATLAB = 'in MATLAB write a timetable as text, writetimetable(T, "log.csv")'
ROS = "export a topic as CSV, as with `rostopic echo -b log.bag -p /topic > log.csv` or PlotJuggler"
SHEET = "save the sheet as .xlsx or CSV"
RUNS_CODE = "it can run code when it is loaded and is never read; export the log as CSV or Parquet"


class Format(NamedTuple):
    """What a file is, in words, and what to do with one that is not read ("" where it is)."""

    name: str
    cure: str = ""


MAGIC: tuple[tuple[bytes, Format], ...] = (
    (b"PAR1", Format(PARQUET)),
    (b"ARROW1", Format(ARROW)),
    (b"TDSm", Format(TDMS)),
    (b"TDSh", Format("the index of a TDMS file", "give the .tdms file beside it")),
    (b"MDF     ", Format(MDF)),
    (b"UnFinMF ", Format("an MDF file that was not finished", "finalise it, as asammdf and CANape do when they open it")),
    (b"\x1f\x8b", Format("gzip")),
    (b"BZh", Format("bzip2")),
    (b"\xfd7zXZ\x00", Format("xz")),
    (b"\x28\xb5\x2f\xfd", Format("compressed by zstd", "unpack it: `zstd -d`")),
    (b"\x04\x22\x4d\x18", Format("compressed by lz4", "unpack it: `lz4 -d`")),
    (b"7z\xbc\xaf\x27\x1c", Format("a 7z archive", "unpack it")),
    (b"Rar!", Format("a RAR archive", "unpack it")),
    (b"MATLAB 5.0 MAT-file", Format("a MAT file of MATLAB 5", MATLAB)),
    (b"MATLAB 7.3 MAT-file", Format("a MAT file of MATLAB 7.3 (HDF5)", MATLAB)),
    (b"\x89HDF\r\n\x1a\n", Format("an HDF5 file", "export the log as CSV or Parquet, as with pandas.read_hdf(...).to_parquet")),
    (b"CDF\x01", Format("a netCDF file", "export the log as CSV, as with xarray's to_dataframe().to_csv")),
    (b"CDF\x02", Format("a netCDF file", "export the log as CSV, as with xarray's to_dataframe().to_csv")),
    (b"#ROSBAG V", Format("a bag of ROS", ROS)),
    (b"\x89MCAP0\r\n", Format("an MCAP file of ROS 2 or Foxglove", "export a topic as CSV, as PlotJuggler does")),
    (
        b"SQLite format 3\x00",
        Format("an SQLite database", '`sqlite3 -csv -header log.db "SELECT * FROM t" > log.csv` exports a table'),
    ),
    (b"LOGG", Format("a BLF log of a CAN bus", "decode it by its DBC file to MDF4 or CSV, as with asammdf")),
    (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", Format("an Excel workbook of before 2007 (.xls)", SHEET)),
    (b"%PDF-", Format("a PDF document", "export the readings as CSV from the program that made it")),
    (b"{\\rtf", Format("an RTF document", "save it as plain text")),
    (b"\x93NUMPY", Format("an array of NumPy", "give it to load_log as a pandas frame, or write it as CSV")),
    (b"\x80\x02", Format("a pickle", RUNS_CODE)),
    (b"\x80\x03", Format("a pickle", RUNS_CODE)),
    (b"\x80\x04", Format("a pickle", RUNS_CODE)),
    (b"\x80\x05", Format("a pickle", RUNS_CODE)),
    (b"Obj\x01", Format("an Avro file", "export the log as CSV or Parquet")),
    (b"ORC", Format("an ORC file", "export the log as CSV or Parquet")),
    (b"RIFF", Format("a WAV or AVI file", "export the readings as CSV")),
    (b"\x89PNG", Format("an image", "export the readings themselves as CSV")),
    (b"\xff\xd8\xff", Format("an image", "export the readings themselves as CSV")),
    (b"GIF8", Format("an image", "export the readings themselves as CSV")),
)
FIELD = r"[^\s,=]+=(?:\"[^\"]*\"|[^\s,]+)"  # of the line protocol
LINES: tuple[tuple[str, Format], ...] = (
    (
        r"\s*\{\s*\"[^\n]*\}\s*(?:\n\s*\{|$)",
        Format("JSON lines", 'pandas.read_json("log.json", lines=True).to_csv("log.csv", index=False) writes it as CSV'),
    ),
    (
        r"\s*(?:\[\s*[\[{]|\{\s*(?:\"|\}))",
        Format("JSON", 'pandas.read_json("log.json").to_csv("log.csv", index=False) writes a list of records as CSV'),
    ),
    (
        r"(?i)\s*<(?:!doctype html|html|table)",
        Format("an HTML page", "a page in place of data is often one to log in: export it as CSV"),
    ),
    (r"\s*<(?:\?xml|[A-Za-z])", Format("XML", "export the log as CSV")),
    (
        rf"(?:#[^\n]*\n)*[^\s,#\"]+(?:,[^\s,=]+=[^\s,]+)* {FIELD}(?:,{FIELD})*(?: \d{{9,19}})?\r?(?:\n|$)",
        Format("line protocol of InfluxDB", "query the bucket as CSV, with a column for each field (in Flux: pivot)"),
    ),
)


def kind_of(file: IO[bytes], suffix: str) -> Format:
    """Return what an opened file is, from its first bytes on; it is then at its beginning again."""
    start = file.read(START)
    file.seek(0)
    if start.startswith(b"PK\x03\x04") or start.startswith(b"PK\x05\x06"):
        return _of_zip(file, suffix)
    for magic, kind in MAGIC:
        if start.startswith(magic) and (len(magic) > 6 or not magic.isascii() or b"\0" in start[:64] or not _is_text(start)):
            return kind
    text = start.decode("utf-8-sig", "replace")
    for pattern, kind in LINES:
        if re.match(pattern, text):
            return kind
    if start.startswith((b"\xff\xfe", b"\xfe\xff")) or _is_text(start):
        return Format(TEXT)
    return Format(
        "a binary file of a kind that is not known", "expected CSV, Parquet, Excel, TDMS or MDF: export the log as one of them"
    )


def unpacked(where: str, file: IO[bytes], kind: Format) -> io.BytesIO:
    """Return the file that a compressed one holds; ValueError for one that is damaged or larger than LARGEST."""
    try:
        if kind.name == "zip":
            with zipfile.ZipFile(file) as archive:
                name = next(name for name in archive.namelist() if not name.endswith("/"))
                with archive.open(name) as member:
                    data = member.read(LARGEST + 1)
        else:
            with PACKED[kind.name](file) as member:
                data = member.read(LARGEST + 1)
    except (OSError, EOFError, lzma.LZMAError, zlib.error, zipfile.BadZipFile, RuntimeError, NotImplementedError) as error:
        raise ValueError(
            f"{where} is a {kind.name} file that does not unpack ({error}); copy it again, or unpack it"
        ) from error
    if len(data) > LARGEST:
        raise ValueError(f"{where} unpacks to more than {LARGEST >> 30} GiB; unpack it, and give a part")
    return io.BytesIO(data)


def _of_zip(file: IO[bytes], suffix: str) -> Format:
    try:
        with zipfile.ZipFile(file) as archive:
            names = archive.namelist()
            document = archive.read("mimetype")[:200] if "mimetype" in names else b""
    except (zipfile.BadZipFile, OSError, RuntimeError, NotImplementedError, EOFError):
        what = "an Excel workbook" if suffix.startswith(".xls") else "a zip archive"
        return Format(f"{what} that is damaged", "copy it again, or save it as CSV")
    finally:
        file.seek(0)
    if "xl/workbook.xml" in names:
        return Format(WORKBOOK)
    if "xl/workbook.bin" in names:
        return Format("an Excel workbook in binary form (.xlsb)", SHEET)
    if b"opendocument.spreadsheet" in document:
        return Format("an OpenDocument spreadsheet", SHEET)
    if "word/document.xml" in names or document:
        return Format("a text document", "export the readings as CSV")
    if names and all(name.endswith(".npy") for name in names):
        return Format("an archive of NumPy arrays", "give them to load_log as a pandas frame, or write them as CSV")
    files = [name for name in names if not name.endswith("/")]
    if len(files) == 1:
        return Format("zip")
    return Format("a zip archive", f"unpack it, and give one of its {len(files)} files" + (f": {some(files)}" if files else ""))


def _is_text(start: bytes) -> bool:
    """Whether the first bytes may be text: few control characters beside NUL, which UTF-16 and a loss of power leave."""
    control = sum(start.count(bytes([c])) for c in range(1, 32) if c not in b"\t\n\r\f\x1a\x1b")
    return control <= 0.02 * len(start)
