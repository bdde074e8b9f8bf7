"""The diagnosers of a plant's areas are those of the network."""

from __future__ import annotations

import numpy as np
from chebyshev_runs import ERROR, SETTLED, STEPS, WATCHING, decisions, healthy, network, network_areas_of
from toy_plants import changed

from fusion_sfdia.core.plant import Plant
from fusion_sfdia.stochastic_thresholds.chebyshev import Chebyshev
from fusion_sfdia.stochastic_thresholds.consensus import predict, take


def test_the_diagnosers_of_a_plant_are_those_of_its_areas() -> None:
    t, y, u = (a[:, :2] if a.ndim > 1 else a for a in healthy("network"))
    d = decisions(Chebyshev(network(), **WATCHING), (t, y, u))
    areas = network_areas_of(network())
    now = Chebyshev(network()).init((2,)).memory.diagnoser
    for k in range(STEPS):
        ahead = predict(areas, now, u[k, :, :15], u[k, :, 15:], 0.3, "corrected")
        now = take(areas, ahead, y[k, :, :60].reshape(2, 15, 4), y[k, :, 60:])
        both = np.concatenate([ahead.estimate.reshape(2, 60), ahead.estimate_shared], axis=-1)
        np.testing.assert_allclose(d.residual[k], y[k] - both, atol=100 * np.finfo(float).eps)  # a compiled sum of 20 terms


def partly_measured() -> Plant:
    """The power network; of areas 2, 7 and 13 only angle and speed are read."""
    whole = network()
    keep = [i for i, s in enumerate(whole.sensors) if s.name not in {f"{p}_{a}" for p in ("p_m", "p_v") for a in (2, 7, 13)}]
    jacobian = whole.numerics.output_jacobian
    assert jacobian is not None
    return changed(
        whole,
        sensors=tuple(whole.sensors[i] for i in keep),
        output=lambda t, x, u: whole.output(t, x, u)[..., keep],
        output_jacobian=lambda t, x, u: jacobian(t, x, u)[keep],
        finer=None,
    )


def test_areas_that_read_only_angle_and_speed() -> None:
    plant, whole = partly_measured(), network()
    kept = [whole.sensor_index(name) for name in plant.sensor_names]
    t, y, u = healthy("network")
    d = decisions(Chebyshev(plant, rule="gaussian", alpha=1.0, **WATCHING), (t, y[..., kept], u))
    full = decisions(Chebyshev(whole, rule="gaussian", alpha=1.0, **WATCHING), (t, y, u))
    z = (d.residual / d.threshold)[SETTLED:]
    assert np.all(np.sqrt(np.mean(z**2, axis=(0, 1))) < 1 + ERROR)
    own = np.array([s.name in {f"{p}_{a}" for p in ("omega",) for a in (2, 7, 13)} for s in plant.sensors])
    wider = d.threshold[-1, 0] / full.threshold[-1, 0, kept]
    assert np.all(wider[own] > 1.0) and np.all(wider >= 1 - 1e-12) and wider.max() < 3
    far = np.array([s.owner == "area 10" and s.name != "theta_7@10" for s in plant.sensors]) & (wider == 1.0)
    np.testing.assert_array_equal(d.residual[..., far], full.residual[:, :, kept][..., far])
    faulty = y[..., kept].copy()
    i = plant.sensor_index("omega_7")
    faulty[25:, :20, i] += 60 * plant.sensor_sigma[i]
    found = decisions(Chebyshev(plant, lam=0.0, alpha=5.0), (t, faulty[:, :20], u[:, :20]))
    assert np.mean(found.isolated[25:, :, i]) > 0.9
