"""The interpretations of Shaheen 2024, and its tables compared with all of them.

Sec. V makes the process noise "10% lower" than the measurement noise: 0.9 sigma, read literally, the default of the scenarios.
"10 % of" it, 0.1 sigma, is the other interpretation. Step 4 of sec. III-B feeds the mixture back as P_i = beta_i P_m; the form
of the federated filter, P_i = P_m / beta_i, is the default (see `fusing_bank`).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from fusion_sfdia.common.run_statistics import Estimate
from fusion_sfdia.detectors.kalman_banks.fusing_bank import FEEDBACKS
from fusion_sfdia.models.gas_pipeline.plant import PROCESS_NOISE
from fusion_sfdia.report.content import Interval, ResultTable
from fusion_sfdia.report.results import Published
from fusion_sfdia.study.experiments.scenario import Settings


class Interpretation(NamedTuple):
    """A feedback of the bank, and a process noise of its filters, by their names."""

    feedback: str
    process_noise: str

    @property
    def title(self) -> str:
        """Such as "federated, 0.9 sigma"."""
        return f"{self.feedback}, {PROCESS_NOISE[self.process_noise]:g} sigma"


Cases = Mapping[tuple[str, ...], Mapping[Interpretation, Estimate]]  # (detector, ...): {interpretation: value}
EVERY = tuple(Interpretation(f, p) for f in FEEDBACKS for p in sorted(PROCESS_NOISE, key=lambda k: -PROCESS_NOISE[k]))


def interpretations(settings: Settings) -> dict[Interpretation, str]:
    """All interpretations, that of the settings first, each with the suffix of the condition in its rows."""
    chosen = Interpretation(str(settings["feedback"]), str(settings["process_noise"]))
    return {chosen: ""} | {one: f", {one.title}" for one in EVERY if one != chosen}


def condition(snr: str, suffix: str = "") -> str:
    """The condition of a row: the noise level, and the suffix of another interpretation."""
    return f"{snr} SNR{suffix}"


def interpretations_table(
    title: str, header: tuple[str, ...], found: Cases, published: Mapping[tuple[str, ...], Published | None]
) -> ResultTable:
    """Each case with its published value and ours by interpretation."""
    lines: list[tuple[str | float | Interval, ...]] = []
    for case, values in found.items():
        theirs = published.get(case)
        if theirs is not None:
            ours: list[float | Interval] = [interval(values[k]) if k in values else float("nan") for k in EVERY]
            lines.append((*case, theirs.value, *ours))
    return ResultTable(
        title,
        (*header, "published", *(one.title for one in EVERY)),
        tuple(lines),
        "Feedback of the mixture: federated is P_i = P_m / beta_i, printed is P_i = beta_i P_m. Process noise: 0.9 sigma is "
        "what the paper prints, 10 % lower than the measurement noise; 0.1 sigma would be 10 % of it. A single filter has no "
        "feedback.",
    )


def interval(e: Estimate) -> Interval:
    """A cell of a table."""
    return e.value, e.low, e.high, e.n


def near(found: Cases, published: Mapping[tuple[str, ...], Published | None], factor: float | None = None) -> str:
    """How many of the published values each interpretation meets: within a factor, or, without one, by its interval."""
    count, of = dict.fromkeys(EVERY, 0), dict.fromkeys(EVERY, 0)
    for case, values in found.items():
        if (theirs := published.get(case)) is None:
            continue
        for one, ours in values.items():
            of[one] += 1
            if factor is None:
                count[one] += ours.low <= theirs.value <= ours.high
            else:
                count[one] += theirs.value / factor <= ours.value <= theirs.value * factor
    counts = ", ".join(f"{one.title} {n} of {of[one]}" for one, n in count.items() if of[one])
    return f"Published values met {'by our 95 % interval' if factor is None else f'within a factor of {factor:g}'}: {counts}."
