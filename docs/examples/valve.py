"""A control valve behind a flow sensor that drifts with temperature: an own plant on one page. Units: SI.

The equations and numbers are those of the valve of EstimationPy (Lawrence Berkeley National Laboratory): the mass flow goes
with the square of the opening and the root of the pressure drop, and the sensor reads (1 + drift (T - 293.15 K)) times the
flow. The noises are the root mean squares of its log against its truth, rounded up.
"""

import numpy as np

from fusion_sfdia import Plant, Sensor, Signal

K_VALVE = 4.71967e-3  # kg/s per root of Pa, fully open
READS_TRUE = 293.15  # K, where the flow sensor has no error


def step(t_start, x, u, dt):
    """Opening and drift stay as they are, but for process noise: x (..., 2), u (..., 2) pressure drop and temperature."""
    return x


def mass_flow(x, u):
    """The true flow (...), kg/s."""
    return K_VALVE * x[..., 0] ** 2 * np.sqrt(u[..., 0])


def output(t, x, u):
    """The readings (..., 2): the flow sensor, and the command as a reading of the opening."""
    return np.stack([(1 + x[..., 1] * (u[..., 1] - READS_TRUE)) * mass_flow(x, u), x[..., 0]], axis=-1)


def make():
    """The plant, with readings every 3 s."""
    return Plant(
        "valve",
        states=(
            Signal("opening", "1", nominal=1.0, low=0.01, high=1.1, initial_sigma=0.05, process_sigma=0.05),
            Signal("drift", "1/K", nominal=0.0, low=-0.05, high=0.05, initial_sigma=0.02, process_sigma=2e-5),
        ),
        sensors=(Sensor("flow", "flow", "kg/s", sigma=0.03), Sensor("command", "opening", "1", sigma=0.01)),
        step=step,
        output=output,
        dt=3.0,
        inputs=(Signal("pressure_drop", "Pa", nominal=5e4), Signal("temperature", "K", nominal=READS_TRUE)),
    )
