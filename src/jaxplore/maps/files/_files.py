"""Map files: YAML that is not trusted, and outputs that are written whole or not at all."""

import os
import reprlib
import secrets
from collections.abc import Sequence
from pathlib import Path

import yaml
from PIL import UnidentifiedImageError

YAML_LIMIT = 100_000
"""Largest YAML file read [bytes]."""
# What PyYAML and Pillow let out, beside their own errors, when a file is malformed.
MALFORMED = (ValueError, TypeError, LookupError, AttributeError, ArithmeticError, RuntimeError)
_YAML_DEPTH = 20
_YAML_ERRORS = (*MALFORMED, yaml.YAMLError)
_SHORT = reprlib.Repr(maxlevel=2, maxstring=80, maxother=80, maxlong=80)


def read_bytes(path: Path, what: str, limit: int) -> bytes:
    """Return what is in a file.

    Args:
        path: of the file.
        what: it is to hold, for messages.
        limit: largest file that is read [bytes].

    Raises:
        ValueError: a file that is missing, cannot be read or is too large.
    """
    where = name_of(path)
    try:
        if not path.is_file():
            raise ValueError(f"{where} is not there or not a file; accepted: {what} file")
        with path.open("rb") as file:
            data = file.read(limit + 1)
    except OSError as error:
        raise ValueError(f"{where} cannot be read: {reason_of(error)}") from None
    if len(data) > limit:
        raise ValueError(f"{where} is too large; accepted: at most {limit} bytes of {what}")
    return data


def read_yaml(path: Path, of: str = "map", limit: int = YAML_LIMIT) -> dict[object, object]:
    """Return the mapping in a YAML file.

    Args:
        path: of the file.
        of: what it is to hold, for messages.
        limit: largest file that is read [bytes].

    Raises:
        ValueError: a file that is missing, too large, too intricate or no YAML mapping.
    """
    where = name_of(path)
    data = read_bytes(path, f"a {of}'s YAML", limit)
    try:
        _refuse_intricate(data)
        entries = yaml.safe_load(data)
    except _YAML_ERRORS as error:
        raise ValueError(f"{where} is not a {of}'s YAML: {reason_of(error)}") from None
    if not isinstance(entries, dict):
        raise ValueError(f"{where} holds {show(entries)}; accepted: a YAML mapping of a {of}")
    return entries


def _refuse_intricate(data: bytes) -> None:
    # A few nested aliases can stand for more entries than fit in memory, and the time PyYAML takes
    # grows with the square of the depth. A map's YAML is a flat mapping with one list.
    depth = 0
    for event in yaml.parse(data, yaml.SafeLoader):
        if isinstance(event, yaml.AliasEvent):
            raise ValueError("it uses YAML aliases")
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        if depth > _YAML_DEPTH:
            raise ValueError(f"it nests more than {_YAML_DEPTH} deep")


def replace_files(files: Sequence[tuple[Path, bytes]]) -> None:
    """Write all files, or none of them."""
    for path, _ in files:
        # The one way the second rename fails once the first, in the same folder, has succeeded.
        if path.is_dir():
            raise IsADirectoryError(f"{name_of(path)} is a folder")
    staged: list[tuple[Path, Path]] = []
    try:
        for path, data in files:
            staged.append((path.with_name(f".{secrets.token_hex(8)}.tmp"), path))
            with staged[-1][0].open("xb") as file:
                file.write(data)
        for temporary, path in staged:
            os.replace(temporary, path)
    finally:
        for temporary, _ in staged:
            temporary.unlink(missing_ok=True)


def show(value: object) -> str:
    """Return a short text of any value."""
    try:
        return _SHORT.repr(value)
    except ValueError:  # a whole number with more digits than Python prints
        return f"a {type(value).__name__} that is too long to print"


def name_of(path: Path) -> str:
    """Return a path as it can be printed."""
    return str(path) if str(path).isprintable() else repr(str(path))


def reason_of(error: BaseException) -> str:
    """Return why something failed, in one short line."""
    if isinstance(error, UnidentifiedImageError):  # its text is the open file's repr
        return "it is none of these"
    text = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    line = " ".join(text.split())
    return _SHORT.repr(line)[1:-1] if len(line) > 200 else line or type(error).__name__
