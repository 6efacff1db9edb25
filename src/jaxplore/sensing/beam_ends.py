"""Scans from the ends of rays that do not lie on the beams of a sensor."""

import numpy as np

from jaxplore._xla import on_device
from jaxplore.sensing.beams import Beams, Scan, covers_circle, fan_angles


def scan_of_ends(
    sensor: Beams, met: np.ndarray, free: np.ndarray, *, is_rest_free: bool = False
) -> Scan:
    """Return the scan of a sensor from the ends of rays.

    A beam with an end of `met` within half a spacing has the nearest one's distance. Others are
    free up to the farthest end of `free`, and without one they have no measurement.

    Args:
        sensor: sensor whose beams are filled.
        met: (2, N) ends that met something, relative to the sensor, along the robot's heading [m].
        free: (2, M) ends that met nothing, likewise.
        is_rest_free: whether beams without an end are free up to the greatest range.
    """
    number, most = sensor.num_beams, float(sensor.max_range)
    # One more for ends outside of the field of view.
    nearest = np.full(number + 1, np.inf, met.dtype)
    farthest = np.zeros(number + 1, free.dtype)
    np.minimum.at(nearest, _beam_of(sensor, met), np.sqrt(np.square(met).sum(axis=0)))
    np.maximum.at(farthest, _beam_of(sensor, free), np.sqrt(np.square(free).sum(axis=0)))
    # A beam whose nearest end is beyond its range met nothing within it.
    is_free = np.isfinite(nearest) | ((farthest == 0.0) & is_rest_free)
    ranges = np.where(nearest <= most, nearest, np.where(is_free, most, np.minimum(farthest, most)))
    is_return = nearest[:number] <= most
    return Scan(on_device(ranges[:number].astype(np.float32)), on_device(is_return))


def _beam_of(sensor: Beams, ends: np.ndarray) -> np.ndarray:
    """Return the beam (N,) that is nearest to each end (2, N); B for none within half a spacing."""
    number, view = sensor.num_beams, float(sensor.field_of_view)
    away = np.arctan2(ends[1], ends[0]) - fan_angles(number, view)[0]
    beam = np.round(away / sensor.beam_spacing).astype(int)
    if covers_circle(view):
        return np.asarray(beam % number)
    return np.where((beam >= 0) & (beam < number), beam, number)
