"""Generation areas joined by tie lines, which are plugged in and out (Boem 2018)."""

from fusion_sfdia.detectors.registry import register_plant

register_plant(
    "power-network",
    "15 generation areas joined by tie lines, 94 sensors, of which 34 read a neighbour's angle (Boem 2018)",
    "fusion_sfdia.models.power_network.plant:power_network",
    cases="fusion_sfdia.models.power_network.comparison:CASES",
)
