"""Files are written completely or not at all, and errors name them."""

from __future__ import annotations

import errno
import os
import stat
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

import pytest

from fusion_sfdia.core.files import atomic_write, explained


@pytest.mark.parametrize("mode", ["w", "wb"])
def test_a_file_takes_its_name_when_the_block_ends_well(mode: str, tmp_path: Path) -> None:
    path = tmp_path / "deep" / "er" / "file"
    content = "a,b\r\nπ\n" if mode == "w" else b"a\x00"
    with atomic_write(path, mode) as file:  # type: ignore[arg-type]
        file.write(content)
        assert not path.exists()
    assert path.read_bytes() == (content if isinstance(content, bytes) else content.encode())
    assert [p.name for p in path.parent.iterdir()] == ["file"]
    usual = tmp_path / "usual"
    usual.touch()
    assert stat.S_IMODE(path.stat().st_mode) == stat.S_IMODE(usual.stat().st_mode)


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_nothing_is_left_behind_when_the_block_raises(error: type[BaseException], tmp_path: Path) -> None:
    path = tmp_path / "file.csv"
    with pytest.raises(error), atomic_write(path) as file:
        file.write("half of it")
        raise error
    assert list(tmp_path.iterdir()) == []
    path.write_text("the old one")
    with pytest.raises(error), atomic_write(path) as file:
        file.write("half of it")
        raise error
    assert [p.name for p in tmp_path.iterdir()] == ["file.csv"] and path.read_text() == "the old one"


def refuse(number: int, text: str) -> Callable[..., NoReturn]:
    def raised(*_: object, **__: object) -> NoReturn:
        raise OSError(number, text, "/tmp/.file.csv.x81h")

    return raised


def test_an_error_names_the_expected_file_and_the_cure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "file.csv"
    with pytest.raises(OSError) as full, atomic_write(path):
        raise OSError(errno.ENOSPC, "No space left on device")
    assert explained(full.value) == f"{path}: No space left on device; make room, or name another place"
    (tmp_path / "file").touch()
    with pytest.raises(OSError) as below, atomic_write(tmp_path / "file" / "deeper.csv"):
        pass
    assert "deeper.csv" in explained(below.value) and "below folders" in explained(below.value)
    for module, name in ((tempfile, "mkstemp"), (os, "replace")):
        with monkeypatch.context() as patch:
            patch.setattr(module, name, refuse(errno.EACCES, "Permission denied"))
            with pytest.raises(PermissionError) as denied, atomic_write(path):
                pass
        assert explained(denied.value) == f"{path}: Permission denied; name another place, or change its permissions"
    assert [p.name for p in tmp_path.iterdir()] == ["file"]
    assert explained(ValueError("as it is")) == "as it is"
    assert "ask for fewer steps" in explained(MemoryError("8 GiB"))
    assert explained(OverflowError("to C long")) == "a number is too large (to C long); give a smaller one"


def test_a_replaced_file_keeps_its_mode_and_its_link(tmp_path: Path) -> None:
    path, link = tmp_path / "file.csv", tmp_path / "link.csv"
    path.write_text("the old one")
    path.chmod(0o640)
    link.symlink_to(path)
    with atomic_write(link) as file:
        file.write("the new one")
    assert link.is_symlink() and path.read_text() == "the new one" and stat.S_IMODE(path.stat().st_mode) == 0o640


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
def test_a_pipe_is_written_to_and_stays_one(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    with atomic_write(pipe) as file:
        file.write("through\n")
    assert os.read(reader, 100) == b"through\n" and stat.S_ISFIFO(pipe.stat().st_mode)
    os.close(reader)
    assert [p.name for p in tmp_path.iterdir()] == ["pipe"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs the device /dev/full")
def test_a_device_that_is_full_stays_one() -> None:
    with pytest.raises(OSError, match="No space left on device: '/dev/full'"), atomic_write(Path("/dev/full")) as file:
        file.write("too much")
    assert stat.S_ISCHR(Path("/dev/full").stat().st_mode)


def test_a_failed_write_leaves_no_new_folder(tmp_path: Path) -> None:
    with pytest.raises(ValueError), atomic_write(tmp_path / "a" / "b" / "file.csv"):
        raise ValueError
    assert list(tmp_path.iterdir()) == []
