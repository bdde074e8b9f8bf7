"""What a comparison tries on the plant `two-tanks`. Kinds and amounts are ours."""

from __future__ import annotations

from functools import partial

from fusion_sfdia.evaluation.cases import ComparisonCases, MismatchCase, ProcessFaultCase
from fusion_sfdia.models.two_tanks.plant import two_tanks

CASES = ComparisonCases(
    mismatch=(
        MismatchCase("outlets -5 %", "coefficients of discharge are known to some 5 %", partial(two_tanks, outlet=0.95)),
        MismatchCase("inflow swings", "by 20 % within 1200 s", partial(two_tanks, swing=0.2)),
    ),
    process_faults=(ProcessFaultCase("leak", "a tenth of the inflow is lost before the upper tank", lost=(0.9,)),),
)
