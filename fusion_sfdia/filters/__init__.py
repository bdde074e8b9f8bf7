"""Kalman, ensemble and particle filters as pure functions on batches."""
