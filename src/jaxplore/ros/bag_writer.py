"""Write bags of ROS 2 without ROS."""

import math
import os
import sqlite3
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from jaxplore import _checks, _kinds
from jaxplore._optional import import_optional
from jaxplore._text import error_reason, printable_path, short_repr
from jaxplore.report.folder import hidden_folder, in_one_line
from jaxplore.ros.bag import EXTRA, KINDS, typestore

STORAGES = ("sqlite3", "mcap")
"""Formats of the file in a bag."""
VERSION = 8
"""Version of the format that is written, that of ROS 2 Iron."""
SINGLE, NESTED, FIXED = 1, 2, 3
"""Shapes of fields in the definitions of messages; the last one is an array of fixed length."""


class BagWriter:
    """Writes a bag, completely or not at all.

    It is a context manager. The folder, which must not exist before, appears when the context is
    left; after an exception there is none. The storage is one of `STORAGES`. A path that is no new
    folder, another storage or a missing `rosbags` raises a `ValueError`.
    """

    @_kinds.check_arguments
    def __init__(self, path: str | os.PathLike[str], *, storage: str = "sqlite3") -> None:
        if storage not in STORAGES:
            raise ValueError(f"storage is {storage!r}; accepted: {', '.join(STORAGES)}")
        import_optional("rosbags.rosbag2", EXTRA)
        self.path, self._storage = Path(path), storage
        _check_vacant(self.path)
        self._stack = ExitStack()
        self._writer: Any = None
        self._topics: dict[str, tuple[str, Any]] = {}

    def __enter__(self) -> "BagWriter":
        self._writer = self._stack.enter_context(_whole_bag(self.path, self._storage))
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._writer = None
        self._stack.__exit__(kind, error, trace)

    def write(self, topic: str, kind: str, message: Any, time: float) -> None:
        """Write a message that was recorded at a time [s].

        The kind is one of `KINDS`, the same for all messages of a topic. The message is any object
        with the attributes of the ROS message, such as one of rclpy. It raises a `ValueError` if
        one is missing or of another type.
        """
        if self._writer is None:
            raise ValueError("BagWriter is not open; accepted: with BagWriter(...) as writer")
        if kind not in KINDS:
            raise ValueError(f"kind is {kind!r}; accepted: {', '.join(KINDS)}")
        seconds = _checks.number("time", time, at_least=0.0)
        store = typestore()
        known, connection = self._topics.get(topic, (kind, None))
        if known != kind:
            raise ValueError(f"kind is {kind!r} of topic {topic!r}; accepted: {known!r}")
        data = _pack(store, kind, message)
        if connection is None:
            connection = self._writer.add_connection(topic, KINDS[kind], typestore=store)
            self._topics[topic] = (kind, connection)
        whole = math.floor(seconds)
        nanoseconds = whole * 10**9 + round((seconds - whole) * 1e9)
        with _writable(self.path):
            self._writer.write(connection, nanoseconds, data)


@contextmanager
def _whole_bag(target: Path, storage: str) -> Iterator[Any]:
    """Yield a writer of a bag in a hidden folder, which is moved to its place at the end."""
    module = import_optional("rosbags.rosbag2", EXTRA)
    plugin = module.StoragePlugin[storage.upper()]
    with in_one_line("bag", target), _writable(target), hidden_folder(target, "bag") as hidden:
        hidden.mkdir()
        # The files of a bag bear the name of its folder.
        folder = hidden / target.name
        with module.Writer(folder, version=VERSION, storage_plugin=plugin) as writer:
            yield writer
        _check_vacant(target)
        folder.rename(target)


@contextmanager
def _writable(target: Path) -> Iterator[None]:
    """Convert errors of the database, such as a full disk, into one line."""
    try:
        yield
    except sqlite3.Error as error:
        raise ValueError(
            f"bag {printable_path(target)!r} cannot be written: {error_reason(error)}; accepted: a "
            "folder on a writable disk with space left"
        ) from error


def _check_vacant(target: Path) -> None:
    if os.path.lexists(target) or not target.name or "\0" in str(target):
        raise ValueError(
            f"bag is {printable_path(target)!r}, which exists; accepted: the path of a new folder"
        )
    if not target.parent.is_dir():
        raise ValueError(
            f"bag is {printable_path(target)!r}; accepted: a folder in one that exists"
        )


def _pack(store: Any, kind: str, message: Any) -> Any:
    """Return the bytes of a message; a missing field or one of another type is a `ValueError`."""
    typed = _convert(store, KINDS[kind], message, kind)
    try:
        return store.serialize_cdr(typed, KINDS[kind])
    except Exception as error:
        # The packer raises errors of many kinds for numbers out of range and other types.
        raise ValueError(
            f"{kind} cannot be packed ({error_reason(error)}); accepted: values of the types of "
            "its fields"
        ) from None


def _convert(store: Any, name: str, message: Any, where: str) -> Any:
    """Return a message object of the package from any object with the same attributes."""
    fields = {}
    for field, (shape, of) in store.fielddefs[name][1]:
        inside = f"{where}.{field}"
        if not hasattr(message, field):
            raise ValueError(f"{inside} is missing; accepted: all fields of {name}")
        fields[field] = _field(store, int(shape), of, getattr(message, field), inside)
    return store.types[name](**fields)


def _field(store: Any, shape: int, of: Any, value: Any, where: str) -> Any:
    if shape == NESTED:
        return _convert(store, of, value, where)
    if shape == SINGLE:
        return value
    (inner_shape, inner), number = of
    if int(inner_shape) == NESTED:
        return [_convert(store, inner, each, f"{where}[{i}]") for i, each in enumerate(value)]
    try:
        rows = np.asarray(value)
        packed = rows.astype(inner[0])
    except (TypeError, ValueError):
        raise ValueError(f"{where} is {short_repr(value)}; accepted: numbers") from None
    # An integer that does not fit would be wrapped.
    if rows.ndim != 1 or (packed.dtype.kind in "iu" and not np.array_equal(packed, rows)):
        raise ValueError(f"{where} is {short_repr(value)}; accepted: a list of {inner[0]}")
    if number and shape == FIXED and len(packed) != number:
        raise ValueError(f"{where} has {len(packed)} numbers; accepted: {number}")
    return packed
