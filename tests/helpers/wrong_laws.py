"""Plants whose model has a wrong law, not a wrong number: readings of a true one, in closed loop, by the minute.

Each is a model for the detectors and a truth with another law and other parameters. Nothing of a published plant.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Numerics, Plant
from fusion_sfdia.plant.signals import Sensor, Signal
from fusion_sfdia.plant.uncertainty import Parameter, Uncertainty

Array = NDArray[Any]
Flow = Callable[[Array, Array, Array], Array]  # of x (..., n), u (..., m), theta (..., p): rates, or readings

DT, DAY = 60.0, 1440
OFF = 0.05  # relative standard deviation of the true parameters about the model's


@dataclass(frozen=True)
class WrongLaw:
    """A model (rates, readings) and the truth (true_rates, true_readings); control: the inputs from readings, weather (m,)."""

    name: str
    states: tuple[Signal, ...]
    sensors: tuple[Sensor, ...]
    inputs: tuple[Signal, ...]
    parameters: tuple[Parameter, ...]
    rates: Flow
    readings: Flow
    true_rates: Flow
    true_readings: Flow
    weather: Callable[[Array, np.random.Generator], Array]
    control: Callable[[Array, Array], Array]
    process: Array

    def plant(self) -> Plant:
        """The model."""
        nominal = np.array([p.nominal for p in self.parameters])

        def step(t: float, x: Array, u: Array, dt: float, theta: Array) -> Array:
            return _rk4(self.rates, x, u, theta, dt)

        def output(t: float, x: Array, u: Array, theta: Array) -> Array:
            return self.readings(x, u, theta)

        return Plant(
            self.name,
            self.states,
            self.sensors,
            lambda t, x, u, dt: step(t, x, u, dt, nominal),
            lambda t, x, u: output(t, x, u, nominal),
            DT,
            inputs=self.inputs,
            process_cov=self.process**2,
            uncertainty=Uncertainty(self.parameters, step, output),
            numerics=Numerics(max_dt=20 * DT),
        )

    def record(
        self,
        days: float,
        seed: int,
        *,
        building: int = 0,
        bias: Callable[[Array], Array] | None = None,
        change: Callable[[Array], Array] | None = None,
        warmer: float = 0.0,
        stuck: tuple[int, int, int] | None = None,
    ) -> Log:
        """Readings of so many days: bias (K, N) is added to them in sigma, change (K, p) multiplies the true parameters.

        stuck: a sensor that repeats the reading of a row until before another row.
        """
        rng, rows = np.random.default_rng([seed, 5]), int(days * DAY)
        theta = np.array([p.nominal for p in self.parameters])
        theta = theta * (1 + OFF * np.random.default_rng([building, 6]).standard_normal(theta.size).clip(-2, 2))
        t = DT * np.arange(1, rows + 1)
        sigma = np.array([s.noise_sigma for s in self.sensors])
        outside = self.weather(t, rng) + warmer * np.array([s.unit == "K" for s in self.inputs])
        slow, noise = 0.0, np.empty((rows, sigma.size))
        for k, e in enumerate(rng.standard_normal((rows, sigma.size))):
            slow = 0.6 * slow + 0.8 * e
            noise[k] = slow
        noise *= sigma
        off = np.zeros((rows, sigma.size)) if bias is None else bias(t) * sigma
        factor = np.ones((rows, theta.size)) if change is None else change(t)
        shaken = self.process * rng.standard_normal((rows, len(self.states)))
        x = np.array([s.nominal for s in self.states])
        y, u = np.empty((rows, sigma.size)), np.empty((rows, len(self.inputs)))
        before = self.true_readings(x, np.array([s.nominal for s in self.inputs]), theta)
        for k in range(rows):
            u[k] = self.control(before, outside[k])
            x = _rk4(self.true_rates, x, u[k], theta * factor[k], DT) + shaken[k]
            exact = self.true_readings(x, u[k], theta * factor[k])
            before = y[k] = np.round((exact + noise[k] + off[k]) / (0.5 * sigma)) * 0.5 * sigma
            if stuck is not None and stuck[1] <= k < stuck[2]:
                y[k, stuck[0]] = y[stuck[1], stuck[0]]
        return Log(t, y, u)


def _rk4(rates: Flow, x: Array, u: Array, theta: Array, dt: float) -> Array:
    parts = 4
    h = dt / parts
    for _ in range(parts):
        a = rates(x, u, theta)
        b = rates(x + h / 2 * a, u, theta)
        c = rates(x + h / 2 * b, u, theta)
        x = x + h / 6 * (a + 2 * b + 2 * c + rates(x + h * c, u, theta))
    return x


def columns(*values: Any) -> Array:
    """The values as columns (..., n)."""
    shape = np.broadcast_shapes(*(np.shape(v) for v in values))
    found = np.empty((*shape, len(values)), np.result_type(*values))
    for i, value in enumerate(values):
        found[..., i] = value
    return found


def walk(t: Array, rng: np.random.Generator, sd: float, hours: float) -> Array:
    """A smooth random course of that standard deviation and time constant."""
    keep, found = np.exp(-DT / 3600 / hours), np.zeros(t.size)
    first = second = 0.0
    for k, e in enumerate(rng.standard_normal(t.size)):
        first = keep * first + np.sqrt(1 - keep**2) * e
        second = 0.97 * second + 0.03 * first
        found[k] = second
    return sd * found


def heated_room() -> WrongLaw:
    """Coil, supply air and room; the true heat transfer grows with the fan's power .6, the valve is equal-percentage."""
    tau = {"coil": 200.0, "air": 90.0, "room": 5400.0}

    def law(exponent: float, equal_percentage: bool, gains: bool) -> tuple[Flow, Flow]:
        def parts(x: Array, u: Array, theta: Array) -> tuple[Array, ...]:
            coil, air, room = (x[..., i] for i in range(3))
            out, valve, fan, boiler = (u[..., i] for i in range(4))
            ua, loss, flow = (theta[..., i] for i in range(3))
            mixed = 0.25 * out + 0.75 * room
            transfer = ua * (fan / 0.7) ** exponent * (coil - mixed)
            water = flow * (0.06 * (22.0**valve) if equal_percentage else valve)
            return coil, air, room, out, fan, boiler, mixed, transfer, water, loss

        def rates(x: Array, u: Array, theta: Array) -> Array:
            coil, air, room, out, fan, boiler, mixed, transfer, water, loss = parts(x, u, theta)
            return columns(
                (water * (boiler - coil) - transfer) / tau["coil"],
                (transfer - fan * (air - mixed)) / tau["air"],
                (fan * (air - room) * 6 - 6 * loss * (room - out)) / tau["room"],
            )

        def readings(x: Array, u: Array, theta: Array) -> Array:
            coil, air, room, _, _, boiler, mixed, transfer, water, _ = parts(x, u, theta)
            return columns(coil, air, room, mixed, transfer, water, boiler - transfer / (water + 0.2))

        return rates, readings

    model, truth = law(0.0, False, False), law(0.6, True, True)
    return WrongLaw(
        "heated room",
        (
            Signal("coil", "K", 315.0, initial_sigma=4.0),
            Signal("air", "K", 303.0, initial_sigma=4.0),
            Signal("room", "K", 294.0, initial_sigma=2.0),
        ),
        (
            Sensor("coil_t", "coil", "K", 0.15),
            Sensor("supply_t", "air", "K", 0.15),
            Sensor("room_t", "room", "K", 0.1),
            Sensor("mixed_t", "mixed", "K", 0.15),
            Sensor("heat", "transfer", "1", 0.1),
            Sensor("water", "water", "1", 0.01),
            Sensor("return_t", "return", "K", 0.3),
        ),
        (
            Signal("outdoor", "K", 280.0, 230.0, 330.0),
            Signal("valve", "1", 0.5, 0.0, 1.0),
            Signal("fan", "1", 0.7, 0.0, 2.0),
            Signal("boiler", "K", 333.0, 273.0, 400.0),
        ),
        (Parameter("ua", "1", 0.35, sd=0.03), Parameter("loss", "1", 0.35, sd=0.03), Parameter("flow", "1", 1.0, sd=0.08)),
        *model,
        *truth,
        lambda t, rng: columns(
            279 + 4 * np.sin(2 * np.pi * (t / 86400 - 0.4)) + walk(t, rng, 2.0, 6.0),
            0.0 * t,
            np.where((t / 3600 % 24 > 6) & (t / 3600 % 24 < 20), 0.8, 0.6) + 0.0 * t,
            333 + walk(t, rng, 1.5, 3.0),
        ),
        lambda y, w: np.array([w[0], np.clip(0.5 + 0.2 * (294.5 - y[2]) + 0.02 * (282 - w[0]), 0.05, 1.0), w[2], w[3]]),
        np.array([0.05, 0.05, 0.004]),
    )


