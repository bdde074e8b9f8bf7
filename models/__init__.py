"""Plants of the papers, one folder each; every parameter has its provenance."""
