"""Locks of files and folders, and hidden files and folders that are swept when nobody holds them.

A lock is one of the operating system (`flock`) on a hidden file. The system drops it when the
process ends, however it ends, so a lock that can be taken is nobody's: no process number has to be
compared. Who takes a lock removes its file at the end.

What is written completely or not at all is written under a hidden name with a lock. When a process
was killed, its hidden files stay. The next process that writes to the same folder removes those
whose locks it can take.

Where the system or the disk has no such locks, nothing is refused and nothing is swept.
"""

import contextlib
import errno
import hashlib
import os
import re
import secrets
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from jaxplore import _signals

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

OWN: Final = ".jaxplore.lock"
"""Lock of a folder whose files are added one by one, inside of it."""
_PREFIX, _LOCK, _FORMER, _FILE = ".jaxplore-", ".lock", "-former", ".tmp"
_DIGITS = 12
_HIDDEN = re.compile(rf"{re.escape(_PREFIX)}([0-9a-f]{{{_DIGITS}}})({_LOCK}|{_FILE})")
_PATIENCE = 0.2
"""Time after which a lock that is held is another process's [s]."""
_HELD = (errno.EAGAIN, errno.EACCES)
_NO_LOCKS = (errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL, errno.EBADF)
_swept: set[Path] = set()


class InUseError(Exception):
    """Another thread or process holds a lock; `process` is its number, None if it is not known."""

    def __init__(self, process: int | None) -> None:
        super().__init__(process)
        self.process = process

    def __str__(self) -> str:
        return "another process" + ("" if self.process is None else f", number {self.process}")


@contextmanager
def lock(path: Path, note: bytes = b"") -> Iterator[bool]:
    """Hold a lock. Its file, in an existing folder, exists only as long as the lock is held.

    Yields whether others are kept out, which not every disk can do. `note` is kept in the file.

    Raises:
        InUseError: it is held.
        OSError: the file cannot be made.
    """
    file = None
    try:
        with _signals.hold():
            file, is_exclusive = _take(path, os.O_CREAT)
            os.ftruncate(file, 0)
            os.write(file, b"%d\n%s" % (os.getpid(), note))
        yield is_exclusive
    finally:
        if file is not None:
            with _signals.hold():
                _drop(file, path)


def is_locked(path: Path) -> bool:
    """Check whether a lock is held."""
    try:
        file, _ = _take(path)
    except InUseError:
        return True
    except OSError:
        return False
    os.close(file)
    return False


@contextmanager
def reserve_hidden_folder(target: Path) -> Iterator[Path]:
    """Reserve the path of a folder, and yield the hidden one that is filled and then moved there.

    The hidden folder does not exist yet. It is beside the target, so on the same file system, where
    a rename is one operation. It is removed at the end if it is still there. The parent must exist.

    Raises:
        InUseError: another process has reserved the path.
        OSError: the parent cannot be written to.
    """
    sweep(target.parent)
    name = os.fsencode(target.name)
    hidden = target.with_name(_PREFIX + _digest(name))
    with lock(reservation(target), name) as is_exclusive:
        if is_exclusive:
            _recover(hidden, target)
        else:
            hidden = target.with_name(_random())
        try:
            yield hidden
        finally:
            with _signals.hold():
                shutil.rmtree(hidden, ignore_errors=True)


def reservation(target: Path) -> Path:
    """Return the path of the lock of `reserve_hidden_folder`."""
    return target.with_name(_PREFIX + _digest(os.fsencode(target.name)) + _LOCK)


def put_folder(hidden: Path, target: Path) -> None:
    """Move a complete hidden folder to its path, and remove the former folder there.

    On failure the former folder is restored, and an `OSError` raised.
    """
    with _signals.hold():
        if not os.path.lexists(target):
            hidden.rename(target)
            return
        # A folder cannot be renamed onto one with content, so the former one moves aside first.
        former = _aside(hidden)
        target.rename(former)
        try:
            hidden.rename(target)
        except BaseException:
            former.rename(target)
            raise
        shutil.rmtree(former, ignore_errors=True)


