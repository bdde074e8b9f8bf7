"""Monitoring without a model: what is learnt from healthy logs, and what it finds in others."""
