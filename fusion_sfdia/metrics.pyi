# Public names of this module, which reads them here; type checkers do, too.

from fusion_sfdia.study.audit import AuditResult as AuditResult
from fusion_sfdia.study.comparison.compare import ComparisonResult as ComparisonResult
from fusion_sfdia.study.detection_metrics import RocCurve as RocCurve
from fusion_sfdia.study.detection_metrics import auc as auc
