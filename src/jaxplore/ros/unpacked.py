"""Bounds of the unpacked size of an MCAP file's chunks, without unpacking them.

A reader unpacks a chunk as a whole, and a few bytes may stand for gigabytes.

Source: MCAP specification (records, chunks); RFC 8878 (zstd frames and blocks); LZ4 frame format.
"""

import struct
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

from jaxplore._files import open_regular

CHUNK_LIMIT = 2**28
"""Greatest unpacked size of a chunk [bytes]."""
_MAGIC = b"\x89MCAP0\r\n"
_CHUNK = 0x06
_ZSTD, _SKIPPABLE, _LZ4 = 0xFD2FB528, 0x184D2A5, 0x184D2204
_ZSTD_BLOCK = 2**17
"""Greatest unpacked size of a block of zstd [bytes]."""


def check_chunks(path: Path, limit: int = CHUNK_LIMIT) -> None:
    """Check that no chunk of an MCAP file can be unpacked to more than a limit.

    Args:
        path: the file.
        limit: the limit [bytes].

    Raises:
        ValueError: a chunk that may be larger, or is packed in a way that is not known; a file that
            is no MCAP. A damaged one may raise a `struct.error` or an `IndexError`.
    """
    opened = open_regular(path)
    if opened is None:
        raise ValueError("it is not there or not a file")
    with opened as file:
        if file.read(len(_MAGIC)) != _MAGIC:
            raise ValueError("it is no MCAP file")
        end = file.seek(0, 2)
        file.seek(len(_MAGIC))
        while file.tell() < end - len(_MAGIC):
            kind, size = struct.unpack("<BQ", file.read(9))
            following = file.tell() + size
            if kind == _CHUNK:
                _check_chunk(file, limit)
            file.seek(following)


def _check_chunk(file: BinaryIO, limit: int) -> None:
    declared, name_size = struct.unpack("<16xQ4xI", file.read(32))
    name = file.read(name_size)
    (size,) = struct.unpack("<Q", file.read(8))
    if max(declared, size) > limit:
        raise ValueError(f"a chunk has {max(declared, size)} bytes, more than {limit}")
    bounds = {b"": lambda data: len(data), b"zstd": zstd_bound, b"lz4": lz4_bound}
    if name not in bounds:
        raise ValueError(f"a chunk is packed by {name!r}")
    if bounds[name](file.read(size)) > max(limit, 0):
        raise ValueError(f"a chunk may have more than {limit} bytes unpacked")


def zstd_bound(data: bytes) -> int:
    """Return a bound of the unpacked size of zstd frames [bytes]."""
    return _bound(data, _zstd_frame)


def lz4_bound(data: bytes) -> int:
    """Return a bound of the unpacked size of LZ4 frames [bytes]."""
    return _bound(data, _lz4_frame)


def _bound(data: bytes, frame: Callable[[bytes, int], tuple[int, int]]) -> int:
    """Return the sum of the bounds of all frames [bytes].

    Args:
        data: the frames, and skippable ones, which both formats share.
        frame: function that returns the position after the frame at a position, and its bound.
    """
    at = total = 0
    while at < len(data):
        if _magic(data, at) >> 4 == _SKIPPABLE:
            at += 8 + struct.unpack_from("<I", data, at + 4)[0]
            continue
        at, size = frame(data, at)
        total += size
    return total


def _magic(data: bytes, at: int) -> int:
    return int(struct.unpack_from("<I", data, at)[0])


def _zstd_frame(data: bytes, at: int) -> tuple[int, int]:
    if _magic(data, at) != _ZSTD:
        raise ValueError("a chunk is no zstd frame")
    about, bound = data[at + 4], 0
    is_single, content = about >> 5 & 1, about >> 6
    # The sizes of the window's, dictionary's and content's fields.
    at += 5 + (1 - is_single) + (0, 1, 2, 4)[about & 3] + (is_single, 2, 4, 8)[content]
    is_last = 0
    while not is_last:
        block = int.from_bytes(data[at : at + 3], "little")
        is_last, kind, size = block & 1, block >> 1 & 3, block >> 3
        if at + 3 > len(data) or kind == 3:
            raise ValueError("a zstd frame is damaged")
        # A block is plain, one byte repeated, or compressed.
        at += 3 + (size, 1, size)[kind]
        bound += (size, size, _ZSTD_BLOCK)[kind]
    return at + 4 * (about >> 2 & 1), bound


def _lz4_frame(data: bytes, at: int) -> tuple[int, int]:
    if _magic(data, at) != _LZ4:
        raise ValueError("a chunk is no LZ4 frame")
    flags, most, bound = data[at + 4], 1 << 8 + 2 * (data[at + 5] >> 4 & 7), 0
    at += 7 + 8 * (flags >> 3 & 1) + 4 * (flags & 1)
    while True:
        (block,) = struct.unpack_from("<I", data, at)
        at += 4
        if block == 0:
            break
        # The highest bit marks a plain block.
        at += (block & 0x7FFFFFFF) + 4 * (flags >> 4 & 1)
        bound += most
    return at + 4 * (flags >> 2 & 1), bound
