"""When the model is wrong: detectors under model mismatch, process faults and slow drifts, with and without a healthy log."""
