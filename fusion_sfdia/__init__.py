"""Sensor-fault detection, isolation and accommodation: three schools on one state-space interface.

The names below are loaded when they are first used, so that importing the package is cheap.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from fusion_sfdia.adaptive_thresholds.adaptive_threshold import AdaptiveThreshold as AdaptiveThreshold
    from fusion_sfdia.adaptive_thresholds.diagnosis_sets import DiagnosisLogic as DiagnosisLogic
    from fusion_sfdia.adaptive_thresholds.signatures import Agent as Agent
    from fusion_sfdia.adaptive_thresholds.signatures import SignatureMatrix as SignatureMatrix
    from fusion_sfdia.adaptive_thresholds.signatures import global_signatures as global_signatures
    from fusion_sfdia.adaptive_thresholds.signatures import local_signatures as local_signatures
    from fusion_sfdia.adaptive_thresholds.signatures import sensors_read as sensors_read
    from fusion_sfdia.adaptive_thresholds.signatures import signature_matrix as signature_matrix
    from fusion_sfdia.adaptive_thresholds.virtual_sensors import VirtualSensors as VirtualSensors
    from fusion_sfdia.core.detector import Decision as Decision
    from fusion_sfdia.core.detector import Detector as Detector
    from fusion_sfdia.core.detector import MissingPackageError as MissingPackageError
    from fusion_sfdia.core.detector import NotApplicableError as NotApplicableError
    from fusion_sfdia.core.detector import run as run
    from fusion_sfdia.core.discretise import discretise as discretise
    from fusion_sfdia.core.equation import equation as equation
    from fusion_sfdia.core.linear import linear_plant as linear_plant
    from fusion_sfdia.core.log import Log as Log
    from fusion_sfdia.core.log import as_log as as_log
    from fusion_sfdia.core.physics import Physics as Physics
    from fusion_sfdia.core.plant import Plant as Plant
    from fusion_sfdia.core.plant_groups import Numerics as Numerics
    from fusion_sfdia.core.plant_groups import Structure as Structure
    from fusion_sfdia.core.plant_groups import Truth as Truth
    from fusion_sfdia.core.saved_detectors import load_detector as load_detector
    from fusion_sfdia.core.saved_detectors import save_detector as save_detector
    from fusion_sfdia.core.signals import Sensor as Sensor
    from fusion_sfdia.core.signals import Signal as Signal
    from fusion_sfdia.core.storage import load_state as load_state
    from fusion_sfdia.core.storage import save_state as save_state
    from fusion_sfdia.data_driven.ewma_limits import EwmaLimits as EwmaLimits
    from fusion_sfdia.data_driven.fixed_limits import FixedLimits as FixedLimits
    from fusion_sfdia.data_driven.one_class import OneClass as OneClass
    from fusion_sfdia.data_driven.pca import PrincipalComponents as PrincipalComponents
    from fusion_sfdia.evaluation.diagnose import Diagnosis as Diagnosis
    from fusion_sfdia.evaluation.diagnose import Event as Event
    from fusion_sfdia.evaluation.fault_draws import FaultRange as FaultRange
    from fusion_sfdia.evaluation.fault_draws import draw_faults as draw_faults
    from fusion_sfdia.evaluation.fault_effects import apply_faults as apply_faults
    from fusion_sfdia.evaluation.faults import Fault as Fault
    from fusion_sfdia.evaluation.faults import load_faults as load_faults
    from fusion_sfdia.evaluation.logs import read_log as read_log
    from fusion_sfdia.evaluation.logs import write_log as write_log
    from fusion_sfdia.evaluation.simulate import Recording as Recording
    from fusion_sfdia.evaluation.simulate import simulate as simulate
    from fusion_sfdia.filters.estimators import Ensemble as Ensemble
    from fusion_sfdia.filters.estimators import Extended as Extended
    from fusion_sfdia.filters.estimators import Unscented as Unscented
    from fusion_sfdia.filters.filterpy_adapter import plant_from_filterpy as plant_from_filterpy
    from fusion_sfdia.intervals.interval import Interval as Interval
    from fusion_sfdia.intervals.monotone import monotone_hull as monotone_hull
    from fusion_sfdia.intervals.sivia import Paving as Paving
    from fusion_sfdia.intervals.sivia import sivia as sivia
    from fusion_sfdia.kalman_banks.central_filter import CentralFilter as CentralFilter
    from fusion_sfdia.kalman_banks.fusing_bank import FusingBank as FusingBank
    from fusion_sfdia.kalman_banks.leave_one_out_bank import LeaveOneOutBank as LeaveOneOutBank
    from fusion_sfdia.kalman_banks.memory_rules import Cusum as Cusum
    from fusion_sfdia.kalman_banks.memory_rules import Ewma as Ewma
    from fusion_sfdia.kalman_banks.memory_rules import Shewhart as Shewhart
    from fusion_sfdia.kalman_banks.memory_rules import SumOfSquares as SumOfSquares
    from fusion_sfdia.kalman_banks.moving_horizon_bank import MovingHorizon as MovingHorizon
    from fusion_sfdia.kalman_banks.multiple_model import MultipleModel as MultipleModel
    from fusion_sfdia.kalman_banks.particle_filter import ParticleFilter as ParticleFilter
    from fusion_sfdia.kalman_banks.sequential_bank import SequentialBank as SequentialBank
    from fusion_sfdia.kalman_banks.unknown_input import UnknownInputFilter as UnknownInputFilter
    from fusion_sfdia.models.gas_pipeline.plant import gas_pipeline as gas_pipeline
    from fusion_sfdia.models.marine_engine.plant import marine_engine as marine_engine
    from fusion_sfdia.models.two_tanks.plant import two_tanks as two_tanks
    from fusion_sfdia.named import diagnose as diagnose
    from fusion_sfdia.named import fit as fit
    from fusion_sfdia.stochastic_thresholds.chebyshev import Chebyshev as Chebyshev
    from fusion_sfdia.stochastic_thresholds.fault_hypotheses import FaultHypotheses as FaultHypotheses
    from fusion_sfdia.stochastic_thresholds.monte_carlo import MonteCarlo as MonteCarlo
    from fusion_sfdia.stochastic_thresholds.replug import replug as replug

_MODULES = {
    "adaptive_thresholds.adaptive_threshold": ("AdaptiveThreshold",),
    "kalman_banks.central_filter": ("CentralFilter",),
    "stochastic_thresholds.chebyshev": ("Chebyshev",),
    "core.detector": ("Decision", "Detector", "MissingPackageError", "NotApplicableError", "run"),
    "evaluation.diagnose": ("Diagnosis", "Event"),
    "adaptive_thresholds.diagnosis_sets": ("DiagnosisLogic",),
    "core.discretise": ("discretise",),
    "core.equation": ("equation",),
    "core.linear": ("linear_plant",),
    "core.log": ("Log", "as_log"),
    "filters.estimators": ("Ensemble", "Extended", "Unscented"),
    "evaluation.fault_draws": ("FaultRange", "draw_faults"),
    "evaluation.fault_effects": ("apply_faults",),
    "stochastic_thresholds.fault_hypotheses": ("FaultHypotheses",),
    "evaluation.faults": ("Fault", "load_faults"),
    "filters.filterpy_adapter": ("plant_from_filterpy",),
    "data_driven.ewma_limits": ("EwmaLimits",),
    "data_driven.fixed_limits": ("FixedLimits",),
    "data_driven.one_class": ("OneClass",),
    "kalman_banks.fusing_bank": ("FusingBank",),
    "intervals.interval": ("Interval",),
    "kalman_banks.leave_one_out_bank": ("LeaveOneOutBank",),
    "kalman_banks.memory_rules": ("Cusum", "Ewma", "Shewhart", "SumOfSquares"),
    "kalman_banks.moving_horizon_bank": ("MovingHorizon",),
    "kalman_banks.multiple_model": ("MultipleModel",),
    "kalman_banks.sequential_bank": ("SequentialBank",),
    "kalman_banks.unknown_input": ("UnknownInputFilter",),
    "evaluation.logs": ("read_log", "write_log"),
    "models.gas_pipeline.plant": ("gas_pipeline",),
    "models.marine_engine.plant": ("marine_engine",),
    "models.two_tanks.plant": ("two_tanks",),
    "intervals.monotone": ("monotone_hull",),
    "stochastic_thresholds.monte_carlo": ("MonteCarlo",),
    "kalman_banks.particle_filter": ("ParticleFilter",),
    "data_driven.pca": ("PrincipalComponents",),
    "core.physics": ("Physics",),
    "core.plant": ("Plant",),
    "core.plant_groups": ("Numerics", "Structure", "Truth"),
    "stochastic_thresholds.replug": ("replug",),
    "core.signals": ("Sensor", "Signal"),
    "adaptive_thresholds.signatures": (
        "Agent",
        "SignatureMatrix",
        "global_signatures",
        "local_signatures",
        "sensors_read",
        "signature_matrix",
    ),
    "evaluation.simulate": ("Recording", "simulate"),
    "intervals.sivia": ("Paving", "sivia"),
    "named": ("diagnose", "fit"),
    "core.saved_detectors": ("load_detector", "save_detector"),
    "core.storage": ("load_state", "save_state"),
    "adaptive_thresholds.virtual_sensors": ("VirtualSensors",),
}
_PUBLIC = {
    public: (f"{__name__}.{module}", name or public)
    for module, names in _MODULES.items()
    for public, _, name in (n.partition(":") for n in names)
}
__all__ = ["__version__", *_PUBLIC]  # all of them are strings


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}; public names: {', '.join(_PUBLIC)}")
    module, attribute = _PUBLIC[name]
    value = getattr(import_module(module), attribute)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_PUBLIC})
