"""Documents as TOML: what is written is read again to the last bit."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from fusion_sfdia.learning.tuning.tuned_file import read_document, write_document


def test_a_document_is_read_as_it_was_written(tmp_path: Path) -> None:
    numbers = [*np.random.default_rng(0).standard_normal(50).tolist(), 1e-310, 1e300, math.inf, -0.0]
    document = {
        "plain": {"a": 1, "b": 0.1 + 0.2, "c": True, "d": [1.0, 2.0], "e": numbers},
        'odd "name" \\ é': {"a b": {"x": 1.5, "unit": "m3/s"}, "\x7f\t\n": "line\nbreak \x01 \x7f ü"},
        "many": [{"v": 1.0}, {"v": 2.0, "inner": {}}],
        "nothing": {},
    }
    path = tmp_path / "x.toml"
    write_document(path, document, {"": "of the whole\nin two lines", "plain": "a comment"})
    assert read_document(path) == document
    assert path.read_text().startswith("# of the whole\n# in two lines\n\n# a comment\n[plain]\n")


def test_what_a_file_cannot_hold_leaves_none(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="cannot hold None"):
        write_document(tmp_path / "x.toml", {"a": {"b": None}}, {})
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_is_no_toml_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.toml"
    for content in (b"a = = 1", b"\xff\xfe", b"[a]\n[a]"):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=r"x\.toml is not a TOML file"):
            read_document(path)
