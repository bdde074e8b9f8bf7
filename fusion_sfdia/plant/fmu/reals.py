"""Real variables of an instance, in memory that calls of FMI read and write."""

from __future__ import annotations

from ctypes import POINTER, c_double, c_uint32, cast
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


class Reals:
    """Variables (k,) of an instance of FMPy by their value references; version: 2 or 3 of FMI."""

    def __init__(self, model: Any, version: int, references: tuple[int, ...]) -> None:
        self.size, self.component = len(references), model.component
        self.references = (c_uint32 * self.size)(*references)
        self.array: Array = np.zeros(self.size)
        self.values = cast(self.array.ctypes.data, POINTER(c_double))
        self.each = [(c_uint32 * 1)(reference) for reference in references]
        self.last = () if version == 2 else (self.size,)  # FMI 3.0 also states the number of values
        self.seed = ((c_double * 1)(1.0), 1)[: version - 1]
        kind = "Real" if version == 2 else "Float64"
        self.getter, self.setter = (getattr(model, f"fmi{version}{verb}{kind}") for verb in ("Get", "Set"))
        self.directional = getattr(model, f"fmi{version}GetDirectionalDerivative")

    def read(self) -> Array:
        """Their values (k,)."""
        if self.size:
            self.getter(self.component, self.references, self.size, self.values, *self.last)
        return self.array.copy()

    def write(self, values: Array) -> None:
        """Set them to values (k,)."""
        if self.size:
            self.array[:] = values
            self.setter(self.component, self.references, self.size, self.values, *self.last)

    def derivatives(self, known: Reals) -> Array:
        """Their derivatives with respect to others (k, m), as the FMU gives them, one direction at a time."""
        found = np.empty((self.size, known.size))
        if self.size:
            for j, by in enumerate(known.each):
                self.directional(self.component, self.references, self.size, by, 1, *self.seed, self.values, *self.last)
                found[:, j] = self.array
        return found
