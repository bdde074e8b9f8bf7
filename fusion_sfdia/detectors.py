"""The named detectors of the command line, built for any plant."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.adaptive_thresholds.adaptive_threshold import AdaptiveThreshold
from fusion_sfdia.adaptive_thresholds.virtual_sensors import VirtualSensors
from fusion_sfdia.core.detector import Detector
from fusion_sfdia.core.plant import Plant, diagonal
from fusion_sfdia.data_driven.ewma_limits import EwmaLimits
from fusion_sfdia.data_driven.fixed_limits import FixedLimits
from fusion_sfdia.data_driven.one_class import OneClass
from fusion_sfdia.data_driven.pca import PrincipalComponents
from fusion_sfdia.evaluation.simulate import Recording, simulate
from fusion_sfdia.filters.estimators import Ensemble, Estimator, Extended, Unscented
from fusion_sfdia.kalman_banks.central_filter import CentralFilter
from fusion_sfdia.kalman_banks.fusing_bank import FusingBank
from fusion_sfdia.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.kalman_banks.memory_rules import Cusum, Ewma, Rule, Shewhart, SumOfSquares
from fusion_sfdia.kalman_banks.moving_horizon_bank import MovingHorizon
from fusion_sfdia.kalman_banks.multiple_model import MultipleModel
from fusion_sfdia.kalman_banks.sequential_bank import SequentialBank
from fusion_sfdia.kalman_banks.unknown_input import UnknownInputFilter
from fusion_sfdia.stochastic_thresholds.chebyshev import Chebyshev
from fusion_sfdia.structural_residuals.structural_residuals import StructuralResiduals
from fusion_sfdia.structural_residuals.structure import modules_of

Array = NDArray[Any]

FALSE_ALARM = 1e-3  # per step over all sensors, of every detector here
CALIBRATION_SEEDS = range(900_000, 900_020)  # apart from those of any campaign
CALIBRATION_STEPS = 360
WARM_UP = 60  # samples: the printed filters are slow to forget how they began
CHEBYSHEV_ALPHA = 5.0  # a component alarms falsely in at most 1/25 of all steps, of Gaussian noise in 6e-7
PAPER_PROCESS = {"gas-pipeline": 0.9}  # of the sigma of a state's sensor: Shaheen 2024, sec. V, of its own plant
PAPER_UNITS = {"Pa": 1e6}  # Shaheen 2024 computes in MPa, kg/s, K: its residual (20) adds them as they are

PAPER_FILTERS: dict[str, Estimator] = {"ekf": Extended(), "ukf": Unscented(redraw=False), "enkf": Ensemble()}


def as_printed(plant: Plant) -> Plant:
    """The plant with the process noise that Shaheen 2024 prints for the filters of its own: "10% lower than that of the
    measurement noise". The sentence is on the pipeline, all states of which are measured; on other plants the bank has
    their own process noise, as every detector has.
    """
    if (share := PAPER_PROCESS.get(plant.name)) is None:
        return plant
    sigma = {s.measures: s.noise_sigma for s in plant.sensors}
    unread = np.sqrt(np.broadcast_to(diagonal(plant.process_cov), plant.x0.shape))
    std = [share * sigma[s.name] if s.name in sigma else own for s, own in zip(plant.states, unread, strict=True)]
    return replace(plant, process_cov=np.square(std))


@dataclass(frozen=True)
class Learnt:
    """How a detector that learns is built.

    fit: of plant, healthy readings and rate of false alarms. simulated: of plant and rate, the readings where none are given.
    """

    fit: Callable[[Plant, Any, float], Detector]
    simulated: Callable[[Plant, float], Any]

    def __call__(self, plant: Plant) -> Detector:
        """Fit to simulated readings at FALSE_ALARM."""
        return self.fit(plant, self.simulated(plant, FALSE_ALARM), FALSE_ALARM)


def fusing_bank(plant: Plant, kind: str, healthy: Any = None, false_alarm: float = FALSE_ALARM) -> FusingBank:
    """The paper's bank in the paper's units, its thresholds fitted to healthy readings, None for simulated runs."""
    scale = tuple(PAPER_UNITS.get(s.unit, 1.0) for s in plant.states)
    bank = FusingBank(plant, PAPER_FILTERS[kind], residual_scale=scale)
    return bank.fit_thresholds(bank_data(plant, false_alarm) if healthy is None else healthy, false_alarm, WARM_UP)


def paper_bank(kind: str) -> Learnt:
    """`fusing_bank` with the process noise that the paper prints for its plant."""
    return Learnt(
        lambda plant, healthy, rate: fusing_bank(as_printed(plant), kind, healthy, rate),
        lambda plant, rate: bank_data(as_printed(plant), rate),
    )


def bank_data(plant: Plant, false_alarm: float) -> Recording:
    """Healthy runs of the plant as the filters know it, longer for more quantities."""
    expected = len(plant.quantities) / false_alarm / len(CALIBRATION_SEEDS)
    steps = max(CALIBRATION_STEPS, WARM_UP + int(np.ceil(1.5 * expected)))
    return simulate(plant, steps, CALIBRATION_SEEDS, truth="model", process_noise=plant.disturbed)


def healthy_data(plant: Plant, false_alarm: float = FALSE_ALARM, checks: int = 2) -> Recording:
    """Healthy readings y (K, B, N) of the plant's truth, runs enough for `checks` limits of each quantity at that rate.

    More than it takes: all sensors of a plant share one order statistic, so that the samples for a limit do not grow with the
    quantities. The number of runs is kept, since the thresholds depend on it.

    A detector that learns from data records the plant, not its model: so the finer truth where there is one, as for the
    readings judged, of other seeds. Runs of CALIBRATION_STEPS, more of them rather than longer: for that long the operation of
    the gas pipeline moves.
    """
    expected = 1.5 * 2 * checks * len(plant.quantities) / false_alarm  # every other sample sets limits
    runs = max(len(CALIBRATION_SEEDS), int(np.ceil(expected / CALIBRATION_STEPS)))
    seeds = range(CALIBRATION_SEEDS.start, CALIBRATION_SEEDS.start + runs)
    return simulate(plant, CALIBRATION_STEPS, seeds, process_noise=plant.disturbed)


def settled_readings(plant: Plant, false_alarm: float) -> Array:
    """Healthy readings (K, B, N) for detectors that learn how readings move together.

    Of a disturbed plant without the first WARM_UP samples, in which disturbances build up from none at all
    (of 0, 5, 20 and 60 that were tried on seeds of no comparison, 60 served dynamic-pca); of others a run
    begins at their operating point, and is learnt from there. Runs as for four checks: these detectors set three limits for all
    sensors, on the better part of half the windows.
    """
    return healthy_data(plant, false_alarm, checks=4).y[WARM_UP if plant.disturbed else 0 :]


def module_readings(plant: Plant, false_alarm: float) -> Recording:
    """`healthy_data` of a plant with scalar equations; NotApplicableError, before anything is simulated, for any other."""
    modules_of(plant)
    return healthy_data(plant, false_alarm)


def bounded(plant: Plant) -> Detector:
    """Thresholds that bounded noise cannot cross: of a plant's monitoring modules, or else of predicted readings."""
    if plant.modules is None:
        return Chebyshev(plant, lam=0.0, rule="bound", moments=Extended())
    return adaptive_threshold(plant, "valid")


