"""Scenarios and their runs: workers or a cluster, resumable parts, results on disk."""
