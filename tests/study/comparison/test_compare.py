"""compare() in Python: plants and detectors of one's own, what is kept of an interrupted comparison, and what comes back."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from toy_plants import chain

from fusion_sfdia import compare
from fusion_sfdia.cli.main import main
from fusion_sfdia.common.errors import MissingPackageError
from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.detector import Claims
from fusion_sfdia.detectors.kalman_banks.central_filter import CentralFilter
from fusion_sfdia.detectors.registry import NamedPlant, plants
from fusion_sfdia.diagnosis.faults import Fault
from fusion_sfdia.models.two_tanks.plant import two_tanks
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.report.results import read_rows
from fusion_sfdia.study.cases import ComparisonCases, MismatchCase, ProcessFaultCase
from fusion_sfdia.study.comparison.recordings import failing
from fusion_sfdia.study.comparison.subjects import ComparedPlant, cases_of, compared_detector, compared_plant

TINY: dict[str, Any] = {
    "faults": ["bias"],
    "magnitudes": (30.0,),
    "lengths": (),
    "settle": 20,
    "window": 6,
    "false_alarm": 0.02,
    "calibration_error": 0.5,
    "seeds": 2,
}


def my_chain() -> Plant:
    """Six tanks in a row."""
    return chain(6)


@dataclass(frozen=True)
class Cautious(CentralFilter):
    """A filter that alarms rarely at its own threshold."""

    false_alarm: float = 1e-4


def louder_chain() -> Plant:
    """The same with more process noise."""
    return chain(6, process=0.3)


CASES = ComparisonCases(
    mismatch=(MismatchCase("louder", "more of what moves them", louder_chain),),
    process_faults=(ProcessFaultCase("jump", "more of what moves them from the onset on", lambda onset: louder_chain()),),
    settle=15,
)


def numbers(rows: Any) -> list[tuple[Any, ...]]:
    return [tuple(row.columns.values()) for row in rows]


def test_a_plant_and_a_detector_of_ones_own_with_any_number_of_workers(tmp_path: Path) -> None:
    two = compare(my_chain, [Cautious, "limits"], workers=2, cases={"chain": CASES}, **TINY)
    assert not two.failures and two.folder is None
    assert {(r.plant, r.detector) for r in two.rows} == {("chain", "Cautious"), ("chain", "limits")}
    assert {r.condition for r in two.rows if r.metric == "false_isolation_probability"} == {"", "louder"}
    assert {r.fault for r in two.rows if r.metric == "false_isolation_probability"} == {"none", "jump"}
    claimed = {r.detector: r.value for r in two.rows if r.metric == "claimed_false_alarm_probability"}
    assert claimed == {"Cautious": 1e-4, "limits": 1e-3}
    assert set(two.ranks) == {"chain"} and two.ranks["chain"]["isolation"] == {"Cautious": 1, "limits": 1}
    page = two.report(tmp_path / "page.html").read_text(encoding="utf-8")
    assert "Six tanks in a row" in page and "more of what moves them" in page and "A filter that alarms rarely" in page
    one = compare([my_chain], [Cautious, "limits"], workers=1, cases={"chain": CASES}, **TINY)
    assert not one.failures, one.failures
    assert numbers(one.rows) == numbers(two.rows)


@pytest.mark.usefixtures("undrawn")
def test_what_is_registered_meanwhile_is_compared_by_default(monkeypatch: pytest.MonkeyPatch) -> None:
    mine = {"my-chain": NamedPlant("my-chain", "tanks in a row", my_chain, source=f"{__name__}:my_chain")}
    monkeypatch.setattr(registry, "plants", lambda: mine)
    monkeypatch.setattr(registry, "find_plant", lambda what: mine[what] if isinstance(what, str) else what)
    found = compare(detectors=Cautious, workers=1, **TINY)
    assert not found.failures and {r.plant for r in found.rows} == {"my-chain"}


@pytest.mark.usefixtures("undrawn")
def test_a_plant_without_cases_is_compared_with_generic_faults() -> None:
    found = compare(chain(4), [Cautious], workers=1, **TINY)
    assert not found.failures and {r.plant for r in found.rows} == {"chain"}
    assert {r.fault for r in found.rows} == {"none", "bias-30-sigma", "graded-30-sigma", "large", "ranked"}


@pytest.mark.usefixtures("undrawn")
def test_the_command_has_the_same_bits(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    here = compare("two-tanks", ["limits", "kf-chi2"], out=tmp_path / "here", workers=1, **TINY)
    settings = [f"--set={k}={','.join(map(str, v)) if isinstance(v, tuple) else v}" for k, v in TINY.items()
                if k not in ("faults", "seeds")]  # fmt: skip
    command = ["compare", "--plants=two-tanks", "--detectors=limits,kf-chi2", "--faults=bias", "--seeds=2", "--workers=1"]
    assert main([*command, *settings, "--out", str(tmp_path / "there")]) == 0
    assert capsys.readouterr().err == ""
    assert (tmp_path / "here" / "metrics.csv").read_bytes() == (tmp_path / "there" / "metrics.csv").read_bytes()
    assert numbers(read_rows(tmp_path / "there" / "metrics.csv")) == numbers(here.rows)
    manifests = [json.loads((tmp_path / of / "manifest.json").read_text(encoding="utf-8")) for of in ("here", "there")]
    assert manifests[0]["command"] == manifests[1]["command"]  # either may go on where the other stopped


FILE = '''
from fusion_sfdia import Sensor, linear_plant
from {helper} import SIGMA

def tank():
    """A tank of a file."""
    return linear_plant(
        "tank", [[0.9]], [[1.0], [1.0]], [Sensor("a", "x0", sigma=SIGMA), Sensor("b", "x0", sigma={sigma})],
        dt=1.0, x0=[0.0], initial_cov=[0.01], process_cov=[0.01],
    )
'''


def resumed(out: Path) -> int:
    return int(json.loads((out / "manifest.json").read_text(encoding="utf-8"))["scenarios"][0]["resumed"])


@pytest.mark.usefixtures("undrawn")
def test_a_changed_plant_never_takes_up_old_parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "helper_of_tank.py").write_text("SIGMA = 0.1\n", encoding="utf-8")
    file, out = tmp_path / "tank.py", tmp_path / "out"
    file.write_text(FILE.format(helper="helper_of_tank", sigma=0.1), encoding="utf-8")
    first = compare(f"{file}:tank", Cautious, out=out, workers=1, **TINY)
    assert not first.failures and {r.plant for r in first.rows} == {"tank.py:tank"} and resumed(out) == 0
    again = compare(f"{file}:tank", Cautious, out=out, workers=1, **TINY)
    assert numbers(again.rows) == numbers(first.rows) and resumed(out) == 1
    monkeypatch.chdir(tmp_path)
    compare("tank.py:tank", Cautious, out=out, workers=1, **TINY)
    assert resumed(out) == 1  # wherever it is called from
    file.write_text(FILE.format(helper="helper_of_tank", sigma=0.4), encoding="utf-8")
    changed = compare(f"{file}:tank", Cautious, out=out, workers=1, **TINY)
    assert numbers(changed.rows) != numbers(first.rows) and resumed(out) == 0
    before = compared_plant("tank.py:tank")
    (tmp_path / "helper_of_tank.py").write_text("SIGMA = 0.2\n", encoding="utf-8")
    assert compared_plant("tank.py:tank") != before  # what it imports counts, too


def test_the_registered_plant_as_an_object_has_its_cases_under_its_name() -> None:
    named = compared_plant("two-tanks")
    for what in (two_tanks, two_tanks(), lambda: two_tanks(), "fusion_sfdia.models.two_tanks.plant:two_tanks"):
        found = compared_plant(what)
        assert cases_of(found).mismatch and found.note == ""
        assert isinstance(what, str) or found == named
    used = two_tanks()
    assert used.sensor_names and compared_plant(used) == named  # what a cached property keeps does not count


@pytest.mark.usefixtures("undrawn")
def test_another_plant_of_a_registered_name_is_compared_without_cases_and_noted() -> None:
    plant = replace(two_tanks(), dt=2 * two_tanks().dt)
    found = compare(plant, "limits", workers=1, **TINY)
    [note] = found.notes
    assert "'two-tanks' has the name of a registered plant, but differs from it" in note and "cases={'two-tanks'" in note
    assert not found.failures and {r.condition for r in found.rows if r.metric == "false_isolation_probability"} == {""}
    assert compared_plant(plant, CASES).note == "" == compared_plant(chain(4)).note
    assert compared_plant(lambda: plant).note == note


def test_a_plant_that_cannot_be_built_is_refused() -> None:
    def broken() -> Plant:
        raise KeyError("length")

    with pytest.raises(ValueError, match="plant broken cannot be built: KeyError: 'length'; correct its function"):
        compared_plant(broken)


READING = """
import json
from pathlib import Path
from fusion_sfdia import Sensor, linear_plant

