from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from fusion_sfdia.cli.completion import SHELLS
from fusion_sfdia.cli.main import main


def test_without_shtab_the_error_names_the_extra(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "shtab", None)
    assert main(["completion", "bash"]) == 1
    assert "pip install 'fusion-sfdia[completion]'" in capsys.readouterr().err


@pytest.mark.parametrize("shell", SHELLS)
def test_each_shell_completes_commands_options_and_names(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("shtab")
    assert main(["completion", shell]) == 0
    script = capsys.readouterr().out
    assert all(word in script for word in ("diagnose", "fail-on", "two-tanks", "robust-glr"))


def test_bash_takes_the_script(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    pytest.importorskip("shtab")
    if shutil.which("bash") is None:
        pytest.skip("no bash")
    assert main(["completion", "bash"]) == 0
    (tmp_path / "script").write_text(capsys.readouterr().out)
    words = "COMP_WORDS=(fusion-sfdia diagnose --fail-on pr); COMP_CWORD=3"
    typed = f"source ./script; {words}; _shtab_fusion_sfdia; echo ${{COMPREPLY[*]}}"
    done = subprocess.run(["bash", "-c", typed], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["process"]
