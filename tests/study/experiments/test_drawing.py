"""Figures that are drawn in several processes; that their bytes do not depend on these is held in test_runner."""

from __future__ import annotations

from pathlib import Path

import pytest
from matplotlib.figure import Figure as Drawing

from fusion_sfdia.report.content import Figure
from fusion_sfdia.study.experiments.drawing import draw_figures


def plain() -> Drawing:
    return Drawing(figsize=(1, 1))


def broken() -> Drawing:
    raise ZeroDivisionError("no runs")


@pytest.mark.parametrize("workers", [1, 2])
def test_one_that_fails_leaves_the_others(tmp_path: Path, workers: int) -> None:
    figures = [Figure(name, name, "", draw, "") for name, draw in (("a", plain), ("b", broken), ("c", plain))]
    shown, errors = draw_figures(tmp_path, "toy/mean", figures, workers)
    assert errors == {"b": "ZeroDivisionError: no runs"}
    assert list(shown) == ["toy-mean-a", "toy-mean-c"]
    assert all(one.svg == (tmp_path / f"{slug}.svg").read_text(encoding="utf-8") for slug, one in shown.items())
    assert sorted(p.suffix for p in tmp_path.iterdir()) == [".png", ".png", ".svg", ".svg"]


def test_without_figures_nothing_is_written(tmp_path: Path) -> None:
    assert draw_figures(tmp_path / "none", "toy/mean", [], 2) == ({}, {}) and not (tmp_path / "none").exists()
