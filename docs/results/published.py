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
    "What else the papers print wrongly: [misprints](../explanations/misprints.md); every equation, figure and claim: "
    "[items](paper-items.md)."
)

if __name__ == "__main__":
    metrics = [Path(name) for name in sys.argv[1:]] or [HERE / NUMBERS]
    write_page(HERE, stated(row for path in metrics for row in read_rows(path)), SEE)
