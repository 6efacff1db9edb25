"""Read meshes and point clouds by their libraries, in a process with bounds of memory and time.

The libraries take a file at its word: a few bytes may ask for all memory, or never end. So
`mesh_script` runs them in a process of its own. Readers allocate what a header promises: what
cannot be true of the size of the file is refused before, and in words.
"""

import json
import math
import os
import re
import struct
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxplore._optional import is_missing
from jaxplore._text import error_reason

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
SECONDS = 60
"""Greatest processor time of a reader [s]."""
WAITS = 10
"""Greatest ratio of the time on the wall to it: a machine may be shared."""
LEAST = 0.5e9
"""Least memory of a reader: it takes half of that without a file [bytes]."""
KINDS = ("stl", "obj", "ply", "glb", "gltf", "dae", "pcd", "las", "laz")
"""Kinds of files that are read so."""
_SCRIPT = Path(__file__).with_name("mesh_script.py")
_LONGEST = 10_000
AXES = ("x", "y", "z")
"""Axes of a file of which one is up."""
_TALL = 500.0
"""Least extent from which on the unit of a file is taken for the millimetre [m]: no building is as
high."""
_VAST = 500.0
"""Extent from which on it may be another one [m]."""
_TINY = 1.0
"""Extent below which it may be another one [m]: no robot fits in."""
_FLAT = {"x": 0.5, "y": 0.75, "z": 0.75}
"""Share of the other two extents below which the extent along an axis is a height. Files with x up
are rare, and corridors along y or z are not."""


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


class Geometry(NamedTuple):
    """What the file of a mesh or of a point cloud holds, in its own unit and axes.

    Args:
        corners: (N, 3) corners or points.
        faces: (M, 3) corners of each triangle; none of a point cloud.
        num_open: edges that belong to an odd number of triangles.
        up: axis that the format says is up; None where it says none.
        unit: unit that it says [m]; None where it says none.
    """

    corners: NDArray[np.float64]
    faces: NDArray[np.int32]
    num_open: int
    up: str | None
    unit: float | None


def read_geometry(file: BinaryIO, kind: str, memory: float) -> Geometry:
    """Read a mesh or a point cloud from a regular file at its beginning; `kind` is in `KINDS`.

    The reader may take `memory` [bytes]; at least `LEAST` is given.
    """
    most = int(max(memory, LEAST))
    # Each thread of a numerical library takes address space.
    alone = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
    # -P: modules beside the script are not found by its imports.
    command = [sys.executable, "-P", "-W", "ignore", str(_SCRIPT), kind, str(most), str(SECONDS)]
    with tempfile.TemporaryFile() as out:
        try:
            ended = subprocess.run(
                command,
                stdin=file,
                stdout=out,
                stderr=subprocess.DEVNULL,
                timeout=WAITS * SECONDS,
                env=os.environ | alone,
                check=False,
            )
        except subprocess.TimeoutExpired:
            raise ValueError(f"its reader did not end within {WAITS * SECONDS} s") from None
        except OSError as error:
            raise ValueError(f"its reader cannot be started: {error_reason(error)}") from None
        out.seek(0)
        about = json.loads(out.readline(_LONGEST) or b'{"error": "ended"}')
        if "missing" in about:
            raise is_missing(about["missing"], "volumes")
        if about.get("error") == "memory":
            raise ValueError(f"its reader needs more than {most / 1e9:.3g} GB")
        if about.get("error") == "ended" or ended.returncode:
            raise ValueError(
                f"its reader ended with code {ended.returncode}, within {most / 1e9:.3g} GB and "
                f"{SECONDS} s"
            )
        if "error" in about:
            raise ValueError(error_reason(ValueError(about["error"])))
        corners = np.fromfile(out, np.float64, 3 * about["corners"]).reshape(-1, 3)
        faces = np.fromfile(out, np.int32, 3 * about["faces"]).reshape(-1, 3)
    return Geometry(corners, faces, about["open"], about.get("up"), about.get("unit"))


def place(
    geometry: Geometry, scale: float | None, up: str | None, name: str
) -> NDArray[np.float64]:
    """Return corners or points (N, 3) in metres with z up, and warn of what was guessed.

    `scale` is metres in a unit of the geometry, and `up` its up axis. Where one is None, what the
    file says counts, or else a guess. Warnings name the file by `name`.
    """
    extent = np.ptp(geometry.corners, axis=0)
    said = geometry.unit
    factor = said if scale is None and said is not None else scale
    notes = []
    if factor is None:
        factor = 1e-3 if extent.min() > _TALL else 1.0
        if factor < 1.0:
            notes.append("millimetres are taken for its unit, file.scale=0.001")
    axis = up
    if axis is None:
        by_extent = _least(extent)
        axis = by_extent or geometry.up or "z"
        if axis != "z" or geometry.up not in (None, axis):
            why = "by its extents" if by_extent else "as its format has it"
            notes.append(f"{axis} is taken for up {why}, file.up={axis}")
    size = extent * factor
    if scale is None and not notes and said is None:
        if size.max() > _VAST:
            notes.append("if its unit is not the metre, file.scale, 0.001 for millimetres")
        elif size.max() < _TINY:
            notes.append("if its unit is not the metre, file.scale, such as 100")
    if notes:
        x, y, z = size
        warnings.warn(
            f"volume {name} is {x:.4g} m x {y:.4g} m x {z:.4g} m along its x, y and z: "
            f"{'; '.join(notes)}",
            UserWarning,
            stacklevel=4,
        )
    return _turn(geometry.corners, axis) * factor


def _least(extent: NDArray[np.float64]) -> str | None:
    """Return the axis along which something is flat, which is the height of most buildings."""
    for axis, size in zip(AXES, extent, strict=True):
        if size < _FLAT[axis] * np.delete(extent, AXES.index(axis)).min():
            return axis
    return None


def _turn(points: NDArray[np.float64], up: str) -> NDArray[np.float64]:
    """Return points (N, 3) turned so that an axis of theirs is z: a rotation, no reflection."""
    x, y, z = points.T
    if up == "y":
        return np.stack([x, -z, y], axis=1)
    return np.stack([y, z, x], axis=1) if up == "x" else points
