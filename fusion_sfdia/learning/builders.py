"""Builders of the named detectors for any plant: usual settings, and healthy data for those that learn.

A builder imports its detector when it is called: to import all of them, and SciPy for them, takes longer than to build one.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.covariance import diagonal
from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.detector import Detector
from fusion_sfdia.detectors.named import FALSE_ALARM
from fusion_sfdia.diagnosis.simulate import Recording, simulate
from fusion_sfdia.filters.enkf import EnKFSettings
from fusion_sfdia.filters.estimators import Ensemble, Estimator, Extended, Unscented
from fusion_sfdia.filters.ukf import SigmaPoints
from fusion_sfdia.plant.plant import Plant

if TYPE_CHECKING:
    from fusion_sfdia.detectors.adaptive_thresholds.adaptive_threshold import AdaptiveThreshold
    from fusion_sfdia.detectors.data_driven.ewma_limits import EwmaLimits
    from fusion_sfdia.detectors.data_driven.fixed_limits import FixedLimits
    from fusion_sfdia.detectors.data_driven.one_class import OneClass
    from fusion_sfdia.detectors.data_driven.pca import PrincipalComponents
    from fusion_sfdia.detectors.kalman_banks.fusing_bank import FusingBank
    from fusion_sfdia.detectors.kalman_banks.sequential_bank import SequentialBank
    from fusion_sfdia.detectors.structural_residuals.structural_residuals import StructuralResiduals
    from fusion_sfdia.learning.frozen_model.frozen_bank import FrozenBank

Array = NDArray[Any]

CALIBRATION_SEEDS = range(900_000, 900_020)  # used by no campaign
CALIBRATION_STEPS = 360
FEW = 4  # runs from which a frozen model is commissioned: its limits are of blocks, not of single samples
WARM_UP = 60  # samples: the printed filters converge slowly
PAPER_UNITS = {"Pa": 1e6}  # Shaheen 2024 computes in MPa, kg/s, K: its residual (20) adds these units

PAPER_FILTERS: dict[str, Estimator] = {  # Shaheen 2024, sec. V-A: alpha, beta and N_e
    "ekf": Extended(),
    "ukf": Unscented(SigmaPoints(alpha=1e-3, beta=2.0), redraw=False),
    "enkf": Ensemble(EnKFSettings(size=40)),
}


def as_printed(plant: Plant) -> Plant:
    """The plant with the process noise that Shaheen 2024 prints: "10% lower than that of the measurement noise".

    The sentence is on the pipeline, all states of which are measured: a plant without `printed_process_noise` keeps its own.
    """
    if (share := plant.printed_process_noise) is None:
        return plant
    sigma = {s.measures: s.noise_sigma for s in plant.sensors}
    stated = np.sqrt(np.broadcast_to(diagonal(plant.process_cov), plant.x0.shape))
    std = [share * sigma[s.name] if s.name in sigma else own for s, own in zip(plant.states, stated, strict=True)]
    return replace(plant, process_cov=np.square(std))


def printed_bank(plant: Plant, kind: str, healthy: Any = None, false_alarm: float = FALSE_ALARM) -> FusingBank:
    """The paper's bank of filters "ekf", "ukf" or "enkf" with the paper's process noise.

    The initial covariance is the plant's; the paper has the identity.
    """
    return fusing_bank(as_printed(plant), kind, healthy, false_alarm)


def fusing_bank(
    plant: Plant, kind: str, healthy: Any = None, false_alarm: float = FALSE_ALARM, feedback: str = "federated"
) -> FusingBank:
    """The paper's bank in the paper's units, its thresholds fitted to healthy readings.

    None for simulated runs of the filters' own model; they are longer for more quantities.
    """
    from fusion_sfdia.detectors.kalman_banks.fusing_bank import FusingBank

    scale = tuple(PAPER_UNITS.get(s.unit, 1.0) for s in plant.states)
    if healthy is None:
        expected = len(plant.quantities) / false_alarm / len(CALIBRATION_SEEDS)
        steps = max(CALIBRATION_STEPS, WARM_UP + int(np.ceil(1.5 * expected)))
        healthy = simulate(plant, steps, CALIBRATION_SEEDS, truth="model", process_noise=plant.truth.disturbed)
    bank = FusingBank(plant, PAPER_FILTERS[kind], residual_scale=scale, feedback=feedback)
    return bank.fit_thresholds(healthy, false_alarm, WARM_UP)


def filterpy_bank(plant: Plant, kind: str, healthy: Any = None, false_alarm: float = FALSE_ALARM) -> FusingBank:
    """`printed_bank` "ekf" or "ukf" of filterpy's filters, run one by one.

    Its thresholds are those of our filters, which a test holds equal: fitting them with filterpy's takes hours on the pipeline.
    """
    from fusion_sfdia.filters.filterpy_estimators import FilterpyExtended, FilterpyUnscented

    filters: dict[str, Estimator] = {"ekf": FilterpyExtended(), "ukf": FilterpyUnscented(redraw=False)}
    return replace(printed_bank(plant, kind, healthy, false_alarm), estimator=filters[kind], literal=True)


def healthy_data(plant: Plant, false_alarm: float = FALSE_ALARM, checks: int = 2) -> Recording:
    """Simulated healthy readings y (K, B, N) of the plant, enough for `checks` limits of each quantity at that rate.

    This is more than needed: all sensors of a plant share one order statistic, so that the samples for a limit do not grow with
    the number of quantities.

    Detectors that learn from data record the real plant. The readings are therefore those of the high-fidelity model where the
    plant has one, with other seeds than the readings that are tested. A higher number of samples takes more runs of
    CALIBRATION_STEPS instead of longer runs: the operation of the gas pipeline varies over that time only.
    """
    expected = 1.5 * 2 * checks * len(plant.quantities) / false_alarm  # every other sample sets limits
    runs = max(len(CALIBRATION_SEEDS), int(np.ceil(expected / CALIBRATION_STEPS)))
    seeds = range(CALIBRATION_SEEDS.start, CALIBRATION_SEEDS.start + runs)
    return simulate(plant, CALIBRATION_STEPS, seeds, process_noise=plant.truth.disturbed)


def settled_readings(plant: Plant, false_alarm: float) -> Array:
    """Healthy readings (K, B, N) for detectors that learn how readings are correlated.

    The first WARM_UP samples of a disturbed plant are left out, because disturbances start from zero (of 0, 5, 20 and 60
    samples, tried on seeds outside the comparison, dynamic-pca needs 60). Runs of other plants begin at their operating point
    and are used in full. The number of runs is that of four checks: these detectors set three limits for all sensors, on most
    of half of the windows.
    """
    return healthy_data(plant, false_alarm, checks=4).y[WARM_UP if plant.truth.disturbed else 0 :]


def structural_residuals(plant: Plant, healthy: Any = None, false_alarm: float = FALSE_ALARM) -> StructuralResiduals:
    """Structural residuals with limits from healthy readings, None for simulated runs.

    NotApplicableError for a plant without scalar equations, MissingPackageError without faultdiagnosistoolbox.
    """
    from fusion_sfdia.detectors.structural_residuals.structural_residuals import StructuralResiduals
    from fusion_sfdia.detectors.structural_residuals.structure import modules_of

    modules_of(plant)  # refuses a plant without scalar equations before the simulation
    return StructuralResiduals.fit(plant, healthy_data(plant, false_alarm) if healthy is None else healthy, false_alarm)


def frozen_model(plant: Plant, healthy: Any = None, false_alarm: float = FALSE_ALARM) -> FrozenBank:
    """A frozen model commissioned on healthy readings, None for simulated runs, with the adaptive bank where that fits them."""
    from fusion_sfdia.learning.frozen_model.commissioned_bank import with_bank
    from fusion_sfdia.learning.frozen_model.frozen_bank import FrozenBank

    if healthy is None:
        runs = max(FEW, int(np.ceil(2 / false_alarm / CALIBRATION_STEPS)))
        seeds = range(CALIBRATION_SEEDS.start, CALIBRATION_SEEDS.start + runs)
        healthy = simulate(plant, CALIBRATION_STEPS, seeds, process_noise=plant.truth.disturbed)
    return with_bank(FrozenBank.fit(plant, healthy, false_alarm), healthy)[0]


def bounded(plant: Plant) -> Detector:
    """Thresholds that bounded noise cannot cross, on a plant's monitoring modules or else on predicted readings."""
    from fusion_sfdia.detectors.stochastic_thresholds.chebyshev import Chebyshev

    if plant.structure.modules is None:
        return Chebyshev(plant, lam=0.0, rule="bound", moments=Extended())
    return adaptive_threshold(plant, "valid")


