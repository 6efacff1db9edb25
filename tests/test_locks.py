"""Locks, and what processes that were killed have left."""

import fcntl
import os
import subprocess
import sys
import threading
from pathlib import Path
from typing import BinaryIO

import pytest

from jaxplore import _locks
from jaxplore._files import replace_files
from jaxplore._locks import (
    InUseError,
    lock,
    open_hidden_file,
    put_folder,
    reserve_hidden_folder,
    sweep,
)
from jaxplore.report.folder import (
    check_folder,
    is_reserved,
    lock_folder,
    reserve_folder,
    run_folder,
    write_whole,
)

KILLED = """
import contextlib, os, signal, sys
from pathlib import Path
from jaxplore._locks import lock, open_hidden_file, reserve_hidden_folder

top = Path(sys.argv[1])
with contextlib.ExitStack() as stack:
    for name in ("run", "moved"):
        hidden = stack.enter_context(reserve_hidden_folder(top / name))
        hidden.mkdir()
        (hidden / "half").write_text("1")
    # Between the two renames of a replacement.
    (top / "moved").rename(hidden.with_name(hidden.name + "-former"))
    stack.enter_context(open_hidden_file(top / "file")).write_text("1")
    stack.enter_context(lock(top / "study" / ".jaxplore.lock"))
    os.kill(os.getpid(), signal.SIGKILL)
"""


def tree(path: Path) -> list[str]:
    return sorted(str(each.relative_to(path)) for each in path.rglob("*"))


def write(path: Path, text: str, *, overwrite: bool = False) -> None:
    with run_folder(path, overwrite=overwrite) as folder:
        (folder / "metrics.json").write_text(text)


def test_what_a_killed_process_has_left_is_swept_and_what_is_alive_stays(tmp_path: Path) -> None:
    write(tmp_path / "moved", "former")
    (tmp_path / "study").mkdir()
    subprocess.run([sys.executable, "-c", KILLED, str(tmp_path)], check=False)
    left = tree(tmp_path)
    assert "moved" not in left
    assert sum(each.startswith(".jaxplore-") for each in left) >= 6
    # Another user's, a link, and a name that is not of a lock.
    strange = [tmp_path / ".jaxplore-xyz.tmp", tmp_path / ".jaxplore-0123456789ab"]
    strange[0].write_text("1")
    strange[1].mkdir()
    (tmp_path / ".jaxplore-0123456789ab.lock").symlink_to("moved")
    with (
        reserve_hidden_folder(tmp_path / "alive") as hidden,
        open_hidden_file(tmp_path / "other") as file,
    ):
        hidden.mkdir()
        check_folder(tmp_path / "new")
        assert hidden.is_dir()
        assert file.is_file()
        assert is_reserved(tmp_path / "alive")
    assert (tmp_path / "moved" / "metrics.json").read_text() == "former"
    with lock_folder(tmp_path / "study", "study folder"):
        assert tree(tmp_path / "study") == [".jaxplore.lock"]
    assert set(tree(tmp_path)) == {
        *("moved", "moved/metrics.json", "study"),
        *(each.name for each in strange),
        ".jaxplore-0123456789ab.lock",
    }
    assert not is_reserved(tmp_path / "alive")


def test_a_run_folder_that_is_written_is_refused_at_once(tmp_path: Path) -> None:
    write(tmp_path / "run", "former")
    told = rf"run folder '.*run' is in use by another process, number {os.getpid()}; accepted"
    with reserve_folder(tmp_path / "run", overwrite=True):
        # The same thread writes the folder that it has reserved; another one may not.
        errors: list[BaseException] = []

        def other() -> None:
            try:
                write(tmp_path / "run", "other", overwrite=True)
            except ValueError as error:
                errors.append(error)

        thread = threading.Thread(target=other)
        thread.start()
        thread.join()
        with pytest.raises(ValueError, match=told):
            raise errors[0]
        with pytest.raises(RuntimeError), run_folder(tmp_path / "run", overwrite=True):
            raise RuntimeError
        write(tmp_path / "run", "new", overwrite=True)
    assert (tmp_path / "run" / "metrics.json").read_text() == "new"
    assert tree(tmp_path) == ["run", "run/metrics.json"]
    with reserve_folder(tmp_path / "a" / "b" / "run"):
        pass
    assert tree(tmp_path) == ["run", "run/metrics.json"]


def test_a_folder_that_is_refused_keeps_no_lock(tmp_path: Path) -> None:
    for _ in range(2):
        with pytest.raises(RuntimeError), lock_folder(tmp_path / "a" / "study", "study folder"):
            raise RuntimeError
    assert tree(tmp_path) == []
    with lock_folder(tmp_path / "study", "study folder"):
        (tmp_path / "study" / "study.jsonl").touch()
        with (
            pytest.raises(ValueError, match=r"study folder .* is in use by another process"),
            lock_folder(tmp_path / "study", "study folder"),
        ):
            pass
        assert tree(tmp_path / "study") == [".jaxplore.lock", "study.jsonl"]
    assert tree(tmp_path) == ["study", "study/study.jsonl"]


def test_a_lock_is_the_file_at_its_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The former holder removes the file after another process has opened it."""
    path, flock, calls = tmp_path / "lock", fcntl.flock, 0

    def late(file: int, how: int) -> None:
        nonlocal calls
        calls += 1
        if calls == 1:
            path.unlink()
        flock(file, how)

    monkeypatch.setattr(fcntl, "flock", late)
    with lock(path):
        assert calls == 2
        assert path.read_text() == f"{os.getpid()}\n"
        with pytest.raises(InUseError), lock(path):
            pass
    assert tree(tmp_path) == []
    calls = 1
    real = os.open

    def swept(name: Path, *arguments: int) -> int:
        # The sweep of another process comes between the file and its lock.
        file = real(name, *arguments)
        if not removed:
            removed.append(name)
            name.unlink()
        return file

    removed: list[Path] = []
    monkeypatch.setattr(os, "open", swept)
    with open_hidden_file(tmp_path / "file") as file:
        assert [file] != removed
        assert tree(tmp_path) == [file.name]
    assert tree(tmp_path) == []


def test_a_disk_without_locks_refuses_and_sweeps_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def none(*_: object) -> None:
        raise OSError(_locks._NO_LOCKS[0], "No locks available")

    monkeypatch.setattr(fcntl, "flock", none)
    target = tmp_path / "run"
    with reserve_hidden_folder(target) as one, reserve_hidden_folder(target) as other:
        assert one != other
        one.mkdir()
        sweep(tmp_path)
        assert one.is_dir()
        put_folder(one, target)
    assert tree(tmp_path) == ["run"]


def test_files_are_whole_or_as_before(tmp_path: Path) -> None:
    file = tmp_path / "file"
    write_whole(file, lambda stream: stream.write(b"former"), "settings")

    def half(stream: BinaryIO) -> None:
        stream.write(b"half")
        raise RuntimeError

    with pytest.raises(RuntimeError):
        write_whole(file, half, "settings")
    with pytest.raises(OSError, match="No such file"):
        replace_files([(file, b"new"), (tmp_path / "no" / "file", b"new")])
    assert tree(tmp_path) == ["file"]
    assert file.read_text() == "former"
    replace_files([(file, b"new"), (tmp_path / "second", b"2")])
    assert [each.read_text() for each in sorted(tmp_path.iterdir())] == ["new", "2"]
