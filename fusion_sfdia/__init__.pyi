# Public names of this module, which reads them here; type checkers do, too.

from fusion_sfdia import detectors as detectors
from fusion_sfdia import events as events
from fusion_sfdia import faults as faults
from fusion_sfdia import filters as filters
from fusion_sfdia import learning as learning
from fusion_sfdia import logs as logs
from fusion_sfdia import metrics as metrics
from fusion_sfdia import plants as plants
from fusion_sfdia.common.errors import MissingPackageError as MissingPackageError
from fusion_sfdia.common.errors import NotApplicableError as NotApplicableError
from fusion_sfdia.detectors.detector import run as run
from fusion_sfdia.detectors.registry import register_detector as register_detector
from fusion_sfdia.detectors.registry import register_plant as register_plant
from fusion_sfdia.detectors.saved_detectors import load_detector as load_detector
from fusion_sfdia.detectors.saved_detectors import save_detector as save_detector
from fusion_sfdia.diagnoser import Diagnoser as Diagnoser
from fusion_sfdia.diagnoser import detector as detector
from fusion_sfdia.diagnoser import diagnose as diagnose
from fusion_sfdia.diagnosis.diagnose import Diagnosis as Diagnosis
from fusion_sfdia.diagnosis.faults import Fault as Fault
from fusion_sfdia.diagnosis.simulate import simulate as simulate
from fusion_sfdia.diagnosis.watch import Watch as Watch
from fusion_sfdia.learning.checks.detectors import check_detector as check_detector
from fusion_sfdia.learning.checks.plants import check_plant as check_plant
from fusion_sfdia.learning.inspection.inspect import inspect as inspect
from fusion_sfdia.learning.monitor.monitor import Monitor as Monitor
from fusion_sfdia.learning.tuning.tune import tune as tune
from fusion_sfdia.logs.reading import load_log as load_log
from fusion_sfdia.plant.discretise import discretise as discretise
from fusion_sfdia.plant.linear import linear_plant as linear_plant
from fusion_sfdia.plant.log import Log as Log
from fusion_sfdia.plant.physics import Physics as Physics
from fusion_sfdia.plant.plant import Plant as Plant
from fusion_sfdia.plant.signals import Sensor as Sensor
from fusion_sfdia.plant.signals import Signal as Signal
from fusion_sfdia.plant.uncertainty import Parameter as Parameter
from fusion_sfdia.plant.uncertainty import Uncertainty as Uncertainty
from fusion_sfdia.report.result import Result as Result
from fusion_sfdia.study.audit import audit as audit
from fusion_sfdia.study.comparison.compare import compare as compare
from fusion_sfdia.study.detection_metrics import roc as roc
from fusion_sfdia.study.isolation_metrics import confusion as confusion

__version__: str
