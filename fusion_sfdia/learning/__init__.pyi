# Public names of this module, which reads them here; type checkers do, too.

from fusion_sfdia.learning.builders import fit as fit
from fusion_sfdia.learning.commissioning.commission import Commissioning as Commissioning
from fusion_sfdia.learning.identification.choice import Candidate as Candidate
from fusion_sfdia.learning.identification.choice import ModelChoice as ModelChoice
from fusion_sfdia.learning.identification.healthy_runs import without_repeats as without_repeats
from fusion_sfdia.learning.identification.identify import identify as identify
from fusion_sfdia.learning.innovations import WhitenessTest as WhitenessTest
from fusion_sfdia.learning.innovations import whiteness as whiteness
from fusion_sfdia.learning.inspection.inspection import Inspection as Inspection
from fusion_sfdia.learning.outlier_detectors.calibration import Calibration as Calibration
from fusion_sfdia.learning.outlier_detectors.outlier_detector import SensorFaultDetector as SensorFaultDetector
from fusion_sfdia.learning.outlier_detectors.since_start import SinceStart as SinceStart
from fusion_sfdia.learning.tuning.tuned import Tuned as Tuned
