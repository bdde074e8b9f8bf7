"""The marine engine's signature matrices as printed (models/marine_engine/published.py), and the structure of its equations.

K24: Kougiatsos and Reppa 2024, Tables I-IV. K22: Kougiatsos et al. 2022, Tables 1-3. f3(2) is the fault of sensor
S(2){3}, E(2,3) the residual of module M(2,3). Only single faults are printed; a column that is not printed is 0.
"""

from __future__ import annotations

from fusion_sfdia.detectors.adaptive_thresholds.signatures import Agent
from fusion_sfdia.models.marine_engine.published import SIGNATURES, PrintedTable

SENSORS = ("f1(1)", "f1(2)", "f2(2)", "f3(2)", "f1(3)", "f2(3)", "f3(3)", "f1(4)", "f2(4)", "f3(4)")
# the papers print no matrix of agent 1; K24 excludes f1(1) because D(1) = 0, so the entry is 1
AGENT_1 = """
        f1(1)
E(1,1)  1
"""
K24_TABLE_IV, K22_TABLE_3 = (SIGNATURES[t] for t in (PrintedTable("K24", "Table IV"), PrintedTable("K22", "Table 3")))


def parse(*tables: str) -> dict[str, dict[str, str]]:
    """Return {row: {column: entry}} of tables as printed."""
    found: dict[str, dict[str, str]] = {}
    for table in tables:
        header, *lines = (line.split() for line in table.strip().splitlines())
        found |= {row: dict(zip(header, entries, strict=True)) for row, *entries in lines}
    return found


K24_LOCAL = parse(AGENT_1, *(SIGNATURES[PrintedTable("K24", f"Table {n}")] for n in ("I", "II", "III")))
# K22 prints no matrix of agent 2
K22_LOCAL = parse(
    AGENT_1, *(SIGNATURES[PrintedTable(*t)] for t in (("K24", "Table I"), ("K22", "Table 1"), ("K22", "Table 2")))
)
AGENTS = {
    f"E({agent})": Agent(tuple(m for m in K24_LOCAL if m[2] == agent), tuple(s for s in SENSORS if s[3] == agent))
    for agent in "1234"
}

# Sensor subsets S(I,q) of the observers, K22 sec. 5 and K24 sec. VII; a 1 stands for the observer's own state (K24) or
# for the whole subset (K22)
K24_CERTAIN = {"E(1,1)": ("f1(1)",), "E(3,1)": ("f1(3)",), "E(4,1)": ("f1(4)",)}
K22_CERTAIN = {"E(1,1)": ("f1(1)",), "E(3,1)": ("f1(3)", "f2(3)"), "E(4,1)": ("f1(4)", "f2(4)")}

SENSOR_OF = {f"{'x' if s in ('f1(1)', 'f1(3)', 'f1(4)') else 'z'}_{s}": s for s in SENSORS}
# K24 (27)-(49), corrected: module -> the variable it checks and the arguments of its prediction
VARIABLES = {
    "E(1,1)": ("x_f1(1)", "u"),  # (27)
    "E(2,1)": ("z_f1(2)", "x_f1(1)", "x_f1(4)", "X_cv"),  # (31); z1(4), an argument in (30), cancels
    "E(2,2)": ("z_f2(2)", "x_f1(1)", "x_f1(4)", "z_f2(4)", "X_cv"),  # (32)
    "E(2,3)": ("z_f3(2)", "x_f1(1)", "x_f1(4)", "z_f2(4)", "z_f2(2)", "X_cv"),  # (33); z2(2) as T_6, its subset has S(2){2}
    "E(3,1)": ("x_f1(3)", "x_f1(1)", "z_f2(3)", "x_f1(4)", "z_f2(4)", "n_fe", "slip"),  # (36)
    "E(3,2)": ("z_f2(3)", "x_f1(3)", "x_f1(1)", "z_f1(2)", "z_f2(2)", "x_f1(4)", "z_f2(4)", "slip"),  # (37)-(40)
    "E(3,3)": ("z_f3(3)", "z_f2(3)", "x_f1(3)", "eta_tur"),  # (41)-(43)
    "E(4,1)": ("x_f1(4)", "x_f1(1)", "z_f2(4)", "z_f2(3)", "x_f1(3)", "slip"),  # (46)-(47)
    "E(4,2)": ("z_f2(4)",),  # (49a)
    "E(4,3)": ("z_f3(4)", "x_f1(1)", "x_f1(4)", "z_f2(4)", "z_f2(3)", "T_turbine", "slip"),  # (49b)
}
COMPUTED = {
    "n_fe": ("z_f3(2)",),
    "X_cv": ("n_fe",),  # K22 (6) has it
    "slip": ("x_f1(3)", "x_f1(4)", "z_f2(4)", "n_fe"),
    "eta_tur": ("x_f1(4)",),
    "T_turbine": ("x_f1(3)", "z_f2(3)", "eta_tur"),  # psi_4 z1(3) for z2(3), no reading of it
}
# and what the tables take: heat released as at the nominal speed (K24 (30) has no z3(2) there), a constant turbine efficiency
COMPUTED_AS_IN_THE_TABLES = COMPUTED | {"X_cv": (), "eta_tur": ()}
