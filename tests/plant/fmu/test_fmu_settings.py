"""The file beside an FMU, and commands that take an FMU where they take a plant."""

from __future__ import annotations

from pathlib import Path

import pytest
from conftest import MakeFmu

from fusion_sfdia.cli.main import main
from fusion_sfdia.detectors import registry

DIRECTIONAL = 'providesDirectionalDerivative="true"'
SETTINGS = """
dt = 5.0
sensors = 0.01
initial_sigma = 0.01
process_sigma = { level_1 = 1e-3, level_2 = 1e-3 }
[unknown]
outlet_1 = 3e-5
"""


@pytest.fixture
def path(fmu: MakeFmu, tmp_path: Path) -> Path:
    path = tmp_path / "tanks.fmu"
    path.write_bytes(fmu(2, "ModelExchange", DIRECTIONAL).read_bytes())
    return path


def test_the_description_is_a_file_to_fill_in(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fmu", str(path)]) == 0
    text = capsys.readouterr().out
    assert "FMI 2.0 model exchange 'TwoTanks' of cc" in text and "Jacobians exact, from its directional derivatives" in text
    assert '"flow_12" = nan  # m3/s\n' in text and '"level_1" = nan  # m, nominally 1\n' in text
    beside = path.with_suffix(".toml")
    beside.write_text(text)
    with pytest.raises(ValueError, match="signal 'level_1': initial_sigma is nan; it must be finite"):
        registry.plant(str(path))
    beside.write_text(text.replace("nan", "0.001"))
    assert registry.plant(str(path)).sensor_names == ("level_1", "level_2", "flow_12", "flow_out")


def test_commands_take_an_fmu(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = path.with_name("log.csv")
    command = ["simulate", "--plant", str(path), "--out", str(log), "--steps", "20"]
    assert main(command) == 2
    error = capsys.readouterr().err
    assert "tanks.fmu states no noise, as no FMU does; expected" in error and error.count("\n") == 1
    path.with_suffix(".toml").write_text(SETTINGS)
    assert main(command) == 0 and len(log.read_text().splitlines()) == 21
    assert main(["check-log", "--plant", str(path), "--data", str(log)]) == 0
    assert "20 rows" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("dt = ", "is no TOML"),
        ("sigma = 1.0\n", "has 'sigma'; .*expected of: sensors, initial_sigma"),
        ("sensors = 0.1\n", "has no initial_sigma; expected sensors"),
    ],
)
def test_files_that_do_not_fit(path: Path, text: str, message: str) -> None:
    path.with_suffix(".toml").write_text(text)
    with pytest.raises(ValueError, match=message):
        registry.plant(str(path))
