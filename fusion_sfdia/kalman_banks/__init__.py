"""Detectors on filters: banks that leave each sensor out, single filters, and their algebra."""
