"""Read files and texts that are not trusted, and write files completely or not at all.

Every file from outside is opened by `open_regular`, and every YAML and JSON of ours is read by
`parse_yaml` and `parse_json`.
"""

import codecs
import errno
import json
import os
import stat
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, BinaryIO

import yaml

from jaxplore._locks import open_hidden_file
from jaxplore._text import error_reason, printable_path, short_repr

YAML_LIMIT = 100_000
"""Largest YAML file that is read where nothing else is said [bytes]."""
YAML_SUFFIXES = (".yaml", ".yml")
"""Endings of YAML files."""
JSON_LIMIT = 1_000_000
"""Largest JSON text that is read where nothing else is said [bytes]."""
# Exceptions that content of a wrong form raises where it is used, beside those of parsers.
MALFORMED = (
    ValueError,
    TypeError,
    LookupError,
    AttributeError,
    ArithmeticError,
    AssertionError,
    RuntimeError,
    MemoryError,
)
_YAML_DEPTH, _JSON_DEPTH = 20, 100
_MOST_NODES = 200_000
"""Greatest number of values in a YAML text; they take a few seconds."""
_MOST_ENTRIES = 5_000
"""Greatest number of entries of a YAML mapping. Keys may be chosen to have the same hash."""
_LONGEST_SCALAR = 10_000
"""Longest single value of a YAML text [characters]: numbers to base 60 take quadratic time."""
# In C and some ten times as fast, but missing where PyYAML was built without libyaml.
_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_REPLACED = "\ufffd"
"""What Python puts in place of bytes that are no UTF-8."""
_NO_FILE = (
    errno.ENOENT, errno.ENOTDIR, errno.EISDIR, errno.ENXIO, errno.ELOOP, errno.ENAMETOOLONG,
)  # fmt: skip


def open_regular(path: Path) -> BinaryIO | None:
    """Open a regular file for reading, or return None if there is none at a path.

    Pipes, devices, sockets and folders are none: reading from them may wait for ever or not end.
    """
    # The open file is examined, not the name, which may stand for another file by then. Without
    # waiting, because opening a pipe waits for someone who writes to it.
    flags = os.O_RDONLY
    for name in ("O_NONBLOCK", "O_NOCTTY", "O_CLOEXEC", "O_BINARY"):
        flags |= getattr(os, name, 0)
    try:
        number = os.open(path, flags)
    except ValueError:  # a null character
        return None
    except OSError as error:
        if error.errno in _NO_FILE:
            return None
        raise
    if not stat.S_ISREG(os.fstat(number).st_mode):
        os.close(number)
        return None
    return open(number, "rb")


def read_bytes(path: Path, what: str, limit: int, subject: str | None = None) -> bytes:
    """Read a regular file of at most `limit` bytes.

    Messages call its content `what`, and the file `subject`, or by its path without one.
    """
    where = printable_path(path) if subject is None else subject
    with open_limited(path, what, limit, subject) as file:
        try:
            data = file.read(limit + 1)
        except OSError as error:
            raise ValueError(f"{where} cannot be read: {error_reason(error)}") from None
    # It may have grown since.
    if len(data) > limit:
        raise ValueError(f"{where} is too large; accepted: at most {limit} bytes of {what}")
    return data


def open_limited(path: Path, what: str, limit: int, subject: str | None = None) -> BinaryIO:
    """Open a file of at most `limit` bytes; arguments and refusals are those of `read_bytes`."""
    where = printable_path(path) if subject is None else subject
    try:
        file = open_regular(path)
    except OSError as error:
        raise ValueError(f"{where} cannot be read: {error_reason(error)}") from None
    if file is None:
        raise ValueError(f"{where} is not there or not a file; accepted: {what} file")
    if os.fstat(file.fileno()).st_size > limit:
        file.close()
        raise ValueError(f"{where} is too large; accepted: at most {limit} bytes of {what}")
    return file


def read_yaml(path: Path, of: str = "map", limit: int = YAML_LIMIT) -> dict[object, object]:
    """Read a YAML file of at most `limit` bytes that holds a mapping; `of` names it in messages."""
    where = printable_path(path)
    data = read_bytes(path, f"a {of}'s YAML", limit)
    try:
        entries = parse_yaml(data, limit)
    except ValueError as error:
        beside = yaml_beside(path)
        named = (
            "" if beside is None else f"; accepted: {printable_path(beside)}, which is beside it"
        )
        raise ValueError(f"{where} is not a {of}'s YAML: {error}{named}") from None
    if not isinstance(entries, dict):
        raise ValueError(f"{where} holds {short_repr(entries)}; accepted: a YAML mapping of a {of}")
    return entries


