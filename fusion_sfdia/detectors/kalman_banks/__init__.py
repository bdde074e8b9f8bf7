"""Detectors on filters: banks of leave-one-out filters, single filters, and their algebra."""
