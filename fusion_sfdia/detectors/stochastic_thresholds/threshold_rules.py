"""The threshold of a residual in standard deviations: rules that relate alpha to a false-alarm probability.

For a residual of mean 0 and standard deviation at most s, with an alarm where |residual| > alpha s:

    rule                 false alarms at most    for
    chebyshev            1 / alpha^2             any distribution (Boem et al. 2018, (12))
    cantelli             2 / (1 + alpha^2)       any distribution, at most half of them on either side
    cantelli-one-sided   1 / (1 + alpha^2)       any distribution, alarms on one side only
    gaussian             2 Phi(-alpha)           Gaussian residuals
    conformal            calibrated              residuals that are exchangeable with those of the calibration
    bound                0                       errors within bounds, where s is the bound of the residual; alpha is 1

Cantelli's inequality on both sides is not sharper than Chebyshev's (2 / (1 + a^2) > 1 / a^2 for a > 1), but it also bounds the
alarms of each side. alpha of `conformal` is an order statistic: see `conformal_alpha`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from fusion_sfdia.common.arguments import floats, number, probability, shown
from fusion_sfdia.common.order_statistics import exceedance_rank, order_statistic

Array = NDArray[Any]


class ThresholdRule(NamedTuple):
    """false_alarm(alpha), alpha(false_alarm); alpha must be larger than `least`, at which the probability is 1 or more."""

    false_alarm: Callable[[Any], Any]
    alpha: Callable[[Any], Any]
    least: float


RULES = {
    "chebyshev": ThresholdRule(lambda a: 1 / a**2, lambda p: p**-0.5, 1.0),
    "cantelli": ThresholdRule(lambda a: 2 / (1 + a**2), lambda p: (2 / p - 1) ** 0.5, 1.0),
    "cantelli-one-sided": ThresholdRule(lambda a: 1 / (1 + a**2), lambda p: (1 / p - 1) ** 0.5, 0.0),
    "gaussian": ThresholdRule(lambda a: 2 * ndtr(-a), lambda p: -ndtri(p / 2), 0.0),
}
CONFORMAL, BOUND = "conformal", "bound"


def require_rule(rule: object) -> None:
    """Raise ValueError for an unknown rule."""
    if rule not in (*RULES, CONFORMAL, BOUND):
        raise ValueError(f"rule is {shown(rule)}; known: {', '.join((*RULES, CONFORMAL, BOUND))}")


def require_alpha(rule: str, alpha: object) -> float:
    """Return alpha; ValueError where the rule gives no bound below 1 (alpha <= 1 for Chebyshev)."""
    value, least = number("alpha", alpha), RULES[rule].least if rule in RULES else 0.0
    if not least < value < np.inf:
        raise ValueError(
            f"alpha is {value:g}; with the rule {rule!r} expected a finite number above {least:g}: "
            "otherwise the bound of false alarms is 1 or more"
        )
    return value


def false_alarm_of(rule: str, alpha: float) -> float:
    """Return the largest false-alarm probability of a component under alpha.

    Raises ValueError for `conformal`, where alpha does not determine it.
    """
    require_rule(rule)
    if rule == BOUND:
        return 0.0
    if rule == CONFORMAL:
        raise ValueError(
            "a conformal alpha does not determine its false-alarm probability; give the one for which alpha was calibrated"
        )
    return float(RULES[rule].false_alarm(require_alpha(rule, alpha)))


def alpha_for(rule: str, false_alarm: float, components: int = 1) -> float:
    """Return the alpha with which a diagnoser of `components` components has at most this false-alarm probability in a step.

    Bonferroni: each component has false_alarm / components, for any correlation. Raises ValueError for a probability that is
    not strictly between 0 and 1, and for `conformal`, which is calibrated.
    """
    require_rule(rule)
    if rule == CONFORMAL:
        raise ValueError("the rule 'conformal' needs healthy data; calibrate it, or give another rule")
    if rule == BOUND:
        raise ValueError("the rule 'bound' has no false alarms; leave false_alarm out, or give another rule")
    if components < 1:
        raise ValueError(f"a diagnoser has {components} components; expected at least 1")
    return float(RULES[rule].alpha(probability("false_alarm", false_alarm) / components))


def conformal_alpha(scores: Array, false_alarm: float) -> Array:
    """Return alpha (...) from healthy |residual| / s (M, ...): the ceil((M + 1)(1 - false_alarm))-th smallest of M.

    A further score that is exchangeable with these exceeds alpha with probability at most false_alarm, for any M and any
    distribution. Consecutive scores in time are exchangeable only approximately: take them far apart, or from different runs.
    NaN scores count as the largest. Raises ValueError for fewer than 1 / false_alarm - 1 scores, which determine no threshold.
    """
    probability("false_alarm", false_alarm)
    scores = floats("scores", scores)
    count = len(scores) if scores.ndim else 0
    if exceedance_rank(count, false_alarm) > count:
        raise ValueError(
            f"{count} healthy scores cannot set a false-alarm probability of {false_alarm:g}; give at least "
            f"{int(np.ceil(1 / false_alarm - 1 - 1e-9))} or use a larger probability"
        )
    return order_statistic(np.where(np.isnan(scores), np.inf, scores), false_alarm)
