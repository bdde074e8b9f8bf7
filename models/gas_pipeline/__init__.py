"""150 km of high-pressure natural gas under transient flow (Shaheen 2024)."""

from fusion_sfdia.detectors.registry import register_plant

register_plant(
    "gas-pipeline",
    "150 km of high-pressure natural gas under transient flow, 21 nodes, 63 sensors (Shaheen 2024)",
    "fusion_sfdia.models.gas_pipeline.plant:gas_pipeline",
    cases="fusion_sfdia.models.gas_pipeline.comparison:CASES",
)
