"""Read files that are not trusted, and write files completely or not at all."""

import os
import reprlib
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

import yaml

from jaxplore._locks import hidden_file

YAML_LIMIT = 100_000
"""Largest YAML file that is read [bytes]."""
# Exceptions that PyYAML and Pillow raise for malformed files beside their own.
MALFORMED = (ValueError, TypeError, LookupError, AttributeError, ArithmeticError, RuntimeError)
_YAML_DEPTH = 20
_YAML_ERRORS = (*MALFORMED, yaml.YAMLError)
_SHORT = reprlib.Repr(maxlevel=2, maxstring=80, maxother=80, maxlong=80)


def read_bytes(path: Path, what: str, limit: int) -> bytes:
    """Read a file of limited size.

    Args:
        path: path of the file.
        what: expected content, for messages.
        limit: largest file that is read [bytes].

    Raises:
        ValueError: a file that is missing, cannot be read or is too large.
    """
    where = printable_path(path)
    try:
        if not path.is_file():  # opening a pipe would block for ever
            raise ValueError(f"{where} is not there or not a file; accepted: {what} file")
        with path.open("rb") as file:
            data = file.read(limit + 1)
    except OSError as error:
        raise ValueError(f"{where} cannot be read: {error_reason(error)}") from None
    if len(data) > limit:
        raise ValueError(f"{where} is too large; accepted: at most {limit} bytes of {what}")
    return data


def read_yaml(path: Path, of: str = "map", limit: int = YAML_LIMIT) -> dict[object, object]:
    """Read a YAML file that holds a mapping.

    Args:
        path: path of the file.
        of: expected content, for messages.
        limit: largest file that is read [bytes].

    Raises:
        ValueError: a file that is missing, too large, too intricate or no YAML mapping.
    """
    where = printable_path(path)
    data = read_bytes(path, f"a {of}'s YAML", limit)
    try:
        _refuse_intricate(data)
        entries = yaml.safe_load(data)
    except _YAML_ERRORS as error:
        raise ValueError(f"{where} is not a {of}'s YAML: {error_reason(error)}") from None
    if not isinstance(entries, dict):
        raise ValueError(f"{where} holds {short_repr(entries)}; accepted: a YAML mapping of a {of}")
    return entries


def _refuse_intricate(data: bytes) -> None:
    # A few nested aliases can expand to more entries than fit in memory, and the time of PyYAML
    # grows with the square of the depth. A legitimate map needs neither.
    depth = 0
    for event in yaml.parse(data, yaml.SafeLoader):
        if isinstance(event, yaml.AliasEvent):
            raise ValueError("it uses YAML aliases")
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        if depth > _YAML_DEPTH:
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
            staged.append((stack.enter_context(hidden_file(path)), path))
            staged[-1][0].write_bytes(data)
        for temporary, path in staged:
            os.replace(temporary, path)


def short_repr(value: object) -> str:
    """Return a short text of any value, for messages."""
    try:
        return _SHORT.repr(value)
    except ValueError:  # an integer with more digits than Python prints
        return f"a {type(value).__name__} that is too long to print"


def printable_path(path: Path) -> str:
    """Return a path for messages, with unprintable characters escaped."""
    return str(path) if str(path).isprintable() else repr(str(path))


def error_reason(error: BaseException) -> str:
    """Return the reason of an error in one short line, for messages."""
    from PIL import UnidentifiedImageError  # slow to import, and few need it

    if isinstance(error, UnidentifiedImageError):  # its text is only the repr of the open file
        return "it is none of these"
    text = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    line = " ".join(text.split())
    return _SHORT.repr(line)[1:-1] if len(line) > 200 else line or type(error).__name__
