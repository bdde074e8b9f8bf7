"""Plants of the papers, a plant a file, each parameter with its provenance."""
