"""Scenarios, and what runs them: workers or a cluster, parts that an interrupted run takes up again, results on disk."""
