"""Check what headers of meshes and point clouds promise against the size of their files.

Readers allocate what they promise. `mesh_process` bounds all of it; this refuses at once and in
words what cannot be true.
"""

import math
import re
import struct
from collections.abc import Callable, Iterator, Mapping
from typing import BinaryIO

_HEADER = 20_000
"""Longest part of a file that is looked at [bytes]."""
_DIGITS = 15
"""Digits of a number that are read: all files are shorter."""
_PCD = re.compile(rb"^(COUNT|POINTS|WIDTH|HEIGHT)[ \t]+([\d \t]{1,10000})\r?$", re.MULTILINE)
_PLY = re.compile(rb"^element[ \t]+\S+[ \t]+(\d{1,10000})[ \t]*\r?$", re.MULTILINE)
_LAS = struct.Struct("<HIIBHI")
"""From byte 94: size of the header, begin of the points, records of variable length, format of a
point, its length, and number of points."""
_LEAST_RECORD = 54
"""Bytes of a record of variable length without content."""

_BEGINNINGS = {
    "ply": b"ply",
    "las": b"LASF",
    "laz": b"LASF",
    "glb": b"glTF",
    "gltf": b"{",
    "dae": b"<",
}
"""What files begin with, after space and a mark of UTF-8. Meshes in STL and OBJ have no sign."""

type _Promises = Iterator[tuple[str, int, int]]
"""What there is, how many, and the least bytes of each."""


def check_header(file: BinaryIO, kind: str) -> None:
    """Check the numbers in the header of a regular file, and go back to the file's beginning.

    `kind` is the ending of its name, without the dot. Kinds without a check here all pass.
    """
    header, size = file.read(_HEADER), file.seek(0, 2)
    file.seek(0)
    begins = header.removeprefix(b"\xef\xbb\xbf").lstrip()
    if not begins.startswith(_BEGINNINGS.get(kind, b"")) or not begins:
        raise ValueError(f"it begins with {begins[:8]!r}")
    for what, number, least in _CHECKS.get(kind, _nothing)(header):
        if number * least > size:
            raise ValueError(f"its header promises {number} {what} in {size} bytes")


def _nothing(header: bytes) -> _Promises:
    yield from ()


def _of_pcd(header: bytes) -> _Promises:
    if b"\nDATA " not in header:
        raise ValueError("it has no header with DATA")
    found = {each[1]: _numbers(each[2]) for each in _PCD.finditer(header)}
    yield "numbers of a point", sum(found.get(b"COUNT", ())), 1
    yield "points", sum(found.get(b"POINTS", ())), 1
    yield "points", math.prod((*found.get(b"WIDTH", [0]), *found.get(b"HEIGHT", [1]))), 1


def _of_ply(header: bytes) -> _Promises:
    for each in _PLY.finditer(header.partition(b"end_header")[0]):
        yield "elements", sum(_numbers(each[1])), 1


def _of_las(header: bytes) -> _Promises:
    if len(header) < 94 + _LAS.size:
        return
    own, begin, records, form, length, points = _LAS.unpack_from(header, 94)
    yield "bytes before the points", max(own, begin), 1
    yield "records", records, _LEAST_RECORD
    # A bit of the format says that the points are compressed.
    if not form & 0x80:
        yield f"points of {length} bytes", points, length


_CHECKS: Mapping[str, Callable[[bytes], _Promises]] = {
    "pcd": _of_pcd,
    "ply": _of_ply,
    "las": _of_las,
    "laz": _of_las,
}


def _numbers(text: bytes) -> list[int]:
    return [int(each[:_DIGITS]) for each in text.split()]
