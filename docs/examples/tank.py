"""A heated tank: water flows in, is heated, and flows out through a hole. Units: SI."""

import numpy as np

from fusion_sfdia import Plant, Sensor, Signal, diagnose, simulate

AREA, OUTFLOW = 1.0, 1e-3  # m^2; m^3/s at a level of 1 m
INFLOW_TEMPERATURE, HEAT_CAPACITY = 290.0, 4.18e6  # K; J/(m^3 K)


def step(t_start, x, u, dt):
    """The state dt seconds later: x (..., 2) level and temperature, u (..., 2) inflow and power."""
    level, temperature = x[..., 0], x[..., 1]
    inflow, power = u[..., 0], u[..., 1]
    level_rate = (inflow - OUTFLOW * np.sqrt(level)) / AREA
    temperature_rate = (inflow * (INFLOW_TEMPERATURE - temperature) + power / HEAT_CAPACITY) / (AREA * level)
    return np.stack([level + dt * level_rate, temperature + dt * temperature_rate], axis=-1)


def output(t, x, u):
    """The readings (..., 4): level twice, temperature twice."""
    return x[..., [0, 0, 1, 1]]


def make():
    """The plant, with readings once a minute."""
    return Plant(
        "heated-tank",
        states=(
            Signal("level", "m", nominal=1.0, low=0.1, high=3.0, initial_sigma=0.02, process_sigma=1e-3),
            Signal("temperature", "K", nominal=300.0, low=273.0, high=373.0, initial_sigma=0.5, process_sigma=0.02),
        ),
        sensors=(
            Sensor("level_1", "level", "m", sigma=0.01, quantity="level"),
            Sensor("level_2", "level", "m", sigma=0.01, quantity="level"),
            Sensor("temperature_1", "temperature", "K", sigma=0.2, quantity="temperature"),
            Sensor("temperature_2", "temperature", "K", sigma=0.2, quantity="temperature"),
        ),
        step=step,
        output=output,
        dt=60.0,
        inputs=(Signal("inflow", "m^3/s", nominal=1e-3), Signal("power", "W", nominal=41.8e3)),
    )


if __name__ == "__main__":
    plant = make()
    recording = simulate(plant, 100, seeds=[1])  # 100 readings of one run
    recording.y[50:, 0, 1] += 0.1  # a bias of 0.1 m of level_2, from the 51st reading on
    for event in diagnose("loo-glr", recording, plant=plant).events:
        print(f"{event.hypothesis} from {event.start:.0f} s, {event.size:.2f} {event.unit}")  # level_2 from 3060 s, 0.10 m
