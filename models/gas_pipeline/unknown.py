"""What is not known of the gas pipeline: of the pipe, the ground, the gas and the inputs.

The usual operation hardly tells some of the parameters apart. After 50 minutes the estimates of roughness and gas constant
have the correlation -0.97, since both act by the loss of pressure, and those of ground temperature and heat transfer 0.89,
since both act by h (T - T_ground). The length and diameter of the pipe are known far better than all of these. What leaks just
before the outlet is an error of m_outlet.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.models.gas_pipeline.equations import UNKNOWN, PipelineParameters
from fusion_sfdia.plant.uncertainty import Parameter, PriorSpread

Array = NDArray[Any]

SPREAD = {
    "roughness": PriorSpread("m", 0.3, 0.0, "tables give pipes of one kind a factor of two; 30 % is our choice"),
    "ambient": PriorSpread("K", 2.5, 0.1, "ground at laying depth follows the seasons by several kelvin, by one in a week"),
    "heat_transfer": PriorSpread(
        "W/(m2 K)", 0.3, 0.0, "conductivity of soil: by a factor of two between dry and wet; our choice"
    ),
    "gas_constant": PriorSpread(
        "J/(kg K)",
        0.01,
        0.001,
        "molar masses of natural gases of one quality differ by some percent; our choice",
    ),
}
INPUT_ERRORS = {  # our choices from usual classes of instruments
    "p_inlet": 4e3,  # Pa: 0.04 % of a transmitter's range of 10 MPa
    "T_inlet": 0.3,  # K: a resistance thermometer of class B
    "m_outlet": 3.0,  # kg/s: 1 % of the initial flow, an orifice or ultrasonic meter; also what leaks before it
}


def unknown_of(c: PipelineParameters) -> Array:
    """Positions (p,) in UNKNOWN of what a pipe has: no roughness with a friction factor, no heat transfer when insulated."""
    amounts = {"roughness": c.roughness * (c.friction == 0), "heat_transfer": c.heat_transfer}
    return np.array([j for j, name in enumerate(UNKNOWN) if amounts.get(name, 1) > 0])


def unknown_parameters(c: PipelineParameters) -> tuple[Parameter, ...]:
    """The parameters at these positions, with their spreads."""
    found = []
    for name in (UNKNOWN[j] for j in unknown_of(c)):
        low = 0.0 if name == "heat_transfer" else np.finfo(float).tiny
        found.append(SPREAD[name].parameter(name, float(getattr(c, name)), low))
    return tuple(found)
