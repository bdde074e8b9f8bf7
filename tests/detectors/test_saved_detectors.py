"""Detectors on disk: what is read is what was written, on the plant it was written with."""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from toy_plants import readings, tanks

from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.data_driven.fixed_limits import FixedLimits
from fusion_sfdia.detectors.kalman_banks.central_filter import CentralFilter
from fusion_sfdia.detectors.saved_detectors import load_detector, save_detector
from fusion_sfdia.detectors.storage import load_state, read_arrays, save_state, write_arrays
from fusion_sfdia.filters.estimators import Unscented

PLANT = tanks()


@dataclass(frozen=True)
class Mine(CentralFilter):
    """A detector of a caller's own module, with settings of every kind."""

    any: Any = None


@pytest.mark.parametrize(
    "value",
    [None, True, 3, 0.1, float("inf"), "text", (), (1, (2.0, "x")), {"a": (1.0,)}, np.float64(0.1), Unscented(redraw=False)],
    ids=repr,
)
def test_a_setting_comes_back_as_it_was(value: Any, tmp_path: Path) -> None:
    save_detector(tmp_path / "mine.npz", Mine(PLANT, any=value))
    found = load_detector(tmp_path / "mine.npz", PLANT, [Mine])
    assert type(found) is Mine and found.any == value and type(found.any) is type(value) and found.plant is PLANT


@pytest.mark.parametrize("array", [np.array(0.1), np.eye(3, dtype=np.float32), np.array([True, False]), np.array(["a", "b"])])
def test_an_array_comes_back_to_the_bit(array: np.ndarray, tmp_path: Path) -> None:
    save_detector(tmp_path / "mine.npz", Mine(PLANT, any=(array, array + array if array.dtype.kind == "f" else array)))
    found = load_detector(tmp_path / "mine.npz", PLANT, [Mine]).any
    np.testing.assert_array_equal(found[0], array)
    assert found[0].dtype == array.dtype and found[0].shape == array.shape and len(found) == 2


def test_what_only_pickle_keeps_is_refused_by_its_place(tmp_path: Path) -> None:
    for value, where in ((len, r"Mine\.any is <built-in"), ((1, {2}), r"Mine\.any\[1\] is \{2\}"), ({1: 2}, r"Mine\.any is")):
        with pytest.raises(ValueError, match=where + ".*; a saved detector holds numbers, text, arrays"):
            save_detector(tmp_path / "mine.npz", Mine(PLANT, any=value))
    assert not list(tmp_path.iterdir())


def test_another_plant_or_file_is_refused(tmp_path: Path) -> None:
    t, _, y, u = readings(PLANT, 60, 2, seed=0)
    detector, path = FixedLimits.fit(PLANT, (t, y, u), 0.1), tmp_path / "limits.npz"
    save_detector(path, detector)
    for other in (
        replace(PLANT, name="other tanks"),
        replace(PLANT, dt=6.0),
        replace(PLANT, sensors=(replace(PLANT.sensors[0], sigma=0.02), *PLANT.sensors[1:])),
    ):
        with pytest.raises(ValueError, match=r"was saved with another plant than .*; build the plant as it was, or fit"):
            load_detector(path, other)
    fewer = PLANT.sensors[:3]
    with pytest.raises(ValueError, match=r"does not fit plant 'two-tanks' or this version of the package: centre has shape"):
        load_detector(path, replace(PLANT, sensors=fewer, output=lambda t, x, u: PLANT.output(t, x, u)[..., :3]))
    save_state(tmp_path / "state.npz", detector, detector.init())
    (tmp_path / "notes.txt").write_text("readings of 3 May")
    for wrong in ("state.npz", "notes.txt"):
        with pytest.raises(ValueError, match=rf"{wrong} is not a saved detector .*; write one with save_detector"):
            load_detector(tmp_path / wrong, PLANT)


