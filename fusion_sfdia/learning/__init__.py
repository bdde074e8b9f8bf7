"""What is learnt from healthy logs: tuned models, monitors, checks of plants and models."""