def tank():
    a = json.loads(Path(__file__).with_name("p.json").read_text(encoding="utf-8"))
    return linear_plant(
        "tank", [[a]], [[1.0], [1.0]], [Sensor("a", "x0", sigma=0.1), Sensor("b", "x0", sigma=0.1)],
        dt=1.0, x0=[0.0], initial_cov=[0.01], process_cov=[0.01],
    )
"""


def test_numbers_that_a_plant_reads_from_a_file_count(tmp_path: Path) -> None:
    (tmp_path / "tank3.py").write_text(READING, encoding="utf-8")
    found = []
    for a in (0.9, 0.9, 0.8):
        (tmp_path / "p.json").write_text(str(a), encoding="utf-8")
        found.append(compared_plant(f"{tmp_path / 'tank3.py'}:tank"))
    assert found[0] == found[1] != found[2]


@pytest.mark.slow
def test_two_processes_give_a_plant_one_digest(tmp_path: Path, root: Path) -> None:
    (tmp_path / "tank3.py").write_text(READING, encoding="utf-8")
    (tmp_path / "p.json").write_text("0.9", encoding="utf-8")
    code = (
        "from fusion_sfdia.study.comparison.subjects import compared_plant as c\n"
        "from fusion_sfdia.detectors.registry import plants, plant\n"
        "from fusion_sfdia.study.experiments.sources import content_digest as d\n"
        "print(c('tank3.py:tank').digest, [d(plant(name)) for name in plants()])"
    )
    here = {"cwd": tmp_path, "check": True, "capture_output": True, "text": True}
    outputs = [
        subprocess.run([sys.executable, "-c", code], env=os.environ | {"PYTHONPATH": str(root), "PYTHONHASHSEED": seed}, **here)
        for seed in ("1", "2")
    ]
    assert outputs[0].stdout == outputs[1].stdout


def test_objects_that_differ_have_other_digests() -> None:
    assert compared_plant(chain(4)) == compared_plant(chain(4))
    assert compared_plant(chain(4)) != compared_plant(chain(5))
    assert compared_plant(my_chain) == compared_plant(my_chain) != compared_plant(louder_chain)
    assert compared_plant(my_chain, CASES) != compared_plant(my_chain)
    low, high = (compared_detector(lambda of, rate=rate: CentralFilter(of, false_alarm=rate)) for rate in (0.1, 0.2))
    assert low.name == high.name and low != high
    assert compared_detector("limits") == compared_detector("limits") != compared_detector("kf-chi2")


def test_cases_stand_beside_the_registered_plants_only() -> None:
    for name in plants():
        assert cases_of(compared_plant(name)).mismatch
    assert cases_of(compared_plant(my_chain)) == ComparisonCases()
    wrong = ComparedPlant("wrong", "", NamedPlant("wrong", "", my_chain, cases="fusion_sfdia.models.two_tanks.plant:INFLOW"))
    with pytest.raises(ValueError, match="cases of plant wrong are of type float; expected ComparisonCases"):
        cases_of(wrong)
    case = MismatchCase("louder", "why", louder_chain)
    with pytest.raises(ValueError, match="louder stand twice"):
        ComparisonCases(mismatch=(case, case))


def test_process_faults_that_cannot_be_made_are_refused() -> None:
    with pytest.raises(ValueError, match="'nothing' of chain: expected either a truth or what is lost"):
        failing(compared_plant(my_chain), ProcessFaultCase("nothing", "no fault"), 5, (0,), 1.0)
    closed = ProcessFaultCase("lost", "half of all inputs", lost=(0.5,) * 30)
    with pytest.raises(ValueError, match="'power-network' has controllers, which would act on what is lost"):
        failing(compared_plant("power-network"), closed, 5, (0,), 1.0)


def test_the_comparison_knows_no_plant(root: Path) -> None:
    names = [name for plant in plants() for name in (plant, plant.replace("-", "_"))]
    for path in sorted((root / "fusion_sfdia" / "comparison").glob("*.py")):
        found = re.search("|".join([*names, r"fusion_sfdia\.models"]), path.read_text(encoding="utf-8"))
        assert not found, f"{path.name} names {found and found[0]}"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"plants": [my_chain, my_chain]}, "plants named chain are given twice"),
        ({"detectors": ["limits", "limits"]}, "detectors named limits are given twice"),
        ({"plants": "two-tank"}, "did you mean 'two-tanks'"),
        ({"plants": my_chain, "cases": {"chains": CASES}}, "did you mean 'chain'"),
        (
            {"detectors": Cautious(chain(4))},
            r"is already built for plant 'chain'; .* pass the class, Cautious, or lambda plant",
        ),
        ({"plants": my_chain, "seeds": 1.5}, "seeds is 1.5; expected a whole number of at least 1"),
        (
            {"faults": [Fault("x0", "bias", 1.0, magnitude=2.0)]},
            r"faults has Fault\(.* in it; expected names .* give sizes as magnitudes=",
        ),
        (
            {"faults": {"bias": 3.0}},
            r"faults is {'bias': 3.0}; expected a list of kinds of faults, such as \['bias', 'drift'\]",
        ),
        ({"faults": {"bias"}}, r"faults is {'bias'}; expected a list"),
        ({"faults": 3}, "faults is 3; expected a list"),
        ({"detectors": 3}, "expected a class or function that takes a Plant"),
        ({"plants": my_chain, "sizes": (3,)}, "no setting 'sizes'"),
        ({"plants": my_chain, "window": 1}, "a whole number from 2 "),
        ({"plants": my_chain, "detectors": []}, "setting detectors is empty"),
    ],
)
def test_what_does_not_fit_is_refused_before_any_work(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        compare(**({"detectors": ["limits"]} | arguments))


def test_a_folder_that_is_in_use_is_refused_with_the_arguments_of_the_function(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine", encoding="utf-8")
    message = r"name another folder with out= \(--out\), or write into it with force=True \(--force\)"
    with pytest.raises(ValueError, match=message):
        compare("two-tanks", "limits", out=tmp_path, workers=1, **TINY)


@dataclass(frozen=True)
class Unscaled(Claims):
    """A detector without a scale of its thresholds."""

    plant: Plant
    hypotheses: tuple[str, ...] = ()

    def init(self, batch: tuple[int, ...], t: float) -> tuple[Any, ...]:
        return (np.zeros(batch),)

    def step(self, state: Any, t: float, y: Any, u: Any) -> Any:
        return state, None


@pytest.mark.usefixtures("undrawn")
def test_a_detector_whose_thresholds_have_no_scale_fails_with_the_cure() -> None:
    found = compare(my_chain, [Unscaled, Cautious], workers=1, **TINY)
    [line] = found.failures
    assert "sources" not in line and not re.search("[0-9a-f]{16}", line)
    assert "detector Unscaled has no field threshold_scale" in line and "derive it from BatchDetector" in line
    assert {r.detector for r in found.rows if r.metric == "auc"} == {"Cautious"}


@pytest.mark.usefixtures("undrawn")
def test_a_frame_has_the_columns_of_the_file(monkeypatch: pytest.MonkeyPatch) -> None:
    found = compare(my_chain, Cautious, workers=1, **TINY)
    monkeypatch.setitem(sys.modules, "pandas", SimpleNamespace(DataFrame=list))
    assert found.frame() == [row.columns for row in found.rows]
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(MissingPackageError, match="pandas, which is not installed"):
        found.frame()
