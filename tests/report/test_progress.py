from __future__ import annotations

import sys

import pytest

from fusion_sfdia.report.progress import progress, working


def test_progress_is_shown_on_a_terminal_alone(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    def shown() -> str:
        assert list(progress(range(3))) == [0, 1, 2] and list(progress(iter("ab"), "auditing", 2)) == ["a", "b"]
        with working("learning"):
            pass
        return capsys.readouterr().err

    assert shown() == ""
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    assert all(what in (err := shown()) for what in ("diagnosing", "auditing", "learning")), err
