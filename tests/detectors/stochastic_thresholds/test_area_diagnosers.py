"""The diagnosers of a plant's areas are those of the network."""

from __future__ import annotations

import numpy as np
from chebyshev_runs import ERROR, SETTLED, STEPS, WATCHING, decisions, healthy, network, network_areas_of
from toy_plants import changed

from fusion_sfdia.detectors.batch_detector import TimeStep
from fusion_sfdia.detectors.stochastic_thresholds.chebyshev import Chebyshev
from fusion_sfdia.detectors.stochastic_thresholds.consensus import Diagnosers, predict, take
from fusion_sfdia.detectors.stochastic_thresholds.present_readings import PredictedReadings
from fusion_sfdia.plant.plant import Array, Plant


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


def test_effects_of_readings_pass_through_estimates_of_unread_states() -> None:
    """The equations are linear: a reading that is larger by 1 changes the next expected ones by its effect as a held value less
    that as a residual; without it, the prediction is that without the fault, of unread states, too."""
    plant = partly_measured()
    t, y, u = healthy("network")
    y = y[:2, :2, [network().sensor_index(name) for name in plant.sensor_names]].copy()
    y[1, 1, plant.sensor_index("omega_13")] = np.nan
    diagnoser = Chebyshev(plant).diagnoser
    memory, rows, partly = (
        diagnoser.start((2,), 0),
        np.ones(2, bool),
        [network_areas_of(network()).network.topology.index(a) for a in ("2", "7", "13")],
    )

    def after(readings: Array) -> tuple[Diagnosers, PredictedReadings]:
        now = memory
        for k in range(2):
            now = diagnoser.take(diagnoser.predict(now, step_at(k), u[k, :2]), readings[k]).memory
        return now, diagnoser.predict(now, step_at(2), u[2, :2])

    def step_at(k: int) -> TimeStep:
        return TimeStep(float(t[k]) - plant.dt, float(t[k]), plant.dt, 0, k)

    now, expected = after(y)
    held, residual = diagnoser.effects(now, expected, step_at(2), u[2, :2], rows)
    for name in ("theta_7", "omega_7", "omega_4", "theta_7@10"):
        i, size = plant.sensor_index(name), 0.5
        more = y.copy()
        more[1, :, i] += size
        later, faulty = after(more)
        change = faulty.expected - expected.expected
        np.testing.assert_allclose(change, size * (held - residual)[:, :, i], atol=1e-12)  # sums of terms up to 10
        sizes = np.zeros((2, len(plant.sensors)))
        sizes[:, i] = size
        mended = diagnoser.without_faults(later, faulty, step_at(2), u[2, :2], sizes, 0.1 * sizes)
        np.testing.assert_allclose(mended.inner.ahead[:, partly], expected.inner.ahead[:, partly], atol=1e-12)
        wider = mended.inner.covariance - expected.inner.covariance
        assert np.all(np.diagonal(wider, axis1=-2, axis2=-1) >= 0) and (name != "omega_7" or np.any(wider > 0))
