"""Plants that no setting was chosen on: drawn at random, stable, observable, with one uncertain parameter.

    x+ = x* + F (x - x*) + theta G (u - u*) - c (x - x*)^3,    y = H x

F has eigenvalues from 0.5 to 0.97 in magnitude; the cubic term, small within a few standard deviations, keeps the plant from
being linear. All numbers are drawn, none is chosen.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from fusion_sfdia.common.random_streams import stream
from fusion_sfdia.plant.plant import Plant, Truth
from fusion_sfdia.plant.signals import Sensor, Signal
from fusion_sfdia.plant.uncertainty import Parameter, Uncertainty

Array = NDArray[Any]

MOVES, LONGEST_PERIOD = 20.0, 150.0  # standard deviations of the readings by which inputs move them; s
MOST_CUBIC = 0.02  # of the change of a state that is 5 standard deviations off


@dataclass(frozen=True, eq=False)
class _Equations:
    """The matrices of a plant, and its functions."""

    f: Array
    g: Array
    h: Array
    cubic: Array
    x_usual: Array
    u_usual: Array

    def step(self, t_start: float, x: Array, u: Array, dt: float, theta: Array = np.ones(1)) -> Array:  # noqa: B008
        off = x - self.x_usual
        return np.asarray(self.x_usual + off @ self.f.T + theta * ((u - self.u_usual) @ self.g.T) - self.cubic * off**3)

    def output(self, t: float, x: Array, u: Array) -> Array:
        return np.asarray(x @ self.h.T)


@dataclass(frozen=True, eq=False)
class _Operation:
    """Inputs that go up and down, each with a period of its own, so that the readings move and the parameter shows."""

    usual: Array
    period: Array

    def __call__(self, t: float) -> Array:
        return np.asarray(self.usual + np.sign(np.sin(2 * np.pi * t / self.period)))


def random_plant(seed: int) -> Plant:
    """A plant of 3 to 12 states, one or two inputs, and from as many sensors as states to twice as many; dt is 1 s.

    Its parameter `gain` multiplies what the inputs do: nominal 1, standard deviation 0.05 to 0.15.

    Parameters
    ----------
    seed : int
        Of the plant.

    Returns
    -------
    Plant
        The same for the same seed.

    Examples
    --------
    >>> from fusion_sfdia.plants import random_plant
    >>> plant = random_plant(1)
    >>> 3 <= len(plant.states) <= len(plant.sensors), plant.dt
    (True, 1.0)
    """
    rng = stream(seed, "random plant")
    n, m = int(rng.integers(3, 13)), int(rng.integers(1, 3))
    blocks: list[Array] = []
    while (left := n - sum(len(b) for b in blocks)) > 0:
        size = rng.uniform(0.5, 0.97)
        if left > 1 and rng.random() < 0.4:
            angle = rng.uniform(0.05, 0.8)
            blocks.append(size * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]))
        else:
            blocks.append(np.array([[size]]))
    mixing = np.linalg.qr(rng.standard_normal((n, n)))[0]
    f = mixing @ block_diag(*blocks) @ mixing.T
    count = int(rng.integers(n, 2 * n + 1))
    h = rng.standard_normal((count, n)) * (rng.random((count, n)) < 0.6) + np.eye(n)[np.arange(count) % n]
    process_sigma = rng.uniform(0.02, 0.2, n)
    sigma = rng.uniform(0.05, 0.5, count)
    x_usual = rng.uniform(5.0, 50.0, n)
    cubic = MOST_CUBIC / np.maximum((5 * process_sigma) ** 2, 1.0) * rng.random(n)
    g = rng.standard_normal((n, m))
    gain = h @ np.linalg.solve(np.eye(n) - f, g)  # of constant inputs
    g *= MOVES * sigma.mean() / np.abs(gain).max(axis=0)
    equations = _Equations(f, g, h, cubic, x_usual, np.ones(m))
    return Plant(
        f"random plant {seed}",
        tuple(
            Signal(f"x{i + 1}", "1", nominal=float(x), initial_sigma=float(5 * s), process_sigma=float(s))
            for i, (x, s) in enumerate(zip(x_usual, process_sigma, strict=True))
        ),
        tuple(Sensor(f"y{i + 1}", f"reading {i + 1}", "1", sigma=float(s)) for i, s in enumerate(sigma)),
        equations.step,
        equations.output,
        dt=1.0,
        inputs=tuple(Signal(f"u{j + 1}", "1", nominal=1.0) for j in range(m)),
        truth=Truth(operation=_Operation(np.ones(m), rng.uniform(30.0, LONGEST_PERIOD, m)), disturbed=True),
        uncertainty=Uncertainty((Parameter("gain", "1", 1.0, float(rng.uniform(0.05, 0.15)), low=0.1),), step=equations.step),
    )
