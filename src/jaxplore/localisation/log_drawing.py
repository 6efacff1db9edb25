"""The sensor of a log, the size of cells that its scans need, and the map of scans at poses."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import NDArray

from jaxplore._limits import MOST_BEAMS
from jaxplore._types import Count
from jaxplore.localisation.surface import USUAL_NOISE
from jaxplore.maps.frame import GridFrame
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.sensing.base import Sensor
from jaxplore.sensing.beams import Beams, Scan
from jaxplore.sensing.inverse_sensor_model import InverseSensorModel
from jaxplore.sensing.laser_log import LaserLog
from jaxplore.sensing.lidar import Lidar

MOST_CELLS = 40_000_000
"""Greatest number of cells of a map: 10 ha have that many of 0.05 m."""
WHOLE = 128
"""The sides of maps are multiples of so many cells, so that few shapes are compiled."""
CERTAIN = 4.0
"""Greatest log-odds of a cell of the map."""
SIDES = (0.05, 0.1, 0.2)
"""Sides of cells to choose from [m]."""
SPREAD, GAP = 2.5, 0.4
"""Least side of a cell by the noise of ranges, in standard deviations, and as a share of the median
distance of neighbouring points. The surfaces of a scan are 3 cells wide."""
MOST_FILLING = 6
"""Greatest number of points with which a surface between two beams is written."""
NEAR, STEEP = 8.0, 0.3
"""Range up to which the noise of readings is estimated [m], and the difference of readings from a
straight line from which on they are no longer of one surface [m]."""
_Floats = NDArray[np.float64]


class Sampling(eqx.Module):
    """How densely the scans of a log sample surfaces.

    Args:
        noise: standard deviation of its readings [m].
        side: side of the cells in which its scans are matched [m].
        filling: number of points with which a surface between two beams is written.
    """

    noise: float
    side: float
    filling: int = eqx.field(static=True)

    @classmethod
    def of(cls, log: LaserLog, max_range: float) -> "Sampling":
        """Estimate it from readings of at most `max_range` [m].

        On a flat surface the inverse of a reading is a cosine of its direction, so that it follows
        from its two neighbours, a step a away on either side:

            r_0 = 2 cos(a) / (1 / r_1 + 1 / r_2)

        The difference has one and a half times the variance of a reading where the three are about
        equal; its median says what that is. Cells are as large as the noise and the distance
        between neighbouring points need.
        """
        ranges = log.ranges
        noise, gaps = USUAL_NOISE, np.zeros(1)
        if ranges.shape[1] > 2:
            before, at, after = ranges[:, :-2], ranges[:, 1:-1], ranges[:, 2:]
            cosine = math.cos(log.angle_increment)
            expected = 2.0 * cosine * before * after / np.maximum(before + after, 1e-9)
            bend = np.abs(at - expected)
            flat = bend[(at < NEAR) & (np.minimum(at, expected) > 0.0) & (bend < STEEP)]
            if len(flat):
                noise = max(float(1.4826 * np.median(flat) / math.sqrt(1.5)), 1e-3)
            # The law of cosines.
            one, two = ranges[:, :-1], ranges[:, 1:]
            square = (one - two) ** 2 + 2.0 * one * two * (1.0 - math.cos(log.angle_increment))
            is_point = (np.maximum(one, two) < max_range) & (np.minimum(one, two) > 0.0)
            gaps = np.sqrt(square[is_point]) if is_point.any() else gaps
        median, upper = np.quantile(gaps, [0.5, 0.75])
        needed = max(SPREAD * noise, GAP * median)
        side = next((each for each in SIDES if each >= needed), SIDES[-1])
        return cls(noise, side, min(max(math.ceil(upper / side), 1), MOST_FILLING))


def log_sensor(log: LaserLog, max_range: float) -> Lidar:
    """Return a lidar whose beams are those of a log, with readings up to `max_range` [m].

    The beams of a `Lidar` are symmetric to the heading. Where those of the log are not, as 180
    beams from -90 degrees, it has one more, which never has a reading.
    """
    step, number = log.angle_increment, log.ranges.shape[1]
    if abs(step * number - math.tau) < 1e-6:
        return Lidar(number, max_range, math.tau)
    widest = max(abs(log.angle_min), abs(log.angle_min + log.field_of_view))
    number = min(round(2.0 * widest / step) + 1, MOST_BEAMS) if number > 1 else 1
    return Lidar(number, max_range, 2.0 * widest if number > 1 else step or math.pi)


def frame_around(
    sensor: Beams, scans: Scan, poses: _Floats, resolution: float, margin: float
) -> tuple[GridFrame, tuple[int, int]]:
    """Return the frame and the shape of a map along the axes that holds all points of scans.

    The scans are arrays (N, B). The map is `margin` [m] wider than the points on each side.
    """
    low, high = poses[:, :2].min(axis=0), poses[:, :2].max(axis=0)
    for pose, ranges, is_return in zip(
        poses, np.asarray(scans.ranges), np.asarray(scans.is_return), strict=True
    ):
        angles = pose[2] + sensor.beam_angles[is_return]
        ends = pose[:2] + ranges[is_return, None] * np.stack([np.cos(angles), np.sin(angles)], 1)
        if len(ends):
            low, high = np.minimum(low, ends.min(axis=0)), np.maximum(high, ends.max(axis=0))
    low = np.floor((low - margin) / resolution) * resolution
    cells = np.ceil((high + margin - low) / (resolution * WHOLE)) * WHOLE
    if cells.prod() > MOST_CELLS:
        raise ValueError(
            f"resolution is {resolution:g}, which makes a map of {cells.prod():.3g} cells; "
            f"accepted: a resolution that makes at most {MOST_CELLS}"
        )
    return GridFrame(resolution, (*low.tolist(), 0.0)), (int(cells[1]), int(cells[0]))


def draw_map(sensor: Sensor, scans: Scan, poses: _Floats, resolution: float) -> OccupancyGrid:
    """Return the occupancy grid of scans, in arrays (N, B), at poses (N, 3)."""
    frame, shape = frame_around(sensor, scans, poses, resolution, resolution)
    blank = OccupancyGrid.unknown(shape, frame)
    # Beams without an echo often met glass or something black: they say nothing of what is free.
    returned = Scan(jnp.where(scans.is_return, scans.ranges, 0.0), scans.is_return)
    model = InverseSensorModel.from_odds(clamp=(-CERTAIN, CERTAIN))
    return _draw(sensor, model, blank, returned, jnp.asarray(poses, jnp.float32))


@eqx.filter_jit
def _draw(
    sensor: Sensor,
    model: InverseSensorModel,
    grid: OccupancyGrid,
    scans: Scan,
    poses: Float[Array, "N 3"],
) -> OccupancyGrid:
    """Return a grid after scans."""

    def add(index: Count, grid: OccupancyGrid) -> OccupancyGrid:
        scan = Scan(scans.ranges[index], scans.is_return[index])
        return sensor.update(grid, scan, poses[index], model)

    drawn: OccupancyGrid = jax.lax.fori_loop(0, poses.shape[0], add, grid)
    return drawn


def all_scans(log: LaserLog, sensor: Beams, used: NDArray[np.int64]) -> Scan:
    """Return some scans of a log for a sensor, in arrays (N, B); `used` are their indices (N,)."""
    scans = [log.scan(int(index), sensor) for index in used]
    return Scan(
        jnp.asarray(np.stack([np.asarray(each.ranges) for each in scans])),
        jnp.asarray(np.stack([np.asarray(each.is_return) for each in scans])),
    )
