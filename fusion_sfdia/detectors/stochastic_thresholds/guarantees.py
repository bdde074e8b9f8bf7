"""Which faults are detected, and which hypotheses excluded, for certain: Boem et al. 2018 ("B18"), sec. III-D and V.

A residual is what a fault adds to it and what noise does, |noise| <= alpha s with the probability of the rule, 1 - 1 / alpha^2:

    (29, 30)   e(t) = U(t) + E(t),   E(t) = lam E(t-1) + phi(t-1),   |U| <= alpha s
    (33)       |E(t)| > 2 alpha s(t)                                                   the residual exceeds its threshold
    (34, 35)   phi > lam r_upp + 2 alpha sd(chi)  or  phi < lam r_low - 2 alpha sd(chi)   so it does in the next step,
               with the distances r_upp = alpha s - e, r_low = -alpha s - e, sd(chi) = s+ - lam s
    (38, 39)   the same for the estimator of hypothesis l, where phi is phi_p - phi_l, p the true fault, and 2 alpha sd(chi) is
               alpha (sd(chi_l) + sd(chi)) + E[phi_l(x) - phi_l(y)]
    (36)       alpha_l = |e_l| / s_l: of noise alone a residual is as large with a probability of at most 1 / alpha_l^2

(33) as printed sums s from the start of the fault on. But the noise before it is in U as it is in the threshold, and is bounded
from the same side: "paper" has the printed sum, with which a fault soon after a start in the middle of a run seems detectable
and need not be. (36) as printed has the threshold for alpha in place of the one for alpha_l, which then does not give the
residual. (34) and (38) take U(t-1) as known; the noise of the last reading is in both e and chi, so that their probability is
that of the rule only where lam or the model's slope is 0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import floats, number, shown
from fusion_sfdia.detectors.detector import run
from fusion_sfdia.detectors.stochastic_thresholds.chebyshev import Chebyshev
from fusion_sfdia.detectors.stochastic_thresholds.consensus import MODES
from fusion_sfdia.detectors.stochastic_thresholds.fault_functions import FaultFunction
from fusion_sfdia.detectors.stochastic_thresholds.fault_hypotheses import FaultHypotheses
from fusion_sfdia.detectors.stochastic_thresholds.threshold_rules import BOUND, CONFORMAL, RULES, require_rule
from fusion_sfdia.detectors.stochastic_thresholds.unread_states import require_estimable
from fusion_sfdia.logs.log_forms import as_log
from fusion_sfdia.plant.areas import Areas
from fusion_sfdia.plant.log import Log, one_run

Array = NDArray[Any]


class Margins(NamedTuple):
    """Of each reading at times t (K,) what a fault adds to its residual over what (33) asks, ratio (K, N); NaN where it is not
    tested. probability: of the residual to exceed its threshold where its ratio is above 1.
    """

    t: Array
    ratio: Array
    probability: float

    @property
    def certain(self) -> Array:
        """Where (33) holds (K, N)."""
        return np.asarray(self.ratio > 1)

    @property
    def smallest(self) -> float:
        """The factor on the size of the fault with which (33) just holds once, where residuals are proportional to it."""
        return float(1 / np.nanmax(self.ratio))


def accumulated(phi: Array, lam: float) -> Array:
    """E (K, ...) of (30), of what a fault adds to the residual in each step, phi (K, ...)."""
    found = np.empty(np.shape(phi))
    before = np.zeros(np.shape(phi)[1:])
    for k, now in enumerate(phi):
        found[k] = before = lam * before + now
    return found


def margins(phi: Array, deviation: Array, lam: float, alpha: Any, mode: str = "corrected") -> Array:
    """|E| over 2 alpha s (K, ...): (33) holds where it is above 1.

    phi (K, ...): what the fault adds to each residual in each step. deviation (K, ...): s of the residuals. mode: "paper" for
    the sum of s since the start of the fault, as printed. ValueError for shapes that do not fit and an unknown mode.
    """
    phi, s = floats("phi", phi), floats("deviation", deviation)
    if phi.shape != s.shape or not phi.ndim:
        raise ValueError(f"phi {phi.shape} and deviation {s.shape} do not fit; expected one number each a step and residual")
    if mode not in MODES:
        raise ValueError(f"mode is {shown(mode)}; known: {', '.join(MODES)}")
    if mode == "paper":
        added = np.diff(s, axis=0, prepend=0.0) + (1 - lam) * np.concatenate([np.zeros_like(s[:1]), s[:-1]])  # s+ - lam s
        begun = np.maximum.accumulate(np.any(phi != 0, axis=tuple(range(1, phi.ndim))))
        s = accumulated(np.where(begun.reshape(-1, *[1] * (phi.ndim - 1)), added, 0.0), lam)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(phi == phi, np.abs(accumulated(phi, lam)) / (2 * alpha * s), np.nan)


def detectable(detector: Chebyshev, faulty: Any, healthy: Any = None) -> Margins:
    """How far a fault is beyond what is detected for certain, (33), at each time.

    Parameters
    ----------
    detector : Chebyshev
        With its thresholds.
    faulty : Log, Recording or frame
        Readings with the fault and without noise, of one run.
    healthy : Log, Recording or frame, optional
        The same without the fault, where the truth is not the detector's model, so that residuals are not 0 then.

    Returns
    -------
    Margins
        ratio (K, N): what the fault adds to each residual over what (33) asks.

    Raises
    ------
    ValueError
        For data that do not fit.

    Notes
    -----
    Boem et al. 2018, sec. V.

    Examples
    --------
    >>> from fusion_sfdia import Log, simulate
    >>> from fusion_sfdia.detectors import Chebyshev, detectable
    >>> from fusion_sfdia.plants import two_tanks
    >>> plant = two_tanks()
    >>> recording = simulate(plant, 40, seeds=[1], truth="model")
    >>> faulty = recording.signal[:, 0] + (recording.t > 100)[:, None] * [0.5, 0.0, 0.0, 0.0]
    >>> margins = detectable(Chebyshev(plant, alpha=3.0), Log(recording.t, faulty, recording.u))
    >>> float(recording.t[margins.certain.any(axis=-1)][0])
    105.0
    """
    log = one_run(as_log(detector.plant, faulty))
    residual, deviation = _residuals(detector, log)
    if healthy is not None:
        other = one_run(as_log(detector.plant, healthy))
        if not np.array_equal(other.t, log.t):
            raise ValueError("the times of the healthy and the faulty readings differ; give both at the same times")
        residual = residual - _residuals(detector, other)[0]
    with np.errstate(invalid="ignore"):
        return Margins(log.t, np.abs(residual) / (2 * detector.limits * deviation), 1 - _false_alarm(detector))


def excludable(hypotheses: Mapping[str, Chebyshev], faulty: Any) -> dict[str, Margins]:
    """Of each hypothesis how far the fault is beyond what excludes it for certain, (38), (39).

    Parameters
    ----------
    hypotheses : mapping of str to Chebyshev
        By name, the detector on the plant with that fault in its model.
    faulty : Log, Recording or frame
        Readings with the true fault and without noise, as for `detectable`; its own hypothesis has a ratio of 0.

    Returns
    -------
    dict of str to Margins
        By the same names; a ratio above 1 excludes the hypothesis for certain.

    Notes
    -----
    Boem et al. 2018, sec. V.

    Examples
    --------
    >>> from fusion_sfdia import Log, simulate
    >>> from fusion_sfdia.detectors import Chebyshev, excludable
    >>> from fusion_sfdia.plants import two_tanks
    >>> hypotheses = {f"outlets {outlet:.0%}": Chebyshev(two_tanks(outlet=outlet), alpha=3.0) for outlet in (0.8, 1.2)}
    >>> wide = simulate(two_tanks(outlet=1.2), 40, seeds=[1], truth="model")
    >>> found = excludable(hypotheses, Log(wide.t, wide.signal[:, 0], wide.u_of_runs[:, 0]))
    >>> {name: bool((margins.ratio[-1] > 1).any()) for name, margins in found.items()}
    {'outlets 80%': True, 'outlets 120%': False}
    """
    return {name: detectable(matched, faulty) for name, matched in hypotheses.items()}


def excludable_faults(isolation: FaultHypotheses, true: FaultFunction, x: Array, u: Array, e: Array, deviation: Array) -> Array:
    """Of each fault function of an area of a network how far a fault is beyond what excludes it for certain, (38), (39).

    Parameters
    ----------
    isolation : FaultHypotheses
        With the fault functions, its lam, alpha and mode.
    true : callable
        The fault function of the true fault, phi(x (..., n), u (...), e (...)) -> (..., n).
    x : array (K, n)
        True states of the area from the start of the isolation on, at the beginning of each step.
    u : array (K,)
        Its reference in these steps.
    e : array (K,)
        Its inflow, sum_j P_ij x_j - d.
    deviation : array (K, L, n)
        s of the residuals after each step, such as those of an `Isolation` for its own readings.

    Returns
    -------
    array (K, L)
        The largest ratio of its residuals; above 1 the hypothesis is excluded for certain. That of the true fault is 0.

    Raises
    ------
    ValueError
        For shapes that do not fit.

    Notes
    -----
    Boem et al. 2018, sec. V, Proposition 4.

    Examples
    --------
    >>> import numpy as np
    >>> from fusion_sfdia.detectors import FaultHypotheses, excludable_faults
    >>> from fusion_sfdia.plants import power_network
    >>> half, none = lambda x, u, e: 0.5 * e[..., None] * np.array([0.0, 0.1, 0.0, 0.0]), lambda x, u, e: 0.0 * x
    >>> areas = power_network(loads=()).structure.areas
    >>> isolation = FaultHypotheses(areas, "4", {"half of the load": half, "nothing": none}, alpha=3.0)
    >>> x, u, e = np.zeros((20, 4)), np.zeros(20), np.full(20, 0.1)
    >>> excludable_faults(isolation, half, x, u, e, np.full((20, 2, 4), 1e-3))[-1].round(2)
    array([0.  , 1.19])
    """
    phi = np.stack([true(x, u, e) - one(x, u, e) for one in isolation.faults.values()], axis=1)
    return np.asarray(margins(phi, deviation, isolation.lam, isolation.alpha, isolation.mode).max(axis=-1))


def exceeds_next(phi: Array, residual: Array, before: Array, after: Array, lam: float, alpha: float) -> Array:
    """(34), (35): whether a fault that adds phi to a residual lets it exceed its threshold in the next step.

    residual: the present one; before, after: s now and in the next step. Of the estimator of hypothesis l, (38), (39), before
    and after are its own, and phi is phi_p - phi_l at the true state, so that what is left is its noise chi_l. For own states:
    of a shared one residual and s of all who share it count, with their weights.
    """
    chi = after - lam * before
    upper, lower = alpha * before - residual, -alpha * before - residual
    return np.asarray((phi > lam * upper + 2 * alpha * chi) | (phi < lam * lower - 2 * alpha * chi))


def exclusion_error(residual: Array, deviation: Array, rule: str = "chebyshev", prior: Sequence[float] | None = None) -> Array:
    """(36): how likely it is at most to exclude a true hypothesis that has this residual.

    Parameters
    ----------
    residual : array (..., L, n)
        e_l of L hypotheses; of the n readings of a hypothesis the largest counts, with Bonferroni's factor n.
    deviation : array (..., L, n)
        s_l, in the same unit.
    rule : str, default "chebyshev"
        Of `threshold_rules`.
    prior : sequence of float (L,), optional
        How likely each hypothesis is; then the result is the probability that it is true and excluded, and their sum is that of
        any wrong exclusion.

    Returns
    -------
    array (..., L)
        Probabilities.

    Raises
    ------
    ValueError
        For a prior that is none, and for a rule that does not give a probability.

    Notes
    -----
    Boem et al. 2018, sec. V.

    Examples
    --------
    >>> import numpy as np
    >>> from fusion_sfdia.detectors import exclusion_error
    >>> exclusion_error(np.array([[0.5], [2.0]]), np.array([[0.1], [0.1]])).round(4)
    array([0.04  , 0.0025])
    """
    e, s = floats("residual", residual), floats("deviation", deviation)
    require_rule(rule)
    if rule not in RULES:
        raise ValueError(f"the rule {rule!r} does not give a probability of a residual; expected one of {', '.join(RULES)}")
    with np.errstate(invalid="ignore", divide="ignore"):
        own = np.nanmax(np.where(np.isfinite(e) & (s > 0), np.abs(e) / s, 0.0), axis=-1)
        least = RULES[rule].least
        found = np.where(own > least, e.shape[-1] * RULES[rule].false_alarm(np.maximum(own, least + 1e-12)), 1.0)
    found = np.minimum(found, 1.0)
    if prior is None:
        return found
    p = floats("prior", prior)
    if p.shape != found.shape[-1:] or np.any(p < 0) or np.sum(p) > 1 + 1e-12:
        raise ValueError(f"prior is {shown(prior)}; expected {found.shape[-1]} probabilities with a sum of at most 1")
    return found * p


def isolation_probability(prior: float, false_exclusion: float) -> float:
    """B18, sec. V-B: how likely it is at least that a hypothesis is true and is not excluded, (1 - 1 / alpha^2) prior."""
    return float(number("prior", prior) * (1 - number("false_exclusion", false_exclusion)))


def spectral_radius(areas: Areas, lam: float) -> float:
    """Proposition 2: the largest magnitude of an eigenvalue of lam W over all shared states, (21), and of the errors of unread
    states (unread_states).

    The rows of W have the sum 1, so that it is lam where all states are read: errors decay like lam^t, and bounded ones stay
    bounded, for any network and after any plugging, where lam < 1. ValueError as of `require_estimable`.
    """
    topology, noise = areas.network.topology, areas.noise
    largest = require_estimable(areas)
    for i in range(areas.size[0]):
        sides = [s for s in range(int(topology.start[i]), int(topology.start[i + 1])) if areas.network.closed[s]]
        v = np.array([noise[i, 0], *(areas.shared_noise[areas.opposite[s]] for s in sides)])
        v = v[np.isfinite(v)]  # of a state that nobody reads there is no residual
        if not v.size:
            continue
        weights = np.tile((1 / v) / np.sum(1 / v), (v.size, 1))  # (17): the same in all areas that share the state
        largest = max(largest, float(np.max(np.abs(np.linalg.eigvals(lam * weights)))))
    return largest


def _residuals(detector: Chebyshev, log: Log) -> tuple[Array, Array]:
    """Residuals and their s (K, N) of readings of which none is left out."""
    plain = replace(detector, accommodate=False)
    _, found = run(plain, plain.init((), float(log.t[0]) - plain.plant.dt), *log)
    return found.residual, found.threshold / detector.limits


def _false_alarm(detector: Chebyshev) -> float:
    """The probability that noise exceeds alpha s of a single residual."""
    if detector.rule == BOUND:
        return 0.0 if np.all(detector.limits >= 1) else np.nan
    if detector.rule == CONFORMAL:  # of a diagnoser, shared equally by its sensors
        rate = np.nan if detector.fitted_rate is None else detector.fitted_rate
        return float(rate / detector.diagnoser_count / np.min(detector.components))
    return float(np.max(RULES[detector.rule].false_alarm(np.maximum(detector.limits, RULES[detector.rule].least + 1e-12))))
