"""No file that a command reads makes it import or run what the file names; only the command line says where code is."""

from __future__ import annotations

import io
import json
import pickle
import sys
from collections.abc import Iterator
from hashlib import sha256
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from toy_plants import readings, tanks

from fusion_sfdia.cli.main import main
from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.kalman_banks.central_filter import CentralFilter
from fusion_sfdia.detectors.saved_detectors import load_detector, save_detector
from fusion_sfdia.detectors.storage import load_state, read_arrays, save_state, write_arrays
from fusion_sfdia.learning.tuning.tuned import Tuned, plant_table, settings_digest
from fusion_sfdia.logs.csv_log import write_log
from fusion_sfdia.study.experiments.parts import read_part

CANARY = """
from dataclasses import dataclass
from pathlib import Path
from fusion_sfdia.detectors.kalman_banks.central_filter import CentralFilter

Path({marker!r}).touch()


@dataclass(frozen=True)
class Mine(CentralFilter):
    size: int = {size}


def make(plant):
    return Mine(plant)
"""
FILE, MODULE = "canary.py:make", "canary:make"
PLANT = ("--plant", "two-tanks")


@pytest.fixture
def marker(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A file that is there once the canary has been imported, which both its path and its name would do."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    found = tmp_path / "imported"
    Path("canary.py").write_text(CANARY.format(marker=str(found), size=1))
    t, _, y, u = readings(tanks(), 40, 1, seed=1)
    write_log(tmp_path / "log.csv", tanks(), t, y[:, 0], u[:, 0])
    yield found
    for name in [n for n in sys.modules if n.startswith("canary")]:
        del sys.modules[name]


def tuned(detector: str = "kf-chi2", plant: str | None = None, fitted: str | None = None, digest: str | None = None) -> Path:
    """A file as `tune` writes it, in which nothing was learnt."""
    used = {"name": detector, "threshold_scale": 1.0, "false_alarm": "0.01", "per_sample": 0.01}
    used |= {k: v for k, v in {"fitted": fitted, "digest": digest}.items() if v is not None}
    table = plant_table(tanks())
    sensors = {s.name: {"sigma": s.noise_sigma, "stated": s.noise_sigma, "unit": s.unit} for s in tanks().sensors}
    document = {"plant": table | ({} if plant is None else {"name": plant}), "detector": used, "sensors": sensors}
    Tuned({**document, "quality": {"remarks": []}}).write("tuned.toml")
    return Path("tuned.toml")


def called(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str]:
    code = main(arguments)
    return code, capsys.readouterr().err


@pytest.mark.parametrize("name", [FILE, MODULE, "./canary.py:make", "{here}/canary.py:make"])
def test_the_detector_of_a_tuned_file_is_not_imported(name: str, marker: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tuned(name.format(here=marker.parent))
    for command in (
        ("diagnose", "--data", "log.csv", "--out", "out"),
        ("watch",),
        ("inspect", "--no-simulation"),
    ):
        code, err = called(capsys, *command, *PLANT, "--tuned", "tuned.toml")
        assert code == 2 and "which is none of this package, and a settings file imports no code: state where that" in err
        assert "--detector" in err and err.count("\n") == 1 and not marker.exists()
    for plain in (("check-log", "--data", "log.csv"), ("simulate", "--steps", "20", "--out", "new.csv")):
        called(capsys, *plain, *PLANT, "--tuned", "tuned.toml")
        assert not marker.exists()


def test_the_plant_of_a_tuned_file_is_a_name_to_compare(marker: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tuned(plant=FILE)
    code, err = called(capsys, "diagnose", "--data", "log.csv", *PLANT, "--tuned", "tuned.toml")
    assert code == 2 and "that one has name 'canary.py:make', this one 'two-tanks'" in err and not marker.exists()


def test_a_tuned_detector_is_found_where_the_command_line_says(marker: Path, capsys: pytest.CaptureFixture[str]) -> None:
    digest = settings_digest(registry.detector(FILE, tanks()))
    tuned("/elsewhere/canary.py:make", digest=digest)
    diagnose = ("diagnose", "--data", "log.csv", *PLANT, "--tuned", "tuned.toml", "--out", "out", "--force")
    assert called(capsys, *diagnose, "--detector", FILE)[0] == 0
    assert called(capsys, "inspect", *PLANT, "--tuned", "tuned.toml", "--detector", FILE, "--no-simulation")[0] == 0
    code, err = called(capsys, *diagnose, "--detector", "kf-chi2")
    assert code == 2 and "it was tuned for /elsewhere/canary.py:make, not kf-chi2" in err
    code, err = called(capsys, *diagnose, "--detector", "canary.py:Mine")
    assert code == 2 and "it was tuned for /elsewhere/canary.py:make, not canary.py:Mine" in err
    Path("canary.py").write_text(CANARY.format(marker=str(marker), size=22))
    code, err = called(capsys, *diagnose, "--detector", FILE)
    assert code == 2 and f"digest '{digest}', {FILE} is now a Mine with other settings" in err
    tuned("kf-chi2", digest="0" * 16)
    code, err = called(capsys, *diagnose)
    assert code == 2 and "it was tuned for kf-chi2 with the digest '0000000000000000', kf-chi2 is now a CentralFilter" in err
    code, err = called(capsys, "inspect", *PLANT, "--detector", FILE, "--no-simulation")
    assert code == 2 and "--detector is the one of --tuned, which is not given" in err


@pytest.mark.parametrize("fitted", ["../beside.npz", "/dev/zero", "a/b.npz", ".."])
def test_a_tuned_file_opens_nothing_but_the_file_beside_it(
    fitted: str, marker: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tuned()
    text = Path("tuned.toml").read_text().replace("[detector]\n", f'[detector]\nfitted = "{fitted}"\n')
    Path("tuned.toml").write_text(text)
    code, err = called(capsys, "diagnose", "--data", "log.csv", *PLANT, "--tuned", "tuned.toml")
    assert code == 2 and f"fitted is {fitted!r}; expected the name of an .npz file in the same folder" in err


@pytest.mark.parametrize("reference", [FILE.replace("make", "Mine"), MODULE.replace("make", "Mine"), "canary:make"])
def test_the_saved_detector_beside_a_tuned_file_imports_nothing(
    reference: str, marker: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tuned(fitted="beside.npz")
    save_detector("beside.npz", CentralFilter(tanks()))
    arrays = read_arrays(Path("beside.npz"))
    own = f"{CentralFilter.__module__}:CentralFilter"
    arrays["detector"] = np.array(str(arrays["detector"]).replace(own, reference))
    write_arrays(Path("beside.npz"), arrays)
    for command in (("diagnose", "--data", "log.csv"), ("watch",)):
        code, err = called(capsys, *command, *PLANT, "--tuned", "tuned.toml")
        assert code == 2 and "a file imports no code" in err and not marker.exists()
    with pytest.raises(ValueError, match="a file imports no code"):
        load_detector("beside.npz", tanks())
    assert not marker.exists()


class Payload:
    """Pickled, it imports the canary when it is read."""

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return __import__, ("canary",)


def pickled(path: Path) -> None:
    """A file with a valid digest, whose arrays are pickles."""
    packed = io.BytesIO()
    np.savez(packed, allow_pickle=True, detector=np.array([Payload()], dtype=object), t=np.array([Payload()], dtype=object))
    path.write_bytes(packed.getvalue() + sha256(packed.getvalue()).digest())


def test_pickles_in_saved_files_are_not_read(marker: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, detector = Path("state.npz"), CentralFilter(tanks())
    for make in (pickled, lambda p: p.write_bytes(pickle.dumps(Payload()))):
        make(path)
        code, _ = called(capsys, "watch", *PLANT, "--detector", "kf-chi2", "--state", str(path))
        assert code == 2
        for read in (lambda: load_state(path, detector), lambda: load_detector(path, tanks())):
            with pytest.raises(ValueError, match=r"state.npz is not a saved detector"):
                read()
        assert read_part(path) is None
        tuned(fitted="state.npz")
        code, err = called(capsys, "diagnose", "--data", "log.csv", *PLANT, "--tuned", "tuned.toml")
        assert code == 2 and "is not a saved detector" in err and not marker.exists()
    save_state(path, detector, detector.init())  # whereas a true one is
    load_state(path, detector)


KEYS = ("plant", "detector", "name", "time", "format", "tz", "bad", "decimal", "columns", "read", "write", "status", "security")


@pytest.mark.parametrize(
    "arguments",
    [
        ("diagnose", "--data", "log.csv", *PLANT, "--map", "file.toml"),
        ("check-log", "--data", "log.csv", *PLANT, "--map", "file.toml"),
        ("monitor", "--healthy", "log.csv", "--data", "log.csv", "--map", "file.toml"),
        ("watch", *PLANT, "--map", "file.toml"),
        ("watch", *PLANT, "--opcua", "opc.tcp://127.0.0.1:1", "--nodes", "file.toml"),
        ("watch", *PLANT, "--mqtt", "mqtt://127.0.0.1:1", "--topics", "file.toml"),
        ("simulate", *PLANT, "--out", "new.csv", "--faults", "file.toml"),
        ("diagnose", "--data", "log.csv", *PLANT, "--tuned", "file.toml"),
        ("bench", "model", "--against", "file.toml"),
        ("fmu", "file.toml"),
        ("diagnose", "--data", "file.toml", *PLANT),
    ],
    ids=lambda a: " ".join(a[:1] + a[-2:]),
)
def test_references_anywhere_in_a_settings_file_import_nothing(
    arguments: tuple[str, ...], marker: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=io.BytesIO(b"")))
    for reference in (FILE, MODULE):
        for key in KEYS:
            for text in (f"{key} = '{reference}'", f"[{key}]\nl1 = '{reference}'", f"[[{key}]]\nsensor = '{reference}'"):
                Path("file.toml").write_text(f"{text}\n")
                code, err = called(capsys, *arguments)
                assert code == 2 and err.startswith("fusion-sfdia: ") and not marker.exists(), (text, err)


def test_the_manifest_of_a_run_imports_nothing(marker: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path("out").mkdir()
    command = "fusion-sfdia compare --plants canary.py:make"
    manifest = {"program": "fusion-sfdia", "command": command, "scenarios": [FILE], "plant": MODULE, "files": [FILE]}
    Path("out/manifest.json").write_text(json.dumps(manifest))
    code, err = called(capsys, "compare", "--plants", "two-tanks", "--out", "out")
    assert code == 2 and "out is already used: it holds another run" in err and not marker.exists()
