"""Checks of the arguments of a perception."""

import math
from collections.abc import Sequence

from jaxplore import _kinds
from jaxplore._types import Scalar
from jaxplore._xla import compute
from jaxplore.belief.roadmap import narrowest
from jaxplore.sensing.base import Sensor
from jaxplore.sensing.beams import Scan

NARROW_SHARE = 0.4
"""Share of the margin that a robot keeps in passages that are too narrow for all of it."""


def as_sensors(sensors: Sensor | Sequence[Sensor]) -> tuple[Sensor, ...]:
    """Return one sensor or several as a tuple."""
    if isinstance(sensors, Sensor):
        return (sensors,)
    if not isinstance(sensors, (list, tuple)):
        _kinds.instance("sensors", sensors, Sensor, hint="or a list of them")
    if not sensors:
        raise ValueError("sensors is empty; accepted: a Sensor, or a list of them")
    _kinds.instances("sensors", sensors, Sensor)
    return tuple(sensors)


def as_scans(scans: Scan | Sequence[Scan], number: int) -> Sequence[Scan]:
    """Return one scan, or one for each of `number` sensors, as a sequence."""
    scans = (scans,) if isinstance(scans, Scan) else scans
    if not isinstance(scans, (list, tuple)):
        _kinds.instance("scans", scans, Scan, hint="or a list of one for each sensor")
    _kinds.instances("scans", scans, Scan)
    if len(scans) != number:
        raise ValueError(f"scans has {len(scans)} scans; accepted: {number}, one per sensor")
    return scans


def safe_stride(
    node_spacing: float, resolution: float, radius: float, required: float | None = None
) -> int:
    """Return the largest stride s <= node_spacing / resolution at which no path can jump a wall.

    A node of the guidance field is open if the robot fits at any cell of its block. Two such cells
    in adjacent blocks are at most `sqrt(2) (2 s - 1)` cells apart. On two sides of a wall whose
    cells share faces they are at least `2 radius` plus a cell apart. The line between them crosses
    the line between two cells of the wall, which are at most `sqrt(2)` cells apart where they touch
    at a corner. Both are at least R = `required` plus half a cell from both, so they are at least
    `2 sqrt(R^2 - 1/2)` cells apart. `required` is the clearance that paths keep; the radius of the
    robot's disc when None. All arguments are in metres.

    With a stride of 1 a diagonal step may pass a wall, which `clear_corners` forbids.
    """
    stride = max(1, round(node_spacing / resolution))
    nearest = (radius if required is None else required) / resolution + 0.5
    # The tolerance counts equal lengths as a path that jumps.
    apart = 2.0 * math.sqrt(max(0.0, nearest**2 - 0.5)) - 1e-6
    apart = min(2.0 * radius / resolution + 1.0, apart)
    # The largest s with sqrt(2) (2 s - 1) < apart, in closed form: counting down takes 10^8 steps
    # for cells of a nanometre, which a user may have written by mistake.
    return max(1, min(stride, math.ceil(0.5 * (apart / math.sqrt(2.0) + 1.0)) - 1))


def narrow_clearance(
    radius: Scalar, margin: Scalar, stride: int, resolution: float, *, has_corners: bool
) -> Scalar:
    """Return the clearance from which a robot takes narrow passages [m].

    It is `radius + NARROW_SHARE margin`, and at least `narrowest`. Other paths keep `margin` [m]
    beyond the radius of the robot's disc. With `has_corners`, paths are checked at the corners of
    blocks.
    """
    least = narrowest(stride, resolution, has_corners=has_corners)
    return compute(
        lambda xp, *each: xp.maximum(each[0] + NARROW_SHARE * each[1], xp.float32(least)),
        *(radius, margin),
    )
