# The public names of this module, which reads this file to find them, and so do type checkers.

from fusion_sfdia.filters.estimators import Ensemble as Ensemble
from fusion_sfdia.filters.estimators import Extended as Extended
from fusion_sfdia.filters.estimators import GaussianParticles as GaussianParticles
from fusion_sfdia.filters.estimators import Unscented as Unscented
