"""Directions of model mismatch that a healthy log shows, without a word of what causes them.

A disturbance B = (V, W) of course xi, x+ += V xi, y += W xi, changes the innovations by N B with

    N = H eps + [0 I] xi,    eps <- F (I - K H) eps - F K [0 I] xi + [I 0] xi.

1. Windows: with xi = 1 within a window, eps = 0 before it, each leaves the score g = sum N' S^-1 d, of covariance
   I = sum N' S^-1 N where the model is right. In units in which the mean of I is the unit matrix, the second moments of g over
   M windows are of noise, with eigenvalues up to (1 + sqrt(p / M))^2 (Marchenko and Pastur 1967), and of disturbances, which
   stand out. The largest gives a first B and with it the size xi of each window.
2. What the filter had absorbed before a window is missing in 1. So B is fitted anew, to the whole log with that course xi.
3. The mean of xi becomes an offset of the plant, what remains a disturbance. From the innovations of that plant the next
   direction is learnt, until none stands out.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.covariance import diagonal
from fusion_sfdia.learning.commissioning.corrections import ConstantCorrection, with_offset
from fusion_sfdia.learning.innovations import InnovationStep, filtered, until
from fusion_sfdia.plant.augment import fixed
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.uncertainty import Disturbance

Array = NDArray[Any]

WINDOW = 15  # samples
UNSEEN = 1e-3  # of the largest information: directions below it are not searched
BEYOND = 3.0  # of the largest eigenvalue of noise, which spreads by (p M)^-1/3 about the edge (Johnstone 2001)
SURE = 2.0  # standard errors
LIKELY = 0.05, 0.99  # correlation of a disturbance between windows
ELSEWHERE = 0.1  # of its mean: standard deviation of a disturbance in an operation that is not in the log, our choice
LASTING = 100  # samples: operation changes no more slowly, our choice
MOST = 4  # disturbances
LEARNT = "learnt disturbance"
ALONG = 0.3  # of what a sensor is moved most: what is moved less is not named


class Windows(NamedTuple):
    """Scores g (runs, M, p) and information I (runs, M, p, p) of consecutive windows, in units of scale (p,) = (V, W)."""

    g: Array
    info: Array
    scale: Array


class FoundDisturbance(NamedTuple):
    """A disturbance: directions state (n,) and reading (N,), its size in each window (runs, M) and the variance of its error,
    its mean, sd about it and time constant (s), and how far its eigenvalue is above that of noise. score (p,) and information
    (p, p): of the whole log for any directions with that course, in the units of `Windows`; None before step 2.
    """

    state: Array
    reading: Array
    size: Array
    error: Array
    mean: float
    sd: float
    time_constant: float
    excess: float
    score: Array | None = None
    information: Array | None = None


def learnt(plant: Plant, log: Log, use: Array, seen: Windows | None = None) -> tuple[Plant, tuple[FoundDisturbance, ...]]:
    """The plant with the disturbances that the samples use (K,) of a log of runs show, and these disturbances.

    seen: the windows of the plant, None where they are not known yet.
    """
    found: tuple[FoundDisturbance, ...] = ()
    while len(found) < MOST and (first := leading(plant, seen or windows(plant, log, use))) is not None:
        refined, seen = fitted_anew(plant, log, use, first), None
        plant, found = with_disturbance(plant, refined), (*found, refined)
    return plant, found


def windows(plant: Plant, log: Log, use: Array) -> Windows:
    """Scores of all directions in windows of consecutive samples use (K,); ValueError for less than two windows."""
    g: list[Array] = []
    info: list[Array] = []
    for j, (now, effect) in enumerate(_effects(plant, log, use, None)):
        score, known = _of_sample(now, effect)
        if j % WINDOW:
            g[-1] += score
            info[-1] += known
        else:
            g.append(score)
            info.append(known)
    whole = int(np.sum(use)) // WINDOW
    if whole < 2:
        raise ValueError(f"the log has {whole} windows of {WINDOW} samples after settling; give at least 2")
    return Windows(np.stack(g[:whole], axis=1), np.stack(info[:whole], axis=1), _scale(plant))


def leading(plant: Plant, seen: Windows) -> FoundDisturbance | None:
    """The disturbance that stands out most, None where nothing is above noise."""
    mean = np.mean(seen.info, axis=(0, 1))
    values, vectors = np.linalg.eigh(mean)
    kept = values > UNSEEN * values[-1]
    unit = (seen.g @ (vectors[:, kept] / np.sqrt(values[kept]))).reshape(-1, int(np.sum(kept)))
    many, p = unit.shape
    powers, axes = np.linalg.eigh(unit.T @ unit / many)
    edge = (1 + np.sqrt(p / many)) ** 2 * (1 + BEYOND * (p * many) ** (-1 / 3))
    if powers[-1] <= edge:
        return None
    ridge = 1.0 / (many * powers[-1])  # prior of a direction: as large as its signal
    b = np.linalg.solve(mean + ridge * np.eye(len(mean)), vectors[:, kept] * np.sqrt(values[kept]) @ axes[:, -1])
    known = seen.info @ b @ b
    size, error = (seen.g @ b) / known, 1.0 / known
    state, reading = np.split(b * seen.scale, [len(plant.states)])
    return FoundDisturbance(state, reading, size, error, *_course(size, error, plant.dt), float(powers[-1] / edge))


def fitted_anew(plant: Plant, log: Log, use: Array, found: FoundDisturbance) -> FoundDisturbance:
    """The disturbance with the direction that fits the log best, of the same course; as large as `found` where unseen."""
    noise = float(np.mean(found.error))
    trusted = 0.0 if np.isinf(found.time_constant) else found.sd**2 / (found.sd**2 + noise)
    course, scale = found.mean + (found.size - found.mean) * trusted, _scale(plant)
    first = np.concatenate([found.state, found.reading]) / scale
    g, info = np.zeros(first.size), np.zeros((first.size, first.size))
    for now, effect in _effects(plant, log, use, course):
        score, known = _of_sample(now, effect)
        g += np.sum(score, axis=0)
        info += np.sum(known, axis=0)
    prior = first.size / np.sum(first**2) * np.eye(first.size)
    state, reading = np.split(np.linalg.solve(info + prior, g) * scale, [len(plant.states)])
    return found._replace(state=state, reading=reading, score=g, information=info)


def _scale(plant: Plant) -> Array:
    """Units of a direction (n + N,): sigma of the process noise, of the first state where there is none, and of readings."""
    process = np.sqrt(diagonal(plant.process_cov))
    return np.concatenate([np.where(process > 0, process, np.sqrt(diagonal(plant.initial_cov))), plant.sensor_sigma])


def _effects(plant: Plant, log: Log, use: Array, course: Array | None) -> Iterator[tuple[InnovationStep, Array]]:
    """Each sample that is used, with the effect N (B, N, p) of every direction on it.

    course (B, M): xi of each window, before the first one as in it; None for xi = 1 since the window began.
    """
    model, n, count = fixed(plant), len(plant.states), len(plant.sensors)
    size, scale = model.x0.size, _scale(plant)
    drive, read = np.zeros((size, n + count)), np.zeros((count, n + count))
    drive[:n, :n], read[:, n:] = np.diag(scale[:n]), np.diag(scale[n:])
    eps = zero = np.zeros((log.y.shape[1], size, n + count))
    j, xi = 0, np.ones((1, 1, 1))
    for k, now in enumerate(filtered(model, until(log, use))):
        if course is not None:
            xi = course[:, min(j // WINDOW, course.shape[1] - 1), None, None]
        elif not use[k]:
            continue
        elif j % WINDOW == 0:
            eps = zero
        eps = now.tangent @ eps + drive * xi
        if use[k]:
            yield now, now.readout @ eps + read * xi
            j += 1
        eps = now.closed @ eps - now.gain @ (read * xi)


def _of_sample(now: InnovationStep, effect: Array) -> tuple[Array, Array]:
    """N' S^-1 d (B, p) and N' S^-1 N (B, p, p)."""
    turned = np.swapaxes(effect, -1, -2)
    return (turned @ now.whitened[..., None])[..., 0], turned @ (now.inverse @ effect)


def _course(size: Array, error: Array, dt: float) -> tuple[float, float, float]:
    """Mean, standard deviation about it and time constant (s) of sizes (B, M) with errors of these variances.

    Where they change by no more than chance, the time constant is infinite, and sd that of the mean.
    """
    mean = float(np.average(size, weights=1 / error))
    of_mean, about = 1.0 / float(np.sum(1 / error)), size - mean
    variance = float(np.mean(about**2 - error))
    if variance <= SURE * float(np.mean(error)) * np.sqrt(2 / size.size):
        return mean, float(np.sqrt(of_mean)), np.inf
    together = np.clip(float(np.mean(about[:, 1:] * about[:, :-1])) / variance, *LIKELY)
    return mean, float(np.sqrt(variance + of_mean)), float(-WINDOW * dt / np.log(together))


def with_disturbance(plant: Plant, found: FoundDisturbance) -> Plant:
    """The plant with the mean of a disturbance as an offset, and with what remains of it as a disturbance.

    A mismatch changes with the operating point: its size is taken as known to a tenth only, and as changing within 100 samples.
    Its name states which sensors it moves most.
    """
    known = plant.uncertainty
    offset = ConstantCorrection(np.zeros(len(plant.inputs)), found.state * found.mean, found.reading * found.mean, plant.dt)
    moved = with_offset(plant, offset)
    number = 1 + sum(d.name.startswith(LEARNT) for d in known.disturbances)
    name = f"{LEARNT} {number} ({', '.join(moved_most(plant, found.state, found.reading))})"
    sd = float(np.hypot(found.sd, ELSEWHERE * found.mean))
    lasting = min(found.time_constant, LASTING * plant.dt)
    added = Disturbance(name, found.state * sd, found.reading * sd, 1.0, lasting)
    return replace(moved, uncertainty=replace(moved.uncertainty, disturbances=(*known.disturbances, added)))


def moved_most(plant: Plant, state: Array, reading: Array) -> list[str]:
    """Names of the sensors whose readings a disturbance moves most over their noise, within a window: at most two of them.

    From the initial state under the usual inputs; where the model does not hold there, what it adds to the readings at once.
    """
    x, pushed = plant.x0, plant.x0
    change = np.abs(reading)
    for k in range(WINDOW):
        t = k * plant.dt
        u, after = plant.input_at(t), t + plant.dt
        with np.errstate(all="ignore"):  # beyond the limits of the model
            x, pushed = plant.step(t, x, u, plant.dt), plant.step(t, pushed, u, plant.dt) + state
            moved = plant.output(after, pushed, u) + reading - plant.output(after, x, u)
        change = np.fmax(change, np.abs(moved))
    change = change / plant.sensor_sigma
    order = [i for i in np.argsort(-change)[:2] if change[i] >= ALONG * np.max(change)]
    return [plant.sensor_names[i] for i in order]


def moves(plant: Plant, found: FoundDisturbance) -> str:
    """What a disturbance moves most over its noise, up to three signals, each by its mean and the deviation about it."""
    process = np.sqrt(diagonal(plant.process_cov))
    noise = np.concatenate([np.where(process > 0, process, plant.state_scale), plant.sensor_sigma])
    by = np.concatenate([found.state, found.reading])
    named = [(s, " a step") for s in plant.states] + [(s, "") for s in plant.sensors]
    return ", ".join(
        f"{s.name} by {found.mean * by[i]:.3g} +- {found.sd * abs(by[i]):.2g}{'' if s.unit == '1' else f' {s.unit}'}{each}"
        for i in np.argsort(-np.abs(by) / noise, kind="stable")[:3]
        for s, each in [named[i]]
        if by[i] != 0
    )
