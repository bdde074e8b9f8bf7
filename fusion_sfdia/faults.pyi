# Public names of this module, which reads them here; type checkers do, too.

from fusion_sfdia.diagnosis.fault_draws import FaultRange as FaultRange
from fusion_sfdia.diagnosis.fault_draws import draw_faults as draw_faults
from fusion_sfdia.diagnosis.fault_effects import apply_faults as apply_faults
from fusion_sfdia.diagnosis.faults import load_faults as load_faults
from fusion_sfdia.models.marine_engine.faults import EngineFault as EngineFault
from fusion_sfdia.models.power_network.operation import AreaFault as AreaFault
from fusion_sfdia.study.cases import ComparisonCases as ComparisonCases
from fusion_sfdia.study.cases import MismatchCase as MismatchCase
from fusion_sfdia.study.cases import PaperFault as PaperFault
from fusion_sfdia.study.cases import ProcessFaultCase as ProcessFaultCase
