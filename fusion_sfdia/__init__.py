"""Sensor-fault detection, isolation and accommodation: three schools on one state-space interface.

The names below are loaded when they are first used, so that importing the package is cheap. Where a name is that of a
module too (simulate, discretise, diagnose, replug, sivia), `fusion_sfdia.simulate` is always the function; the module's other
names come by `from fusion_sfdia.simulate import ...`.
"""

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from fusion_sfdia.adaptive_threshold import AdaptiveThreshold as AdaptiveThreshold
    from fusion_sfdia.calibration import calibrate as calibrate
    from fusion_sfdia.central_filter import CentralFilter as CentralFilter
    from fusion_sfdia.chebyshev import Chebyshev as Chebyshev
    from fusion_sfdia.detector import Decision as Decision
    from fusion_sfdia.detector import Detector as Detector
    from fusion_sfdia.detector import run as run
    from fusion_sfdia.diagnose import Diagnosis as Diagnosis
    from fusion_sfdia.diagnose import Event as Event
    from fusion_sfdia.diagnose import diagnose as diagnose
    from fusion_sfdia.diagnosis_sets import DiagnosisLogic as DiagnosisLogic
    from fusion_sfdia.discretise import discretise as discretise
    from fusion_sfdia.discretise import linear_plant as linear_plant
    from fusion_sfdia.equation import equation as equation
    from fusion_sfdia.estimators import Ensemble as Ensemble
    from fusion_sfdia.estimators import Extended as Extended
    from fusion_sfdia.estimators import Unscented as Unscented
    from fusion_sfdia.fault_draws import FaultRange as FaultRange
    from fusion_sfdia.fault_draws import draw as draw_faults  # noqa: F401
    from fusion_sfdia.fault_hypotheses import FaultHypotheses as FaultHypotheses
    from fusion_sfdia.faults import Fault as Fault
    from fusion_sfdia.faults import apply as apply_faults  # noqa: F401
    from fusion_sfdia.faults import load_faults as load_faults
    from fusion_sfdia.filterpy_adapter import plant_from_filterpy as plant_from_filterpy
    from fusion_sfdia.fixed_limits import FixedLimits as FixedLimits
    from fusion_sfdia.fusing_bank import FusingBank as FusingBank
    from fusion_sfdia.interval import Interval as Interval
    from fusion_sfdia.leave_one_out_bank import LeaveOneOutBank as LeaveOneOutBank
    from fusion_sfdia.logs import Log as Log
    from fusion_sfdia.logs import read_log as read_log
    from fusion_sfdia.logs import write_log as write_log
    from fusion_sfdia.models.gas_pipeline import gas_pipeline as gas_pipeline
    from fusion_sfdia.models.marine_engine import marine_engine as marine_engine
    from fusion_sfdia.models.two_tanks import two_tanks as two_tanks
    from fusion_sfdia.monotone import monotone_hull as monotone_hull
    from fusion_sfdia.monte_carlo import MonteCarlo as MonteCarlo
    from fusion_sfdia.particle_filter import ParticleFilter as ParticleFilter
    from fusion_sfdia.pca import PrincipalComponents as PrincipalComponents
    from fusion_sfdia.physics import Block as Block
    from fusion_sfdia.physics import Physics as Physics
    from fusion_sfdia.plant import Plant as Plant
    from fusion_sfdia.replug import replug as replug
    from fusion_sfdia.signals import Sensor as Sensor
    from fusion_sfdia.signals import Signal as Signal
    from fusion_sfdia.signatures import Agent as Agent
    from fusion_sfdia.signatures import SignatureMatrix as SignatureMatrix
    from fusion_sfdia.signatures import global_signatures as global_signatures
    from fusion_sfdia.signatures import local_signatures as local_signatures
    from fusion_sfdia.signatures import sensors_read as sensors_read
    from fusion_sfdia.signatures import signature_matrix as signature_matrix
    from fusion_sfdia.simulate import Recording as Recording
    from fusion_sfdia.simulate import simulate as simulate
    from fusion_sfdia.sivia import Paving as Paving
    from fusion_sfdia.sivia import sivia as sivia
    from fusion_sfdia.storage import load_state as load_state
    from fusion_sfdia.storage import save_state as save_state
    from fusion_sfdia.virtual_sensors import VirtualSensors as VirtualSensors

_MODULES = {
    "adaptive_threshold": ("AdaptiveThreshold",),
    "calibration": ("calibrate",),
    "central_filter": ("CentralFilter",),
    "chebyshev": ("Chebyshev",),
    "detector": ("Decision", "Detector", "run"),
    "diagnose": ("Diagnosis", "Event", "diagnose"),
    "diagnosis_sets": ("DiagnosisLogic",),
    "discretise": ("discretise", "linear_plant"),
    "equation": ("equation",),
    "estimators": ("Ensemble", "Extended", "Unscented"),
    "fault_draws": ("FaultRange", "draw_faults:draw"),
    "fault_hypotheses": ("FaultHypotheses",),
    "faults": ("Fault", "apply_faults:apply", "load_faults"),
    "filterpy_adapter": ("plant_from_filterpy",),
    "fixed_limits": ("FixedLimits",),
    "fusing_bank": ("FusingBank",),
    "interval": ("Interval",),
    "leave_one_out_bank": ("LeaveOneOutBank",),
    "logs": ("Log", "read_log", "write_log"),
    "models.gas_pipeline": ("gas_pipeline",),
    "models.marine_engine": ("marine_engine",),
    "models.two_tanks": ("two_tanks",),
    "monotone": ("monotone_hull",),
    "monte_carlo": ("MonteCarlo",),
    "particle_filter": ("ParticleFilter",),
    "pca": ("PrincipalComponents",),
    "physics": ("Block", "Physics"),
    "plant": ("Plant",),
    "replug": ("replug",),
    "signals": ("Sensor", "Signal"),
    "signatures": ("Agent", "SignatureMatrix", "global_signatures", "local_signatures", "sensors_read", "signature_matrix"),
    "simulate": ("Recording", "simulate"),
    "sivia": ("Paving", "sivia"),
    "storage": ("load_state", "save_state"),
    "virtual_sensors": ("VirtualSensors",),
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


class _Package(ModuleType):
    """Keeps a public function from being replaced by the module of the same name, whichever is imported first."""

    def __setattr__(self, name: str, value: Any) -> None:
        if not (name in _PUBLIC and isinstance(value, ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
