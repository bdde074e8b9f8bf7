"""Shared by the scenarios on the power network, and figures of some of them."""