def tank_cascade() -> WrongLaw:
    """Three tanks, a pump and a control valve; the true outlets follow a power .65, the pump has a curve."""

    def law(power: float, curve: float) -> tuple[Flow, Flow]:
        def flows(x: Array, u: Array, theta: Array) -> tuple[Array, ...]:
            first, second, third = (x[..., i] for i in range(3))
            speed, valve, draw = (u[..., i] for i in range(3))
            pump, one, two, three = (theta[..., i] for i in range(4))
            fed = pump * speed * (1 - curve * (first - 1.0))
            return fed, one * first**power, two * second**power, three * valve * third**power, draw

        def rates(x: Array, u: Array, theta: Array) -> Array:
            fed, a, b, c, draw = flows(x, u, theta)
            return columns((fed - a) / 900, (a - b - 0.3 * draw) / 1500, (b - c) / 1200)

        def readings(x: Array, u: Array, theta: Array) -> Array:
            fed, a, b, c, _ = flows(x, u, theta)
            return columns(x[..., 0], x[..., 1], x[..., 2], fed, a, b, c)

        return rates, readings

    return WrongLaw(
        "tank cascade",
        tuple(Signal(f"h{i}", "m", 1.0, 0.05, 5.0, initial_sigma=0.1) for i in (1, 2, 3)),
        (
            *(Sensor(f"level_{i}", f"h{i}", "m", 0.008) for i in (1, 2, 3)),
            *(Sensor(name, name, "1", 0.01) for name in ("feed", "flow_12", "flow_23", "outflow")),
        ),
        (Signal("speed", "1", 1.0, 0.0, 3.0), Signal("valve", "1", 1.0, 0.0, 3.0), Signal("draw", "1", 0.0, -1.0, 1.0)),
        (
            Parameter("pump", "1", 1.0, sd=0.06),
            *(Parameter(f"outlet_{i}", "1", 1.0, sd=0.06) for i in (1, 2, 3)),
        ),
        *law(0.5, 0.0),
        *law(0.65, 0.25),
        lambda t, rng: columns(
            0.0 * t,
            1 + 0.12 * np.sin(2 * np.pi * t / 43200) + walk(t, rng, 0.06, 2.0),
            0.2 * (np.sin(2 * np.pi * t / 86400) > 0.5) + walk(t, rng, 0.1, 4.0),
        ),
        lambda y, w: np.array([np.clip(1.0 + 0.8 * (1.0 - y[2]), 0.2, 2.0), w[1], w[2]]),
        np.full(3, 5e-4),
    )


