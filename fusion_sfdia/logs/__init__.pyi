# Public names of this module, which reads them here; type checkers do, too.

from fusion_sfdia.diagnosis.simulate import Recording as Recording
from fusion_sfdia.logs.check import check_log as check_log
from fusion_sfdia.logs.csv_log import read_log as read_log
from fusion_sfdia.logs.csv_log import write_log as write_log
from fusion_sfdia.logs.log_forms import as_log as as_log
from fusion_sfdia.logs.log_map import Column as Column
from fusion_sfdia.logs.log_map import LogMap as LogMap
from fusion_sfdia.logs.log_map import load_map as load_map
from fusion_sfdia.logs.physics import StatedPhysics as StatedPhysics
from fusion_sfdia.plant.gaps import Gap as Gap
