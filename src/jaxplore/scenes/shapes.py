"""Geometry of the view: lines as segments, bodies as meshes."""

import numpy as np

SIDES = 24
"""Number of corners of a rounded outline."""
_ANGLES = 2.0 * np.pi * np.arange(SIDES) / SIDES
_DIRECTIONS = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=-1)
BURIED = -1e4
"""Height at which a shape that is nowhere is put [m]."""


def raise_points(points: np.ndarray, height: float) -> np.ndarray:
    """Append a height [m] to points (..., 2)."""
    level = np.full((*points.shape[:-1], 1), height)
    return np.concatenate([points, level], axis=-1).astype(np.float32)


def segments(lines: np.ndarray, height: float) -> np.ndarray:
    """Cut lines (N, T, 2) into segments (N * (T - 1), 2, 3) at a height [m].

    A segment with an end that is not finite becomes a point at the origin, below the ground, so
    that the number of segments stays the same.
    """
    pieces = raise_points(np.stack([lines[:, :-1], lines[:, 1:]], axis=2), height).reshape(-1, 2, 3)
    is_lost = ~np.isfinite(pieces).all(axis=(1, 2))
    pieces[is_lost] = (0.0, 0.0, BURIED)
    return pieces


def grow_outlines(corners: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """Return outlines (N, 24, 2) of convex polygons (N, V, 2) that are grown by radii (N,) [m].

    A polygon of one corner becomes a disc. Points of a polygon that is not finite are NaN.
    """
    along = np.einsum("nvi,ki->nkv", corners, _DIRECTIONS)
    farthest = np.take_along_axis(corners, along.argmax(axis=-1)[..., None], axis=1)
    return np.asarray(farthest + np.reshape(radii, (-1, 1, 1)) * _DIRECTIONS)


def prisms(outlines: np.ndarray, bottom: float, top: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the vertices (2 N K, 3) and the faces (F, 3) of upright prisms on convex outlines (N,
    K, 2), counterclockwise [m], from `bottom` to `top`. The faces depend on the shape of the
    outlines only. Prisms whose outline is not finite are put deep below the ground."""
    number, sides = outlines.shape[:2]
    vertices = np.stack([raise_points(outlines, bottom), raise_points(outlines, top)], axis=1)
    is_lost = ~np.isfinite(vertices).all(axis=(1, 2, 3))
    vertices[is_lost] = (0.0, 0.0, BURIED)
    here = np.arange(sides)
    ahead = np.roll(here, -1)
    walls = [
        np.stack([here, ahead, sides + ahead], axis=-1),
        np.stack([here, sides + ahead, sides + here], axis=-1),
    ]
    fan = np.arange(1, sides - 1)
    lid = sides + np.stack([np.zeros_like(fan), fan, fan + 1], axis=-1)
    faces = np.concatenate([*walls, lid])
    starts = 2 * sides * np.arange(number)[:, None, None]
    return vertices.reshape(-1, 3), (starts + faces).reshape(-1, 3).astype(np.uint32)


def strip(left: np.ndarray, right: np.ndarray, height: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the vertices (2 P, 3) and the faces of the ground between two lines (P, 2) [m]."""
    count = len(left)
    here = np.arange(count - 1)
    faces = np.concatenate(
        [
            np.stack([here, here + count, here + 1], axis=-1),
            np.stack([here + 1, here + count, here + count + 1], axis=-1),
        ]
    )
    return raise_points(np.concatenate([left, right]), height), faces.astype(np.uint32)


def turn(heading: float) -> tuple[float, float, float, float]:
    """Return the quaternion (w, x, y, z) of a heading [rad]; that of 0 if it is not finite."""
    half = 0.5 * heading if np.isfinite(heading) else 0.0
    return float(np.cos(half)), 0.0, 0.0, float(np.sin(half))
