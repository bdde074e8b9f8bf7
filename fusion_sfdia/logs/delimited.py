"""Delimited text, such as CSV: from the bytes of a file to its lines, the line of the header, and rows of cells."""

from __future__ import annotations

import codecs
import csv
import io
import re
from collections.abc import Iterable, Sequence
from itertools import islice
from typing import Any, NamedTuple

from fusion_sfdia.common.arguments import shown
from fusion_sfdia.logs.loaded_log import Finding, counted
from fusion_sfdia.logs.log_map import LogMap

LONGEST = 1_000_000  # characters of a line
SEARCHED = 500  # lines for a header
MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
SEPARATORS = (",", ";", "\t", "|")
STATED = re.compile(r'"?sep=(.|\\t)"?[,;\t|]*\s*', re.IGNORECASE)  # a first line that Excel understands
READING = re.compile(r"[-+\d.,:/TZ ]*\d[-+\d.,:/TZeE ]*(?:[ap]m)?", re.IGNORECASE)  # a number or a stamp
GARBLED_BYTES = re.compile("[\udc80-\udcff]")
GARBLED = re.compile("[^\\s;,\t]?[\udc80-\udcff][^\\s;,\t]{0,10}")  # with what stands beside them
MOST_LINES = 20  # of a cell with line ends in quotes

Row = tuple[int, list[Any]]


class Header(NamedTuple):
    """Where the titles of a text file stand: position of their line, the separator, and the mark of comments ("" for none)."""

    position: int
    separator: str
    comment: str = ""


class Cells(NamedTuple):
    """Rows (number, cells) of a file from the header on, the cells above it, and what was recognised or left out.

    unfinished: whether the last line lacks its end. separator: between cells, "" in a workbook.
    """

    rows: list[Row]
    above: list[list[str]]
    findings: list[Finding]
    unfinished: bool = False
    separator: str = ""


def read_text(where: str, data: bytes, log_map: LogMap) -> Cells:
    """Return the rows of a text file. ValueError for what is no text."""
    findings: list[Finding] = []
    lines = lines_of(where, decoded(where, data, log_map.encoding, findings))
    unfinished = bool(lines) and not lines[-1].endswith("\n")
    nul = _without_nul(lines)
    header = find_header(lines, log_map)
    above = [split(line, header.separator) for line in lines[: header.position] if line.strip()]
    _add_header_findings(header, len(above), log_map, findings)
    garbled = _without_garbled(where, lines, header, log_map.encoding)
    comments = 0
    if header.comment and header.position < len(lines):
        lines[header.position] = _uncommented(lines[header.position], header.comment)
        for k in range(header.position + 1, len(lines)):
            if lines[k].lstrip().startswith(header.comment):
                lines[k], comments = "\n", comments + 1
    if comments:
        begin = "begins" if comments == 1 else "begin"
        text = f"{counted(comments, 'line')} that {begin} with {header.comment!r} taken as comments"
        findings.append(Finding("file", "", comments, text))
    rows, unreadable, torn = split_rows(where, lines, header)
    if torn and len(rows) > 1:
        unfinished = False
        findings.append(Finding("rows left out", "", 1, "the last line, which ends within a cell in quotes, left out"))
    elif torn:
        unreadable.append(len(lines))
    if too_many(len(unreadable), len(rows)):
        raise ValueError(
            f"{where}, row {unreadable[0]}: not a CSV text file: a quote does not close, or text follows a closing quote; "
            "expected cells with quotes around all of it or none, and quotes within it doubled"
        )
    for numbers, why in (
        (nul, "with NUL bytes, as a loss of power leaves them,"),
        (garbled, f"with bytes that are not {log_map.encoding}"),
        (unreadable, "whose quotes do not close"),
    ):
        if numbers:
            findings.append(Finding("rows left out", "", len(numbers), f"{listed(numbers)} {why} left out"))
    return Cells(rows, above, findings, unfinished, header.separator)


