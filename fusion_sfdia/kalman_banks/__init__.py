"""Detectors on filters: banks that leave out each sensor, single filters, and their algebra."""
