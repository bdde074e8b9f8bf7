"""Claimed and measured false-alarm probabilities, and whether a measured one exceeds its claim."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

from fusion_sfdia.benchmarks.network.support.residuals import B18
from fusion_sfdia.detectors.stochastic_thresholds.threshold_rules import CONFORMAL
from fusion_sfdia.report.results import AT_MOST, Published, Row

ALPHAS = (2.0, 5.0, 10.0)
B18_ALPHA = 2.0  # B18, sec. VIII
LEVELS = (0.1, 0.01, 0.001)  # claimed probabilities, by which the rules set alpha
RULES_SHOWN = ("chebyshev", "cantelli", "cantelli-one-sided", "gaussian", CONFORMAL)
SINGLE, CONSECUTIVE = "false_alarm_probability", "consecutive_alarm_probability"
AFTER, CONFIRMED = "alarm_after_alarm_probability", "false_confirmation_share"
ONE_SHOCK = "one white shock"  # the law of a residual without any other noise


class Counted(NamedTuple):
    """The samples of which a probability was counted.

    quantity: the components or areas. noise: process noise (empty for ONE_SHOCK). law: distribution of all noise. alpha, or
    the rule that sets it and its claimed level. q: consecutive alarms, 0 for other metrics.
    """

    metric: str
    detector: str
    quantity: str
    noise: str
    law: str
    alpha: float | None = None
    rule: str = ""
    level: float | None = None
    q: int = 0

    @property
    def runs(self) -> str:
        """The noise of the runs: "lit, gaussian"."""
        return ", ".join(filter(None, (self.noise, self.law)))

    @property
    def condition(self) -> str:
        """The condition of its row: "3 consecutive, alpha 5, lit, gaussian"."""
        threshold = f"{self.rule} {self.level:g}" if self.level is not None else f"alpha {self.alpha:g}"
        return ", ".join([f"{self.q} consecutive"] * bool(self.q) + [threshold, self.runs])

    @property
    def claim(self) -> float:
        """The claimed upper bound: the rule's level, or that of alpha and q."""
        if self.level is not None:
            return self.level
        return claim(self.alpha or math.nan, max(self.q, 1))


Rates = Mapping[Counted, Row]


def claim(alpha: float, q: int = 1) -> float:
    """(1 / alpha^2)^q, of B18's (12) and Proposition 5."""
    return float(alpha ** (-2.0 * q))


def published_claim(of: Counted) -> Published | None:
    """B18's bound for consecutive alarms, for Gaussian noise and for the shocks that cross most of the bounds."""
    if of.metric != CONSECUTIVE or of.law not in ("gaussian", ONE_SHOCK):
        return None
    return Published(of.claim, f"{B18}, " + ("(12)" if of.q == 1 else "Proposition 5") + AT_MOST)


def claim_kept(found: Row, allowed: float) -> str:
    """Whether a count keeps a claimed upper bound: "yes" or "no" by its interval, otherwise "undecided"."""
    return "no" if found.low > allowed else "yes" if found.high <= allowed else "undecided"


def chosen(rates: Rates, **expected: object) -> dict[Counted, Row]:
    """The rates with a finite value whose keys have these entries."""
    return {
        key: r
        for key, r in rates.items()
        if math.isfinite(r.value) and all(getattr(key, name) == value for name, value in expected.items())
    }
