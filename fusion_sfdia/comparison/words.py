"""The last chapter of a comparison's report: what its words mean, and what each detector is."""

from __future__ import annotations

from collections.abc import Sequence

from fusion_sfdia import registry
from fusion_sfdia.report.content import Chapter, Table

WORDS = {
    "sigma": "the standard deviation of a sensor's noise",
    "detection": "an alarm while a sensor is faulty: some residual is beyond its threshold",
    "isolation": "the faulty sensor is named, exactly: it alone",
    "accommodation": "named and missing readings are replaced; the error after over that before, of the faulty sensors",
    "exoneration": "no healthy sensor is named where none is faulty, or readings are missing",
    "blame": "false isolation: a healthy sensor is named",
    "departure": "model mismatch: a plant that is not as its model, or an operation on which nothing was learnt; no sensor is "
    "faulty",
    "fault of the plant": "something else than a sensor breaks; no sensor is faulty",
    "area under the ROC": "the chance that a sample with a fault scores higher than one without: 0.5 is guessing. It counts "
    "single samples; a run has an alarm where any of its samples has",
    "mean area": "the mean of the areas of bias, drift, noise and scale of a size, and of a freeze, which has none",
    "memory": "over what a detector's test gathers evidence: present readings only, a filter's state, some samples, a sum",
    "common rate": "the rate of alarms without a fault to which the thresholds of all detectors are scaled",
    "as deployed": "with all that an alarm does afterwards: sensors that stay named, alarms that stay on",
    "silent": "with thresholds out of reach, so that nothing is ever named or replaced; its scores give the ROC",
    "cluster": "the runs of a seed with one kind of fault, which share noise and sensor and count once",
    "freeze, replay, sign": "a reading that stays as it was; earlier ones over again; its negative",
    "truth": "what makes the readings: the plant computed more finely, of the tanks another model; see the tables' heads",
    "K22, K24; V22; B18": "Kougiatsos 2022 and 2024; its virtual sensors, 2022; Boem 2018",
    ":paper, :corrected, :calibrated": "as printed; with what is wrong in print put right; with margins set by hand",
}


def words(detectors: Sequence[str]) -> Chapter:
    """What the words mean, and what each of the detectors is."""
    named = registry.detectors()
    return Chapter(
        "words",
        "Words and detectors",
        tables=[
            Table("Words", ("word", "what it means here"), tuple(WORDS.items())),
            Table(
                "Detectors",
                ("detector", "memory", "what it is"),
                tuple((d, named[d].memory, named[d].about) for d in detectors),
            ),
        ],
    )
