"""Files are written completely or not at all, and errors name them."""

from __future__ import annotations

import errno
import os
import stat
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import NoReturn

import pytest

from fusion_sfdia.common import files
from fusion_sfdia.common.files import all_or_none, atomic_write, explained, locked, locked_file


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
    for module, name in ((os, "open"), (os, "replace")):
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


def left_by(code: str, root: Path) -> None:
    """Run code whose process ends at once, as if it were killed."""
    code = f"import os\nfrom pathlib import Path\nfrom fusion_sfdia.common.files import *\n{code}"
    ended = subprocess.run([sys.executable, "-c", code], env={**os.environ, "PYTHONPATH": str(root)}, check=False)
    assert ended.returncode == 9


@pytest.mark.skipif(sys.platform == "win32", reason="the system has no locks of files")
def test_what_a_killed_process_left_is_removed_by_the_next_and_nothing_else(tmp_path: Path, root: Path) -> None:
    out = tmp_path / "out"
    mine = tmp_path / ".file.csv.20260301"  # of somebody else
    mine.touch()
    left_by(f"with atomic_write(Path({str(tmp_path / 'file.csv')!r})) as file:\n    file.write('half')\n    os._exit(9)", root)
    left_by(f"with all_or_none(Path({str(out)!r})) as new:\n    (new / 'a').write_text('half')\n    os._exit(9)", root)
    assert len(list(tmp_path.glob(".fusion-sfdia.*"))) == 1 + 1 - 1  # the second run has removed what the first left
    with all_or_none(out) as new:
        (held,) = tmp_path.glob(".fusion-sfdia.*")
        with atomic_write(tmp_path / "file.csv") as file:
            file.write("whole")
        assert new.is_relative_to(held) and new.is_dir()  # of a run that lives
        (new / "a").write_text("whole")
    assert {p.name for p in tmp_path.iterdir()} == {"out", "file.csv", mine.name} and (out / "a").read_text() == "whole"


@pytest.mark.skipif(sys.platform == "win32", reason="the system has no locks of files")
def test_a_temporary_that_is_taken_before_it_is_held_is_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make, made = files._make_file, []

    def taken_at_first(path: Path, permissions: int = 0o666) -> None:
        make(path, permissions)
        made.append(path)
        if len(made) == 1:
            files.remove_leftovers(tmp_path)

    monkeypatch.setattr(files, "_make_file", taken_at_first)
    with atomic_write(tmp_path / "file.csv") as file:
        file.write("whole")
    assert len(made) == 2 and [p.name for p in tmp_path.iterdir()] == ["file.csv"]


def test_leftovers_that_are_no_files_or_folders_stay(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / ".fusion-sfdia.link").symlink_to(tmp_path / "mine")
    with atomic_write(tmp_path / "file.csv") as file:
        file.write("whole")
    assert sorted(p.name for p in tmp_path.iterdir()) == [".fusion-sfdia.link", "file.csv", "mine"]


def test_content_and_names_are_on_the_disk_before_and_after_a_file_is_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[str] = []
    sync, replace = os.fsync, os.replace

    def synced(handle: int) -> None:
        calls.append("folder" if stat.S_ISDIR(os.fstat(handle).st_mode) else "file")
        sync(handle)

    def replaced(source: Path, target: Path) -> None:
        calls.append("replace")
        replace(source, target)

    monkeypatch.setattr(os, "fsync", synced)
    monkeypatch.setattr(os, "replace", replaced)
    with atomic_write(tmp_path / "file.csv") as file:
        file.write("whole")
    assert calls == ["file", "replace", "folder"]
    calls.clear()
    with all_or_none(tmp_path / "out") as new:
        (new / "a").write_text("whole")
        (new / "b").write_text("whole")
    assert calls == ["file", "file", "replace", "replace", "folder", "folder"]


def test_the_umask_of_the_process_is_never_changed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = os.umask(0o027)
    try:
        with monkeypatch.context() as patch:
            patch.setattr(os, "umask", refuse(errno.EPERM, "another thread would make files for everybody"))
            with atomic_write(tmp_path / "file.csv") as file:
                file.write("whole")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "file.csv").stat().st_mode) == 0o640


@pytest.mark.skipif(sys.platform == "win32", reason="the system has no locks of files")
def test_a_folder_or_file_has_one_writer_at_a_time(tmp_path: Path, root: Path) -> None:
    out, state = tmp_path / "out", tmp_path / "state.npz"
    with locked(out):
        with pytest.raises(
            ValueError, match=r"out is in use: another run writes into it; wait until it has ended, or name anoth"
        ):
            with locked(out):
                raise AssertionError
        with locked(tmp_path / "other"):
            pass
    assert list(tmp_path.iterdir()) == []
    with locked_file(state), pytest.raises(ValueError, match=r"state.npz is in use: .* name another file"), locked_file(state):
        raise AssertionError
    assert list(tmp_path.iterdir()) == []
    left_by(f"with locked(Path({str(out)!r})):\n    os._exit(9)", root)
    with locked(out, force=False):  # what a killed run has left neither holds the folder nor counts as its content
        (out / "a").touch()
    with pytest.raises(ValueError, match="already used"), locked(out, force=False):
        raise AssertionError
    with locked_file(Path("/dev/stdout")):
        pass


def test_without_locks_files_are_written_and_leftovers_stay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As on Windows, which has no `fcntl`."""
    monkeypatch.setattr(files, "sys", SimpleNamespace(platform="win32"))
    monkeypatch.delattr(files, "fcntl", raising=False)
    out, leftover = tmp_path / "out", tmp_path / ".fusion-sfdia.0"
    leftover.touch()
    with locked(out), all_or_none(out) as new, atomic_write(new / "a") as file:
        file.write("whole")
    with locked_file(out / "a"), atomic_write(out / "a") as file:
        file.write("again")
    assert [p.name for p in out.iterdir()] == ["a"] and (out / "a").read_text() == "again"
    assert {p.name for p in tmp_path.iterdir()} == {"out", leftover.name}
