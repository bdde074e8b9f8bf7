"""Recordings of the Tennessee Eastman process (Downs and Vogel 1993) in closed loop, and a plant identified from them.

The files are those of Russell, Chiang and Braatz 2000, "Data-driven methods for fault detection and diagnosis in chemical
processes": 41 measurements and 11 manipulated variables every 3 minutes. d00 is healthy, 500 samples, to learn from; d00_te is
healthy, 960 samples; d01_te, d04_te, d05_te and d11_te have a process fault from sample 160 on. The analyses of the feed and of
the purge are made every second sample, those of the product every fifth, and are repeated in between.
"""

from __future__ import annotations

import hashlib
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import shown
from fusion_sfdia.learning.identification.healthy_runs import without_repeats
from fusion_sfdia.learning.identification.identify import identify
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Signal
from fusion_sfdia.plant.uncertainty import Uncertainty

Array = NDArray[Any]

STEP = 180.0  # s
ONSET = 160  # samples before the process faults begin
FAULTS = {  # Downs and Vogel 1993, table 8
    "d01": "A/C feed ratio (step)",
    "d04": "reactor cooling water inlet temperature (step)",
    "d05": "condenser cooling water inlet temperature (step)",
    "d11": "reactor cooling water inlet temperature (random)",
}
FILES = ("d00", "d00_te", *(f"{name}_te" for name in FAULTS))
LENGTHS = {"d00": 500}
LENGTH = 960
MEASUREMENTS = (  # XMEAS(1) to XMEAS(41), Downs and Vogel 1993, tables 4 and 5
    ("A feed", "kscmh"), ("D feed", "kg/h"), ("E feed", "kg/h"), ("A and C feed", "kscmh"), ("recycle flow", "kscmh"),
    ("reactor feed", "kscmh"), ("reactor pressure", "kPa"), ("reactor level", "%"), ("reactor temperature", "degC"),
    ("purge rate", "kscmh"), ("separator temperature", "degC"), ("separator level", "%"), ("separator pressure", "kPa"),
    ("separator underflow", "m3/h"), ("stripper level", "%"), ("stripper pressure", "kPa"), ("stripper underflow", "m3/h"),
    ("stripper temperature", "degC"), ("stripper steam flow", "kg/h"), ("compressor work", "kW"),
    ("reactor cooling water outlet", "degC"), ("separator cooling water outlet", "degC"),
    *((f"{part} in {where}", "mol%") for where, parts in (("feed", "ABCDEF"), ("purge", "ABCDEFGH"), ("product", "DEFGH"))
      for part in parts),
)  # fmt: skip
ANALYSES = np.arange(len(MEASUREMENTS)) >= 22
VALVES = (  # XMV(1) to XMV(11), %; Downs and Vogel 1993, table 3
    "D feed valve", "E feed valve", "A feed valve", "A and C feed valve", "compressor recycle valve", "purge valve",
    "separator liquid valve", "stripper product valve", "stripper steam valve", "reactor cooling water valve",
    "condenser cooling water valve",
)  # fmt: skip
ORDER, RIDGE, ITERATIONS = 20, 5.0, 60  # see `identified`
INPUT_ERROR = 3.0  # declared error of a manipulated variable over its standard deviation in d00


def channels(folder: str, name: str) -> Array:
    """The 52 channels of a file (K, 52), .dat or .dat.gz; ValueError where the folder or the file is not as expected."""
    found = [path for path in (Path(folder) / f"{name}.dat", Path(folder) / f"{name}.dat.gz") if path.is_file()]
    if not folder or not found:
        raise ValueError(
            f"setting data is {shown(folder)}, a folder without {name}.dat or {name}.dat.gz; expected that of the files "
            f"{', '.join(FILES)} of Russell, Chiang and Braatz, such as github.com/jkitchin/tennessee-eastman-profbraatz "
            "(licence: University of Illinois/NCSA): pass --set data=FOLDER"
        )
    table = np.loadtxt(found[0])
    table = table.T if table.shape[0] == 52 else table  # d00 is transposed
    if table.shape != (LENGTHS.get(name, LENGTH), 52) or not np.isfinite(table).all():
        raise ValueError(f"{found[0].name} has shape {table.shape}; expected ({LENGTHS.get(name, LENGTH)}, 52) finite numbers")
    return table


def digest(folder: str) -> str:
    """A digest of the contents of the files."""
    return hashlib.sha256(b"".join(channels(folder, name).tobytes() for name in FILES)).hexdigest()[:16]


def recording(folder: str, name: str, *, repeated: bool = False) -> Log:
    """A file as a Log: t in s, y (K, 41), u (K, 11).

    repeated: keep the repeated analyses, which are missing otherwise. u is the manipulated variable of the sample before:
    that of the same sample is computed from its readings, noise included, and four of them copy a reading (correlation 1.00).
    """
    table = channels(folder, name)
    y, u = np.split(table, [len(MEASUREMENTS)], axis=1)
    return Log(STEP * np.arange(len(table)), y if repeated else without_repeats(y, ANALYSES), np.concatenate([u[:1], u[:-1]]))


@cache
def identified(folder: str) -> Plant:
    """The plant identified from d00, whose manipulated variables may err.

    By the likelihood of the first half of d00_te, of orders 12, 16, 20, 24 and ridge 1, 5, 20, 60: with all valves as inputs
    the best stable model has order 20 and ridge 5 (with ridge 1 it is unstable): a log-likelihood of -27.7 a sample.
    With seven valves it is -27.6, with none and ridge 1 -26.9: the valves predict little. They are inputs
    nevertheless, since an error of an input is a process hypothesis with a name.
    """
    healthy = recording(folder, "d00")
    plant = identify(
        "tennessee-eastman", [Signal(*one) for one in MEASUREMENTS], healthy,
        inputs=[Signal(one, "%") for one in VALVES], order=ORDER, ridge=RIDGE, iterations=ITERATIONS,
    )  # fmt: skip
    moves = INPUT_ERROR * healthy.u.std(axis=0)
    return replace(
        plant, uncertainty=Uncertainty(inputs={s.name: float(sd) for s, sd in zip(plant.inputs, moves, strict=True)})
    )