def adaptive_threshold(plant: Plant, mode: str) -> AdaptiveThreshold:
    """Monitoring modules with thresholds "valid", "paper" or "calibrated"; NotApplicableError for a plant without modules."""
    from fusion_sfdia.detectors.adaptive_thresholds.adaptive_threshold import AdaptiveThreshold

    detector = AdaptiveThreshold(plant)  # refuses a plant without modules
    assert plant.structure.modules is not None
    if mode == "paper":
        return replace(detector, observer_bounds=plant.structure.modules.observer_bounds)
    return replace(detector, margins=plant.structure.modules.margins) if mode == "calibrated" else detector


def sequential(plant: Plant, rule: str, *, leave_one_out: bool = False) -> SequentialBank:
    """A sequential test and a test of the present sample for each sensor of a plant, at FALSE_ALARM."""
    from fusion_sfdia.detectors.kalman_banks.sequential_bank import SequentialBank
    from fusion_sfdia.detectors.kalman_banks.sequential_rules import Cusum, Ewma, SequentialRule, Shewhart, SumOfSquares

    rules: dict[str, SequentialRule] = {"window": SumOfSquares(15), "cusum": Cusum(1.0), "ewma": Ewma(0.2)}
    return SequentialBank(plant, (Shewhart(), rules[rule]), leave_one_out, false_alarm=FALSE_ALARM)


