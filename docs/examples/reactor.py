"""A CasADi model as a plant, with its exact Jacobians: a stirred reactor with a cooled jacket. Units: mol/l, K, hours inside.

The equations and numbers are those of the benchmark of Chen, Kremling and Allgoewer (1995), Nonlinear predictive control of a
benchmark CSTR, Proc. 3rd European Control Conference: A to B to C, and 2 A to D (van de Vusse). The noises are our choice.
CasADi takes a batch as the columns of a matrix, and maps over it what was written for one state.
"""

import casadi as ca
import numpy as np

from fusion_sfdia import Plant, Sensor, Signal, diagnose, simulate
from fusion_sfdia.plants import Numerics

RATES = (1.287e12, 9758.3), (1.287e12, 9758.3), (9.043e9, 8560.0)  # 1/h, 1/h, l/(mol h); K: of A to B, B to C, 2 A to D
HEATS = 4.2, -11.0, -41.85  # kJ/mol
RHO_CP, WALL, VOLUME, JACKET = 0.9342 * 3.01, 4032 * 0.215, 10.0, 5.0 * 2.0  # kJ/(l K), kJ/(h K), l, kJ/K
FEED, FEED_TEMPERATURE = 5.1, 378.05  # mol/l, K
HOUR, SUBSTEPS = 3600.0, 4

x, u, dt = ca.SX.sym("x", 4), ca.SX.sym("u", 2), ca.SX.sym("dt")  # c_A, c_B, T, T_jacket; flow over volume 1/h, heat kJ/h
c_a, c_b, temperature, jacket = ca.vertsplit(x)
k_ab, k_bc, k_ad = (k * ca.exp(-e / temperature) for k, e in RATES)
reactions = k_ab * c_a, k_bc * c_b, k_ad * c_a**2
rates = ca.vertcat(
    u[0] * (FEED - c_a) - reactions[0] - reactions[2],
    -u[0] * c_b + reactions[0] - reactions[1],
    u[0] * (FEED_TEMPERATURE - temperature)
    - sum(r * h for r, h in zip(reactions, HEATS, strict=True)) / RHO_CP
    + WALL / (RHO_CP * VOLUME) * (jacket - temperature),
    (u[1] + WALL * (temperature - jacket)) / JACKET,
)
f = ca.Function("f", [x, u], [rates])
ahead, part = x, dt / HOUR / SUBSTEPS
for _ in range(SUBSTEPS):  # Runge-Kutta 4
    k1 = f(ahead, u)
    k2 = f(ahead + part / 2 * k1, u)
    k3 = f(ahead + part / 2 * k2, u)
    ahead = ahead + part / 6 * (k1 + 2 * k2 + 2 * k3 + f(ahead + part * k3, u))
STEP = ca.Function("step", [x, u, dt], [ahead])
JACOBIAN = ca.Function("jacobian", [x, u, dt], [ca.jacobian(ahead, x)])


def mapped(function, x, u, dt):
    """A function of one state for a batch: x (..., 4) and u (..., 2) to (..., rows, columns)."""
    batch = np.broadcast_shapes(x.shape[:-1], u.shape[:-1])
    columns = [np.broadcast_to(a, (*batch, a.shape[-1])).reshape(-1, a.shape[-1]).T for a in (x, u)]
    found = function(*columns, np.full((1, columns[0].shape[1]), dt)).toarray()  # (rows, runs * columns)
    return found.reshape(len(found), -1, function.size2_out(0)).swapaxes(0, 1).reshape(*batch, len(found), -1)


def step(t_start, x, u, dt):
    """The state dt seconds later (..., 4)."""
    return mapped(STEP, x, u, dt)[..., 0]


def step_jacobian(t_start, x, u, dt):
    """Its derivatives by the algorithmic differentiation of CasADi (..., 4, 4)."""
    return mapped(JACOBIAN, x, u, dt)


def output(t, x, u):
    """The readings (..., 5): the analyser of B, two thermometers in the reactor, two in the jacket."""
    return x[..., [1, 2, 2, 3, 3]]


def make():
    """The plant, with readings every 20 s."""
    return Plant(
        "reactor",
        states=(
            Signal("c_A", "mol/l", nominal=2.1402, low=0.0, high=6.0, initial_sigma=0.02, process_sigma=1e-3),
            Signal("c_B", "mol/l", nominal=1.0903, low=0.0, high=6.0, initial_sigma=0.02, process_sigma=1e-3),
            Signal("T", "K", nominal=387.34, low=300.0, high=450.0, initial_sigma=0.2, process_sigma=0.02),
            Signal("T_jacket", "K", nominal=386.06, low=300.0, high=450.0, initial_sigma=0.2, process_sigma=0.02),
        ),
        sensors=(
            Sensor("analyser", "c_B", "mol/l", sigma=0.01),
            *(Sensor(f"reactor_{i}", "T", "K", sigma=0.1, quantity="temperature") for i in (1, 2)),
            *(Sensor(f"jacket_{i}", "T_jacket", "K", sigma=0.1, quantity="temperature") for i in (1, 2)),
        ),
        step=step,
        output=output,
        dt=20.0,
        inputs=(Signal("flow", "1/h", nominal=14.19), Signal("heat", "kJ/h", nominal=-1113.5)),
        numerics=Numerics(step_jacobian=step_jacobian, max_dt=60.0),
    )


if __name__ == "__main__":
    plant = make()
    recording = simulate(plant, 120, seeds=[1])  # 40 minutes of one run
    recording.y[60:, 0, 2] += 0.6  # a bias of 0.6 K of reactor_2
    for event in diagnose("loo-glr", recording, plant=plant).events:
        print(f"{event.hypothesis} from {event.start:.0f} s, {event.size:.1f} {event.unit}")  # reactor_2 from 1220 s, 0.6 K
