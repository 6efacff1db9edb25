"""Bounds of the unpacked size of the chunks of bags, without keeping what is unpacked.

A reader unpacks a chunk as a whole, and a few bytes may stand for gigabytes.

Source: MCAP specification (records, chunks); RFC 8878 (zstd frames and blocks); LZ4 frame format;
bag format 2.0 of ROS 1.
"""

import bz2
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from jaxplore._files import open_regular

CHUNK_LIMIT = 2**28
"""Greatest unpacked size of a chunk [bytes]."""
_MAGIC = b"\x89MCAP0\r\n"
_CHUNK = 0x06
_ROS1_MAGIC, _ROS1_CHUNK = b"#ROSBAG V2.0\n", b"\x05"
_BZ2_PART = 2**20
"""Number of bytes that are unpacked of bz2 at a time."""
_ZSTD, _SKIPPABLE, _LZ4 = 0xFD2FB528, 0x184D2A5, 0x184D2204
_ZSTD_BLOCK = 2**17
"""Greatest unpacked size of a block of zstd [bytes]."""


def check_chunks(path: Path, limit: int = CHUNK_LIMIT) -> None:
    """Check that no chunk of an MCAP file can be unpacked to more than a limit [bytes].

    It raises a `ValueError` for a chunk that may be larger or is packed in an unknown way, and for
    a file that is no MCAP. A damaged one may raise a `struct.error` or an `IndexError`.
    """
    with _open_after(_MAGIC, path, "MCAP file") as (file, end):
        while file.tell() < end - len(_MAGIC):
            kind, size = struct.unpack("<BQ", file.read(9))
            following = file.tell() + size
            if kind == _CHUNK:
                _check_chunk(file, limit)
            file.seek(following)


@contextmanager
def _open_after(magic: bytes, path: Path, kind: str) -> Iterator[tuple[BinaryIO, int]]:
    """Open a file that begins with some bytes, behind them; yield it and its size."""
    opened = open_regular(path)
    if opened is None:
        raise ValueError("it is not there or not a file")
    with opened as file:
        if file.read(len(magic)) != magic:
            raise ValueError(f"it is no {kind}")
        end = file.seek(0, 2)
        file.seek(len(magic))
        yield file, end


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


def check_records(path: Path, limit: int = CHUNK_LIMIT) -> None:
    """Check that no chunk of a bag of ROS 1 is unpacked to more than a limit [bytes].

    The limit is also that of each record and header. It raises a `ValueError` for one that is
    larger, a chunk that is packed in an unknown way, and a file that is no such bag or ends within
    a record. A damaged one may raise a `struct.error`, an `IndexError` or an `OSError`.
    """
    with _open_after(_ROS1_MAGIC, path, "bag of ROS 1, version 2.0") as (file, end):
        while file.tell() < end:
            fields = _fields(_read_field_bytes(file, end, limit))
            (size,) = struct.unpack("<I", file.read(4))
            following = file.tell() + size
            if size > limit or following > end:
                raise ValueError(f"a record has {size} bytes, more than {min(limit, end)}")
            if fields.get(b"op") == _ROS1_CHUNK:
                (declared,) = struct.unpack("<I", fields[b"size"])
                name, data = fields[b"compression"], file.read(size)
                if declared > limit or _ros1_bound(name, data, limit) > limit:
                    raise ValueError(f"a chunk may have more than {limit} bytes unpacked")
            file.seek(following)


def _read_field_bytes(file: BinaryIO, end: int, limit: int) -> bytes:
    """Return the bytes that follow, whose number comes first."""
    (size,) = struct.unpack("<I", file.read(4))
    if size > min(limit, end - file.tell()):
        raise ValueError(f"a header has {size} bytes, more than there are")
    return file.read(size)


def _fields(header: bytes) -> dict[bytes, bytes]:
    """Return the fields of a header of ROS 1."""
    fields, at = {}, 0
    while at < len(header):
        (size,) = struct.unpack_from("<I", header, at)
        name, _, value = header[at + 4 : at + 4 + size].partition(b"=")
        fields[name] = value
        at += 4 + size
    return fields


def _ros1_bound(name: bytes, data: bytes, limit: int) -> int:
    """Return a bound of the unpacked size of a chunk of ROS 1; more than the limit says enough."""
    if name == b"none":
        return len(data)
    if name == b"lz4":
        return lz4_bound(data)
    if name != b"bz2":
        raise ValueError(f"a chunk is packed by {name!r}")
    # Its blocks do not say how much they hold.
    total = 0
    while data and total <= limit:
        unpacker = bz2.BZ2Decompressor()
        while not unpacker.eof and total <= limit:
            part = unpacker.decompress(data, _BZ2_PART)
            data = b""
            if not part and unpacker.needs_input:
                raise ValueError("a chunk of bz2 is cut off")
            total += len(part)
        data = unpacker.unused_data
    return total


def zstd_bound(data: bytes) -> int:
    """Return a bound of the unpacked size of zstd frames [bytes]."""
    return _bound(data, _zstd_frame)


def lz4_bound(data: bytes) -> int:
    """Return a bound of the unpacked size of LZ4 frames [bytes]."""
    return _bound(data, _lz4_frame)


def _bound(data: bytes, frame: Callable[[bytes, int], tuple[int, int]]) -> int:
    """Return the sum of the bounds of all frames [bytes]; both formats share skippable frames.

    `frame` returns the position after the frame at a position, and its bound.
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
