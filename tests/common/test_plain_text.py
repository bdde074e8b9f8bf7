"""Texts of others, shown as text by a terminal, a page and a spreadsheet."""

from __future__ import annotations

import io
import json
import unicodedata

import pytest

from fusion_sfdia.common.plain_text import PlainStream, acting, cell, plain, uncell

ACTING = [chr(k) for k in range(0x3000) if unicodedata.category(chr(k)) == "Cc" or unicodedata.bidirectional(chr(k)) in
          ("LRE", "RLE", "LRO", "RLO", "PDF", "LRI", "RLI", "FSI", "PDI")]  # fmt: skip


@pytest.mark.parametrize("character", [c for c in ACTING if c not in "\t\n"] + ["\u2028", "\u200f", "\udc80"])
def test_characters_that_act_are_shown_by_their_numbers(character: str) -> None:
    shown = plain(f"a{character}b")
    assert shown == f"a\\u{ord(character):04x}b" and shown.isprintable()
    assert json.loads(f'"{shown}"') == f"a{character}b"


def test_every_other_text_stays() -> None:
    for text in ("", "a\tb\n", "θ 10⁻³ °C", "日本", "עברית", "a\u200db", "\\u001b"):
        assert plain(text) == text
    every = "".join(map(chr, range(0x110000)))
    assert not set(plain(every)) & (set(ACTING) - {"\t", "\n"})


@pytest.mark.parametrize("text", ["=1+1", "+5V", "-l1", "@sum", "\tx", "\r=x", "=cmd|' /c calc'!A0", "＝1", "'=x", "''-x"])
def test_a_text_like_a_formula_is_a_text_in_a_cell_and_comes_back(text: str) -> None:
    assert cell(text) == f"'{text}" and uncell(cell(text)) == text


@pytest.mark.parametrize("text", ["", "l1 [m]", "a=b", "'quoted'", "it's", "1-2", "'", "''"])
def test_any_other_text_is_a_cell_as_it_is(text: str) -> None:
    assert cell(text) == uncell(text) == text


def test_a_stream_passes_on_plain_text_and_everything_else() -> None:
    stream = io.StringIO()
    wrapped = PlainStream(stream)
    print("a\x1b[31mb", file=wrapped)
    assert stream.getvalue() == "a\\u001b[31mb\n" and not wrapped.isatty() and wrapped.write("é") == 1
    assert acting(wrapped) is stream and acting(stream) is stream
