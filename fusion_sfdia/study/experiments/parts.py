"""Finished pieces of work on disk, named by everything that decides their bits, so that a run can be resumed."""

from __future__ import annotations

import hashlib
import json
import platform
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import fusion_sfdia
from fusion_sfdia.detectors.storage import read_arrays, write_arrays
from fusion_sfdia.study.experiments.provenance import OPTIONAL, sources_digest, versions
from fusion_sfdia.study.experiments.scenario import Arrays, Task

Array = NDArray[Any]

DECISIVE = ("numpy", "scipy", "numba")  # those whose version may change the bits of a piece of work
PART_NAME = re.compile(r"\.?[0-9a-f]{64}\.npz(\..*)?")  # a part, or what a killed process left of one


def part_name(work: Callable[[Task], Arrays], task: Task) -> str:
    """Return the file name of a piece of work; ValueError where the task is not made of JSON values."""
    about = {"work": f"{work.__module__}:{work.__qualname__}", "task": dict(task), **decisive()}
    try:
        text = json.dumps(about, sort_keys=True, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise ValueError(f"a task of {about['work']} is not made of JSON values ({error}): {task!r}") from error
    return f"{hashlib.sha256(text.encode()).hexdigest()}.npz"


def decisive() -> dict[str, Any]:
    """Return what decides the bits of any piece of work besides its task: code, libraries, kind of machine."""
    found = versions()
    return {
        "version": fusion_sfdia.__version__,
        "sources": sources_digest(),
        "libraries": {name: found[name] for name in ("python", *DECISIVE, *OPTIONAL)},
        "machine": platform.machine(),
    }


def write_part(path: Path, arrays: Arrays) -> None:
    """Write a piece's arrays, completely or not at all; TypeError for anything but arrays of numbers, booleans and text."""
    plain: dict[str, Array] = {}
    for name, array in arrays.items():
        plain[name] = np.asarray(array)
        if plain[name].dtype.hasobject:
            raise TypeError(f"work returned {name!r} of type {type(array).__name__}; expected arrays of numbers")
    write_arrays(path, plain, compress=True)


def read_part(path: Path) -> Arrays | None:
    """Return a piece's arrays; None where it is absent or damaged, so that it is done again."""
    try:
        return read_arrays(path)
    except (OSError, ValueError):
        return None
