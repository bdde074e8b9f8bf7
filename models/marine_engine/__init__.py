"""A four-stroke marine diesel engine with turbocharger (Kougiatsos and Reppa 2024)."""

from fusion_sfdia.detectors.registry import register_plant

register_plant(
    "marine-engine",
    "four-stroke marine diesel engine with turbocharger in 4 blocks, 10 sensors (Kougiatsos and Reppa 2024)",
    "fusion_sfdia.models.marine_engine.plant:marine_engine",
    cases="fusion_sfdia.models.marine_engine.comparison:CASES",
)
