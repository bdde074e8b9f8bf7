"""How far rounding may drive two ways of computing the same numbers apart, on any processor."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

EPS = float(np.finfo(float).eps)


def rounding(condition: float = 1.0, operations: float = 1.0) -> float:
    """Relative difference of two results of that many roundings each, magnified by the condition of the problem.

    operations: the length of sums of products, the size of a matrix that is factorised, times the steps of a recursion.
    condition: of the matrix solved with; where terms cancel, the sum of their magnitudes over that of the result.
    """
    return 2.0 * EPS * float(operations) * float(condition)


def rounding_of_solution(matrix: Array, terms: Array, x: Array, right_terms: Array, operations: float) -> Array:
    """Bound (n,) of the difference of two solutions x of matrix x = right whose entries are themselves sums with roundings.

    eps |A^-1| (|A| |x| + |b|) componentwise (Higham, Accuracy and Stability of Numerical Algorithms, 2nd ed., Theorem 7.4) with
    terms (n, n) and right_terms (n,), the sums of the magnitudes of what is added up to an entry, for |A| and |b|.
    """
    magnified: Array = np.abs(np.linalg.inv(matrix)) @ (terms @ np.abs(x) + right_terms)
    return rounding(1.0, operations) * magnified
