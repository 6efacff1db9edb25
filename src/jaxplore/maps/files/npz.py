"""Read `.npz` and `.npy` files of plain arrays that are not trusted."""

import io
import math
import struct
import zipfile
import zlib
from collections.abc import Callable, Collection
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from jaxplore._files import MALFORMED
from jaxplore._text import error_reason, short_repr

MALFORMED_NPZ = (*MALFORMED, OSError, EOFError, zipfile.BadZipFile, zlib.error, struct.error)
"""Exceptions that a malformed file raises."""
MOST_LETTERS = 40
"""Greatest number of letters of the type of an array that a message shows."""
MOST_MEMBERS = 10_000
"""Greatest number of members of a file."""
_PACKED = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_MEMBER = b"PK\1\2"
"""Beginning of each entry in the list of members."""

type CheckHeader = Callable[[str, tuple[int, ...], np.dtype[Any]], None]
"""Function of the name, shape and type of an array, which refuses it by a `ValueError`."""


def array_names(data: bytes) -> list[str]:
    """Return the names of the arrays in a file, in its order."""
    with _open(data) as archive:
        return [name.removesuffix(".npy") for name in archive.namelist()]


def read_arrays(
    data: bytes, check: CheckHeader, names: Collection[str] | None = None
) -> dict[str, NDArray[Any]]:
    """Read the arrays of a file by name; nothing is unpickled.

    With `names` only those of them that are there are read; None reads all. `check` is called
    before memory is allocated for the size that an array declares.
    """
    with _open(data) as archive:
        return {
            name: _array(archive, member, check)
            for member in archive.infolist()
            for name in [member.filename.removesuffix(".npy")]
            if names is None or name in names
        }


def read_array(
    file: IO[bytes], name: str, check: CheckHeader, most: int | None = None
) -> NDArray[Any]:
    """Read an array from the file of one, `.npy`, at its beginning; nothing is unpickled.

    `check` is called, with `name`, before memory is allocated for the size that the array declares.
    `most` is the greatest size of the file [bytes], where it is known.
    """
    try:
        # Later versions are for names of fields; a header of theirs may have 4 GB.
        if np.lib.format.read_magic(file) != (1, 0):
            raise ValueError("it has another version of the format")
        shape, by_column, dtype = np.lib.format.read_array_header_1_0(file)
    except Exception as error:
        # The header is read as Python's text, which also raises what a tokenizer does.
        raise ValueError(f"{name} has a damaged header: {error_reason(error)}") from None
    if dtype.hasobject or dtype.names or not dtype.itemsize or any(size < 0 for size in shape):
        raise ValueError(
            f"{name} has shape {short_repr(shape)} and type {str(dtype)[:MOST_LETTERS]}"
        )
    check(name, shape, dtype)
    size = math.prod(shape) * dtype.itemsize
    # One byte more than expected shows whether the file is longer than its header says.
    data = file.read(size + 1) if most is None or size <= most else b""
    if len(data) != size:
        raise ValueError(f"{name} has more or fewer values than its shape says")
    return np.frombuffer(data, dtype).reshape(shape, order="F" if by_column else "C")


def _open(data: bytes) -> zipfile.ZipFile:
    """Open an archive whose list of members is bounded: a reader keeps ten times its bytes."""
    if data.count(_MEMBER) > MOST_MEMBERS:
        raise ValueError(f"it has more than {MOST_MEMBERS} members")
    return zipfile.ZipFile(io.BytesIO(data))


def _array(archive: zipfile.ZipFile, member: zipfile.ZipInfo, check: CheckHeader) -> NDArray[Any]:
    name = member.filename.removesuffix(".npy")
    if member.compress_type not in _PACKED:
        raise ValueError(f"{name} is packed in a way that is not known")
    with archive.open(member) as file:
        return read_array(file, name, check)