@pytest.mark.parametrize(
    ("reference", "message"),
    [
        (
            "antigravity:Detector",
            r"holds a Detector of 'antigravity', which is no detector or setting .* imports no code: state",
        ),
        ("os:system", "holds a system of 'os', which is no detector or setting of this package"),
        ("/elsewhere/mine.py:Mine", "holds a Mine of '/elsewhere/mine.py', which is no detector or setting of this package"),
        ("fusion_sfdia.__main__:main", "holds a main of 'fusion_sfdia.__main__', which is no detector or setting"),
        ("fusion_sfdia.study.experiments.runner:Command", "which is no detector or setting of this package"),
        ("fusion_sfdia.plant.log:one_run", "is no class of settings"),
        ("fusion_sfdia.plant.log:Plant", "is no class of settings"),
        ("fusion_sfdia.plant.plant:Uncertainty", "is no class of settings"),
        ("fusion_sfdia.plant.plant:Nothing", "has no attribute 'Nothing'"),
        ("fusion_sfdia.detectors.nothing:Nothing", "No module named 'fusion_sfdia.detectors.nothing'"),
        ("fusion_sfdia.plant.signals:Signal", "unexpected keyword argument"),
    ],
)
def test_a_file_names_no_other_code(reference: str, message: str, tmp_path: Path) -> None:
    """A crafted file calls nothing but classes of detectors and settings, and imports no module from outside of the package."""
    path = tmp_path / "mine.npz"
    save_detector(path, Mine(PLANT))
    found = read_arrays(path)
    found["detector"] = np.array(str(found["detector"]).replace(f"{Mine.__module__}:Mine", reference))
    write_arrays(path, found)
    before = set(sys.modules)
    with pytest.raises(ValueError, match=message):
        load_detector(path, PLANT)
    assert "antigravity" not in set(sys.modules) - before


def test_a_file_that_names_former_folders_is_read(tmp_path: Path) -> None:
    path, detector = tmp_path / "glr.npz", CentralFilter(PLANT)
    save_detector(path, detector)
    found = read_arrays(path)
    now = str(found["detector"])
    found["detector"] = np.array(now.replace("fusion_sfdia.detectors.kalman_banks.", "fusion_sfdia.kalman_banks."))
    assert str(found["detector"]) != now
    write_arrays(path, found)
    assert load_detector(path, PLANT) == detector


@pytest.mark.parametrize(
    "settings",
    [
        "[" * 100_000,
        '{"tuple": [], "mapping": {}}',
        '{"class": "fusion_sfdia.plant.plant:Plant", "settings": {}}',
        '{"array": "x"}',
        "3",
    ],
    ids=["deep", "two kinds", "a plant", "no array", "a number"],
)
def test_crafted_settings_are_one_clear_error(settings: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.npz"
    write_arrays(path, {"detector": np.array(settings), "fingerprint": np.array("")})
    with pytest.raises(ValueError, match=r"mine.npz (is not a saved detector|does not fit plant)"):
        load_detector(path, PLANT)


def test_a_detector_of_a_file_is_loaded_where_its_class_is_stated(tmp_path: Path) -> None:
    """In a new process the error names the class and the cure, and the cure works; also where the file was moved."""
    (tmp_path / "bank.py").write_text(
        "from dataclasses import dataclass\n"
        "from fusion_sfdia.detectors.kalman_banks.central_filter import CentralFilter\n"
        "@dataclass(frozen=True)\n"
        "class Bank(CentralFilter):\n"
        "    size: int = 1\n"
        "def make(plant):\n"
        "    return Bank(plant, size=7)\n"
    )
    path, file = tmp_path / "bank.npz", tmp_path / "bank.py"
    saved = registry.detector(f"{file}:make", PLANT)
    save_detector(path, saved)
    with pytest.raises(ValueError, match=r"holds a Bank of 'bank_.*load_detector\(path, plant, classes=\[Bank\]\)"):
        load_detector(path, PLANT)
    moved = file.rename(tmp_path / "moved.py")
    again = type(registry.detector(f"{moved}:make", PLANT))
    assert again is not type(saved)
    found = load_detector(path, PLANT, classes=[again])
    assert type(found) is again and found.size == 7


def test_names_in_place_of_objects_and_a_state_in_place_of_a_detector_are_one_clear_error(tmp_path: Path) -> None:
    path = tmp_path / "mine.npz"
    save_detector(path, Mine(PLANT))
    with pytest.raises(ValueError, match=r"plant is 'two-tanks'; expected a Plant, such as fusion_sfdia.plants.two_tanks"):
        load_detector(path, "two-tanks")  # type: ignore[arg-type]
    for wrong in ("kf-chi2", Mine, PLANT):
        with pytest.raises(
            ValueError, match=r"detector is .*; expected a Detector, such as fusion_sfdia.detector\('kf-chi2', plant\)"
        ):
            save_detector(path, wrong)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="detector is 'kf-chi2'; expected a Detector"):
        load_state(path, "kf-chi2")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"mine.npz is a saved detector, not a state; read it with load_detector"):
        load_state(path, Mine(PLANT))
