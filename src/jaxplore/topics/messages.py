"""Messages of Foxglove's schemas, from arrays.

Lengths are in metres, angles in radians, colours in 256 levels, stamps in nanoseconds.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jaxplore._optional import import_optional
from jaxplore.maps.datum import ORIGIN, Datum
from jaxplore.report.drawing.palette import Colour

EXTRA = "record"
"""Extra that installs the package of Foxglove."""
NUMERIC = {"uint8": "Uint8", "float32": "Float32"}
"""Foxglove's names of the types of a grid's values."""
FLAT = 0.02
"""Height of bodies on the ground [m]: they cover neither the robot's scan nor its plan."""
EVEN = 0.05
"""Greatest deviation of a beam from even angles, in parts of the angle between two beams."""


def _sdk() -> Any:
    return import_optional("foxglove.messages", EXTRA)


def timestamp(stamp: int) -> Any:
    """Return a stamp [ns] as a `Timestamp`."""
    return _sdk().Timestamp(*divmod(stamp, 1_000_000_000))


def rotation(yaw: float) -> Any:
    """Return the `Quaternion` of a heading."""
    return _sdk().Quaternion(z=math.sin(0.5 * yaw), w=math.cos(0.5 * yaw))


def pose(x: float, y: float, yaw: float = 0.0, *, z: float = 0.0) -> Any:
    """Return a `Pose`."""
    sdk = _sdk()
    return sdk.Pose(position=sdk.Vector3(x=x, y=y, z=z), orientation=rotation(yaw))


def frame_transform(
    stamp: int, parent: str, child: str, x: float, y: float, yaw: float, *, z: float = 0.0
) -> Any:
    """Return the `FrameTransform` that places a frame in its parent."""
    sdk = _sdk()
    return sdk.FrameTransform(
        timestamp=timestamp(stamp),
        parent_frame_id=parent,
        child_frame_id=child,
        translation=sdk.Vector3(x=x, y=y, z=z),
        rotation=rotation(yaw),
    )


def pose_in_frame(stamp: int, frame: str, x: float, y: float, yaw: float, *, z: float = 0.0) -> Any:
    """Return a `PoseInFrame`."""
    at = pose(x, y, yaw, z=z)
    return _sdk().PoseInFrame(timestamp=timestamp(stamp), frame_id=frame, pose=at)


def grid(
    stamp: int,
    frame: str,
    origin: np.ndarray,
    cell: float,
    values: Mapping[str, np.ndarray],
    *,
    height: float = 0.0,
) -> Any:
    """Return a `Grid` with one or several values (H, W) per cell, of type uint8 or float32.

    Row 0 is at the origin, the pose (x, y, yaw) of the outer corner of cell (0, 0) in the frame. If
    the values are called red, green, blue and alpha, Foxglove draws the grid in these colours.
    """
    sdk = _sdk()
    packed = np.dtype([(name, each.dtype) for name, each in values.items()])
    shape = next(iter(values.values())).shape
    cells = np.empty(shape, packed)
    for name, each in values.items():
        cells[name] = each
    types = sdk.PackedElementFieldNumericType
    offsets = np.cumsum([0, *(each.dtype.itemsize for each in values.values())]).tolist()
    return sdk.Grid(
        timestamp=timestamp(stamp),
        frame_id=frame,
        pose=pose(*np.asarray(origin, np.float64).tolist(), z=height),
        column_count=shape[1],
        cell_size=sdk.Vector2(x=cell, y=cell),
        row_stride=shape[1] * packed.itemsize,
        cell_stride=packed.itemsize,
        fields=[
            sdk.PackedElementField(
                name=name,
                offset=offset,
                type=getattr(types, NUMERIC[each.dtype.name]),
            )
            for offset, (name, each) in zip(offsets, values.items(), strict=False)
        ],
        data=cells.tobytes(),
    )


def even_angles(bearings: np.ndarray) -> tuple[float, float] | None:
    """Return the first and the last angle of a fan of beams; None if its angles are not even.

    The `bearings` (B,) may be in any turn, and are NaN where they are not known.
    """
    index = np.flatnonzero(np.isfinite(bearings))
    if len(index) < 2:
        return None
    known = np.unwrap(bearings[index].astype(np.float64))
    step = (known[-1] - known[0]) / (index[-1] - index[0])
    first = known[0] - step * index[0]
    if step == 0.0 or np.abs(first + step * index - known).max() > EVEN * abs(step):
        return None
    return float(first), float(first + step * (len(bearings) - 1))


