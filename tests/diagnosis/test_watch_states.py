"""A saved watch with a right digest and wrong content is refused with one ValueError that names the file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from toy_plants import declared, readings, tanks

from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.detectors.kalman_banks.robust_bank import RobustBank
from fusion_sfdia.detectors.storage import load_state, read_arrays, save_state, write_arrays
from fusion_sfdia.diagnosis.watch import Watch
from fusion_sfdia.plant.plant import Plant

Arrays = dict[str, np.ndarray[Any, Any]]
TIMES = 200  # of each kind


def rows_of(plant: Plant, steps: int) -> list[tuple[float, Any, Any]]:
    t, _, y, u = readings(plant, steps, 1, seed=2)
    y = y[:, 0].copy()
    y[steps // 2 :, 0] += 0.5
    y[-12:-4, 1] = np.nan
    return [(float(s), r, a) for s, r, a in zip(t, y, u[:, 0], strict=True)]


def saved(path: Path, detector: Any, steps: int = 70) -> Arrays:
    watch = Watch(detector, refused=print)
    for row in rows_of(detector.plant, steps):
        watch.update(*row)
    watch.save(path)
    return read_arrays(path)


def other_shape(rng: np.random.Generator, a: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    ways: list[Callable[[], np.ndarray[Any, Any]]] = [
        lambda: a[None],
        lambda: np.concatenate([a, a]) if a.ndim and a.size else np.stack([a, a]),
        lambda: a[..., :-1] if a.ndim and a.shape[-1] else a[..., None],
        lambda: a[:-1] if a.ndim and len(a) else a[None, None],
        lambda: a.ravel() if a.ndim > 1 else a[..., None],
        lambda: np.zeros((0, 3), a.dtype),
    ]
    found = ways[rng.integers(len(ways))]()
    return found if found.shape != a.shape else a[None]


def other_dtype(rng: np.random.Generator, a: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    kinds = [d for d in ("f4", "i4", "c16", "U9", "?", "i8", "f8", "M8[s]", "u1") if np.dtype(d).kind != a.dtype.kind]
    kind = np.dtype(kinds[rng.integers(len(kinds))])
    if a.dtype.kind in "Uc" or kind.kind == "M":
        return np.zeros(a.shape, kind)
    with np.errstate(invalid="ignore"):
        return np.nan_to_num(a.astype(float)).astype(kind)


def another(rng: np.random.Generator, arrays: Arrays, kind: str) -> Arrays:
    """The arrays with one change of a kind."""
    found = dict(arrays)
    names = [n for n in arrays if not n.endswith(("fingerprint", "clock"))]
    name = names[rng.integers(len(names))]
    if kind == "missing":
        del found[name]
    elif kind == "added":
        found[f"{name}{rng.integers(99)}" if rng.integers(2) else f"other/{name}"] = found[name]
    elif kind == "shape":
        found[name] = other_shape(rng, found[name])
    elif kind == "dtype":
        found[name] = other_dtype(rng, found[name])
    else:
        whole = ("changes/standing", "changes/sight", "changes/look.numbers", "changes/look.named")
        whole = tuple(n for n in whole if found[n].size)
        name = whole[rng.integers(len(whole))]
        values = found[name] = found[name].copy()
        columns = {"standing": [0, 1, 4], "sight": [0, 2], "look.numbers": [1, 2, 3, 4], "look.named": [0, 3]}[name[8:]]
        values[..., columns[rng.integers(len(columns))]] = (np.nan, np.inf, -1.0, 0.5, 1e300)[rng.integers(5)]
    return found


@pytest.mark.parametrize("kind", ["shape", "dtype", "missing", "added", "not whole"])
def test_a_state_with_a_right_digest_and_wrong_content_is_one_value_error(kind: str, tmp_path: Path) -> None:
    path, rng = tmp_path / "w.state", np.random.default_rng(3)
    for detector in (LeaveOneOutBank(tanks(), window=3), RobustBank(declared())):
        arrays = saved(path, detector)
        for _ in range(TIMES // 2):
            write_arrays(path, another(rng, arrays, kind))
            with pytest.raises(ValueError, match=r"w\.state (is not|has|was)") as caught:
                Watch.load(path, detector)
            assert type(caught.value).__name__ in ("ValueError", "OtherDetectorError")


def test_a_state_as_it_was_saved_is_taken(tmp_path: Path) -> None:
    """Also with an event that stands, before anything was judged, and one saved as the estimate had diverged."""
    path = tmp_path / "w.state"
    for detector, steps in (
        (LeaveOneOutBank(tanks(), window=3), 70),
        (LeaveOneOutBank(tanks()), 3),
        (RobustBank(declared()), 40),
    ):
        write_arrays(path, saved(path, detector, steps))
        loaded = Watch.load(path, detector)
        loaded.save(tmp_path / "again")
        assert (tmp_path / "again").read_bytes() == path.read_bytes()
    plant = tanks()
    broken = replace(plant, output=lambda t, x, u: plant.output(t, x, u) * (np.nan if t > 300 else 1))
    saved(path, LeaveOneOutBank(broken))
    assert Watch.load(path, LeaveOneOutBank(broken)).state is None


def test_an_older_file_and_one_without_arrays_are_refused(tmp_path: Path) -> None:
    path, detector = tmp_path / "w.state", LeaveOneOutBank(tanks())
    arrays = saved(path, detector, 10)
    write_arrays(path, {n: a for n, a in arrays.items() if n != "watch/version"})
    with pytest.raises(ValueError, match=r"it is of version 1 of this file, and this package reads version 6\); name another"):
        Watch.load(path, detector)
    save_state(path, detector, detector.init())
    with pytest.raises(ValueError, match="is not the saved state of a watch"):
        Watch.load(path, detector)
    with pytest.raises(ValueError, match="saved by another detector, other settings or another plant"):
        saved(path, detector, 10)
        Watch.load(path, LeaveOneOutBank(replace(tanks(), x0=tanks().x0 * 1.1)))
    other = LeaveOneOutBank(replace(tanks(), output=lambda t, x, u: tanks().output(t, x, u) * (np.nan if t > 0 else 1)))
    saved(path, other, 10)
    with pytest.raises(ValueError, match="saved by another detector"):  # also where no state is kept
        Watch.load(path, detector)


def test_a_state_of_a_detector_alone_is_checked_as_well(tmp_path: Path) -> None:
    path, rng, detector = tmp_path / "s.npz", np.random.default_rng(5), LeaveOneOutBank(tanks(), window=3)
    for batch in ((), (3,)):
        save_state(path, detector, detector.init(batch))
        arrays = read_arrays(path)
        names = [n for n in arrays if n != "fingerprint"]
        for _ in range(TIMES // 2):
            name = names[rng.integers(len(names))]
            change = (other_shape, other_dtype)[rng.integers(2)]
            write_arrays(path, arrays | {name: change(rng, arrays[name])})
            with pytest.raises(ValueError, match=r"s\.npz is not a saved state of|s\.npz has the state of another version"):
                load_state(path, detector)
