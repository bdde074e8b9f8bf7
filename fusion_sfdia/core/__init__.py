"""The interface: signals, physics, plants, networks, detectors, and what all of them share."""
