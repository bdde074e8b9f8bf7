"""What is claimed of false alarms, and whether a count keeps it."""

from __future__ import annotations

from fusion_sfdia.evaluation.results import Row
from fusion_sfdia.stochastic_thresholds.threshold_rules import CONFORMAL

ALPHAS = (2.0, 5.0, 10.0)
B18_ALPHA = 2.0  # B18, sec. VIII
LEVELS = (0.1, 0.01, 0.001)  # claimed probabilities, by which the rules set alpha
RULES_SHOWN = ("chebyshev", "cantelli", "cantelli-one-sided", "gaussian", CONFORMAL)


def claim(alpha: float, q: int = 1) -> float:
    """(1 / alpha^2)^q, of B18's (12) and Proposition 5."""
    return float(alpha ** (-2.0 * q))


def bound(r: Row) -> float:
    """What is claimed of a row whose quantity says "alpha 5", and "3 in a row" or nothing."""
    parts = r.quantity.split(", ")
    q = next((int(p[0]) for p in parts if p.endswith("in a row")), 1)
    return claim(next(float(p.removeprefix("alpha ")) for p in parts if p.startswith("alpha ")), q)


def verdict(found: Row, allowed: float) -> str:
    """Whether a claimed upper bound is kept: "no" or "yes" where the interval decides it."""
    return "no" if found.low > allowed else "yes" if found.high <= allowed else "undecided"
