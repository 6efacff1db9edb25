"""Bounds of the unpacked size of the chunks of bags, without keeping what is unpacked.

A reader unpacks a chunk as a whole, and a few bytes may stand for gigabytes.

Source: MCAP specification (records, chunks); bag format 2.0 of ROS 1.
"""

import bz2
import struct
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

from jaxplore._files import open_regular
from jaxplore._optional import import_optional

CHUNK_LIMIT = 2**28
"""Greatest unpacked size of a chunk [bytes]."""
_MAGIC = b"\x89MCAP0\r\n"
_CHUNK = 0x06
_ROS1_MAGIC, _ROS1_CHUNK = b"#ROSBAG V2.0\n", b"\x05"
_MOST_NAME = 64
"""Longest name of a compression [bytes]."""
_PART = 2**20
"""Number of bytes that are unpacked at a time."""


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
    if name_size > _MOST_NAME:
        raise ValueError(f"the name of how a chunk is packed has {name_size} bytes")
    name = file.read(name_size)
    (size,) = struct.unpack("<Q", file.read(8))
    if max(declared, size) > limit:
        raise ValueError(f"a chunk has {max(declared, size)} bytes, more than {limit}")
    _check_unpacked(name.decode(errors="replace"), file.read(size), limit)


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
                if declared > limit:
                    raise ValueError(f"a chunk has more than {limit} bytes unpacked")
                name = fields[b"compression"].decode(errors="replace")
                _check_unpacked("" if name == "none" else name, file.read(size), limit)
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


def _check_unpacked(name: str, data: bytes, limit: int) -> None:
    """Unpack data in small parts, which are not kept, until the end or the limit."""
    total = 0 if name else len(data)
    while name and data and total <= limit:
        unpacker = _decompressor(name)
        while not unpacker.eof and total <= limit:
            part = unpacker.decompress(data, max_length=_PART)
            data = b""
            if not part and not unpacker.eof and unpacker.needs_input:
                raise ValueError(f"a chunk of {name} is cut off")
            total += len(part)
        data = unpacker.unused_data or b""
    if total > limit:
        raise ValueError(f"a chunk has more than {limit} bytes unpacked")


def _decompressor(name: str) -> Any:
    """Return what unpacks one stream; the three libraries follow Python's `bz2`."""
    if name == "bz2":
        return bz2.BZ2Decompressor()
    if name == "lz4":
        return import_optional("lz4.frame", "bags").LZ4FrameDecompressor()
    if name != "zstd":
        raise ValueError(f"a chunk is packed by {name!r}")
    module = "compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd"
    return import_optional(module, "bags").ZstdDecompressor()
