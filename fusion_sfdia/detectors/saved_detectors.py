"""Fitted detectors on disk, without pickle: their class, their settings and arrays; the plant is given again.

A file is written by `write_arrays`: arrays, and a JSON text of the settings, which refers to each array and each class by
name. Reading one calls nothing but constructors: of the detectors and settings of this package, and of classes that the
caller states. A file imports no other module.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import shown
from fusion_sfdia.detectors.detector import Detector
from fusion_sfdia.detectors.storage import fingerprint, read_arrays, require_detector, write_arrays
from fusion_sfdia.plant.plant import Plant

OWN = __name__.partition(".")[0]
FOLDERS = (  # those of detectors and their settings
    "derivatives.intervals",
    "detectors",
    "filters",
    "learning.frozen_model",
    "learning.outlier_detectors",
    "plant",
)
FORMER = {  # where files of version 0.1 have them
    "adaptive_thresholds": "detectors.adaptive_thresholds",
    "core": "plant",
    "data_driven": "detectors.data_driven",
    "frozen_model": "learning.frozen_model",
    "intervals": "derivatives.intervals",
    "kalman_banks": "detectors.kalman_banks",
    "monitoring": "learning.outlier_detectors",
    "stochastic_thresholds": "detectors.stochastic_thresholds",
    "structural_residuals": "detectors.structural_residuals",
}
Arrays = dict[str, NDArray[Any]]


def save_detector(path: str | Path, detector: Detector) -> None:
    """Write a detector, a frozen dataclass, to a .npz file: without its plant, of which a fingerprint is saved.

    Parameters
    ----------
    path : str or Path
        The file to write.
    detector : Detector
        Its settings may be numbers, text, None, arrays, tuples, mappings with text keys, and dataclasses or named tuples of
        such.

    Raises
    ------
    ValueError
        For a detector with anything else among its settings, such as a function, which only pickle keeps.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from fusion_sfdia import load_detector, save_detector
    >>> from fusion_sfdia.detectors import CentralFilter
    >>> from fusion_sfdia.plants import two_tanks
    >>> with TemporaryDirectory() as folder:
    ...     save_detector(Path(folder, "filter.npz"), CentralFilter(two_tanks(), false_alarm=1e-4))
    ...     read = load_detector(Path(folder, "filter.npz"), two_tanks())
    >>> read.false_alarm
    0.0001
    """
    require_detector(detector)
    arrays: Arrays = {}
    settings = json.dumps(_packed(detector, detector.plant, arrays, type(detector).__name__))
    write_arrays(Path(path), {"detector": np.array(settings), "fingerprint": np.array(fingerprint(detector)), **arrays})


def load_detector(path: str | Path, plant: Plant, classes: Iterable[type] = ()) -> Any:
    """Read a detector that save_detector wrote, on its plant; on the same machine it decides with the same bits.

    Parameters
    ----------
    path : str or Path
        The file.
    plant : Plant
        That with which it was saved.
    classes : iterable of type, default ()
        Detectors and settings from outside of this package that the file may hold.

    Returns
    -------
    Detector
        As it was saved.

    Raises
    ------
    ValueError
        Where the file is of another kind or damaged, where it holds any other class, and where the plant is not the one with
        which it was saved: another name, noise, step or layout (see `fingerprint`).

    Examples
    --------
    See `save_detector`.
    """
    if not isinstance(plant, Plant):
        raise ValueError(f"plant is {shown(plant)}; expected a Plant, such as fusion_sfdia.plants.two_tanks() returns it")
    try:
        arrays = read_arrays(Path(path))
        settings, expected = json.loads(str(arrays.pop("detector"))), str(arrays.pop("fingerprint"))
    except (KeyError, RecursionError, ValueError) as error:
        raise ValueError(f"{path} is not a saved detector ({error}); write one with save_detector") from error
    try:
        detector = _unpacked(settings, plant, arrays, tuple(classes))
        require_detector(detector)
        fits = fingerprint(detector) == expected
    except (ArithmeticError, AttributeError, ImportError, LookupError, RecursionError, TypeError, ValueError) as error:
        raise ValueError(f"{path} does not fit plant {plant.name!r} or this version of the package: {error}") from error
    if not fits:
        raise ValueError(
            f"{path} was saved with another plant than {plant.name!r} as it is now, or by another version of its class; build "
            "the plant as it was, or fit the detector to it again"
        )
    return detector


def _packed(value: Any, plant: Plant, arrays: Arrays, where: str) -> Any:
    """Return a value as JSON: plain ones unchanged, others as {kind: content}; arrays are added to `arrays`."""
    if type(value) in (type(None), bool, int, float, str):
        return value
    if value is plant:
        return {"plant": None}
    if isinstance(value, np.ndarray | np.generic) and value.dtype != object:
        name = f"array_{len(arrays):03d}"
        arrays[name] = np.asarray(value)
        return {"scalar" if isinstance(value, np.generic) else "array": name}
    if type(value) is tuple:
        return {"tuple": [_packed(v, plant, arrays, f"{where}[{i}]") for i, v in enumerate(value)]}
    if isinstance(value, Mapping) and all(isinstance(k, str) for k in value):
        return {"mapping": {k: _packed(v, plant, arrays, f"{where}[{k!r}]") for k, v in value.items()}}
    names = _settings_of(type(value))
    if names is None or isinstance(value, Plant | type):
        raise ValueError(
            f"{where} is {shown(value)}; a saved detector holds numbers, text, arrays, and dataclasses of such: keep this one "
            "with pickle, or build it again"
        )
    kept = {name: _packed(getattr(value, name), plant, arrays, f"{where}.{name}") for name in names}
    return {"class": f"{type(value).__module__}:{type(value).__qualname__}", "settings": kept}


def _unpacked(packed: Any, plant: Plant, arrays: Arrays, classes: tuple[type, ...]) -> Any:
    """The inverse of `_packed`."""
    if not isinstance(packed, dict):
        return packed
    if "class" in packed:
        settings = {name: _unpacked(v, plant, arrays, classes) for name, v in packed["settings"].items()}
        return _class_of(packed["class"], classes)(**settings)
    ((kind, content),) = packed.items()
    if kind == "plant":
        return plant
    if kind in ("array", "scalar"):
        return arrays[content] if kind == "array" else arrays[content][()]
    if kind == "tuple":
        return tuple(_unpacked(v, plant, arrays, classes) for v in content)
    return {k: _unpacked(v, plant, arrays, classes) for k, v in content.items()}


def _settings_of(kind: type) -> list[str] | None:
    """The names of what a dataclass or named tuple is built from; None for any other class."""
    if is_dataclass(kind):
        return [f.name for f in fields(kind) if f.init]
    return list(getattr(kind, "_fields", [])) or None if issubclass(kind, tuple) else None


def settings_classes(module: Any) -> list[type]:
    """The dataclasses and named tuples that a module defines, for `load_detector`."""
    found = [v for v in vars(module).values() if isinstance(v, type) and v.__module__ == module.__name__]
    return [kind for kind in found if _settings_of(kind) is not None]


def _class_of(reference: str, classes: tuple[type, ...]) -> type:
    """The dataclass or named tuple of "module:name": of this package, or else the one of that name among `classes`."""
    module, _, name = reference.rpartition(":")
    package, _, inner = module.partition(".")
    folder, dot, rest = inner.partition(".")
    inner = FORMER.get(folder, folder) + dot + rest
    if package != OWN or not inner.startswith(tuple(f"{known}." for known in FOLDERS)):
        if kind := next((c for c in classes if c.__qualname__ == name and _settings_of(c) is not None), None):
            return kind
        raise ValueError(
            f"it holds a {name} of {module!r}, which is no detector or setting of this package, and a file imports no code: "
            f"state the class, load_detector(path, plant, classes=[{name.rpartition('.')[2]}])"
        )
    found: Any = import_module(f"{OWN}.{inner}")
    for part in name.split("."):
        found = getattr(found, part)
    if not isinstance(found, type) or _settings_of(found) is None or found.__module__ != f"{OWN}.{inner}":
        raise ValueError(f"{reference} is no class of settings")
    return found
