"""Directions of model mismatch that a healthy log shows, without a word of what causes them.

A disturbance B = (V, W) that lasts, x+ += V xi, y += W xi, changes the innovations by N B xi with

    N = H eps + [0 I],    eps <- F (I - K H) eps - F K [0 I] + [I 0],    eps = 0 before the log.

Of each window remain the score g = sum N' S^-1 d, of covariance I = sum N' S^-1 N where the model is right. In units in which
the mean of I is the unit matrix, the second moments of g over M windows are of noise, with eigenvalues up to
(1 + sqrt(p / M))^2 (Marchenko and Pastur 1967), and of disturbances, which stand out.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.commissioning.corrections import Offset, with_offset
from fusion_sfdia.commissioning.innovations import filtered, fixed, until
from fusion_sfdia.core.covariance import diagonal
from fusion_sfdia.core.log import Log
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.core.uncertainty import Disturbance

Array = NDArray[Any]

WINDOW = 15  # samples
UNSEEN = 1e-3  # of the largest information: directions below it are not searched
BEYOND = 3.0  # of the largest eigenvalue of noise, which spreads by (p M)^-1/3 about the edge (Johnstone 2001)
MOST = 6  # disturbances


class Windows(NamedTuple):
    """Scores g (runs, M, p) and information I (runs, M, p, p) of consecutive windows, in units of scale (p,) = (V, W)."""

    g: Array
    info: Array
    scale: Array


class Found(NamedTuple):
    """A disturbance: directions state (n,) and reading (N,), its size in each window (runs, M) and the variance of its error,
    its mean, sd about it and time constant (s), and how far its eigenvalue is above that of noise.
    """

    state: Array
    reading: Array
    size: Array
    error: Array
    mean: float
    sd: float
    time_constant: float
    excess: float


def windows(plant: Plant, log: Log, use: Array) -> Windows:
    """Scores of all directions in windows of consecutive samples use (K,)."""
    model, n, count = fixed(plant), len(plant.states), len(plant.sensors)
    runs, size = log.y.shape[1], model.x0.size
    process = np.sqrt(diagonal(plant.process_cov))
    scale = np.concatenate([np.where(process > 0, process, np.sqrt(diagonal(plant.initial_cov))), plant.sensor_sigma])
    p = n + count
    drive, read = np.zeros((size, p)), np.zeros((count, p))
    drive[:n, :n], read[:, n:] = np.diag(scale[:n]), np.diag(scale[n:])
    found_g, found_info = [], []
    eps = np.zeros((runs, size, p))
    g, info, filled = np.zeros((runs, p)), np.zeros((runs, p, p)), 0
    for k, now in enumerate(filtered(model, until(log, use))):
        eps = now.tangent @ eps + drive
        if use[k]:
            effect = now.readout @ eps + read
            g += (np.swapaxes(effect, -1, -2) @ now.whitened[..., None])[..., 0]
            info += np.swapaxes(effect, -1, -2) @ now.inverse @ effect
            filled += 1
        eps = now.closed @ eps - now.gain @ read
        if filled == WINDOW:
            found_g.append(g)
            found_info.append(info)
            g, info, filled = np.zeros((runs, p)), np.zeros((runs, p, p)), 0
    if len(found_g) < 2:
        raise ValueError(f"the log has {len(found_g)} windows of {WINDOW} samples after settling; give at least 2")
    return Windows(np.stack(found_g, axis=1), np.stack(found_info, axis=1), scale)


def directions(plant: Plant, seen: Windows) -> list[Found]:
    """The disturbances that stand out of noise, the largest first."""
    n = len(plant.states)
    mean = np.mean(seen.info, axis=(0, 1))
    values, vectors = np.linalg.eigh(mean)
    kept = values > UNSEEN * values[-1]
    root = vectors[:, kept] * np.sqrt(values[kept])
    unit = seen.g @ (vectors[:, kept] / np.sqrt(values[kept]))
    flat = unit.reshape(-1, unit.shape[-1])
    many, p = flat.shape
    powers, axes = np.linalg.eigh(flat.T @ flat / many)
    edge = (1 + np.sqrt(p / many)) ** 2
    edge *= 1 + BEYOND * (p * many) ** (-1 / 3)
    found = []
    for j in range(len(powers) - 1, -1, -1):
        if powers[j] <= edge or len(found) == MOST:
            break
        ridge = 1.0 / (many * powers[j])  # prior of a direction: as large as its signal
        b = np.linalg.solve(mean + ridge * np.eye(len(mean)), root @ axes[:, j])
        effect = seen.info @ b
        known = effect @ b
        size, error = (seen.g @ b) / known, 1.0 / known
        b = b * seen.scale
        found.append(_described(plant, b[:n], b[n:], size, error, float(powers[j] / edge)))
    return found


def _described(plant: Plant, state: Array, reading: Array, size: Array, error: Array, excess: float) -> Found:
    mean = float(np.average(size, weights=1 / error))
    about = size - mean
    variance = float(np.mean(about**2 - error))
    together = float(np.mean(about[:, 1:] * about[:, :-1]))
    uncertain = float(np.sum(1 / error)) ** -1  # variance of the mean
    noise = float(np.mean(error))
    if variance <= 2 * noise * np.sqrt(2 / size.size):  # no more than chance
        return Found(state, reading, size, error, mean, float(np.sqrt(uncertain + max(variance, 0.0))), np.inf, excess)
    rho = np.clip(together / variance, 0.05, 0.99)
    tau = -WINDOW * plant.dt / np.log(rho)
    return Found(state, reading, size, error, mean, float(np.sqrt(variance + uncertain)), float(tau), excess)


def with_disturbances(plant: Plant, found: list[Found]) -> Plant:
    """The plant with the means of disturbances as offsets, and with what remains of them as disturbances."""
    known = plant.uncertainty
    if not found:
        return plant
    state, reading = (sum(getattr(f, what) * f.mean for f in found) for what in ("state", "reading"))
    moved = with_offset(plant, Offset(np.zeros(len(plant.inputs)), np.asarray(state), np.asarray(reading), plant.dt))
    first = len(known.disturbances) + 1
    added = tuple(
        Disturbance(f"learnt disturbance {first + i}", f.state * f.sd, f.reading * f.sd, 1.0, f.time_constant)
        for i, f in enumerate(found)
    )
    return replace(moved, uncertainty=replace(moved.uncertainty, disturbances=(*known.disturbances, *added)))