@contextmanager
def open_hidden_file(target: Path) -> Iterator[Path]:
    """Yield an empty hidden file beside a target; it is removed at the end unless it was moved.

    The folder must exist. Write the file in place: a new file of that name would not be locked.
    """
    # Once for each folder: in one with thousands of files each look takes its time.
    if target.parent not in _swept:
        _swept.add(target.parent)
        sweep(target.parent)
    file = None
    try:
        with _signals.hold():
            while file is None:
                path = target.with_name(_random() + _FILE)
                # A sweep of another process may come between the file and its lock.
                with contextlib.suppress(InUseError):
                    file, _ = _take(path, os.O_CREAT | os.O_EXCL)
            if fcntl is None:  # Windows moves no open file
                os.close(file)
        yield path
    finally:
        if file is not None:
            with _signals.hold():
                path.unlink(missing_ok=True)
                if fcntl is not None:
                    os.close(file)


def sweep(folder: Path) -> None:
    """Remove the hidden files and folders in a folder that no living process holds.

    A folder whose process was killed while it replaced a former one gets the former one back.
    """
    try:
        names = [entry.name for entry in os.scandir(folder)]
    except OSError:
        return
    for name in names:
        found = _HIDDEN.fullmatch(name)
        if found is None:
            continue
        path = folder / name
        # What belongs to another user or is held stays.
        with contextlib.suppress(InUseError, OSError), _signals.hold():
            file, _ = _take(path)
            try:
                note = os.read(file, 2**16).partition(b"\n")[2]
                if found[2] == _LOCK and found[1] == _digest(note) and b"/" not in note:
                    _recover(path.with_suffix(""), folder / os.fsdecode(note))
            finally:
                _drop(file, path)


def _recover(hidden: Path, target: Path) -> None:
    """Remove what a dead process has left, and put back the folder that it had moved aside."""
    shutil.rmtree(hidden, ignore_errors=True)
    former = _aside(hidden)
    if former.is_dir() and not os.path.lexists(target):
        former.rename(target)
    shutil.rmtree(former, ignore_errors=True)


def _aside(hidden: Path) -> Path:
    return hidden.with_name(hidden.name + _FORMER)


def _digest(name: bytes) -> str:
    # A name of the greatest length leaves no room for a prefix.
    return hashlib.sha256(name).hexdigest()[:_DIGITS]


def _random() -> str:
    return _PREFIX + secrets.token_hex(_DIGITS // 2)


def _take(path: Path, how: int = 0) -> tuple[int, bool]:
    """Open a file and lock it; return its descriptor, and whether others are kept out.

    Raises:
        InUseError: another one holds it.
        OSError: it cannot be opened.
    """
    # Links are not followed: the names are known, and another user may have put one there.
    how |= os.O_RDWR | getattr(os, "O_NOFOLLOW", 0)
    # A sweep of another process holds a lock for a moment.
    until = time.monotonic() + (_PATIENCE if how & os.O_CREAT and not how & os.O_EXCL else 0.0)
    while True:
        file = os.open(path, how, 0o666)
        try:
            if fcntl is None:
                raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS))
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # The former holder may have removed the file that was opened.
            if _is_at(file, path):
                return file, True
        except OSError as error:
            if error.errno in _NO_LOCKS and how & os.O_CREAT:
                return file, False
            process = _process(file) if error.errno in _HELD else None
            os.close(file)
            if error.errno in _HELD and time.monotonic() < until:
                time.sleep(_PATIENCE / 10.0)
                continue
            # Without locks nobody can say that a file is left over.
            raise InUseError(process) from None
        os.close(file)
        if how & os.O_EXCL:
            raise InUseError(None)


def _is_at(file: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(file), os.lstat(path))
    except FileNotFoundError:
        return False


def _process(file: int) -> int | None:
    number = os.read(file, 32).partition(b"\n")[0]
    return int(number) if number.isdigit() else None


def _drop(file: int, path: Path) -> None:
    """Remove the file of a lock, then give the lock up: nobody can take one without a file."""
    if fcntl is None:  # Windows removes no open file
        os.close(file)
    with contextlib.suppress(OSError):
        path.unlink()
    if fcntl is not None:
        os.close(file)
