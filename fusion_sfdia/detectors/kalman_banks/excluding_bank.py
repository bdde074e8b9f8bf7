"""Common parts of banks on one central filter that leave out isolated sensors: their settings and the end of a step."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import probability
from fusion_sfdia.detectors.batch_detector import AccommodatingDetector, TimeStep
from fusion_sfdia.detectors.detector import Decision
from fusion_sfdia.detectors.exclusion import Exclusion, exclude, readmit, restored
from fusion_sfdia.detectors.health import broken
from fusion_sfdia.detectors.kalman_banks.leave_one_out import LeaveOneOut, normalised_innovation_squared
from fusion_sfdia.filters.estimators import Estimator, Prior, require_consistent
from fusion_sfdia.filters.gaussian import Joint
from fusion_sfdia.filters.sparse import variances
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.redundancy import redundancy, require_max_faults

Array = NDArray[Any]


class ExclusionUpdate(NamedTuple):
    """The update of a step: estimate x (..., n), covariance p (..., n, n), and the statistics of the readings used.

    at_rest: whether p is one that was found to be finite.
    """

    x: Array
    p: Array
    prior: Prior
    joint: Joint
    found: LeaveOneOut
    at_rest: bool = False


class SensorTests(NamedTuple):
    """Test results of the sensors (..., N).

    usable: in use before the step. isolated: in this step. residual, threshold; size: of the fault. capped (...): another
    sensor would be isolated without max_faults. limit: chi-square limit on the readings of excluded sensors.
    """

    usable: Array
    isolated: Array
    residual: Array
    threshold: Array
    size: Array
    capped: Array
    limit: float


def least_change(H: Array, scale: Array) -> Array:
    """The least change g (..., N, n) of the states, in units of D = diag(scale), that each reading h g = 1 shows, h a row of H
    (..., N, n): D^2 h' / (h D^2 h'), 0 where h is 0.
    """
    scaled = H * scale**2
    shown = np.sum(scaled * H, axis=-1, keepdims=True)
    return np.asarray(scaled / np.where(shown > 0, shown, 1.0))


class ExcludingBank(AccommodatingDetector):
    """A bank with these settings; each bank declares them with its own defaults and documents them."""

    estimator: Estimator
    false_alarm: float

    def __post_init__(self) -> None:
        super().__post_init__()
        require_consistent(self.estimator)
        probability("false_alarm", self.false_alarm)
        require_max_faults(self.plant, self.max_faults)

    @property
    def filter_model(self) -> Plant:
        return self.model

    @property
    def model(self) -> Plant:
        """The plant whose state the filter estimates."""
        return self.plant

    def _readmitted(self, memory: Any, t: float, which: Array) -> Any:
        """For each of `which` (..., N) that was out and alone sees a lasting mode: P + f^2 g g', f the size of its fault, g the
        `least_change` of the state that it shows.
        """
        (x, p), exclusion = memory.estimate, memory.exclusion
        changes = least_change(self.model.output_jacobian_at(t, x, self.model.input_at(t)), self.model.state_scale)
        for i in [i for i in map(self.plant.sensor_index, redundancy(self.plant).indispensable) if np.any(which[..., i])]:
            g = changes[..., i, :]
            size = np.where(exclusion.out[..., i] & which[..., i], exclusion.size[..., i], 0.0)
            p = p + (size**2)[..., None, None] * g[..., :, None] * g[..., None, :]
        return memory._replace(estimate=memory.estimate._replace(P=p), exclusion=restored(exclusion, which))

    def _conclude(
        self, now: TimeStep, y: Array, u: Array, exclusion: Exclusion, update: ExclusionUpdate, tested: SensorTests
    ) -> tuple[Exclusion, Decision]:
        """Exclude the isolated sensors and readmit those that are healthy again; without `accommodate` only report them.

        Return the exclusions and the Decision.
        """
        plant, (x, p, prior, joint, found, at_rest) = self.model, update
        lost = ~np.isfinite(x).all(axis=-1) if at_rest else broken(x, p)
        common = {
            "estimate": x, "diverged": prior.lost | lost, "guarded": prior.guarded,
            "nis": normalised_innovation_squared(joint, found, y), "covariance": p, "capped": tested.capped,
        }  # fmt: skip
        if tested.usable.all() and not tested.isolated.any():  # no reading to replace, none to compare with the others
            decision = Decision(
                reconstruction=y.copy(),
                residual=tested.residual,
                threshold=tested.threshold,
                isolated=tested.isolated,
                fault_size=np.full(y.shape, np.nan),
                **common,
            )
            return exclusion, decision
        expected = plant.output(now.t, x, u)
        h = plant.output_jacobian_at(now.t, x, u)
        variance = (variances(h, p) if plant.sparse[1] else np.sum((h @ p) * h, axis=-1)) + plant.sensor_cov
        error = plant.near(y, expected) - expected  # used for excluded sensors, which do not enter `expected`
        if self.accommodate:
            exclusion = readmit(exclusion, error, variance, tested.limit, -np.log(self.false_alarm / y.shape[-1]))
            exclusion = exclude(exclusion, tested.isolated, error)
        held = exclusion.out if self.accommodate else tested.isolated
        outside = np.isfinite(y) & ~tested.usable
        decision = Decision(
            reconstruction=np.where(np.isfinite(y) & ~held, y, expected),
            residual=np.where(outside, error, np.where(tested.usable, tested.residual, np.nan)),
            threshold=np.where(outside, np.sqrt(tested.limit * variance), tested.threshold),
            isolated=held,
            fault_size=np.where(held, exclusion.size if self.accommodate else tested.size, np.nan),
            **common,
        )
        return exclusion, decision
