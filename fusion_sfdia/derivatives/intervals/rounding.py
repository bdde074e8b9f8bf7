"""Outward rounding: bounds of a real number from its rounded value.

- Operations that IEEE 754 rounds correctly (+ - * / sqrt square) are widened by one unit in the last place, by the predecessor
  and successor of Rump, Zimmermann, Boldo and Melquiond 2009 (BIT 49:419-431), alg. 1.
- Library functions (exp, log, power, ...) are widened by `LIBRARY_ULPS` + 1 units. NumPy states no bound, so this is an
assumption
  about the library; the tests check it against decimal arithmetic.
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
    """Whether the processor rounds to nearest, as every bound here assumes: some libraries change the mode permanently."""
    return 1.0 + TINY == 1.0 == 1.0 - TINY


def below(x: Array, ulps: int = 0) -> Array:
    """Return a lower bound of the number whose rounded value is x; ulps 0: correctly rounded."""
    x = np.minimum(x, MAX)  # the exact value of an overflow is at least this large
    size = np.abs(x)
    return x - ((ulps + 1) * (size * EPS + TINY) if ulps else size * HALF_ULP + TINY)


def above(x: Array, ulps: int = 0) -> Array:
    """Return an upper bound of the number whose rounded value is x."""
    return -below(-x, ulps)
