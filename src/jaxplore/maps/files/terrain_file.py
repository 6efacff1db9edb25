"""Store a terrain map in one `.npz` file of plain arrays, which is not trusted when it is read."""

import io
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxplore._text import error_reason, printable_path
from jaxplore.maps.files.npz import MALFORMED_NPZ, array_names, read_arrays
from jaxplore.maps.resample import CELL_LIMIT

LAYERS = ("probability", "elevation", "slope", "roughness", "traversability")
"""Names of the arrays (H, W); all other arrays are small."""
BYTE_LIMIT = 5 * 4 * CELL_LIMIT + 2**20
"""Largest file that is read [bytes]: the five uncompressed layers of the largest map."""

_SUFFIX = ".npz"
_TYPES = {
    **dict.fromkeys(LAYERS, ("<f4", 2)),
    "origin": ("<f4", 1),
    "resolution": ("<f8", 0),
    "threshold": ("<f4", 0),
    "max_slope": ("<f4", 0),
    "max_roughness": ("<f4", 0),
    "is_given": ("|b1", 0),
}
_OPTIONAL = frozenset({"max_roughness"})


def pack(path: Path, arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Return the content of a terrain file that holds arrays by name; nothing is written.

    A path that does not end in .npz raises a `ValueError`.
    """
    if path.suffix.lower() != _SUFFIX:
        raise ValueError(f"path is {printable_path(path)}; accepted: a name that ends in {_SUFFIX}")
    plain = {name: np.asarray(value, _TYPES[name][0], order="C") for name, value in arrays.items()}
    stream = io.BytesIO()
    np.savez_compressed(stream, allow_pickle=False, **plain)
    return stream.getvalue()


def unpack[T](path: Path, data: bytes, build: Callable[[dict[str, NDArray[Any]]], T]) -> T:
    """Check the content of a terrain file and build an object from its arrays.

    Types, numbers of axes and sizes are checked against those that `pack` writes, and the layers
    must have one shape. `build` gets the arrays by name and has to check their values. The path is
    for messages.
    """
    try:
        return build(_arrays(data))
    except MALFORMED_NPZ as error:
        raise ValueError(
            f"{printable_path(path)} is not a terrain map ({error_reason(error)}); "
            "accepted: what TerrainMap.save writes"
        ) from None


def _arrays(data: bytes) -> dict[str, NDArray[Any]]:
    names = array_names(data)
    missing = sorted(_TYPES.keys() - _OPTIONAL - set(names))
    if missing:
        raise ValueError(f"it lacks {', '.join(missing)}")
    if len(set(names)) < len(names) or not set(names) <= _TYPES.keys():
        raise ValueError(f"it holds more than {', '.join(_TYPES)}")
    arrays = read_arrays(data, _check_header)
    shapes = {arrays[name].shape for name in LAYERS}
    if len(shapes) > 1:
        raise ValueError(f"its layers have the shapes {sorted(shapes)}")
    return arrays


def _check_header(name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
    kind, ndim = _TYPES[name]
    if dtype != np.dtype(kind) or len(shape) != ndim:
        raise ValueError(f"{name} has shape {shape} and type {dtype}")
    if not 0 < math.prod(shape) <= CELL_LIMIT:
        raise ValueError(f"{name} has shape {shape}, not 1 to {CELL_LIMIT} cells")
