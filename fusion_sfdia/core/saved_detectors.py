"""Fitted detectors on disk, without pickle: their class, their settings and arrays; the plant is given again.

A file is written by `write_arrays`: arrays, and a JSON text of the settings, which refers to each array and each class by
name. Reading one runs no code but the constructors of this package and of modules that are imported already; of a class
from a file "path/mine.py:make", that file must have been named before.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.arguments import shown
from fusion_sfdia.core.detector import Detector
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.core.references import imported_from, path_of
from fusion_sfdia.core.storage import fingerprint, read_arrays, require_detector, write_arrays

OWN = __name__.partition(".")[0]
Arrays = dict[str, NDArray[Any]]


def save_detector(path: str | Path, detector: Detector) -> None:
    """Write a detector, a frozen dataclass, to a .npz file: without its plant, of which a fingerprint is saved.

    Settings may be numbers, text, None, arrays, tuples, mappings with text keys, and dataclasses or named tuples of such.
    ValueError for a detector with anything else among its settings, such as a function, which only pickle keeps.
    """
    require_detector(detector)
    arrays: Arrays = {}
    settings = json.dumps(_packed(detector, detector.plant, arrays, type(detector).__name__))
    write_arrays(Path(path), {"detector": np.array(settings), "fingerprint": np.array(fingerprint(detector)), **arrays})


def load_detector(path: str | Path, plant: Plant) -> Any:
    """Read a detector that save_detector wrote, on its plant; on the same machine it decides with the same bits.

    ValueError where the file is of another kind or damaged, where its class is not known here, and where the plant is not
    the one with which it was saved: another name, noise, step or layout (see `fingerprint`).
    """
    if not isinstance(plant, Plant):
        raise ValueError(
            f"plant is {shown(plant)}; expected a Plant, such as registry.plant('two-tanks') returns it for a name"
        )
    try:
        arrays = read_arrays(Path(path))
        settings, expected = json.loads(str(arrays.pop("detector"))), str(arrays.pop("fingerprint"))
    except (KeyError, ValueError) as error:
        raise ValueError(f"{path} is not a saved detector ({error}); write one with save_detector") from error
    try:
        detector = _unpacked(settings, plant, arrays)
        fits = fingerprint(detector) == expected
    except (AttributeError, TypeError, ValueError) as error:
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
    module = type(value).__module__
    return {"class": f"{path_of(module) or module}:{type(value).__qualname__}", "settings": kept}


def _unpacked(packed: Any, plant: Plant, arrays: Arrays) -> Any:
    """The inverse of `_packed`."""
    if not isinstance(packed, dict):
        return packed
    if "class" in packed:
        settings = {name: _unpacked(v, plant, arrays) for name, v in packed["settings"].items()}
        return _class_of(packed["class"])(**settings)
    ((kind, content),) = packed.items()
    if kind == "plant":
        return plant
    if kind in ("array", "scalar"):
        return arrays[content] if kind == "array" else arrays[content][()]
    if kind == "tuple":
        return tuple(_unpacked(v, plant, arrays) for v in content)
    return {k: _unpacked(v, plant, arrays) for k, v in content.items()}


def _settings_of(kind: type) -> list[str] | None:
    """The names of what a dataclass or named tuple is built from; None for any other class."""
    if is_dataclass(kind):
        return [f.name for f in fields(kind) if f.init]
    return list(getattr(kind, "_fields", [])) or None if issubclass(kind, tuple) else None


def _class_of(reference: str) -> type:
    """The dataclass or named tuple of "module:name" or "path/file.py:name".

    The module is of this package or imported already. ValueError for any other.
    """
    module, _, name = reference.rpartition(":")
    if module.endswith(".py"):
        path, module = module, imported_from(module) or ""
        if not module:
            raise ValueError(
                f"its class {name} is of the file {path}, which is not imported yet; build a detector of that file once, with "
                f"registry.detector('{path}:...', plant), then load this one"
            )
    if module.partition(".")[0] != OWN and module not in sys.modules:
        raise ValueError(f"its class {name} is of the module {module!r}; import that first")
    found: Any = import_module(module)
    for part in name.split("."):
        found = getattr(found, part)
    if not isinstance(found, type) or _settings_of(found) is None:
        raise ValueError(f"{reference} is no class of settings")
    return found