def yaml_beside(path: Path) -> Path | None:
    """Return the YAML file of the same name beside a file of another kind; None without one."""
    if path.suffix in YAML_SUFFIXES:
        return None
    beside = (path.with_suffix(ending) for ending in YAML_SUFFIXES)
    return next((each for each in beside if each.is_file()), None)


def parse_yaml(text: bytes | str, limit: int = YAML_LIMIT) -> Any:
    """Return what a YAML text says; a `ValueError` of one line, without the text, refuses it."""
    _check_length(text, limit)
    readable = _readable_text(text)
    try:
        _refuse_intricate(readable)
        value = yaml.load(readable, _LOADER)
    except UnicodeError:
        raise ValueError("it is no text in UTF-8") from None
    except yaml.reader.ReaderError:
        raise ValueError("it holds what is no text") from None
    except (ValueError, yaml.YAMLError) as error:
        raise ValueError(error_reason(error)) from None
    except Exception as error:
        # PyYAML passes on what its conversions raise: KeyError, IndexError and many more.
        raise ValueError(f"a value in it cannot be read ({type(error).__name__})") from None
    if readable is not text and _REPLACED in str(value):
        raise ValueError("a value in it is no text in UTF-8")
    return value


def _readable_text(text: bytes | str) -> bytes | str:
    """Replace bytes that are no UTF-8, so that comments may be in any encoding, such as Latin-1."""
    if isinstance(text, str) or text.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return text
    try:
        text.decode()
    except UnicodeDecodeError:
        return text.decode(errors="replace")
    return text


def parse_json(text: bytes | str, limit: int = JSON_LIMIT) -> Any:
    """Return what a JSON text says; a `ValueError` of one line, without the text, refuses it."""
    _check_length(text, limit)
    try:
        value = json.loads(text)
    except Exception as error:
        raise ValueError(error_reason(error)) from None
    level = [value]
    for _ in range(_JSON_DEPTH + 1):
        level = [
            inner
            for each in level
            if isinstance(each, dict | list)
            for inner in (each.values() if isinstance(each, dict) else each)
        ]
        if not level:
            return value
    raise ValueError(f"it nests more than {_JSON_DEPTH} deep")


def _check_length(text: bytes | str, limit: int) -> None:
    if len(text) > limit:
        raise ValueError(f"it is longer than {limit} bytes")


def _refuse_intricate(text: bytes | str) -> None:
    # A few nested aliases can expand to more entries than fit in memory, and the time of PyYAML
    # grows with the square of the depth. A legitimate file needs neither.
    left, number, documents = [_MOST_NODES], 0, 0
    for event in yaml.parse(text, _LOADER):
        documents += isinstance(event, yaml.DocumentStartEvent)
        if documents > 1:
            raise ValueError("it holds more than one document")
        if isinstance(event, yaml.AliasEvent):
            raise ValueError("it uses YAML aliases")
        if isinstance(event, yaml.CollectionEndEvent):
            left.pop()
        if not isinstance(event, yaml.NodeEvent):
            continue
        number, left[-1] = number + 1, left[-1] - 1
        if number > _MOST_NODES:
            raise ValueError(f"it has more than {_MOST_NODES} values")
        if left[-1] < 0:
            raise ValueError(f"a mapping in it has more than {_MOST_ENTRIES} entries")
        if isinstance(event, yaml.ScalarEvent) and len(event.value) > _LONGEST_SCALAR:
            raise ValueError(f"a value in it is longer than {_LONGEST_SCALAR} characters")
        if isinstance(event, yaml.CollectionStartEvent):
            # Of a mapping, keys and values are counted.
            is_mapping = isinstance(event, yaml.MappingStartEvent)
            left.append(2 * _MOST_ENTRIES if is_mapping else _MOST_NODES)
        if len(left) - 1 > _YAML_DEPTH:
            raise ValueError(f"it nests more than {_YAML_DEPTH} deep")


def replace_files(files: Sequence[tuple[Path, bytes]]) -> None:
    """Write all files or none of them: to temporary names first, then renamed.

    Raises:
        OSError: a file cannot be written; earlier files stay untouched.
    """
    for path, _ in files:
        # Only a folder of that name could make the second rename in one folder fail after the
        # first.
        if path.is_dir():
            raise IsADirectoryError(f"{printable_path(path)} is a folder")
    with ExitStack() as stack:
        staged = []
        for path, data in files:
            staged.append((stack.enter_context(open_hidden_file(path)), path))
            staged[-1][0].write_bytes(data)
        for temporary, path in staged:
            os.replace(temporary, path)
