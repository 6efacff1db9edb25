"""Place what a mesh or a point cloud holds: unit and up axis are given, said or guessed."""

import warnings

import numpy as np
from numpy.typing import NDArray

from jaxplore.maps.files.mesh_process import Geometry

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
