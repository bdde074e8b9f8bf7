"""Simulated recordings: a truth model, its noise, and the readings that a detector receives.

On one machine the recording of a seed is the same bits whatever other seeds are simulated with it: each seed has its own
streams, and the plant steps a batch of shape (seeds, 1), so that a matrix product, too, is that of one seed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy  # whose signal is imported at its first use
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from fusion_sfdia.common.arguments import floats
from fusion_sfdia.common.covariance import diagonal
from fusion_sfdia.common.html import as_html
from fusion_sfdia.common.random_streams import require_seeds, stream
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Sensor

Array = NDArray[Any]

MOST_STEPS = 10**9  # more is taken for a mistake: a step takes at least a microsecond


@dataclass(frozen=True)
class Recording:
    """Healthy readings and the truth behind them, time first, one run a seed.

    Attributes
    ----------
    t : array (K,)
        Times of the readings in s.
    u : array (K, m) or (K, B, m)
        The input that acted until t; the latter in closed loop.
    y : array (K, B, N)
        Readings.
    signal : array (K, B, N)
        The same without noise.
    x : array (K, B, n) or None
        True states; None where they are not those of the detector's plant.
    seeds : tuple of int (B,)
        One of each run.
    states, inputs, sensors : tuple of str
        Names of the columns of x, u and y.

    Examples
    --------
    >>> from fusion_sfdia import simulate
    >>> from fusion_sfdia.logs import Recording
    >>> from fusion_sfdia.plants import two_tanks
    >>> recording: Recording = simulate(two_tanks(), 20, seeds=[0, 1, 2])
    >>> recording.y.shape, recording.u_of_runs.shape, recording.sensors
    ((20, 3, 4), (20, 3, 1), ('l1', 'l2', 'q12', 'q2'))
    """

    t: Array
    u: Array
    y: Array
    signal: Array
    x: Array | None
    seeds: tuple[int, ...]
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    sensors: tuple[str, ...]

    def _repr_html_(self) -> str:
        (rows, runs), sensors = self.y.shape[:2], range(len(self.sensors))
        span = f"{rows} readings from {self.t[0]:g} s to {self.t[-1]:g} s" if rows else "no readings"
        known = [y[np.isfinite(y)] for y in (self.y[..., i] for i in sensors)]
        of = [(n, *((v.min(), v.max()) if v.size else ("", ""))) for n, v in zip(self.sensors, known, strict=True)]
        return as_html(f"Recording of {runs} run{'s' * (runs != 1)}", span, ("sensor", "lowest", "highest"), of)

    @property
    def u_of_runs(self) -> Array:
        """The input of each run (K, B, m)."""
        if self.u.ndim == 3:
            return self.u
        return np.broadcast_to(self.u[:, None], (*self.y.shape[:2], self.u.shape[-1]))


def simulate(
    plant: Plant,
    times: int | Array,
    seeds: Sequence[int],
    *,
    truth: Plant | str = "finer",
    to_states: Callable[[Array], Array] | None = None,
    process_noise: bool = False,
    start: str | Array = "nominal",
    inputs: Callable[[float], Array] | Array | None = None,
    t0: float = 0.0,
) -> Recording:
    """Simulate readings for a detector on `plant`.

    Parameters
    ----------
    plant : Plant
        The model of the detector.
    times : int or array (K,)
        Number of steps of plant.dt, or the times of the readings in s, increasing from t0.
    seeds : sequence of int (B,)
        One run for each.
    truth : Plant or str, default "finer"
        The source of the readings: "finer" for the plant's high-fidelity model where it has one, so that a detector is not
        tested on its own model (the inverse crime), with the noise of the plant's sensors; "model" for `plant` itself, the
        setting of most papers; or a plant with the same sensors and inputs, whose dt divides plant.dt and whose sensors' noise
        is added.
    to_states : callable, optional
        Maps the states (K, B, n') of such a plant to those of `plant` (K, B, n); without it, and with states of other names, x
        is None.
    process_noise : bool, default False
        Whether the truth is disturbed by its process noise.
    start : str or array, default "nominal"
        "nominal" for the truth's x0, "sampled" from its initial covariance, or states (n',) or (B, n').
    inputs : callable or array (K, m), optional
        u as a function of the time (s) from which it acts, or as an array; None for the truth's operation, in closed loop where
        it has feedback, whose controllers get the simulated readings. It is held from one reading to the next; until the first
        one the operation acts alone.
    t0 : float, default 0
        Time at which the runs begin, in s; a number of steps gives the first reading at t0 + plant.dt.

    Returns
    -------
    Recording
        Readings y (K, B, N), and the truth behind them.

    Raises
    ------
    ValueError
        For arguments that do not fit.
    ArithmeticError
        Where a run leaves the limits of the truth's model.

    Notes
    -----
    Noise: Gaussian where a sigma is stated, uniform within the bound where only a bound is, Gaussian truncated to the
    bound where both are; the process noise likewise. That of a sensor that states `SlowNoise` has that course where readings
    are plant.dt apart.

    Examples
    --------
    >>> from fusion_sfdia import simulate
    >>> from fusion_sfdia.plants import two_tanks
    >>> recording = simulate(two_tanks(), 50, seeds=[0, 1])
    >>> recording.t.shape, recording.y.shape, recording.u.shape
    ((50,), (50, 2, 4), (50, 1))
    """
    if isinstance(truth, str):
        if truth not in ("finer", "model"):
            raise ValueError(f"truth is {truth!r}; expected 'finer', 'model' or a plant")
        if truth == "finer" and plant.truth.finer is not None:
            source, to_states = plant.truth.finer()
        else:
            source = plant
    elif isinstance(truth, Plant):
        source = truth
    else:
        raise ValueError(f"truth is {truth!r}; expected 'finer', 'model' or a plant")
    _require_fit(plant, source)
    seeds = require_seeds(seeds)
    if not np.isfinite(t0):
        raise ValueError(f"t0 is {t0}; expected a finite time in s")
    t, dt = _times(plant, times, t0)
    u = _inputs(plant, t - dt, source.input_at if inputs is None else inputs)
    closed = inputs is None and source.truth.feedback is not None
    x = _start(source, start, seeds, t0)
    n, steps, count = x.shape[-1], t.size, len(source.sensors)
    draws = ProcessNoise(source, seeds) if process_noise else None
    xs = np.empty((steps, len(seeds), n))
    signal = np.empty((steps, len(seeds), count))
    noise = sensor_noise(source.sensors if source is truth else plant.sensors, seeds, steps, plant.dt)
    before = t - dt
    if closed:
        u = np.repeat(u[:, None], len(seeds), axis=1)
    for k in range(steps):
        if closed and k > 0:
            u[k] = _fed_back(source, float(before[k]), signal[k - 1] + noise[k - 1], u[k])
        acting = u[k][:, None] if closed else u[k]
        parts = 1 if source.dt == plant.dt else int(np.ceil(float(dt[k]) / source.dt - 1e-9))
        part = float(dt[k]) / parts
        source.check_dt(part)
        for j in range(parts):
            with np.errstate(all="ignore"):
                x = source.step(float(before[k]) + j * part, x, acting, part)
            if draws is not None:
                x = x + draws.over(part)
            _require_inside(source, x, seeds, float(before[k]) + (j + 1) * part)
        xs[k] = x[:, 0]
        signal[k] = source.output(float(t[k]), x, acting)[:, 0]
    names = tuple(s.name for s in plant.states)
    states: Array | None = xs if names == tuple(s.name for s in source.states) else None
    if to_states is not None:
        states = np.asarray(to_states(xs))
        if states.shape != (expected := (steps, len(seeds), len(names))):
            raise ValueError(f"to_states gives {states.shape}; expected {expected}, the states of {plant.name!r}")
    return Recording(
        t=t,
        u=u,
        y=_rounded(source.sensors, signal + noise),
        signal=signal,
        x=states,
        seeds=seeds,
        states=names,
        inputs=tuple(s.name for s in plant.inputs),
        sensors=plant.sensor_names,
    )


def _require_fit(plant: Plant, source: Plant) -> None:
    for what, own, other in (
        ("sensors", plant.sensor_names, source.sensor_names),
        ("inputs", tuple(s.name for s in plant.inputs), tuple(s.name for s in source.inputs)),
    ):
        if own != other:
            raise ValueError(f"truth has the {what} {', '.join(other)}; expected those of the plant, {', '.join(own)}")
    ratio = plant.dt / source.dt
    if not np.isclose(ratio, round(ratio), rtol=1e-9) or round(ratio) < 1:
        raise ValueError(f"truth steps by {source.dt:g} s; expected plant dt = {plant.dt:g} s divided by a whole number")


def _times(plant: Plant, times: int | Array, t0: float) -> tuple[Array, Array]:
    if isinstance(times, int | np.integer):
        if not 1 <= times <= MOST_STEPS:
            raise ValueError(f"{times} steps; expected at least 1 and at most {MOST_STEPS}")
        return t0 + np.arange(1, times + 1) * plant.dt, np.full(int(times), plant.dt)
    t = floats("times", times)
    if t.ndim != 1 or not t.size:
        came = f"has shape {t.shape}" if t.ndim else f"is {times!r}"
        raise ValueError(f"times {came}; expected a whole number of steps or at least one time (K,)")
    dt = np.diff(t, prepend=t0)
    for step in dt:
        plant.check_dt(float(step))
    return t, np.where(np.isclose(dt, plant.dt, rtol=1e-9), plant.dt, dt)


def _inputs(plant: Plant, before: Array, given: Callable[[float], Array] | Array) -> Array:
    u = np.array([given(float(s)) for s in before], dtype=float) if callable(given) else np.asarray(given, dtype=float)
    expected = (before.size, len(plant.inputs))
    if u.shape != expected or not np.all(np.isfinite(u)):
        raise ValueError(f"inputs have shape {u.shape}; expected finite values {expected}, a row a reading")
    return u


def _fed_back(source: Plant, t: float, y: Array, u: Array) -> Array:
    """The input of each run (B, m) from its readings y (B, N); the plant's feedback gets shapes (B, 1, ...)."""
    feedback = source.truth.feedback
    assert feedback is not None
    found = np.asarray(feedback(t, y[:, None], u[:, None]), dtype=float)
    if found.shape != (len(y), 1, u.shape[-1]) or not np.all(np.isfinite(found)):
        raise ValueError(
            f"feedback of plant {source.name!r} gives shape {found.shape} at {t:g} s; expected finite inputs "
            f"(..., {u.shape[-1]}) for readings {y[:, None].shape}"
        )
    return found[:, 0]


def _start(source: Plant, start: str | Array, seeds: tuple[int, ...], t0: float) -> Array:
    """States (B, 1, n) at t0."""
    n = source.x0.size
    if not isinstance(start, str):
        given = np.asarray(start, dtype=float)
        if given.shape not in {(n,), (len(seeds), n)} or not np.all(np.isfinite(given)):
            raise ValueError(f"start has shape {given.shape}; expected finite states ({n},) or ({len(seeds)}, {n})")
        return np.broadcast_to(given, (len(seeds), n))[:, None, :].copy()
    if start not in ("nominal", "sampled"):
        raise ValueError(f"start is {start!r}; expected 'nominal', 'sampled' or states")
    x = np.broadcast_to(source.x0, (len(seeds), 1, n))
    if start == "sampled":
        xi = np.stack([stream(s, "initial state").standard_normal((1, n)) for s in seeds])
        x = x + xi * np.sqrt(source.initial_cov) if source.initial_cov.ndim == 1 else x + xi @ square_root(source.initial_cov).T
        _require_inside(source, x, seeds, t0)
    return x.copy()


def _require_inside(source: Plant, x: Array, seeds: tuple[int, ...], t: float) -> None:
    _, outside = source.guard(x[:, 0])
    if not np.any(outside):
        return
    b = int(np.flatnonzero(outside)[0])
    low, high = source.state_limits
    i = int(np.flatnonzero(~((x[b, 0] >= low) & (x[b, 0] <= high)))[0])
    state = source.states[i]
    raise ArithmeticError(
        f"seed {seeds[b]} left the limits of {source.name!r} at {t:g} s: {state.name} = {x[b, 0, i]:g} {state.unit}, limits "
        f"[{state.low:g}, {state.high:g}]; make inputs or start milder, lower the process noise, or widen the limits"
    )


def _rounded(sensors: Sequence[Sensor], y: Array) -> Array:
    """Readings (K, B, N) as sensors with a resolution show them."""
    for i, sensor in enumerate(sensors):
        if sensor.resolution:
            y[..., i] = sensor.resolution * np.rint(y[..., i] / sensor.resolution)
    return y


def square_root(cov: Array) -> Array:
    """L with L L' = cov, for a positive semi-definite matrix."""
    scale = np.sqrt(np.where(np.diagonal(cov) > 0, np.diagonal(cov), 1.0))
    values, vectors = np.linalg.eigh(cov / np.outer(scale, scale))
    half: Array = scale[:, None] * vectors * np.sqrt(np.clip(values, 0.0, None))
    return half


def _unit(rng: np.random.Generator, shape: tuple[int, ...]) -> Array:
    """Uniform numbers inside (0, 1), so that any quantile of them is finite."""
    return (rng.integers(0, 2**52, shape) + 0.5) / 2**52


def _quantile(uniform: Array, sigma: Array, bound: Array) -> Array:
    """Noise (..., N) by inversion: Gaussian, truncated to the bound; uniform within it where sigma is inf."""
    gaussian = np.isfinite(sigma)
    scale = np.where(gaussian & (sigma > 0), sigma, 1.0)
    beyond = ndtr(-bound / scale)  # each tail's share
    truncated = np.where(gaussian, sigma, 0.0) * ndtri(beyond + uniform * (1 - 2 * beyond))
    even = np.where(gaussian, 0.0, bound) * (2 * uniform - 1)
    return np.asarray(np.where(gaussian, np.clip(truncated, -bound, bound), even))


def sensor_noise(sensors: tuple[Sensor, ...], seeds: tuple[int, ...], steps: int, dt: float) -> Array:
    """Noise (K, B, N) of readings every dt seconds."""
    uniform = np.stack([_unit(stream(s, "measurement noise"), (steps, len(sensors))) for s in seeds], axis=1)
    for i, slow in enumerate(s.noise for s in sensors):
        if slow is not None:
            q = np.exp(-dt / slow.time_constant)
            own = ndtri(np.stack([_unit(stream(s, f"slow noise of {sensors[i].name}"), (steps,)) for s in seeds], axis=1))
            own[1:] *= np.sqrt(1 - q**2)
            wandering = scipy.signal.lfilter([1.0], [1.0, -q], own, axis=0)
            uniform[..., i] = ndtr(np.sqrt(1 - slow.share) * ndtri(uniform[..., i]) + np.sqrt(slow.share) * wandering)
    sigma = np.array([np.inf if s.sigma is None else s.sigma for s in sensors])
    return _quantile(uniform, sigma, np.array([np.inf if s.bound is None else s.bound for s in sensors]))


class ProcessNoise:
    """Process noise of a plant, one stream a seed; each step takes the next numbers of every stream."""

    def __init__(self, plant: Plant, seeds: tuple[int, ...]) -> None:
        self.plant = plant
        self.streams = [stream(s, "process noise") for s in seeds]
        if plant.process_bound is not None and plant.process_cov.ndim == 2:
            raise ValueError(f"plant {plant.name!r} has a process bound and a full process_cov; give variances or no bound")

    def over(self, dt: float) -> Array:
        """Noise (B, 1, n) of a step of dt seconds: its covariance and its bound grow in proportion to dt."""
        plant = self.plant
        uniform = np.stack([_unit(r, (1, plant.x0.size)) for r in self.streams])
        cov = plant.process_cov_over(dt)
        if cov.ndim == 2:
            return np.asarray(ndtri(uniform) @ square_root(cov).T)
        sigma = np.sqrt(diagonal(cov))
        if plant.process_bound is None:
            return np.asarray(sigma * ndtri(uniform))
        bound = np.broadcast_to(plant.process_bound, sigma.shape) * (dt / plant.dt)
        return _quantile(uniform, np.where((sigma == 0) & (bound > 0), np.inf, sigma), bound)
