"""Run folders that are written completely or not at all."""

import os
import secrets
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from os import PathLike
from pathlib import Path
from typing import BinaryIO

MARK = "metrics.json"
"""File by which a former run is recognised."""


def check_folder(path: str | PathLike[str], *, overwrite: bool = False) -> None:
    """Check before a long run whether its folder can be written.

    A test folder is made beside the later one and removed again, with any missing parents.

    Args:
        path: path of the run folder.
        overwrite: whether a former run at `path` is accepted.

    Raises:
        ValueError: an empty path, an existing file or folder (unless it is a former run and
            `overwrite`), a parent that cannot be written to.
    """
    target = _target(path)
    _check_vacant(target, overwrite)
    with in_one_line("run folder", target):
        created = _make_parents(target.parent)
        trial = _hidden(target)
        try:
            _make(trial, target)
        finally:
            shutil.rmtree(trial, ignore_errors=True)
            _remove_empty(created)


@contextmanager
def run_folder(path: str | PathLike[str], *, overwrite: bool = False) -> Iterator[Path]:
    """Yield a hidden folder that is moved to `path` at the end.

    After an exception, Ctrl-C included, the hidden folder is removed and `path` is unchanged. A
    former run is replaced once the new one is complete.

    Args:
        path: path of the run folder; missing parents are made.
        overwrite: whether to replace a former run.

    Raises:
        ValueError: as in `check_folder`; any `OSError` while the folder is filled, such as a full
            disk.
    """
    target = _target(path)
    _check_vacant(target, overwrite)
    with in_one_line("run folder", target):
        created = _make_parents(target.parent)
        folder = _hidden(target)
        try:
            _make(folder, target)
            yield folder
            # The check is repeated, because another process may have made the folder meanwhile.
            _check_vacant(target, overwrite)
            _put(folder, target)
        except BaseException:
            # An interruption counts as well: no half-written folder may stay.
            shutil.rmtree(folder, ignore_errors=True)
            _remove_empty(created)
            raise


def _target(path: str | PathLike[str]) -> Path:
    text = os.fspath(path)
    if not text or "\0" in text:
        raise ValueError(f"run folder is {text!r}; accepted: the path of a new folder")
    # Resolved: if the path is a link, its target is replaced and the link stays.
    return Path(os.path.realpath(text))


def _check_vacant(target: Path, overwrite: bool) -> None:
    if not os.path.lexists(target):
        return
    is_run = os.path.isfile(target / MARK)
    if is_run and overwrite:
        return
    if is_run:
        reason, accepted = "holds a former run", "a new folder, or overwrite"
    elif target.is_dir():
        reason = f"exists and holds no {MARK}"
        accepted = "a new folder, or a former run's with overwrite"
    else:
        reason, accepted = "exists and is not a folder", "a new folder"
    raise ValueError(f"run folder {str(target)!r} {reason}; accepted: {accepted}")


def _make_parents(folder: Path) -> list[Path]:
    """Make a folder and its parents; return those that were missing, outermost first."""
    missing = []
    while not os.path.lexists(folder) and folder != folder.parent:
        missing.append(folder)
        folder = folder.parent
    created: list[Path] = []
    try:
        for parent in reversed(missing):
            # Another run may make the same parent at this moment.
            parent.mkdir(exist_ok=True)
            created.append(parent)
    except BaseException:
        _remove_empty(created)
        raise
    return created


def _remove_empty(folders: list[Path]) -> None:
    for folder in reversed(folders):
        try:
            folder.rmdir()
        except OSError:  # in use by now
            return


def _hidden(target: Path) -> Path:
    # The folder is beside the target, so on the same file system, where a rename is one operation.
    return target.with_name(f".jaxplore-{secrets.token_hex(6)}")


def _make(folder: Path, target: Path) -> None:
    """Make the hidden folder, and check that the file system accepts its final name."""
    folder.mkdir()
    (folder / target.name).mkdir()
    (folder / target.name).rmdir()


def _put(folder: Path, target: Path) -> None:
    """Move the complete folder to its path.

    A former run is removed last, and restored on failure.
    """
    if not os.path.lexists(target):
        folder.rename(target)
        return
    # A folder cannot be renamed onto one with content, so the former run moves aside first.
    former = _hidden(target)
    target.rename(former)
    try:
        folder.rename(target)
    except BaseException:
        former.rename(target)
        raise
    shutil.rmtree(former, ignore_errors=True)


@contextmanager
def whole_file(target: Path, what: str) -> Iterator[Path]:
    """Yield a hidden path whose file is moved to `target` at the end, also safe in a power cut.

    After an exception, Ctrl-C included, `target` is unchanged.

    Args:
        target: path of the file, in an existing folder.
        what: name of the object that the file belongs to, for the message.

    Raises:
        ValueError: it cannot be written.
    """
    # The file is made in the folder of its target, because only there the rename is one operation.
    temporary = target.with_name(f".{secrets.token_hex(8)}.tmp")
    with in_one_line(what, target):
        try:
            yield temporary
            with temporary.open("r+b") as file:
                # Without it a power cut after the rename could leave an empty file.
                os.fsync(file.fileno())
            os.replace(temporary, target)
        finally:
            temporary.unlink(missing_ok=True)


def write_whole(target: Path, write: Callable[[BinaryIO], object], what: str) -> None:
    """Write a file completely or not at all, also after a power cut.

    Args:
        target: path of the file, in an existing folder.
        write: function that writes the content to a binary stream.
        what: name of the object that the file belongs to, for the message.

    Raises:
        ValueError: it cannot be written.
    """
    with whole_file(target, what) as temporary, temporary.open("xb") as file:
        write(file)


@contextmanager
def in_one_line(what: str, target: Path) -> Iterator[None]:
    """Convert errors of the operating system into a `ValueError` of one line.

    Args:
        what: name of the object to write, for the message.
        target: path of the file.

    Raises:
        ValueError: an `OSError` in the body.
    """
    try:
        yield
    except OSError as error:
        reason = " ".join(str(error.strerror or error).split())
        raise ValueError(
            f"{what} {str(target)!r} cannot be written: {reason}; accepted: a folder on a writable "
            "disk with space left"
        ) from error