def adaptive_threshold(plant: Plant, mode: str) -> AdaptiveThreshold:
    """Monitoring modules with thresholds as the mode says; NotApplicableError for a plant without modules."""
    detector = AdaptiveThreshold(plant)  # refuses a plant without modules
    assert plant.modules is not None
    if mode == "paper":
        return replace(detector, observer_bounds=plant.modules.observer_bounds)
    return replace(detector, margins=plant.modules.margins) if mode == "calibrated" else detector


def sequential(plant: Plant, rule: Rule, *, leave_one_out: bool) -> SequentialBank:
    """A sequential test of each sensor of a plant, with one of its present sample, at FALSE_ALARM."""
    return SequentialBank(plant, (Shewhart(), rule), leave_one_out, false_alarm=FALSE_ALARM)


class NamedDetector(NamedTuple):
    """A detector of the command line: what it is, how it is built for a plant, and over what its test statistic accumulates.

    memory: "none" (present readings alone), "state estimate only", or how far back evidence of a fault is gathered.
    """

    about: str
    build: Callable[[Plant], Detector]
    memory: str


NONE = "none"
STATE = "state estimate only"

DETECTORS: dict[str, NamedDetector] = {
    "fusing-ekf": NamedDetector(
        "extended Kalman filters, one without each sensor, with information mixture: statistics (19), (20) of "
        "Shaheen 2024, on its pipeline with its process noise; P0 is the plant's, where the paper has the identity",
        paper_bank("ekf"),
        STATE,
    ),
    "fusing-ukf": NamedDetector(
        "the same of unscented filters as printed, without redrawn sigma points",
        paper_bank("ukf"),
        STATE,
    ),
    "fusing-enkf": NamedDetector(
        "the same of ensemble filters, 40 members",
        paper_bank("enkf"),
        STATE,
    ),
    "loo-chi2": NamedDetector(
        "one extended Kalman filter with exact leave-one-out chi-square statistics and sequential elimination",
        lambda plant: LeaveOneOutBank(plant, window=1, false_alarm=FALSE_ALARM),
        STATE,
    ),
    "loo-glr": NamedDetector(
        "the same with likelihood ratios over the onsets of the last 15 samples",
        lambda plant: LeaveOneOutBank(plant, window=15, false_alarm=FALSE_ALARM),
        "15 samples",
    ),
    "mhe-l1": NamedDetector(
        "moving-horizon estimation on one extended Kalman filter (Rao, Rawlings and Lee 2001): faults constant over a horizon "
        "with an L1 penalty (Kim, Koh, Boyd and Gorinevsky 2009), in horizons of 1, up to 7 and up to 14 samples",
        lambda plant: MovingHorizon(plant, window=15, false_alarm=FALSE_ALARM),
        "8 to 14 samples",
    ),
    "kf-chi2": NamedDetector(
        "one extended Kalman filter with a test of each innovation; names the largest, accommodates nothing",
        lambda plant: CentralFilter(plant, false_alarm=FALSE_ALARM),
        STATE,
    ),
    "kf-window": NamedDetector(
        "one extended Kalman filter; of each sensor the sum of squares of its last 15 normalised innovations, chi-square, and "
        "a test of the present one; names and leaves out the largest, until it is readmitted",
        lambda plant: sequential(plant, SumOfSquares(15), leave_one_out=False),
        "15 samples",
    ),
    "kf-cusum": NamedDetector(
        "the same with two-sided cumulative sums against a shift of one standard deviation (Page 1954), limits by Siegmund's "
        "approximation, and a test of the present sample (Lucas 1982)",
        lambda plant: sequential(plant, Cusum(1.0), leave_one_out=False),
        "cumulative sums",
    ),
    "kf-ewma": NamedDetector(
        "the same with exponentially weighted averages of weight 0.2, limits by their variance, and a test of the present "
        "sample (Lucas and Saccucci 1990)",
        lambda plant: sequential(plant, Ewma(0.2), leave_one_out=False),
        "factor 0.8 a sample",
    ),
    "loo-window": NamedDetector(
        "kf-window on normalised leave-one-out innovations, with sequential elimination",
        lambda plant: sequential(plant, SumOfSquares(15), leave_one_out=True),
        "15 samples",
    ),
    "loo-cusum": NamedDetector(
        "kf-cusum on normalised leave-one-out innovations, with sequential elimination",
        lambda plant: sequential(plant, Cusum(1.0), leave_one_out=True),
        "cumulative sums",
    ),
    "loo-ewma": NamedDetector(
        "kf-ewma on normalised leave-one-out innovations, with sequential elimination",
        lambda plant: sequential(plant, Ewma(0.2), leave_one_out=True),
        "factor 0.8 a sample",
    ),
    "uio": NamedDetector(
        "a filter that no error of the plant's inputs can move (Kitanidis 1987; Gillijns and De Moor 2007) with leave-one-out "
        "chi-square statistics and sequential elimination",
        lambda plant: UnknownInputFilter(plant, false_alarm=FALSE_ALARM),
        STATE,
    ),
    "multiple-model": NamedDetector(
        "models of healthy sensors and of each one's noise ten times as large, with a Markov chain between them (GPB1); names "
        "the most probable",
        lambda plant: MultipleModel(plant),
        "probabilities of the models",
    ),
    "limits": NamedDetector(
        "fixed limits of each reading and of its change since the last, learnt from healthy data",
        Learnt(FixedLimits.fit, healthy_data),
        "1 sample",
    ),
    "limits-ewma": NamedDetector(
        "the same with a limit on the exponentially weighted moving average of each reading, too (Lucas and Saccucci 1990)",
        Learnt(EwmaLimits.fit, partial(healthy_data, checks=3)),
        "EWMA, factor 0.8 a sample",
    ),
    "pca": NamedDetector(
        "principal components of healthy data in units of the sensors' noise, those above the Marchenko-Pastur edge: T2, SPE "
        "and reconstruction-based contributions, by which it isolates",
        Learnt(PrincipalComponents.fit, settled_readings),
        NONE,
    ),
    "dynamic-pca": NamedDetector(
        "the same of present readings and the two before them (Ku 1995)",
        Learnt(partial(PrincipalComponents.fit, lags=2), settled_readings),
        "3 samples",
    ),
    "one-class": NamedDetector(
        "one-class support vector machine (scikit-learn) of readings whitened by the components of pca; isolation by "
        "reconstruction of single readings",
        Learnt(OneClass.fit, settled_readings),
        NONE,
    ),
    "structural-residuals": NamedDetector(
        "residuals of structural analysis (faultdiagnosistoolbox), computed from the equations in their own direction, limits "
        "from healthy data, minimal diagnoses; on a plant with scalar equations",
        Learnt(StructuralResiduals.fit, module_readings),
        "1 sample and observers",
    ),
    "adaptive-threshold": NamedDetector(
        "observers and algebraic residuals with thresholds that bounded noise cannot cross at a steady load, and diagnosis "
        "sets (Kougiatsos 2024); on a plant without scalar equations what bounded noise does to predicted readings, to first "
        "order",
        bounded,
        "observers; alarms latch",
    ),
    "adaptive-threshold:paper": NamedDetector(
        "the same with the constants of (10) as published",
        lambda plant: adaptive_threshold(plant, "paper"),
        "observers; alarms latch",
    ),
    "adaptive-threshold:calibrated": NamedDetector(
        "the same with margins under which the published pattern of modules fires",
        lambda plant: adaptive_threshold(plant, "calibrated"),
        "observers; alarms latch",
    ),
    "chebyshev": NamedDetector(
        "residuals of present readings with stochastic thresholds of 5 standard deviations, in a network by local diagnosers "
        "with consensus (Boem 2018), (15) corrected; no memory in the residuals",
        lambda plant: Chebyshev(plant, lam=0.0, alpha=CHEBYSHEV_ALPHA),
        NONE,
    ),
    "chebyshev:corrected": NamedDetector(
        "the same with the paper's filter parameter 0.3 and 2 standard deviations; names no sensor",
        lambda plant: Chebyshev(plant, accommodate=False),
        "residuals, factor 0.3 a sample",
    ),
    "chebyshev:paper": NamedDetector(
        "the same with (15) and (17) as printed",
        lambda plant: Chebyshev(plant, mode="paper", accommodate=False),
        "residuals, factor 0.3 a sample",
    ),
    "virtual-sensors": NamedDetector(
        "the modules of adaptive-threshold with guaranteed intervals of the faults, whose middles are taken off the readings "
        "before other modules get them (Kougiatsos 2022)",
        VirtualSensors,
        "observers; intervals of a fault since its alarm",
    ),
}


def build(name: str, plant: Plant) -> Detector:
    """Return the detector of that name for a plant; ValueError for an unknown name."""
    if name not in DETECTORS:
        raise ValueError(f"unknown detector {name!r}; known: {', '.join(DETECTORS)}")
    return DETECTORS[name].build(plant)


def watching(detector: Detector) -> Detector:
    """Return the detector without accommodation, so that a threshold may be swept over its residuals after the run."""
    settings: Any = detector
    watcher: Detector = replace(settings, accommodate=False) if hasattr(detector, "accommodate") else detector
    return watcher
