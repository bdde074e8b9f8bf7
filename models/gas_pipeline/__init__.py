"""150 km of high-pressure natural gas under transient flow (Shaheen 2024)."""
