"""An FMU as plants carry it to other processes."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.fmu.instance import Instance
from fusion_sfdia.fmu.interface import Interface

Array = NDArray[Any]


@dataclass(frozen=True, eq=False)
class Fmu:
    """An FMU with the variables that a plant uses, by value references, and the values that it starts from.

    digest: SHA-256 of the file, which another process must find unchanged. start: (setter of FMPy, reference, value) of each.
    parameters: those that are set for each evaluation.
    """

    interface: Interface
    digest: str
    states: tuple[int, ...]
    rates: tuple[int, ...]
    inputs: tuple[int, ...]
    outputs: tuple[int, ...]
    parameters: tuple[int, ...] = ()
    start: tuple[tuple[str, int, Any], ...] = ()

    @cached_property
    def _opened(self) -> list[Any]:
        return [0, None]  # the process, the instance

    def __getstate__(self) -> dict[str, Any]:
        return {f.name: getattr(self, f.name) for f in fields(self)}

    def instance(self) -> Instance:
        """The instance in this process, opened at first use; ValueError where the file is not what it was."""
        if self._opened[0] != os.getpid():  # a copy of the memory of another process is no instance
            self._require_file()
            self._opened[:] = os.getpid(), Instance(self)
        found: Instance = self._opened[1]
        return found

    def _require_file(self) -> None:
        path = self.interface.path
        if not path.is_file() or digest_of(path) != self.digest:
            raise ValueError(
                f"{self.interface} is not there any more, or another file; expected that of which the plant was made: put it "
                "back, or make the plant again"
            )

    def initial(self, of: str, theta: Array) -> Array:
        """The values of its states, inputs or outputs after initialisation; ValueError where that fails."""
        instance = self.instance()
        try:
            found: Array = instance.guarded(instance.initial, of, theta)
        except ArithmeticError as error:
            raise ValueError(
                f"{error}; expected an FMU that initialises: correct its start values, start_values={{...}}"
            ) from error
        if not np.all(np.isfinite(found)):
            raise ValueError(f"{self.interface} has {of} that are not finite at its start; correct its start values")
        return found

    def each(self, evaluation: str, shape: tuple[int, ...], x: Array, u: Array, theta: Array, *times: float) -> Array:
        """Evaluate an instance for each row of a batch: x (..., n), u (..., m) and theta (..., p) to (..., *shape).

        NaN for rows that are not finite and for those of which the FMU says that they have no result. TypeError for numbers
        that are not real.
        """
        arrays = [_real(a) for a in (x, u, theta)]
        batch = np.broadcast_shapes(*(a.shape[:-1] for a in arrays))
        count = math.prod(batch)
        rows = [np.broadcast_to(a, (*batch, a.shape[-1])).reshape(count, a.shape[-1]) for a in arrays]
        out = np.full((count, *shape), np.nan)
        instance = self.instance()
        finite = np.logical_and.reduce([np.isfinite(a).all(axis=1) for a in rows])
        with instance.lock:
            call: Callable[..., Array] = getattr(instance, evaluation)
            for i in np.flatnonzero(finite):
                out[i] = instance.guarded(call, *times, *(a[i] for a in rows))
        return out.reshape(*batch, *shape)


def digest_of(path: Path) -> str:
    """SHA-256 of a file."""
    return sha256(path.read_bytes()).hexdigest()


def _real(a: Array) -> Array:
    if np.asarray(a).dtype.kind not in "biuf":
        raise TypeError(f"an FMU takes real numbers, not {np.asarray(a).dtype}")
    return np.asarray(a, dtype=float)
