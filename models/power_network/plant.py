"""The plant `power-network`: generation areas joined by tie lines (Boem et al. 2018, "B18", sec. VIII).

Each area i has the states theta_i, omega_i, p_m_i, p_v_i with a sensor for each. Its neighbours j read theta_i too, by the
sensors theta_i@j: 60 + 34 sensors for 15 areas with 17 ties, the 94 states of B18's diagnosers. The inputs are the references
and the loads, reference_i and load_i. Equations: equations.py. Parameters and their provenance: parameters.toml.

Omissions and errors of the paper, and the choices made here:
- The slopes of the ties are in a figure that the text at hand lacks: recalled for the first five areas, our choice for the
  others. The same holds for the steps of the loads.
- "sigma_w^2 = 0.0001 and sigma_rho^2 = 0.0001 for noises associated with P_m and P_v, and sigma_rho^2 = 0.00001 for theta and
  omega" can be read in two ways: noise="lit" for a process variance of 1e-4 in all states, "small" for 1e-5 in theta, omega.
- The discretisation is not stated. Local diagnosers can discretise area by area at dt = 1 s (the default); "exact" is the
  high-fidelity model of simulations.
- With the reference and the neighbours' angles held, theta_i+ depends on all of x_i, P_ref, P_L and these angles. Areas that
  share theta_i therefore need one more number from area i: theta_i+ without the term of theta_i itself. They must also know
  the loads.
- Sec. VI-A sets the angle sent by an unplugged area to zero. That is not enough: A_ii contains sum_j P_ij, which changes too.
- An unplugged area continues to run in isolation from the others.

The angles have one common mode without restoring force, so that an open loop drifts. The usual operation is therefore in closed
loop, with references by control.generation_control.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.models.power_network.control import generation_control
from fusion_sfdia.models.power_network.diagnosis import network_areas
from fusion_sfdia.models.power_network.equations import STATES, area_rates
from fusion_sfdia.models.power_network.model import NOISE_VARIANCE, NetworkModel, network_model
from fusion_sfdia.models.power_network.operation import AreaFault, NetworkCondition, Switch, load_profile, network_conditions
from fusion_sfdia.models.power_network.parameters import (
    LoadStep,
    NetworkParameters,
    generate_network,
    load_network,
    load_steps,
)
from fusion_sfdia.models.power_network.unknown import network_uncertainty, rebuilt_uncertainty
from fusion_sfdia.plant.linear import constant, picked
from fusion_sfdia.plant.physics import Physics
from fusion_sfdia.plant.plant import Numerics, Plant, Structure, Truth, with_same_states
from fusion_sfdia.plant.signals import Sensor, Signal

Array = NDArray[Any]

PAPER_AREAS = 15
UNIT = {"theta": "rad", "omega": "rad/s", "p_m": "1", "p_v": "1"}
MEANING = {
    "theta": "rotor angle of area {}",
    "omega": "deviation of the speed of area {}",
    "p_m": "mechanical power of area {}",
    "p_v": "valve position of area {}",
    "reference": "power reference of area {}",
    "load": "load of area {}",
}
CHECK = {
    "reference": "Check that the units of the area follow their set points.",
    "load": "Check the metering of the area's load.",
}
QUANTITY = {"theta": "angle", "omega": "speed", "p_m": "mechanical power", "p_v": "valve"}


def power_network(
    areas: int | NetworkParameters = PAPER_AREAS,
    *,
    seed: int = 0,
    unplugged: Iterable[str] = (),
    dt: float = 1.0,
    noise: str = "lit",
    discretisation: str = "area-by-area",
    loads: Sequence[LoadStep] | None = None,
    faults: Sequence[AreaFault] = (),
    switches: Sequence[Switch] = (),
) -> Plant:
    """Return a network of at most 250 areas as a plant; larger ones are a `network_model`, without a name for each state.

    Parameters
    ----------
    areas : int or NetworkParameters, default 15
        15 for those of B18, another number for a network generated from `seed`, or parameters.
    seed : int, default 0
        Of a generated network.
    unplugged : iterable of str, default ()
        Areas that are not plugged in and run by themselves, as in `network_model`.
    dt : float, default 1
        Seconds between readings.
    noise : str, default "lit"
        "lit" or "small", of the process, as in `network_model`.
    discretisation : str, default "area-by-area"
        "area-by-area" or "exact", as in `network_model`.
    loads : sequence of LoadStep, optional
        Steps of the loads in the usual operation; None for those of B18's scenario 1 in the areas that exist.
    faults : sequence of AreaFault, default ()
        Of a network that is a truth for the detectors of a healthy one.
    switches : sequence of Switch, default ()
        Of such a network.

    Returns
    -------
    Plant
        Of Boem et al. 2018 (B18).

    Raises
    ------
    ValueError
        For settings that do not fit.

    Examples
    --------
    >>> from fusion_sfdia.plants import power_network
    >>> plant = power_network(loads=())
    >>> len(plant.states), len(plant.sensors)
    (60, 94)
    """
    if isinstance(areas, NetworkParameters):
        c = areas
    else:
        c = load_network() if areas == PAPER_AREAS else generate_network(areas, seed)
    away, faults, switches = tuple(unplugged), tuple(faults), tuple(switches)
    model = network_model(c, unplugged=away, dt=dt, noise=noise, discretisation=discretisation)
    model.require_dense()
    names, n = model.names, len(model.names)
    profile = load_profile(model, [s for s in load_steps("1") if s.area in names] if loads is None else loads)
    states = network_states(names)
    sensors = network_sensors(model)
    place = {s.name: k for k, s in enumerate(states)}
    picks = np.array([place[s.measures] for s in sensors])
    readout = np.zeros((len(sensors), 4 * n))
    readout[np.arange(len(sensors)), picks] = 1.0
    running = _Running(n, network_conditions(model, faults, switches), profile)
    exact = partial(
        power_network, c, unplugged=away, dt=dt, noise=noise, discretisation="exact", loads=loads, faults=faults,
        switches=switches,
    )  # fmt: skip
    plant = Plant(
        name="power-network",
        states=states,
        inputs=network_inputs(names),
        sensors=sensors,
        step=running.step,
        output=partial(picked, picks),
        dt=model.dt,
        x0=np.zeros(4 * n),
        initial_cov=np.tile(NOISE_VARIANCE, n),
        process_cov=np.tile(model.process_cov, n),
        numerics=Numerics(running.step_jacobian, partial(constant, readout), fixed_dt=True),
        truth=Truth(
            operation=running.operation,
            feedback=running.feedback,
            finer=None if discretisation == "exact" else partial(with_same_states, exact),
            disturbed=True,
        ),
        structure=Structure(areas=network_areas(model)),
    )
    if faults:
        return plant
    if discretisation == "exact":
        again = partial(
            power_network, unplugged=away, dt=dt, noise=noise, discretisation="exact", loads=loads, switches=switches
        )
        return replace(plant, uncertainty=rebuilt_uncertainty(plant, c, again))
    return replace(plant, uncertainty=network_uncertainty(c, running.condition, readout))


@dataclass(frozen=True, eq=False)
class _Running:
    """The functions of a plant of n areas, from its condition and its loads (n,) as functions of time (s)."""

    n: int
    condition: Callable[[float], NetworkCondition]
    profile: Callable[[float], Array]

    def step(self, t_start: float, x: Array, u: Array, dt: float) -> Array:
        n = self.n
        after = self.condition(t_start).step(x.reshape(*x.shape[:-1], n, 4), u[..., :n], u[..., n:])
        return after.reshape(*after.shape[:-2], 4 * n)

    def step_jacobian(self, t_start: float, x: Array, u: Array, dt: float) -> Array:
        return self.condition(t_start).true.matrices[0]

    def operation(self, t: float) -> Array:
        return np.tile(self.profile(t), 2)

    def feedback(self, t: float, y: Array, u: Array) -> Array:
        n, load = self.n, u[..., self.n :]
        reference = generation_control(self.condition(t).known, y[..., : 4 * n].reshape(*y.shape[:-1], n, 4), load)
        return np.concatenate([reference, np.broadcast_to(load, reference.shape)], axis=-1)


def network_states(names: Sequence[str]) -> tuple[Signal, ...]:
    """Four states of each area."""
    return tuple(Signal(f"{s}_{i}", UNIT[s], meaning=MEANING[s].format(i)) for i in names for s in STATES)


def network_inputs(names: Sequence[str]) -> tuple[Signal, ...]:
    """The references, then the loads of the areas."""
    return tuple(Signal(f"{s}_{i}", meaning=MEANING[s].format(i), check=CHECK[s]) for s in CHECK for i in names)


def network_sensors(model: NetworkModel) -> tuple[Sensor, ...]:
    """Four sensors of each area, then theta_j@i at each side of a tie: the angle of neighbour j, read by area i."""
    names, at = model.names, model.network.topology
    sigma = dict(zip(STATES, np.sqrt(NOISE_VARIANCE), strict=True))
    shared = [
        (f"theta_{names[j]}", f"theta_{names[j]}@{names[i]}", names[i], names[j])
        for i, j in zip(at.node, at.neighbour, strict=True)
    ]
    return (
        *(
            Sensor(
                f"{s}_{i}",
                f"{s}_{i}",
                UNIT[s],
                sigma=float(sigma[s]),
                owner=f"area {i}",
                quantity=QUANTITY[s],
                meaning=MEANING[s].format(i),
            )
            for i in names
            for s in STATES
        ),
        *(
            Sensor(
                name,
                variable,
                UNIT["theta"],
                sigma=float(sigma["theta"]),
                owner=f"area {i}",
                quantity=QUANTITY["theta"],
                meaning=f"{MEANING['theta'].format(j)}, read by area {i},",
            )
            for variable, name, i, j in shared
        ),
    )


def network_physics(model: NetworkModel) -> Physics:
    """The network as physics before discretisation: the same scalar equations over all areas."""
    return Physics(
        name="power-network",
        states=network_states(model.names),
        inputs=network_inputs(model.names),
        f=partial(_rates, model),
    )


def _rates(model: NetworkModel, t: float, x: Array, z: Array, u: Array, c: Any) -> Array:
    n = len(model.names)
    H, R, D, T_t, T_g = model.constants.T
    state = x.reshape(*x.shape[:-1], n, 4)
    external = model.external(state[..., 0], u[..., n:])
    theta, omega, p_m, p_v = (state[..., k] for k in range(4))
    rates = area_rates(theta, omega, p_m, p_v, u[..., :n], external, model.stiffness, H, R, D, T_t, T_g)
    both: Array = np.stack(np.broadcast_arrays(*rates), axis=-1)
    return both.reshape(*both.shape[:-2], 4 * n)
