# Public names of this module, which reads them here; type checkers do, too.

from fusion_sfdia.filters.estimators import Ensemble as Ensemble
from fusion_sfdia.filters.estimators import Extended as Extended
from fusion_sfdia.filters.estimators import GaussianParticles as GaussianParticles
from fusion_sfdia.filters.estimators import Unscented as Unscented
