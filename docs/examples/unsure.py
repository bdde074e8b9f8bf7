"""The tank with a hole that is known to 5 % and a flow meter with an error of 1 %."""

from dataclasses import replace

import numpy as np
import tank

from fusion_sfdia import Parameter, Uncertainty, run, simulate
from fusion_sfdia.detectors import LeaveOneOutBank
from fusion_sfdia.plants import augment

OUTFLOW = Parameter("outflow", "m^3/s", nominal=tank.OUTFLOW, sd=5e-5, source="tables of discharge coefficients")


def step(t_start, x, u, dt, theta):
    """The step with another outflow: theta (..., 1)."""
    more = (theta[..., 0] - tank.OUTFLOW) * np.sqrt(x[..., 0])
    return tank.step(t_start, x, u, dt) - dt / tank.AREA * np.stack([more, 0 * more], axis=-1)


def make():
    return replace(tank.make(), uncertainty=Uncertainty((OUTFLOW,), step=step, inputs={"inflow": 1e-5}))


if __name__ == "__main__":
    plant = augment(make())
    print(", ".join(s.name for s in plant.states))  # level, temperature, outflow, error of inflow
    wider = replace(plant, x0=np.array([1.0, 300.0, 1.05 * tank.OUTFLOW, 0.0]))
    recording = simulate(plant, 200, seeds=[1], truth=wider)
    detector = LeaveOneOutBank(plant)
    _, decisions = run(detector, detector.init((1,)), recording.t, recording.y, recording.u_of_runs, covariance=True)
    print(f"outflow {decisions.estimate[-1, 0, 2] / tank.OUTFLOW - 1:+.1%} of its nominal value")  # +4.7%
