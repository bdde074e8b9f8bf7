"""What is written before a state is saved, and what is not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from toy_plants import chain

from fusion_sfdia.detectors.kalman_banks.central_filter import CentralFilter
from fusion_sfdia.diagnosis.watch import Watch
from fusion_sfdia.live.saving import SavedWatch


def rows(count: int) -> list[tuple[float, np.ndarray, np.ndarray]]:
    y = np.random.default_rng(1).standard_normal((count, 3))
    y[10:, 1] += 20.0
    return [(float(k + 1), y[k], np.zeros(0)) for k in range(count)]


def detector() -> CentralFilter:
    return CentralFilter(chain(3, process=1e-3))


def test_a_state_is_saved_every_so_many_rows_and_only_after_their_lines(tmp_path: Path) -> None:
    path, lines = tmp_path / "s", []

    def write(line: str) -> None:
        if len(lines) == 13:
            raise BrokenPipeError
        lines.append(line)

    saved = SavedWatch(Watch(detector()), write, path, every=5, samples=True)
    with pytest.raises(BrokenPipeError):
        for row in rows(20):
            saved.update(*row)
    assert Watch.load(path, detector()).t == 10.0
    saved.save()  # at the end of the process: the last row's lines are not written
    assert Watch.load(path, detector()).t == 10.0
    again = SavedWatch(Watch.load(path, detector()), lines.append, path, every=5, samples=True)
    for row in rows(20):
        again.update(*row)
    again.save()
    assert Watch.load(path, detector()).t == 20.0
    whole: list[str] = []
    uninterrupted = SavedWatch(Watch(detector()), whole.append, samples=True)
    for row in rows(20):
        uninterrupted.update(*row)
    assert list(dict.fromkeys(lines)) == whole and len(lines) > len(whole)


def test_a_state_that_cannot_be_saved_is_reported_and_tried_again(tmp_path: Path) -> None:
    remarks: list[str] = []
    (tmp_path / "folder").write_text("")
    path = tmp_path / "folder" / "s"
    saved = SavedWatch(Watch(detector(), refused=remarks.append), lambda line: None, path, every=5)
    for row in rows(6):
        saved.update(*row)
    assert len(remarks) == 2 and "the state is not saved" in remarks[0]
    (tmp_path / "folder").unlink()
    saved.update(*rows(7)[-1])
    assert len(remarks) == 2 and Watch.load(path, detector()).t == 7.0