def fixed_limits(plant: Plant, healthy: Any = None, false_alarm: float = FALSE_ALARM) -> FixedLimits:
    """Limits of readings and of their changes, from healthy readings, None for simulated runs."""
    from fusion_sfdia.detectors.data_driven.fixed_limits import FixedLimits

    return FixedLimits.fit(plant, healthy_data(plant, false_alarm) if healthy is None else healthy, false_alarm)


def ewma_limits(plant: Plant, healthy: Any = None, false_alarm: float = FALSE_ALARM) -> EwmaLimits:
    """Limits of readings, of their changes and of their moving averages, from healthy readings, None for simulated runs."""
    from fusion_sfdia.detectors.data_driven.ewma_limits import EwmaLimits

    return EwmaLimits.fit(plant, healthy_data(plant, false_alarm, checks=3) if healthy is None else healthy, false_alarm)


def principal_components(
    plant: Plant, healthy: Any = None, false_alarm: float = FALSE_ALARM, *, lags: int = 0
) -> PrincipalComponents:
    """Principal components of present readings and of `lags` before them, from healthy readings, None for simulated runs."""
    from fusion_sfdia.detectors.data_driven.pca import PrincipalComponents

    data = settled_readings(plant, false_alarm) if healthy is None else healthy
    return PrincipalComponents.fit(plant, data, false_alarm, lags=lags)


def one_class(plant: Plant, healthy: Any = None, false_alarm: float = FALSE_ALARM) -> OneClass:
    """A one-class support vector machine, from healthy readings, None for simulated runs."""
    from fusion_sfdia.detectors.data_driven.one_class import OneClass

    return OneClass.fit(plant, settled_readings(plant, false_alarm) if healthy is None else healthy, false_alarm)


def fit(
    name: str | registry.NamedDetector,
    plant: Plant | str,
    healthy: Any = None,
    false_alarm: float = FALSE_ALARM,
    **unknown: Any,
) -> Detector:
    """The registered detector of that name, fitted to healthy readings; one that does not learn gets its thresholds from them.

    The counterpart of `BatchDetector.fit` for names.

    Parameters
    ----------
    name : str or NamedDetector
        A registered name.
    plant : Plant or str
        An object or a name.
    healthy : Recording, Log, frame or tuple, optional
        As `as_log` takes it; None for simulated runs of the plant, enough for the rate, with the seeds on which registered
        detectors are fitted.
    false_alarm : float, default 1e-3
        Rate per step over all sensors.
    **unknown
        Any other setting is refused.

    Returns
    -------
    Detector
        On that plant.

    Raises
    ------
    ValueError
        For unknown names and any other setting, and where the readings do not fit or are too few.
    NotApplicableError
        As the detector raises it.

    Examples
    --------
    >>> from fusion_sfdia import simulate
    >>> from fusion_sfdia.learning import fit
    >>> from fusion_sfdia.plants import two_tanks
    >>> plant = two_tanks()
    >>> limits = fit("limits", plant, simulate(plant, 300, seeds=range(4), process_noise=True), false_alarm=0.01)
    >>> type(limits).__name__, limits.fitted_rate
    ('FixedLimits', 0.01)
    """
    if unknown:
        raise ValueError(
            f"fit has no settings {', '.join(unknown)}; it has healthy and false_alarm: build the detector's class with its "
            "own settings and call its fit_thresholds"
        )
    plant, named = registry.plant(plant), registry.find_detector(name)
    if named.learns:
        return named.build(plant, healthy=healthy, false_alarm=false_alarm)
    detector = registry.detector(named, plant)
    return detector.fit_thresholds(healthy_data(plant, false_alarm) if healthy is None else healthy, false_alarm)
