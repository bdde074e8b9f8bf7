"""Diagnosis by a model that is commissioned on a healthy log and then frozen: slow drifts, and errors of equations."""
