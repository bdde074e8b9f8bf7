"""Writes published.csv, published.md and its figures: python docs/results/published.py METRICS...

METRICS: metrics.csv of runs of `fusion-sfdia papers`; of a row in several of them the first counts. Without METRICS the page is
written again from published.csv.
"""

import sys
from pathlib import Path

from fusion_sfdia.report.results import read_rows
from fusion_sfdia.study.published_numbers import NUMBERS, stated, write_page

HERE = Path(__file__).parent
SEE = (
    "Readings every 1 and 0.3 ms: `fusion-sfdia run engine/noise --seeds 20 --set sampling=0.001 --set duration=100` and "
    "`fusion-sfdia run engine/virtual-sensors --seeds 4 --set sampling=0.0003 --set 'variants=as printed,intersected' --set "
    "inversion_seeds=0`; Fig. 7 of Shaheen 2024: `fusion-sfdia run pipeline/accommodation --seeds 10`. "
    "What else the papers print wrongly: [misprints](../explanations/misprints.md); every equation, figure and claim: "
    "[items](paper-items.md)."
)

if __name__ == "__main__":
    metrics = [Path(name) for name in sys.argv[1:]] or [HERE / NUMBERS]
    write_page(HERE, stated(row for path in metrics for row in read_rows(path)), SEE)
