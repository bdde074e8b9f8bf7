# Public names of this module, which reads them here; type checkers do, too.

from fusion_sfdia.derivatives.equation import equation as equation
from fusion_sfdia.detectors.kalman_banks.identifiability import IdentifiabilityResult as IdentifiabilityResult
from fusion_sfdia.detectors.kalman_banks.identifiability import identifiability as identifiability
from fusion_sfdia.filters.filterpy_adapter import plant_from_filterpy as plant_from_filterpy
from fusion_sfdia.models.gas_pipeline.plant import gas_pipeline as gas_pipeline
from fusion_sfdia.models.marine_engine.plant import marine_engine as marine_engine
from fusion_sfdia.models.power_network.operation import Switch as Switch
from fusion_sfdia.models.power_network.plant import power_network as power_network
from fusion_sfdia.models.two_tanks.plant import two_tanks as two_tanks
from fusion_sfdia.plant.areas import Areas as Areas
from fusion_sfdia.plant.augment import augment as augment
from fusion_sfdia.plant.fmu.from_fmu import from_fmu as from_fmu
from fusion_sfdia.plant.modules import Modules as Modules
from fusion_sfdia.plant.network import Network as Network
from fusion_sfdia.plant.network import Topology as Topology
from fusion_sfdia.plant.plant import Numerics as Numerics
from fusion_sfdia.plant.plant import Structure as Structure
from fusion_sfdia.plant.plant import Truth as Truth
from fusion_sfdia.plant.secants import secants as secants
from fusion_sfdia.plant.slow_noise import SlowNoise as SlowNoise
from fusion_sfdia.plant.uncertainty import Disturbance as Disturbance
from fusion_sfdia.study.random_plants import random_plant as random_plant