def exchanger_pair() -> WrongLaw:
    """Two heat exchangers in series whose true transfer has a log-mean difference and falls with viscosity; flow controlled."""

    def law(nonlinear: bool) -> tuple[Flow, Flow]:
        def heats(x: Array, u: Array, theta: Array) -> tuple[Array, ...]:
            h1, h2, c1, c2 = (x[..., i] for i in range(4))
            hot, flow, cold, through = (u[..., i] for i in range(4))
            k1, k2 = theta[..., 0], theta[..., 1]
            if nonlinear:
                k1 = k1 * (flow * through) ** 0.4 * (1 + 0.01 * (h1 - 340))
                k2 = k2 * (flow * through) ** 0.4 * (1 + 0.01 * (h2 - 325))
            return k1 * ((hot + h1) / 2 - (c1 + c2) / 2), k2 * ((h1 + h2) / 2 - (cold + c2) / 2), *(h1, h2, c1, c2)

        def rates(x: Array, u: Array, theta: Array) -> Array:
            q1, q2, h1, h2, c1, c2 = heats(x, u, theta)
            hot, flow, cold, through = (u[..., i] for i in range(4))
            loss = theta[..., 2]
            return columns(
                (flow * (hot - h1) - q1 - loss * (h1 - 293)) / 240,
                (flow * (h1 - h2) - q2) / 240,
                (through * (c2 - c1) + q1) / 240,
                (through * (cold - c2) + q2) / 240,
            )

        def readings(x: Array, u: Array, theta: Array) -> Array:
            q1, _, h1, h2, c1, c2 = heats(x, u, theta)
            return columns(h1, h2, c1, c2, 0.1 * q1)

        return rates, readings

    return WrongLaw(
        "exchanger pair",
        tuple(Signal(n, "K", v, initial_sigma=4.0) for n, v in (("h1", 340.0), ("h2", 325.0), ("c1", 320.0), ("c2", 305.0))),
        (
            *(Sensor(f"{n}_t", n, "K", 0.15) for n in ("h1", "h2", "c1", "c2")),
            Sensor("heat", "heat", "1", 0.05),
        ),
        (
            Signal("hot", "K", 355.0, 273.0, 500.0),
            Signal("flow", "1", 1.0, 0.0, 5.0),
            Signal("cold", "K", 290.0, 250.0, 400.0),
            Signal("through", "1", 1.0, 0.0, 5.0),
        ),
        (Parameter("k1", "1", 0.6, sd=0.05), Parameter("k2", "1", 0.6, sd=0.05), Parameter("loss", "1", 0.02, sd=0.004)),
        *law(False),
        *law(True),
        lambda t, rng: columns(
            355 + 3 * np.sin(2 * np.pi * t / 86400) + walk(t, rng, 2.0, 3.0),
            0.0 * t,
            290 + walk(t, rng, 2.0, 5.0),
            1 + 0.15 * np.sin(2 * np.pi * t / 50000) + walk(t, rng, 0.08, 2.0),
        ),
        lambda y, w: np.array([w[0], np.clip(1.0 + 0.05 * (321 - y[2]), 0.4, 2.0), w[2], w[3]]),
        np.full(4, 0.03),
    )


PLANTS = (heated_room, tank_cascade, exchanger_pair)


def drift(sensor: int, count: int, start: float, rows: int, size: float, hold: int = 0) -> Callable[[Array], Array]:
    """A bias (K, N) in sigma of one sensor that grows to `size` within so many rows, stays for `hold`, and is gone."""

    def bias(t: Array) -> Array:
        age = (t - start) / DT
        found = np.zeros((t.size, count))
        found[:, sensor] = np.where((age >= 0) & (age < rows + hold), size * np.minimum(age / max(rows, 1), 1.0), 0.0)
        return found

    return bias
