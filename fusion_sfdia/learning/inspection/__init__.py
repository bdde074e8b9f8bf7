"""What can be diagnosed with a plant: mistakes in its model, observability, redundancy, and which faults are found how fast."""
