"""Run folders that are written completely or not at all."""

import os
import shutil
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from os import PathLike
from pathlib import Path
from typing import BinaryIO

from jaxplore._locks import (
    OWN,
    InUseError,
    is_locked,
    lock,
    open_hidden_file,
    put_folder,
    reservation,
    reserve_hidden_folder,
    sweep,
)
from jaxplore._signals import hold

MARK = "metrics.json"
"""File by which a former run is recognised."""

_reservations: dict[tuple[int, Path], Path] = {}
"""Hidden paths of the run folders that threads have reserved, by thread and target."""


def check_folder(path: str | PathLike[str], *, overwrite: bool = False) -> None:
    """Check before a long run that its folder can be written; raise as `reserve_folder` does."""
    with reserve_folder(path, overwrite=overwrite):
        pass


@contextmanager
def reserve_folder(path: str | PathLike[str], *, overwrite: bool = False) -> Iterator[None]:
    """Check whether a run folder can be written, and keep other processes from it in the body.

    A test folder is made beside the later one and removed again, with any missing parents. In the
    body this thread can write the folder by `run_folder`. Else a `ValueError` is raised.
    """
    target = _target(path)
    with _reserve(target, overwrite) as hidden:
        with in_one_line("run folder", target):
            _make(hidden, target)
            hidden.rmdir()
        _reservations[threading.get_ident(), target] = hidden
        try:
            yield
        finally:
            del _reservations[threading.get_ident(), target]


@contextmanager
def run_folder(path: str | PathLike[str], *, overwrite: bool = False) -> Iterator[Path]:
    """Yield a hidden folder that is moved to `path` at the end; missing parents are made.

    After an exception, Ctrl-C included, the hidden folder is removed and `path` is unchanged. With
    `overwrite`, a former run is replaced once the new one is complete.
    """
    target = _target(path)
    with ExitStack() as stack:
        folder = _reservations.get((threading.get_ident(), target))
        if folder is None:
            folder = stack.enter_context(_reserve(target, overwrite))
        try:
            with in_one_line("run folder", target):
                _make(folder, target)
                yield folder
                # The check is repeated: something else may have made the folder meanwhile.
                _check_vacant(target, overwrite)
                put_folder(folder, target)
        finally:
            # It is not there if it was moved. A reservation may go on after a failure.
            with hold():
                shutil.rmtree(folder, ignore_errors=True)


def is_reserved(path: Path) -> bool:
    """Check whether a process is about to write a run folder."""
    return is_locked(reservation(_target(path)))


@contextmanager
def lock_folder(folder: Path, what: str) -> Iterator[None]:
    """Keep other processes from a folder to which files are added one by one.

    It is made with its parents. If it is empty at the end, it is removed with those. `what` is its
    name in messages.
    """
    with ExitStack() as stack:
        with in_one_line(what, folder):
            stack.callback(_remove_empty, _make_parents(folder))
            try:
                stack.enter_context(lock(folder / OWN))
            except InUseError as error:
                raise ValueError(_in_use(what, folder, error)) from None
            sweep(folder)
        yield


@contextmanager
def _reserve(target: Path, overwrite: bool) -> Iterator[Path]:
    """Yield the hidden path of a run folder that this process alone may write."""
    _check_vacant(target, overwrite)
    with ExitStack() as stack:
        with in_one_line("run folder", target):
            stack.callback(_remove_empty, _make_parents(target.parent))
            hidden = stack.enter_context(hidden_folder(target, "run folder"))
        # The former run of a process that was killed may be back.
        _check_vacant(target, overwrite)
        yield hidden


@contextmanager
def hidden_folder(target: Path, what: str) -> Iterator[Path]:
    """Yield the path of a hidden folder beside `target`, which other processes cannot write then.

    It does not exist yet, and is removed at the end. `what` is the name of the folder in messages.
    """
    with ExitStack() as stack:
        try:
            hidden = stack.enter_context(reserve_hidden_folder(target))
        except InUseError as error:
            raise ValueError(_in_use(what, target, error)) from None
        yield hidden


def _in_use(what: str, folder: Path, error: InUseError) -> str:
    return (
        f"{what} {str(folder)!r} is in use by {error}; accepted: another folder, or when that one "
        "has ended"
    )


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


def _make(folder: Path, target: Path) -> None:
    """Make the hidden folder, and check that the file system accepts its final name."""
    folder.mkdir()
    (folder / target.name).mkdir()
    (folder / target.name).rmdir()


@contextmanager
def whole_file(target: Path, what: str) -> Iterator[Path]:
    """Yield an empty hidden file that is moved to `target` at the end, also safe in a power cut.

    After an exception, Ctrl-C included, `target` is unchanged. The file is locked, so it must be
    written in place. `what` names in messages the object that the file belongs to.
    """
    # The file is made in the folder of its target, because only there the rename is one operation.
    with in_one_line(what, target), open_hidden_file(target) as temporary:
        yield temporary
        with temporary.open("r+b") as file:
            # Without it a power cut after the rename could leave an empty file.
            os.fsync(file.fileno())
        os.replace(temporary, target)


def write_whole(target: Path, write: Callable[[BinaryIO], object], what: str) -> None:
    """Write a file completely or not at all by `whole_file`, also after a power cut."""
    with whole_file(target, what) as temporary, temporary.open("wb") as file:
        write(file)


@contextmanager
def in_one_line(what: str, target: Path) -> Iterator[None]:
    """Convert an `OSError` in the body into a one-line `ValueError` about `what`."""
    try:
        yield
    except OSError as error:
        reason = " ".join(str(error.strerror or error).split())
        raise ValueError(
            f"{what} {str(target)!r} cannot be written: {reason}; accepted: a folder on a writable "
            "disk with space left"
        ) from error
