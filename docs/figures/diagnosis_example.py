"""Draws diagnosis_example.png, the picture in the README: python docs/figures/diagnosis_example.py.

The log and its diagnosis are those of the README's example.
"""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from fusion_sfdia import Fault, diagnose, simulate
from fusion_sfdia.faults import apply_faults
from fusion_sfdia.plants import gas_pipeline
from fusion_sfdia.report.plots import style

FILE = Path(__file__).with_suffix(".png")
FAULT = Fault("p_3", "bias", onset=900.0, length=600.0, magnitude=1.5e3)  # Pa: 3 sigma


def draw() -> Figure:
    """Above the readings of the faulty sensor, below what they are off from what it should have read."""
    plant = gas_pipeline()
    recording = simulate(plant, 180, seeds=[0])
    readings = apply_faults(plant, recording.t, recording.y, [FAULT])
    found = diagnose("robust-glr", recording.t, readings.y, recording.u, plant=plant)
    (event,) = found.events
    sigma = plant.sensors[plant.sensor_names.index(FAULT.sensor)].noise_sigma
    i = plant.sensor_names.index(FAULT.sensor)
    minutes, y = recording.t / 60, readings.y[:, 0, i]
    steps = zip(recording.t, found.decisions.estimate, recording.u, strict=True)
    off = (y - np.array([plant.output(t, x, u)[..., i].item() for t, x, u in steps])) / sigma
    figure = Figure(figsize=(7.2, 4.4), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    above.plot(minutes, y / 1e6)
    above.set_ylabel(f"reading of {FAULT.sensor} (MPa)")
    below.plot(minutes, off, ".", label="reading less estimate")
    below.axhline(0.0, color="0.5", linewidth=0.8)
    below.hlines(event.size / sigma, event.start / 60, event.end / 60, color="#D55E00", label="reported size")
    below.set_ylabel("off by (sigma)")
    below.set_xlabel("time (min)")
    for axes in (above, below):
        axes.axvspan(event.start / 60, event.end / 60, color="0.85", label="isolated", zorder=0)
        axes.axvline(FAULT.onset / 60, color="0.3", linestyle=":", label="fault begins, ends")
        axes.axvline((FAULT.onset + FAULT.length) / 60, color="0.3", linestyle=":")
    labels = dict(zip(*axes.get_legend_handles_labels()[::-1], strict=True))
    figure.legend(labels.values(), labels.keys(), loc="outside lower center", ncols=4, fontsize=8)
    return figure


def main() -> None:
    """Write the figure."""
    with style("diagnosis"):
        draw().savefig(FILE, dpi=160)


if __name__ == "__main__":
    main()
