"""Read `.npz` files of plain arrays that are not trusted."""

import io
import math
import struct
import zipfile
import zlib
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxplore._files import MALFORMED
from jaxplore._text import error_reason

MALFORMED_NPZ = (*MALFORMED, OSError, EOFError, zipfile.BadZipFile, zlib.error, struct.error)
"""Exceptions that a malformed file raises."""
_PACKED = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)

type CheckHeader = Callable[[str, tuple[int, ...], np.dtype[Any]], None]
"""Function of the name, shape and type of an array, which refuses it by a `ValueError`."""


def array_names(data: bytes) -> list[str]:
    """Return the names of the arrays in a file, in its order."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return [name.removesuffix(".npy") for name in archive.namelist()]


def read_arrays(data: bytes, check: CheckHeader) -> dict[str, NDArray[Any]]:
    """Read the arrays of a file, by name; nothing is unpickled.

    Args:
        data: content of the file.
        check: called before memory is allocated for the size that an array declares.

    Raises:
        ValueError: what `check` refuses, and arrays that are not plain. A file that is malformed
            may raise any of `MALFORMED_NPZ`.
    """
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return {
            member.filename.removesuffix(".npy"): _array(archive, member, check)
            for member in archive.infolist()
        }


def _array(archive: zipfile.ZipFile, member: zipfile.ZipInfo, check: CheckHeader) -> NDArray[Any]:
    name = member.filename.removesuffix(".npy")
    if member.compress_type not in _PACKED:
        raise ValueError(f"{name} is packed in a way that is not known")
    with archive.open(member) as file:
        if np.lib.format.read_magic(file) != (1, 0):
            raise ValueError(f"{name} has another version of the format")
        try:
            shape, by_column, dtype = np.lib.format.read_array_header_1_0(file)
        except Exception as error:
            # The header is read as Python's text, which also raises what a tokenizer does.
            raise ValueError(f"{name} has a damaged header: {error_reason(error)}") from None
        if by_column or dtype.hasobject or any(size < 0 for size in shape):
            raise ValueError(f"{name} has shape {shape} and type {dtype}")
        check(name, shape, dtype)
        size = math.prod(shape) * dtype.itemsize
        # One byte more than expected shows whether the member is longer than its header says.
        data = file.read(size + 1)
    if len(data) != size:
        raise ValueError(f"{name} has more or fewer values than its shape says")
    return np.frombuffer(data, dtype).reshape(shape)