def decoded(where: str, data: bytes, encoding: str, findings: list[Finding]) -> str:
    """The text of the bytes: as a byte-order mark states, as UTF-16 where every second byte is NUL, otherwise in the encoding.

    Bytes that are not UTF-8 are surrogates in the text. ValueError for bytes that are not in another encoding.
    """
    known = next((name for mark, name in MARKS if data.startswith(mark)), "")
    if not known and not encoding.casefold().startswith(("utf-16", "utf_16", "utf16", "utf-32")):
        start = data[:4096]
        odd, even = start[1::2].count(0), start[::2].count(0)
        if max(odd, even) > 0.4 * len(start) and min(odd, even) < 0.1 * len(start):
            known = "utf-16-le" if odd > even else "utf-16-be"
    if known and not known.startswith("utf-8") and codecs.lookup(known).name[:6] != codecs.lookup(encoding).name[:6]:
        findings.append(Finding("file", "", 0, f"read as {known.upper()[:6]}, as its first bytes show"))
    chosen = known or encoding
    if known.startswith(("utf-16", "utf-32")):
        data = data[: len(data) - len(data) % (2 if "16" in known else 4)]  # a file may end within a character
    try:
        return data.decode(chosen, "surrogateescape" if chosen.startswith("utf-8") else "strict")
    except UnicodeError as error:
        raise ValueError(
            f"{where} is not a CSV text file in {chosen} ({error}); give the encoding in a map, or export as UTF-8"
        ) from error


def lines_of(where: str, text: str) -> list[str]:
    """The lines with their ends, of all kinds; ValueError for one that is longer than any row."""
    if "\r" in text:
        text = text.replace("\r\r\n", "\n").replace("\r\n", "\n").replace("\r", "\n")
    lines = list(io.StringIO(text, newline="\n"))
    if lines and len(longest := max(lines, key=len)) > LONGEST:
        raise ValueError(
            f"{where}, row {lines.index(longest) + 1}: a line of {len(longest)} characters; expected one row a "
            f"line, of at most {LONGEST}"
        )
    return lines


def find_header(lines: Sequence[str], log_map: LogMap) -> Header:
    """Return where the header is: the first line that has the titles of the times, else what stands above the first readings.

    Commas, the default of a map, are replaced by the separator with which the titles are found, or that a first line `sep=;`
    states; any other separator is as stated.
    """
    separators: tuple[str, ...] = (log_map.separator,)
    first = log_map.preamble
    if separators == (",",):
        separators = SEPARATORS
    if first == 0 and lines and (stated := STATED.fullmatch(lines[0])):
        first, separators = 1, ("\t" if stated[1] == "\\t" else stated[1],)
    present = [k for k in range(first, min(len(lines), first + SEARCHED)) if lines[k].strip()]
    comment = log_map.comment or ("#" if present and lines[present[0]].lstrip().startswith("#") else "")
    plain = [k for k in present if not (comment and lines[k].lstrip().startswith(comment))]
    for where, mark in ((plain, ""), ([k for k in present if k not in set(plain)], comment)):
        for separator in separators:
            for k in where:
                if has_times(split(_uncommented(lines[k], mark), separator), log_map.time):
                    return Header(k, separator, comment)
    if plain and split(lines[plain[0]], separators[0])[:1] == ["TOA5"] and len(plain) > 1:
        return Header(plain[1], separators[0], comment)
    best = max((_above_readings(lines, plain, s) for s in separators), key=lambda found: found[0])
    if best[0]:
        return Header(best[1], best[2], comment)
    return Header(plain[0] if plain else min(first, len(lines)), separators[0], comment)


def has_times(titles: Sequence[str], times: Sequence[str]) -> bool:
    """Whether the titles of the times are among titles, of which another begins with no digit: a label is no header."""
    names = {bare(title) for title in titles} | {*titles}
    others = [title for title in titles if title and title not in times and bare(title) not in times]
    return {*times} <= names and any(not title[0].isdigit() for title in others)


def bare(title: str) -> str:
    """A title without the unit in brackets."""
    return title.partition("[")[0].strip()


def split(line: str, separator: str) -> list[str]:
    """The cells of one line, without blanks around them; none where its quotes do not close."""
    try:
        return [c.strip() for c in next(_reader([line], separator), [])]
    except csv.Error:
        return []


def split_rows(where: str, lines: list[str], header: Header) -> tuple[list[Row], list[int], bool]:
    """The rows with any cell from the header on; those left out since a quote does not close; whether the last line is one.

    A cell in quotes may go over several lines where the row then has the width of the header; otherwise the quote that opens
    it is one that does not close.
    """
    rows: list[Row] = []
    unreadable: list[int] = []
    start = number = header.position  # a row of several lines counts once
    width, mended, torn = 0, False, False
    while start < len(lines):
        reader, done = _reader(islice(lines, start, None), header.separator), 0
        try:
            for row in reader:
                taken = reader.line_num - done
                if taken > 1 and width and (taken > MOST_LINES or len(row) != width):
                    break
                number, done = number + 1, reader.line_num
                if any(map(str.strip, row)):
                    rows.append((number, row))
                    width = width or len(row)
            else:
                break
        except csv.Error as error:
            if not width:
                raise ValueError(
                    f"{where} is not a CSV text file ({error}, line {start + done + 1}); expected text as `simulate` writes it"
                ) from error
        start += done
        before = lines[start]
        if not mended:  # blanks between a closing quote and the separator
            lines[start:] = [re.sub(rf'"[ \t]+(?={re.escape(header.separator)}|$)', '"', line) for line in lines[start:]]
            mended = True
        if lines[start] == before:
            number += 1
            torn = start == len(lines) - 1 and not before.endswith("\n")
            if not torn:
                unreadable.append(number)
            start += 1
            if too_many(len(unreadable), len(lines)):
                break
    return rows, unreadable, torn


