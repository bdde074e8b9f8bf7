"""A map is read as the file states it, and a mistake in it is named with the cure."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from fusion_sfdia.logs.log_map import Column, LogMap, load_map

TEXT = """
[log]
time = "Timestamp"
tz = "Europe/Amsterdam"
decimal = ","
separator = ";"
bad = ["Bad", "I/O Timeout", -9999]
duplicates = "last"
hold = true
mask = "feed < 5"
[columns]
"P1.TT-101A.PV" = { sensor = "TT101A", unit = "degC" }
"P1.FC-001.PV" = { input = "feed", unit = "m3/h", scale = 0.1, quality = "P1.FC-001.Q" }
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "map.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_file_and_an_object_are_the_same_map(tmp_path: Path) -> None:
    columns = {
        "P1.TT-101A.PV": Column(sensor="TT101A", unit="degC"),
        "P1.FC-001.PV": Column(input="feed", unit="m3/h", scale=0.1, quality="P1.FC-001.Q"),
    }
    expected = LogMap(
        time=("Timestamp",),
        tz="Europe/Amsterdam",
        decimal=",",
        separator=";",
        bad=("Bad", "I/O Timeout", -9999),
        duplicates="last",
        hold=math.inf,
        mask=("feed < 5",),
        columns=columns,
    )
    assert load_map(written(tmp_path, TEXT)) == expected
    assert expected.inputs == "at the sample" and expected.order == "refuse"  # the defaults


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time = ", r"is not TOML \(.*\); expected the tables \[log\], \[columns\] and \[physics\]"),
        ("[physics]\nsame = [['a']]\n", r"\[physics\] same: a is no group; expected two sensors or more"),
        ("[physics]\ndrive = {}\n", r"\[physics\] unknown key 'drive'; did you mean 'drives'\?"),
        ("[logs]\n", r"unknown key 'logs'; did you mean 'log'\?"),
        ("log = 1\n", r"log is 1; expected a table \[log\]"),
        ("[log]\nseperator = ';'\n", r"\[log\] unknown key 'seperator'; did you mean 'separator'\?"),
        ("[log]\nseparator = ';;'\n", "separator is ';;'; expected one character"),
        ("[log]\ntime = 1\n", r"time is \(1,\); expected a text or several"),
        ("[log]\ntime = ['a', 'b', 'c']\n", "time names 3 columns; expected one, or two that are joined"),
        ("[log]\ntz = 'Mars/Olympus'\n", "tz is 'Mars/Olympus'; expected a time zone by its place"),
        ("[log]\nformat = 'DD-MM-YYYY'\n", "format is 'DD-MM-YYYY'; expected one as strptime takes it"),
        ("[log]\ndecimal = ','\nthousands = ','\n", "decimal and thousands are both ','; give each its own"),
        ("[log]\nencoding = 'hex'\n", "encoding is 'hex'; expected one such as"),
        ("[log]\nduplicates = 'newest'\n", 'duplicates is \'newest\'; expected "refuse", "first", "last", "mean" or "spread"'),
        ("[log]\ninputs = 'before'\n", 'inputs is \'before\'; expected "at the sample" or "until the sample"'),
        ("[log]\nhold = -1\n", "hold is -1; expected seconds of at least 0, or true for any length"),
        ("[log]\npreamble = 1.5\n", "preamble is 1.5; expected a whole number of at least 0"),
        ("[log]\nunit_row = 1\n", "unit_row is 1; expected true or false"),
        ("[log]\nmask = 'feed under 5'\n", "mask is 'feed under 5'; expected a comparison of a column with a number"),
        ("[log]\nquality = 'Q'\n", "quality is 'Q'; expected a pattern of titles"),
        ("[log]\ngood = 'opc'\n", 'good is \'opc\'; expected "opc-da", "opc-ua", or a list'),
        ("[log]\ntag = 'Tag'\n", "tag is 'Tag' and value ''; a long format needs both titles"),
        ("[columns]\na = 'TT1'\n", "column 'a': 'TT1'; expected a table"),
        ("[columns]\na = { sensor = 'TT1', inputs = 'x' }\n", r"column 'a': unknown key 'inputs'; did you mean 'input'\?"),
        ("[columns]\na = { unit = 'K' }\n", "column 'a': sensor is '' and input ''; expected one of them"),
        ("[columns]\na = { sensor = 'T', scale = 0 }\n", "column 'a': scale is 0; expected a finite number other than 0"),
        ("[columns]\na = { sensor = 'T' }\nb = { sensor = 'T' }\n", "the columns 'a' and 'b' are both 'T'; keep one"),
    ],
)
def test_a_mistake_is_named_with_the_cure(tmp_path: Path, text: str, message: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(ValueError, match=message) as caught:
        load_map(path)
    assert str(caught.value).startswith(f"{path}")


def test_bytes_that_are_no_text(tmp_path: Path) -> None:
    (tmp_path / "map.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(ValueError, match="is not TOML"):
        load_map(tmp_path / "map.toml")
