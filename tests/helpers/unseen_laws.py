"""Plants whose model has a wrong law and with which nothing was chosen: they judge what was made on others."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from wrong_laws import Flow, WrongLaw, columns, walk

from fusion_sfdia.plant.signals import Sensor, Signal
from fusion_sfdia.plant.uncertainty import Parameter

Array = NDArray[Any]


def pressure_main() -> WrongLaw:
    """A pump between a well and two vessels; the true pipes rub with a power .54 of the pressure, the pump slips."""

    def law(power: float, slip: float) -> tuple[Flow, Flow]:
        def flows(x: Array, u: Array, theta: Array) -> tuple[Array, ...]:
            well, near, far = (x[..., i] for i in range(3))
            supply, speed, demand = (u[..., i] for i in range(3))
            pump, pipe, outlet = (theta[..., i] for i in range(3))
            lift = 20.0 * speed**2 - 0.5 * (near - well)
            raised = pump * (0.1 * lift**2 + 0.1) ** 0.25 * (1 - slip * (near - 20) / 20)
            through = pipe * ((near - far) ** 2 + 1e-3) ** (power / 2) * 2.0 ** (0.5 - power)
            return supply, raised, through, outlet * demand * (far / 18.0) ** (power + 0.1)

        def rates(x: Array, u: Array, theta: Array) -> Array:
            supply, raised, through, drawn = flows(x, u, theta)
            return columns((supply - raised) / 4000 - (x[..., 0] - 3) / 9000, (raised - through) / 120, (through - drawn) / 600)

        def readings(x: Array, u: Array, theta: Array) -> Array:
            _, raised, _, drawn = flows(x, u, theta)
            return columns(x[..., 0], x[..., 1], x[..., 2], raised, drawn)

        return rates, readings

    return WrongLaw(
        "pressure main",
        (
            Signal("well", "m", 3.0, 0.1, 9.0, initial_sigma=0.3),
            Signal("near", "m", 20.0, 1.0, 60.0, initial_sigma=1.0),
            Signal("far", "m", 18.0, 1.0, 60.0, initial_sigma=1.0),
        ),
        (
            Sensor("well_level", "well", "m", 0.02),
            Sensor("near_head", "near", "m", 0.1),
            Sensor("far_head", "far", "m", 0.1),
            Sensor("pump_flow", "raised", "1", 0.015),
            Sensor("demand_flow", "drawn", "1", 0.015),
        ),
        (Signal("supply", "1", 1.4, 0.0, 5.0), Signal("speed", "1", 1.0, 0.2, 3.0), Signal("demand", "1", 1.4, 0.0, 5.0)),
        (Parameter("pump", "1", 1.0, sd=0.05), Parameter("pipe", "1", 1.0, sd=0.05), Parameter("outlet", "1", 1.0, sd=0.05)),
        *law(0.5, 0.0),
        *law(0.54, 0.2),
        lambda t, rng: columns(
            1.4 + walk(t, rng, 0.05, 6.0),
            0.0 * t,
            1.4 + 0.25 * np.sin(2 * np.pi * t / 86400) + 0.1 * np.sin(2 * np.pi * t / 21600) + walk(t, rng, 0.08, 1.0),
        ),
        lambda y, w: np.array([w[0], np.clip(1.0 + 0.12 * (18.0 - y[2]), 0.5, 1.6), w[2]]),
        np.array([2e-3, 0.01, 0.01]),
    )


def stirred_reactor() -> WrongLaw:
    """A cooled reactor; the true reaction is of order 1.4 and follows Arrhenius, the jacket takes more heat at more flow."""

    def law(truth: bool) -> tuple[Flow, Flow]:
        def parts(x: Array, u: Array, theta: Array) -> tuple[Array, ...]:
            c, hot, jacket = (x[..., i] for i in range(3))
            feed, fed, warm, coolant, cold = (u[..., i] for i in range(5))
            k, ua, heat = (theta[..., i] for i in range(3))
            if truth:
                reaction = k * (c**2 + 1e-6) ** 0.7 * np.exp(5500.0 * (1 / 350.0 - 1 / hot))
                passed = ua * (coolant**2 + 1e-6) ** 0.3 * (hot - jacket)
            else:
                reaction = k * c * (1 + 0.045 * (hot - 350.0))
                passed = ua * (hot - jacket)
            return c, hot, jacket, feed, fed, warm, coolant, cold, reaction, passed, heat

        def rates(x: Array, u: Array, theta: Array) -> Array:
            c, hot, jacket, feed, fed, warm, coolant, cold, reaction, passed, heat = parts(x, u, theta)
            return columns(
                (feed * (fed - c) - reaction) / 1200,
                (feed * (warm - hot) + 25.0 * heat * reaction - passed) / 1200,
                (3 * coolant * (cold - jacket) + passed) / 200,
            )

        def readings(x: Array, u: Array, theta: Array) -> Array:
            _, _, jacket, _, _, _, coolant, cold, _, passed, _ = parts(x, u, theta)
            return columns(x[..., 0], x[..., 1], x[..., 1], jacket, 0.1 * passed, 0.3 * coolant * (jacket - cold))

        return rates, readings

    return WrongLaw(
        "stirred reactor",
        (
            Signal("product", "1", 1.0, 0.01, 5.0, initial_sigma=0.1),
            Signal("reactor", "K", 350.0, 280.0, 450.0, initial_sigma=2.0),
            Signal("jacket", "K", 325.0, 270.0, 400.0, initial_sigma=3.0),
        ),
        (
            Sensor("analyser", "product", "1", 0.02),
            Sensor("reactor_low", "reactor", "K", 0.2),
            Sensor("reactor_high", "reactor", "K", 0.3),
            Sensor("jacket_t", "jacket", "K", 0.2),
            Sensor("heat_flux", "heat", "1", 0.05),
            Sensor("coolant_heat", "taken", "1", 0.08),
        ),
        (
            Signal("feed", "1", 1.0, 0.0, 4.0),
            Signal("fed", "1", 2.0, 0.0, 5.0),
            Signal("warm", "K", 345.0, 273.0, 400.0),
            Signal("coolant", "1", 0.3, 0.0, 4.0),
            Signal("cold", "K", 290.0, 260.0, 330.0),
        ),
        (Parameter("k", "1", 1.0, sd=0.06), Parameter("ua", "1", 0.65, sd=0.04), Parameter("heat", "1", 1.0, sd=0.06)),
        *law(False),
        *law(True),
        lambda t, rng: columns(
            1 + 0.1 * np.sin(2 * np.pi * t / 40000) + walk(t, rng, 0.05, 2.0),
            2 + walk(t, rng, 0.08, 4.0),
            345 + walk(t, rng, 1.0, 3.0),
            0.0 * t,
            290 + 2 * np.sin(2 * np.pi * t / 86400) + walk(t, rng, 0.8, 5.0),
        ),
        lambda y, w: np.array([w[0], w[1], w[2], np.clip(0.3 + 0.05 * (y[1] - 350.0), 0.1, 2.0), w[4]]),
        np.array([1e-3, 0.02, 0.03]),
    )


def heat_pump() -> WrongLaw:
    """A heat pump, its brine and a layered store; the true efficiency is curved, output falls with cold brine, layers mix."""

    def law(truth: bool) -> tuple[Flow, Flow]:
        def parts(x: Array, u: Array, theta: Array) -> tuple[Array, ...]:
            top, bottom, brine, back = (x[..., i] for i in range(4))
            outdoor, speed, draw, ground = (u[..., i] for i in range(4))
            size, efficiency, field, floor = (theta[..., i] for i in range(4))
            rise = top - brine - 40.0
            cop = efficiency * (4.0 - 0.05 * rise + (0.0012 * rise**2 if truth else 0.0))
            heat = size * 8.0 * speed * (1 + (0.02 if truth else 0.0) * (brine - 277.0))
            drawn = draw * (top - back)
            given = floor * 0.5 * ((back + top) / 2 - 294.0) * (1 + (0.012 if truth else 0.0) * (top - 313.0))
            mixed = (0.15 if truth else 0.1) * (top - bottom)
            source = 2.0 * field * (ground - brine)
            return top, bottom, brine, back, outdoor, heat, heat / cop, drawn, given, mixed, source, draw

        def rates(x: Array, u: Array, theta: Array) -> Array:
            _, bottom, _, back, outdoor, heat, power, drawn, given, mixed, source, draw = parts(x, u, theta)
            return columns(
                (heat - drawn - mixed) / 600,
                (draw * (back - bottom) + mixed - 0.02 * (bottom - outdoor)) / 600,
                (source - heat + power) / 300,
                (drawn - given) / 400,
            )

        def readings(x: Array, u: Array, theta: Array) -> Array:
            top, bottom, brine, back, _, heat, power, drawn, _, _, source, _ = parts(x, u, theta)
            return columns(top, bottom, brine, back, heat, power, drawn, source)

        return rates, readings

    return WrongLaw(
        "heat pump",
        (
            Signal("top", "K", 313.0, 280.0, 360.0, initial_sigma=3.0),
            Signal("bottom", "K", 305.0, 270.0, 350.0, initial_sigma=3.0),
            Signal("brine", "K", 277.0, 250.0, 300.0, initial_sigma=2.0),
            Signal("back", "K", 303.0, 270.0, 350.0, initial_sigma=3.0),
        ),
        (
            *(Sensor(f"{n}_t", n, "K", 0.15) for n in ("top", "bottom", "brine", "back")),
            Sensor("heat", "heat", "1", 0.1),
            Sensor("power", "power", "1", 0.03),
            Sensor("drawn", "drawn", "1", 0.1),
            Sensor("source", "source", "1", 0.1),
        ),
        (
            Signal("outdoor", "K", 278.0, 230.0, 330.0),
            Signal("speed", "1", 0.8, 0.0, 2.0),
            Signal("draw", "1", 0.7, 0.0, 3.0),
            Signal("ground", "K", 281.0, 265.0, 300.0),
        ),
        (
            Parameter("size", "1", 1.0, sd=0.06),
            Parameter("efficiency", "1", 1.0, sd=0.06),
            Parameter("field", "1", 1.0, sd=0.06),
            Parameter("floor", "1", 1.0, sd=0.06),
        ),
        *law(False),
        *law(True),
        lambda t, rng: columns(
            278 + 4 * np.sin(2 * np.pi * (t / 86400 - 0.4)) + walk(t, rng, 2.0, 6.0),
            0.0 * t,
            0.7 + 0.1 * np.sin(2 * np.pi * t / 43200) + walk(t, rng, 0.06, 1.5),
            281 + walk(t, rng, 0.4, 12.0),
        ),
        lambda y, w: np.array([w[0], np.clip(0.8 + 0.06 * (314.0 - 0.3 * (w[0] - 278) - y[0]), 0.2, 1.6), w[2], w[3]]),
        np.array([0.02, 0.02, 0.03, 0.02]),
    )


UNSEEN = (pressure_main, stirred_reactor, heat_pump)
