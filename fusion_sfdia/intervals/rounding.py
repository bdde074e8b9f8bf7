"""Bounds of a real number of which only a rounded value is known: floats rounded outward.

- Operations that IEEE 754 rounds correctly (+ - * / sqrt square) go out by one unit in the last place, by the predecessor and
  successor of Rump, Zimmermann, Boldo and Melquiond 2009 (BIT 49:419-431), alg. 1.
- Library functions (exp, log, power, ...) go out by `LIBRARY_ULPS` + 1 units: NumPy states no bound, so this one is an
  assumption about the library, which the tests check against decimal arithmetic.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

LIBRARY_ULPS = 4
EPS = 2.0**-52
HALF_ULP = 2.0**-53 * (1 + 2.0**-52)
TINY = 5e-324
MAX = float(np.finfo(float).max)


def rounds_to_nearest() -> bool:
    """Whether the processor rounds to nearest, as every bound here assumes: some libraries change the mode for good."""
    return 1.0 + TINY == 1.0 == 1.0 - TINY


def below(x: Array, ulps: int = 0) -> Array:
    """Return a lower bound of what x is the rounded value of; ulps 0: correctly rounded."""
    x = np.minimum(x, MAX)  # the exact value of an overflow is at least this large
    size = np.abs(x)
    return x - ((ulps + 1) * (size * EPS + TINY) if ulps else size * HALF_ULP + TINY)


def above(x: Array, ulps: int = 0) -> Array:
    """Return an upper bound of what x is the rounded value of."""
    return -below(-x, ulps)
