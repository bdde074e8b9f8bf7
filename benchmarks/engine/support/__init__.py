"""Shared by the scenarios on the marine engine, and figures of some of them."""