def too_many(left_out: int, rows: int) -> bool:
    """Whether so many of the rows do not fit that the fault is not in them, but in how they are read."""
    return left_out > max(3, rows // 100) or 4 * left_out > rows


def listed(numbers: Sequence[int]) -> str:
    """Rows by number, as in "row 7", "12 rows (7, 9, 10, 11, 13, ...)"."""
    if len(numbers) == 1:
        return f"row {numbers[0]}"
    return f"{len(numbers)} rows ({', '.join(map(str, numbers[:5]))}{', ...' if len(numbers) > 5 else ''})"


def is_reading(cells: Sequence[str]) -> bool:
    """Whether at least half of the cells that are not empty are numbers or stamps."""
    present = [c for c in cells if c]
    return bool(present) and 2 * sum(bool(READING.fullmatch(c)) for c in present) >= len(present)


def _above_readings(lines: Sequence[str], present: Sequence[int], separator: str) -> tuple[int, int, str]:
    """(cells, position, separator) of the top line of those above the first two readings that have as many cells, or 0s."""
    cells = [split(lines[k], separator) for k in present]
    for i in range(1, len(present)):
        width = len(cells[i])
        if width > 1 and is_reading(cells[i]) and all(len(c) == width for c in cells[i : i + 2]):
            top = i
            while top and len(cells[top - 1]) == width and not is_reading(cells[top - 1]):
                top -= 1
            return (width, present[top], separator) if top < i else (0, 0, separator)
    return 0, 0, separator


def _reader(lines: Iterable[str], separator: str) -> Any:
    if separator == " ":  # any number of blanks between cells
        lines = (" ".join(line.split()) + "\n" for line in lines)
    return csv.reader(lines, strict=True, delimiter=separator, skipinitialspace=separator != " ")


def _uncommented(line: str, mark: str) -> str:
    text = line.lstrip()
    return text.removeprefix(mark).lstrip(mark + " ") if mark and text.startswith(mark) else line


def _without_nul(lines: list[str]) -> list[int]:
    """Empty the lines that hold NUL, and return their numbers."""
    found = [k for k, line in enumerate(lines) if "\0" in line]
    for k in found:
        lines[k] = "\n"
    return [k + 1 for k in found]


def _without_garbled(where: str, lines: list[str], header: Header, encoding: str) -> list[int]:
    """Empty the readings that hold bytes that are no text, and return their numbers; ValueError where they are many.

    The same for any other line, whose text would be lost: names, units.
    """
    if all(map(str.isascii, lines)):
        return []
    found = [k for k, line in enumerate(lines) if GARBLED.search(line)]
    texts = [k for k in found if not lines[k].lstrip('" ')[:1].isdigit()]
    if texts or too_many(len(found), len(lines)):
        k = (texts or found)[0]
        word = GARBLED.search(lines[k])
        text = word[0].encode("utf-8", "surrogateescape").decode("cp1252", "replace") if word else ""
        share = sum(len(GARBLED_BYTES.findall(line)) for line in lines) / max(sum(map(len, lines)), 1)
        if share < 0.1 and "\ufffd" not in text:
            cure = f'state its encoding in a map (encoding = "cp1252" gives {shown(text)}), or export as UTF-8'
        else:
            cure = "it is no text in a usual encoding; export the log as CSV in UTF-8"
        raise ValueError(f"{where} is not a CSV text file in {encoding} (row {k + 1}); {cure}")
    for k in found:
        lines[k] = "\n"
    return [k + 1 for k in found]


def _add_header_findings(header: Header, above: int, log_map: LogMap, findings: list[Finding]) -> None:
    if header.separator != log_map.separator:
        findings.append(Finding("file", "", 0, f"cells are separated by {header.separator!r}"))
    if above and header.position != log_map.preamble:
        text = f"the header is line {header.position + 1}; {above} {'line' if above == 1 else 'lines'} before it left out"
        findings.append(Finding("file", "", above, text))
