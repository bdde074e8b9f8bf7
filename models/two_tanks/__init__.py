"""Two water tanks in series, checkable by hand."""

from fusion_sfdia.detectors.registry import register_plant

register_plant(
    "two-tanks",
    "two water tanks in series, checkable by hand: 2 levels and 2 flows measured",
    "fusion_sfdia.models.two_tanks.plant:two_tanks",
    cases="fusion_sfdia.models.two_tanks.comparison:CASES",
)
