"""How the points of a 3-D lidar or a depth camera become a scan of the plane."""

import dataclasses
import math
from typing import Literal, get_args

from jaxplore import _checks

CloudAxes = Literal["auto", "body", "optical"]
"""Axes of a cloud, see `CloudView`."""


@dataclasses.dataclass(frozen=True)
class CloudView:
    """How a cloud of points becomes a scan of the plane.

    Args:
        height: height of the sensor above the floor [m], within the band: what is as high as a part
            of the robot is in its way.
        least_height: height above the floor below which points are of the floor [m].
        greatest_height: height above the floor above which the robot passes below points [m].
        pitch: tilt of the sensor, forwards downwards [rad].
        roll: tilt of the sensor, to the right downwards [rad].
        least_range: distance from the sensor below which points are of the robot [m].
        axes: axes of the points: `body` has x ahead, y to the left and z up, `optical` z ahead, x
            to the right and y down; `auto` takes the latter where the name of the frame ends in
            `_optical` or `_optical_frame`.
        is_rest_free: whether a beam met nothing that no point tells anything of.

    Raises:
        ValueError: numbers that are not finite, a band without the sensor, other axes.
    """

    height: float
    least_height: float = 0.1
    greatest_height: float = 1.0
    pitch: float = 0.0
    roll: float = 0.0
    least_range: float = 0.0
    axes: CloudAxes = "auto"
    is_rest_free: bool = False

    def __post_init__(self) -> None:
        for name in ("height", "least_height", "greatest_height"):
            _checks.number(name, getattr(self, name))
        for name in ("pitch", "roll"):
            _checks.number(name, getattr(self, name), at_least=-math.pi, at_most=math.pi)
        _checks.number("least_range", self.least_range, at_least=0.0)
        if not self.least_height < self.height < self.greatest_height:
            raise ValueError(
                f"height of a cloud's sensor is {self.height:g}; accepted: between its "
                f"least_height, {self.least_height:g}, and its greatest_height, "
                f"{self.greatest_height:g}"
            )
        if self.axes not in get_args(CloudAxes):
            raise ValueError(f"axes is {self.axes!r}; accepted: {', '.join(get_args(CloudAxes))}")
