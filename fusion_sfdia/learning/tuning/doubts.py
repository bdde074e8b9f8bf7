"""What tuning has found that a user should doubt."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from fusion_sfdia.common.rate import Rate
from fusion_sfdia.learning.commissioning.commission import Commissioning
from fusion_sfdia.learning.tuning.tail import Threshold

FAR, COLOURED, WRONG, WIDE, UNSURE = 3.0, 0.15, 1.5, 2.0, 1.5  # beyond which a figure is remarked on
ABSURD = 10.0  # times the error that the plant as stated expects: together with one of the next, of a wrong unit, our choice
HUGE = 100.0  # standard errors of a window: the mean of a disturbance


def remarks(found: Commissioning, figures: Mapping[str, Any], limit: Threshold, rate: Rate) -> list[str]:
    """What a user should know before relying on a tuned plant; figures: of its quality, by name. rate: as stated."""
    away = {}
    if found.parameters is not None:
        size = np.abs(found.parameters.value - found.parameters.prior) / found.parameters.prior_sd
        away = {name: float(a) for name, a in zip(found.parameters.names, size, strict=True) if a > FAR}
    said = [
        f"{name} is {a:.1f} of its stated deviations off: the model may lack something, or a fault be hidden in it"
        for name, a in away.items()
    ]
    largest = max((abs(d.mean) for d in found.disturbances), default=0.0)
    if figures["nis_before"] > ABSURD**2 and (away or largest > HUGE):
        learnt = [f"{name} {a:.1f} of its stated deviations off" for name, a in away.items()]
        learnt += [f"a lasting disturbance of {largest:.3g} of its standard errors"] * (largest > HUGE)
        said.insert(
            0,
            "check the units of inputs and sensors: the plant as stated errs "
            f"{np.sqrt(figures['nis_before']):.2g} times as much as it expects (NIS, root), and this log is predicted only "
            f"with {', '.join(learnt)}, which is unlikely for the plant that was stated",
        )
    if figures["coloured"] > COLOURED:
        said.append(
            f"{100 * figures['coloured']:.0f} % of the autocorrelations of the prediction errors are outside their bands: the "
            "model lacks something, or a slow fault is in the log"
        )
    if not 1 / WRONG < figures["nis"] < WRONG:
        said.append(f"prediction errors are {np.sqrt(figures['nis']):.2g} times as large as the model expects (NIS, root)")
    achieved = figures["achieved"]
    if achieved["low"] != "0" and Rate.of(achieved["low"]).count > rate.count:
        said.append(
            f"with thresholds of one half of the log there are {achieved['rate']} in the other, where {rate} is stated: what "
            "is learnt in one half does not hold in the other. Give a log with all of its operation, or declare what is not "
            "known of the model (`uncertainty`), so that it is learnt"
        )
    if found.first_error > FAR**2:
        said.append(
            f"runs begin {np.sqrt(found.first_error):.2g} times as far from the plant's x0 as it expects (NIS, root), and no "
            "other start explains it: the first samples of a log may be in alarm. Begin logs when the plant has settled, or "
            "state x0 and initial_cov so that they hold where logs begin"
        )
    if limit.scale > WIDE:
        said.append(f"thresholds are {limit.scale:.2g} times those of a right model: small faults are not seen")
    if limit.high > UNSURE * limit.low:
        said.append("the threshold is uncertain by more than a factor of 1.5: a longer log would settle it")
    return said