def laser_scan(stamp: int, frame: str, angles: tuple[float, float], ranges: np.ndarray) -> Any:
    """Return a `LaserScan` of ranges (B,) at even angles between the first and the last."""
    return _sdk().LaserScan(
        timestamp=timestamp(stamp),
        frame_id=frame,
        pose=pose(0.0, 0.0),
        start_angle=angles[0],
        end_angle=angles[1],
        ranges=ranges.astype(np.float64).tolist(),
    )


def point_cloud(stamp: int, frame: str, points: np.ndarray) -> Any:
    """Return a `PointCloud` of points (N, 2) on the ground, or (N, 3).

    Its points are in single precision, so far from the origin they are relative to its pose.
    """
    sdk = _sdk()
    place = Datum.near(*points[0, :2].tolist()) if len(points) else ORIGIN
    kind = sdk.PackedElementFieldNumericType.Float32
    flat = np.zeros((len(points), 3), np.float32)
    flat[:, : points.shape[1]] = place.to_local(points)
    return sdk.PointCloud(
        timestamp=timestamp(stamp),
        frame_id=frame,
        pose=pose(place.x, place.y),
        point_stride=12,
        fields=[
            sdk.PackedElementField(name=name, offset=4 * i, type=kind)
            for i, name in enumerate("xyz")
        ],
        data=flat.tobytes(),
    )


def colour(levels: Colour) -> Any:
    """Return a `Color`; opaque without a fourth level."""
    red, green, blue, alpha = (*(level / 255.0 for level in levels), 1.0)[:4]
    return _sdk().Color(r=red, g=green, b=blue, a=alpha)


def line(
    points: np.ndarray, levels: Colour, width: float, *, closed: bool = False, z: float = 0.0
) -> Any:
    """Return a `LinePrimitive` through points (N, 2) at height z, or through points (N, 3).

    Points that are not finite are left out. The width is in pixels of the screen. A closed line
    joins the last point to the first.
    """
    sdk = _sdk()
    kinds = sdk.LinePrimitiveLineType
    known = points[np.isfinite(points).all(axis=-1)].astype(np.float64)
    return sdk.LinePrimitive(
        type=kinds.LineLoop if closed else kinds.LineStrip,
        thickness=width,
        scale_invariant=True,
        points=[sdk.Point3(x=x, y=y, z=high[0] if high else z) for x, y, *high in known.tolist()],
        color=colour(levels),
    )


def disc(middle: np.ndarray, radius: float, levels: Colour) -> Any:
    """Return a flat `CylinderPrimitive` around a point (2,) on the ground."""
    sdk, (x, y) = _sdk(), np.asarray(middle, np.float64).tolist()
    return sdk.CylinderPrimitive(
        pose=pose(x, y, z=0.5 * FLAT),
        size=sdk.Vector3(x=2.0 * radius, y=2.0 * radius, z=FLAT),
        bottom_scale=1.0,
        top_scale=1.0,
        color=colour(levels),
    )


def polygon(corners: np.ndarray, levels: Colour) -> Any:
    """Return a convex polygon (V, 2) as a `TriangleListPrimitive`."""
    sdk = _sdk()
    around = [sdk.Point3(x=x, y=y, z=FLAT) for x, y in corners.astype(np.float64).tolist()]
    triangles = [
        point for i in range(1, len(around) - 1) for point in (around[0], *around[i : i + 2])
    ]
    return sdk.TriangleListPrimitive(pose=pose(0.0, 0.0), points=triangles, color=colour(levels))


type Entities = Mapping[str, tuple[str, Mapping[str, Sequence[Any]]]]
"""Entities by name: the frame of each, and its `lines`, `cylinders` and `triangles`."""


def scene(stamp: int, entities: Entities) -> Any:
    """Return a `SceneUpdate`; each entity replaces the former one of its name."""
    sdk = _sdk()
    return sdk.SceneUpdate(
        entities=[
            sdk.SceneEntity(
                timestamp=timestamp(stamp),
                frame_id=frame,
                id=name,
                frame_locked=True,
                **{kind: list(some) for kind, some in primitives.items()},
            )
            for name, (frame, primitives) in entities.items()
        ]
    )
