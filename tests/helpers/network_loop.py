"""The network of 15 areas: its rates of change, and runs in closed loop under its first load steps."""

from __future__ import annotations

import numpy as np

from fusion_sfdia.models.power_network.model import NetworkModel, network_model
from fusion_sfdia.models.power_network.operation import load_profile
from fusion_sfdia.models.power_network.parameters import load_steps
from fusion_sfdia.models.power_network.plant import network_physics
from fusion_sfdia.models.power_network.simulation import NetworkSample, run_network

MODEL = network_model()
LOADS = load_profile(MODEL, load_steps("1"))


def closed_loop(control: object, steps: int = 90, model: NetworkModel = MODEL, **settings: object) -> list[NetworkSample]:
    settings = {"loads": LOADS, "seeds": [0], "process_noise": False} | settings
    return list(run_network(model, steps, control=control, **settings))  # type: ignore[arg-type]


def rates(model: NetworkModel, x: np.ndarray, reference: np.ndarray, load: np.ndarray) -> np.ndarray:
    physics = network_physics(model)
    n = len(model.names)
    flat = x.reshape(*x.shape[:-2], 4 * n)
    u = np.concatenate(np.broadcast_arrays(reference, load), axis=-1)
    return physics.f(0.0, flat, flat[..., :0], u, None).reshape(*flat.shape[:-1], n, 4)
