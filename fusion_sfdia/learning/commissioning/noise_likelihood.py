"""Process noise and sensor noise of greatest likelihood, and slow noise of sensors.

With the filter's F, H, K, S and innovations d, the adjoint of the predicted state runs backward,

    lam = H' S^-1 d + (I - K H)' mu,    mu = F' lam(next),    Lam = H' S^-1 H + (I - K H)' M (I - K H),    M = F' Lam(next) F
    e = S^-1 d - K' mu,    D = S^-1 + K' M K

and gives the derivatives d logL / d Q = (lam lam' - Lam) / 2, d logL / d R = (e e' - D) / 2 (Koopman and Shephard 1992, Exact
score for time series models in state space form). For a factor s on a part of Q or R the likelihood is stationary where
a = s sum lam' Q lam equals b = s sum tr(Lam Q); s <- s a / b leads there, and b counts the degrees of freedom that the log has
for s (MacKay 1992, Bayesian interpolation; with the square root of a / b each step climbs, Zhou, Hu, Zhou and Lange 2019).

Slow noise shows in the leave-one-out innovations. Of white noise with a slow part of the share s and the correlation q from
sample to sample the spectrum is

    f(w) = v ((1 - s) + s (1 - q^2) / (1 - 2 q cos w + q^2))

s and q are those of greatest likelihood of the periodogram I, -sum (ln f + I / f) (Whittle 1953), v its mean of I / f. Whatever
makes the innovations slow, the noise, the equations or a parameter that wanders, makes sums over them vary as much.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.learning.innovations import InnovationStep, filtered, until
from fusion_sfdia.plant.augment import fixed
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.regularity import resolution
from fusion_sfdia.plant.slow_noise import SlowNoise

Array = NDArray[Any]

ROUNDS = 8
CLOSE = 0.5  # standard errors: a change below this ends them
BLOCK = 100  # samples whose adjoint is kept at once
PRIOR = 10.0  # samples' worth of belief in the stated noise (inverse gamma distribution of a variance)
BRIEF = 15  # samples of a window about whose mean a sensor scatters
LOUD = 1.5  # of its stated variance: a sensor is no louder up to there
CHANCE = 4.0  # standard errors of that variance in addition
LEAST, MOST = 0.01, 100.0  # factors of a variance in all
SHARES = np.linspace(0.05, 0.95, 19)
SLOWEST = 8.0  # time constants in the log, at least, of what can be learnt
RATIO = 13.8  # of likelihoods, twice its logarithm: chance exceeds it in 1 of 1000 logs (chi-square, 2 degrees of freedom)
SHORTEST = 64  # samples


class Noise(NamedTuple):
    """Factors of the stated variances: of the process noise of each group of states, and of the noise of each sensor (N,).

    freedom: degrees of freedom that the log had for each; the relative standard error of a factor is sqrt(2 / freedom).
    """

    groups: dict[str, Array]
    process: Array
    process_freedom: Array
    sensors: Array
    sensors_freedom: Array


def state_groups(plant: Plant) -> dict[str, Array]:
    """Indices of states of one unit, which share a factor; all states where their noise is correlated."""
    if plant.process_cov.ndim == 2:
        return {"all": np.arange(len(plant.states))}
    units = [s.unit for s in plant.states]
    noisy = plant.process_cov > 0
    found = {unit: np.array([i for i, u in enumerate(units) if u == unit and noisy[i]]) for unit in dict.fromkeys(units)}
    return {unit: members for unit, members in found.items() if members.size}


def with_noise(plant: Plant, noise: Noise) -> Plant:
    """The plant with its variances times these factors; bounds of the noise grow with them, but do not shrink."""
    groups, process, _, sensors, _ = noise
    factor = np.ones(len(plant.states))
    for members, s in zip(groups.values(), process, strict=True):
        factor[members] = s
    cov = plant.process_cov * (factor if plant.process_cov.ndim == 1 else factor[0])
    meters = tuple(
        replace(
            s, sigma=s.own_sigma(s.noise_sigma * float(np.sqrt(f))), bound=s.bound and s.bound * max(float(np.sqrt(f)), 1.0)
        )
        for s, f in zip(plant.sensors, sensors, strict=True)
    )
    return replace(plant, process_cov=cov, sensors=meters)


def in_steps(plant: Plant, y: Array) -> Plant:
    """The plant with the resolution of sensors that state none and whose readings y (K, B, N) have steps above their noise."""
    steps = [s.resolution or resolution(y[..., i].T.ravel()) for i, s in enumerate(plant.sensors)]
    return replace(
        plant,
        sensors=tuple(replace(s, resolution=q) if q > s.noise_sigma else s for s, q in zip(plant.sensors, steps, strict=True)),
    )


def louder_sensors(plant: Plant, single: Array) -> Plant:
    """The plant with the noise of sensors that scatter clearly more than stated, from errors `single` (K, B, N).

    Their variance is taken about the mean of each window, and its median over the windows: a bias, a drift or a fault in a
    part of the log does not count as noise.
    """
    whole = len(single) // BRIEF
    parts = single[: whole * BRIEF].reshape(whole, BRIEF, -1, single.shape[-1])
    known = np.sum(np.isfinite(parts), axis=1)
    mean = np.nansum(parts, axis=1) / np.maximum(known, 1)
    power = np.nansum((parts - mean[:, None]) ** 2, axis=1) / np.maximum(known - 1, 1)
    sensors = np.ones(len(plant.sensors))
    for i in range(sensors.size):
        enough = known[..., i] > BRIEF // 2
        if (windows := int(np.sum(enough))) > 0:
            chance = CHANCE * 1.25 * np.sqrt(2 / (BRIEF - 1) / windows)  # 1.25: of a median over that of a mean
            factor = float(np.median(power[..., i][enough]))
            sensors[i] = min(factor, MOST) if factor > LOUD + chance else 1.0
    groups = state_groups(plant)
    return with_noise(plant, _noise(groups, factors := np.concatenate([np.ones(len(groups)), sensors]), factors))


def joined(first: Noise, second: Noise) -> Noise:
    """The factors of two parts of a log together: the mean of their logarithms, weighted by what each part says."""
    found: dict[str, Any] = {"groups": first.groups}
    for what in ("process", "sensors"):
        a, b = (getattr(n, f"{what}_freedom") + PRIOR for n in (first, second))
        logs = [np.log(getattr(n, what)) for n in (first, second)]
        found |= {what: np.exp((a * logs[0] + b * logs[1]) / (a + b)), f"{what}_freedom": a + b - 2 * PRIOR}
    return Noise(**found)


def likeliest_noise(plant: Plant, log: Log, use: Array) -> Noise:
    """Return the factors of greatest likelihood on the samples use (K,) of a log of runs, near 1 where the log says little."""
    groups = state_groups(plant)
    factors = np.ones(len(groups) + len(plant.sensors))
    for _ in range(ROUNDS):
        a, b = _moments(with_noise(plant, _noise(groups, factors, factors)), log, use, groups)
        before, factors = factors, np.clip(factors * (a + PRIOR / factors) / (b + PRIOR), LEAST, MOST)
        if np.all(np.abs(np.log(factors / before)) < CLOSE * np.sqrt(2 / (b + PRIOR))):
            break
    return _noise(groups, factors, b)


def _noise(groups: dict[str, Array], factors: Array, freedom: Array) -> Noise:
    (process, sensors), (of_process, of_sensors) = (np.split(a, [len(groups)]) for a in (factors, freedom))
    return Noise(groups, process, of_process, sensors, of_sensors)


def _moments(plant: Plant, log: Log, use: Array, groups: dict[str, Array]) -> tuple[Array, Array]:
    """Return a and b (groups + N,) of the groups of states, then of the sensors."""
    model = fixed(plant)
    cov = plant.process_cov
    process, sensors = np.zeros((2, len(groups))), np.zeros((2, len(plant.sensors)))
    block: list[InnovationStep] = []

    def closed(until: int) -> None:
        size = model.x0.size
        mu, big = np.zeros((log.y.shape[1], size)), np.zeros((log.y.shape[1], size, size))
        for k in range(until, until - len(block), -1):
            now = block[k - until - 1]
            back, transposed = np.swapaxes(now.closed, -1, -2), np.swapaxes(now.gain, -1, -2)
            e = now.whitened - (transposed @ mu[..., None])[..., 0]
            spread = np.diagonal(now.inverse, axis1=-2, axis2=-1) + np.sum(transposed @ big * transposed, axis=-1)
            seen = np.swapaxes(now.readout, -1, -2)
            lam = (seen @ now.whitened[..., None])[..., 0] + (back @ mu[..., None])[..., 0]
            large = seen @ now.inverse @ now.readout + back @ big @ now.closed
            if use[k]:
                sensors[0] += np.sum(e**2 * now.used, axis=0) * plant.sensor_cov
                sensors[1] += np.sum(spread * now.used, axis=0) * plant.sensor_cov
                for i, members in enumerate(groups.values()):
                    q = np.diag(cov[members]) if cov.ndim == 1 else cov
                    part = lam[:, members]
                    process[0, i] += np.sum(part @ q * part)
                    process[1, i] += np.sum(large[:, members[:, None], members] * q)
            forward = np.swapaxes(now.tangent, -1, -2)
            mu, big = (forward @ lam[..., None])[..., 0], forward @ large @ now.tangent
        block.clear()

    log = until(log, use)
    for k, sample in enumerate(filtered(model, log)):
        block.append(sample)
        if len(block) == BLOCK or k == len(log.t) - 1:
            closed(k)
    a, b = np.concatenate([process, sensors], axis=1)
    return a, b


def slow_noise(single: Array, dt: float) -> SlowNoise | None:
    """The slow part of a sensor's noise, from innovations (K, B) of runs, NaN where missing; None where it shows none."""
    length = single.shape[0]
    runs = int(np.sum(np.isfinite(single).any(axis=0)))
    if length < SHORTEST or not runs:
        return None
    e = np.nan_to_num(single - np.nanmean(single))
    periodogram = np.mean(np.abs(np.fft.rfft(e, axis=0)[1:]) ** 2, axis=-1) / length
    angle = 2 * np.pi * np.arange(1, periodogram.size + 1) / length
    times = np.geomspace(0.5, length / SLOWEST, 40)  # time constants, in samples
    q, s = np.exp(-1 / times)[:, None, None], SHARES[:, None]
    f = (1 - s) + s * (1 - q**2) / (1 - 2 * q * np.cos(angle) + q**2)
    deviance = np.sum(np.log(f), axis=-1) + angle.size * np.log(np.mean(periodogram / f, axis=-1))
    white = angle.size * float(np.log(np.mean(periodogram)))
    if not 2 * runs * (white - np.min(deviance)) > RATIO:
        return None
    j, i = np.unravel_index(np.argmin(deviance), deviance.shape)
    return SlowNoise(float(SHARES[i]), float(times[j] * dt))


def with_slow_noise(plant: Plant, single: Array) -> Plant:
    """The plant with the slow noise that innovations (K, B, N) of its sensors show; of one that shows none as it is stated."""
    with np.errstate(invalid="ignore"):
        found = [slow_noise(single[..., i], plant.dt) for i in range(single.shape[-1])]
    return replace(plant, sensors=tuple(replace(s, noise=n or s.noise) for s, n in zip(plant.sensors, found, strict=True)))
