"""The decision tree of the guide: at each end the detectors that did best in the committed numbers of the comparison."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from statistics import mean

import comparison  # beside this file
import robustness

from fusion_sfdia.detectors import registry

Row = comparison.Row
FROM_DATA = ("limits", "limits-ewma", "pca", "dynamic-pca", "one-class")
SHOWN = 3


def tree(rows: Sequence[Row]) -> str:
    """The tree as a nested list in Markdown; rows of comparison.csv."""
    index = comparison.index_of(rows)
    with_model = [n for n in registry.compared_detectors() if n not in FROM_DATA and ":" not in n]

    def value(fault: str, condition: str, metric: str) -> Callable[[str, str], float | None]:
        def of(plant: str, detector: str) -> float | None:
            row = index.get((plant, detector, fault, condition, metric))
            return None if row is None or row["value"] in ("", "nan") else float(row["value"])

        return of

    def false(plant: str, detector: str) -> float | None:
        cell = comparison.worst(rows, plant, detector, mismatch=True)
        return None if cell == comparison.ABSENT else float(cell.split()[0])

    small, short = value("bias-3-sigma", "all", "auc"), value("bias-3-sigma", "2 samples", "auc")
    large = value("graded-10-sigma", "all", "exact_isolation")
    wrong = robustness.summary(robustness.read_rows(robustness.NUMBERS), "robust-glr", comparison.PLANTS)[0]
    return "\n".join(
        (
            "- **No model, recordings only.**",
            f"  - The operation is in the recordings: exact isolation at 10 sigma {best(FROM_DATA, large)}.",
            f"  - It may leave them: false isolation, worst case, {best(FROM_DATA, false, least=True)}.",
            "- **A model.**",
            "  - It may be wrong by more than the noise, or the process may fail: `robust-glr`, false isolation under the "
            f"worst error of readings, start or model {' / '.join(f'{v:.2f}' for v in wrong)}.",
            "  - It is right within the noise.",
            f"    - Faults that last, also small ones: AUC of 3 sigma {best(with_model, small)}.",
            f"    - Faults of two samples: AUC of 3 sigma {best(with_model, short)}.",
            f"    - Which sensor matters most: exact isolation at 10 sigma {best(with_model, large)}.",
            "    - Inputs are not known well: `uio`, whose test no error of an input can move.",
            "    - An alarm must be a proof, noise is bounded: `adaptive-threshold`.",
        )
    )


def best(detectors: Sequence[str], of: Callable[[str, str], float | None], *, least: bool = False) -> str:
    """The detectors with the largest (or least) mean over all plants, with that mean; only those with a value on each."""
    means = []
    for detector in detectors:
        values = [v for p in comparison.PLANTS if (v := of(p, detector)) is not None]
        if len(values) == len(comparison.PLANTS):
            means.append((mean(values), detector))
    means.sort(key=lambda pair: pair[0], reverse=not least)
    return ", ".join(f"`{name}` {value:.2f}" for value, name in means[:SHOWN])
