"""Commissioning: a plant adapted to a healthy log of the real one, so that any detector on it knows what the log shows.

A sensor that reads in steps gets that resolution, and one that scatters clearly more than stated the noise that it has. Then
three stages, each on the result of the one before: declared parameters and errors of inputs (`parameters`), directions of
mismatch of which nothing is declared (`disturbances`), process and sensor noise (`noise_likelihood`). Each is learnt from one
half of the log and judged by the likelihood of the other half, and the reverse; what is kept is then learnt from the whole
log. Where the innovations of a sensor are still slow, that is the slow part of its noise (`with_slow_noise`).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import probability
from fusion_sfdia.learning.commissioning.disturbances import WINDOW, FoundDisturbance, learnt, windows
from fusion_sfdia.learning.commissioning.noise_likelihood import (
    Noise,
    in_steps,
    joined,
    likeliest_noise,
    louder_sensors,
    with_noise,
    with_slow_noise,
)
from fusion_sfdia.learning.commissioning.parameters import ParameterEstimate, estimated, moved
from fusion_sfdia.learning.commissioning.refusals import (
    At,
    require_length,
    require_moving,
    require_no_fault,
    require_no_sensor,
    require_readings,
)
from fusion_sfdia.learning.commissioning.start import Start, first_error, first_state, seen_to_fit, with_start
from fusion_sfdia.learning.innovations import FilterScore, coloured, fitted, settling
from fusion_sfdia.logs.log_forms import as_log
from fusion_sfdia.plant.augment import fixed
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

STRETCHES = 4  # of each run, between which parameters are compared
SURE = 2.0  # standard errors


class HeldOut(NamedTuple):
    """How a plant predicts the half of the log that it was not learnt from.

    log_likelihood: per sample. nis: normalised innovation squared per reading, 1 where consistent. coloured: share of
    autocorrelations of the innovations at lags 1 to 20 outside their 95 % bands, .05 where white.
    """

    log_likelihood: float
    nis: float
    coloured: float


class Commissioning(NamedTuple):
    """What a healthy log has shown.

    Attributes
    ----------
    plant : Plant
        The commissioned one.
    settle : int
        Samples that were left out at the beginning of each run.
    before : HeldOut
        The plant on the halves that it was not learnt from, without what was learnt.
    after : HeldOut
        The same, with what was learnt.
    kept : tuple of str
        The stages that were kept.
    parameters : ParameterEstimate or None
        What its stage found in the whole log; None where not kept.
    disturbances : tuple of FoundDisturbance
        The same; empty where not kept.
    noise : Noise or None
        The same; None where not kept.
    start : Start or None
        Where runs begin, None where as the plant states.
    first_error : float
        NIS per reading of the first samples of the runs with that start.
    middle : int
        The sample at which the second half begins.
    halves : tuple of (Plant, Plant)
        The plants that were learnt from the samples from settle to middle, and from middle on.
    fits : tuple of (FilterScore, FilterScore)
        What these predict.

    Examples
    --------
    See `Commissioning.of`.
    """

    plant: Plant
    settle: int
    before: HeldOut
    after: HeldOut
    kept: tuple[str, ...]
    parameters: ParameterEstimate | None
    disturbances: tuple[FoundDisturbance, ...]
    noise: Noise | None
    start: Start | None
    first_error: float
    middle: int
    halves: tuple[Plant, Plant]
    fits: tuple[FilterScore, FilterScore]

    @classmethod
    def of(cls, plant: Plant, *healthy: Any, false_alarm: float | None = 1e-3, at: At | None = None) -> Commissioning:
        """Adapt a plant to healthy readings of the real one, and report what was found.

        Parameters
        ----------
        plant : Plant
            The model.
        *healthy : arrays, Log, Recording or frame
            t (K,), y (K, N) or (K, B, N) of several runs, u, or a Log, a Recording or a frame, see `as_log`.
        false_alarm : float or None, default 1e-3
            The rate, per step over all sensors, for which thresholds are to be fitted later: `fit` of a detector needs at least
            1 / false_alarm samples, best of other readings than these; None where a log of any length will do.
        at : callable, optional
            The time of a sample of a run in words, for errors; by default as in t.

        Returns
        -------
        Commissioning
            The plant and what was found.

        Raises
        ------
        ValueError
            For a log that is too short for the plant or the rate, that has a frozen sensor, or in which a bias of one sensor
            explains what the plant does not.

        Examples
        --------
        >>> from fusion_sfdia import simulate
        >>> from fusion_sfdia.learning import Commissioning
        >>> from fusion_sfdia.plants import two_tanks
        >>> healthy = simulate(two_tanks(), 300, seeds=[3], truth=two_tanks(outlet=0.9))
        >>> found: Commissioning = Commissioning.of(two_tanks(), healthy, false_alarm=None)
        >>> "parameters" in found.kept, found.after.log_likelihood > found.before.log_likelihood
        (True, True)
        """
        if false_alarm is not None:
            probability("false_alarm", false_alarm)
        log = as_runs(plant, healthy)
        at = at or partial(_at, log)
        require_readings(plant, log)
        require_moving(plant, log, at)
        settle = settling(fixed(plant), log)
        require_length(plant, log, settle, false_alarm)
        steps = len(log.t)
        settled = np.arange(steps) >= settle
        middle = settle + (steps - settle) // 2
        halves = [settled & (np.arange(steps) < middle), settled & (np.arange(steps) >= middle)]
        now = [fitted(plant, log)] * 2
        before = _held_out(now, halves)
        plant, now = _with_sensors(plant, in_steps(plant, log.y), now, log)
        plant, now = _with_sensors(plant, louder_sensors(plant, now[0].single[settled]), now, log)
        halfway, parts = [plant, plant], {}
        for name, stage in STAGES.items():
            found = [stage(p, log, half) for p, half in zip(halfway, halves, strict=True)]
            tried = [p for p, _ in found]
            then = [old if p is q else fitted(q, log) for p, q, old in zip(halfway, tried, now, strict=True)]
            gain = [(a.log_likelihood - b.log_likelihood)[half] for a, b, half in zip(then, now, halves[::-1], strict=True)]
            if _worth(np.concatenate(gain), doubt=name == "parameters"):
                halfway, now, parts[name] = tried, then, [what for _, what in found]
        kept = tuple(parts)
        result, parameters, noise = plant, None, None
        disturbances: tuple[FoundDisturbance, ...] = ()
        if "parameters" in kept:
            result, parameters = _parameters(result, log, settled)
        seen = windows(result, log, settled)
        require_no_fault(result, seen, np.flatnonzero(settled)[WINDOW - 1 :: WINDOW], at)
        if "disturbances" in kept:
            result, disturbances = learnt(result, log, settled, seen)
            for disturbance in disturbances:
                require_no_sensor(plant, disturbance)
        if "noise" in kept:
            noise = joined(*parts["noise"])
            result = with_noise(result, noise)
        if (start := first_state(result, log)) is not None:
            result = with_start(result, start)
        result = with_slow_noise(result, fitted(result, log).single[settled])
        halfway = [with_slow_noise(p, f.single[half]) for p, f, half in zip(halfway, now, halves, strict=True)]
        return cls(
            seen_to_fit(result), settle, before, _held_out(now, halves), kept, parameters, disturbances, noise, start,
            first_error(result, log), middle, (halfway[0], halfway[1]), (now[0], now[1]),
        )  # fmt: skip


def _with_sensors(plant: Plant, changed: Plant, now: list[FilterScore], log: Log) -> tuple[Plant, list[FilterScore]]:
    """The plant with changed sensors, and its fits in place of those before, where the noise is another."""
    same = np.array_equal(plant.sensor_sigma, changed.sensor_sigma)
    return changed, now if same else [fitted(changed, log)] * 2


def as_runs(plant: Plant, healthy: Any) -> Log:
    """The log with one axis of runs: y (K, B, N), u (K, B, m)."""
    t, y, u = as_log(plant, *healthy)
    y = y.reshape(len(t), -1, y.shape[-1])
    if u.ndim > 2:
        u = u.reshape(len(t), int(np.prod(u.shape[1:-1])), u.shape[-1])
    else:
        u = u[:, None]
    return Log(t, y, np.broadcast_to(u, (*y.shape[:2], u.shape[-1])))


def _at(log: Log, k: int, b: int) -> str:
    return f"{log.t[k]:g} s" + (f" of run {b}" if log.y.shape[1] > 1 else "")


def _parameters(plant: Plant, log: Log, use: Array) -> tuple[Plant, ParameterEstimate | None]:
    known = plant.uncertainty
    if not (known.parameters or known.inputs):
        return plant, None
    used = np.cumsum(use) - 1
    stretch = np.clip(used * STRETCHES // np.sum(use), 0, STRETCHES - 1)
    found = estimated(plant, log, use, stretch)
    return moved(plant, found), found


def _noise(plant: Plant, log: Log, use: Array) -> tuple[Plant, Noise]:
    found = likeliest_noise(plant, log, use)
    return with_noise(plant, found), found


STAGES: dict[str, Callable[[Plant, Log, Array], tuple[Plant, Any]]] = {
    "parameters": _parameters,
    "disturbances": learnt,
    "noise": _noise,
}


def _worth(gain: Array, doubt: bool) -> bool:
    """Whether gains of log-likelihood per sample are more than chance; with doubt: whether they are no loss beyond chance."""
    if not np.any(gain):
        return False
    error = float(np.std(gain) * np.sqrt(gain.size))
    return bool(np.sum(gain) > (-SURE if doubt else SURE) * error)


def _held_out(now: list[Any], halves: list[Array]) -> HeldOut:
    """Each plant on the other half."""
    pairs = list(zip(now, halves[::-1], strict=True))
    return HeldOut(
        float(np.mean([np.mean(f.log_likelihood[half]) for f, half in pairs])),
        float(np.mean([np.mean(f.nis[half]) for f, half in pairs])),
        float(np.mean([coloured(f.normal[half]) for f, half in pairs])),
    )
