"""Readings of a real lidar become a scan of the sensor that the map is made with."""

import math

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import jaxplore as jx
from jaxplore.sensing import Scan
from jaxplore.sensing.base import update_grid

FULL, SECTOR = jx.Lidar(num_beams=36, max_range=5.0), jx.Lidar(19, 5.0, math.pi)
READING = st.one_of(
    st.floats(-1.0, 9.0), st.sampled_from([0.0, math.nan, math.inf, -math.inf, 0.1, 6.0])
)


def one_beam(angle, ranges, first, step, half, limits):
    """Look at all readings one by one, in plain Python."""
    least, most, sensor_range = limits
    offsets = []
    for index in range(len(ranges)):
        turn = math.remainder(angle - (first + index * step), 2.0 * math.pi)
        offsets.append(abs(turn))
    best = min(range(len(ranges)), key=offsets.__getitem__)
    reading = ranges[best]
    if offsets[best] > half or math.isnan(reading) or reading <= 0.0 or reading < least:
        return 0.0, False
    if most < reading < math.inf:
        return 0.0, False
    if reading > sensor_range:
        return sensor_range, False
    return reading, True


@given(
    ranges=st.lists(READING, min_size=1, max_size=80),
    first=st.floats(-4.0, 4.0),
    step=st.floats(0.003, 0.4),
    sign=st.sampled_from([-1.0, 1.0]),
    sensor=st.sampled_from([FULL, SECTOR]),
)
def test_each_beam_has_the_nearest_reading(ranges, first, step, sign, sensor) -> None:
    found = Scan.from_ranges(ranges, first, sign * step, sensor, range_min=0.1, range_max=6.0)
    half = 0.5 * max(step, sensor.beam_spacing) + 1e-6
    offsets = np.abs(
        np.remainder(
            sensor.beam_angles.astype(float)[:, None]
            - (first + sign * step * np.arange(len(ranges)))
            + math.pi,
            2.0 * math.pi,
        )
        - math.pi
    )
    ordered = np.sort(offsets, axis=1)
    for beam, angle in enumerate(sensor.beam_angles.astype(float)):
        # Rounding decides between two readings that are equally near, or at the edge.
        is_tie = len(ranges) > 1 and ordered[beam, 1] - ordered[beam, 0] < 1e-6
        if is_tie or abs(ordered[beam, 0] - half) < 1e-6:
            continue
        expected = one_beam(angle, ranges, first, sign * step, half, (0.1, 6.0, 5.0))
        assert float(found.ranges[beam]) == pytest.approx(expected[0], rel=1e-6)
        assert bool(found.is_return[beam]) == expected[1]


def test_the_sensor_s_own_readings_are_its_scan() -> None:
    readings = np.linspace(0.5, 4.5, 36)
    found = Scan.from_ranges(readings, float(FULL.beam_angles[0]), FULL.beam_spacing, FULL)
    np.testing.assert_allclose(found.ranges, readings, rtol=1e-6)
    assert found.is_return.all()
    turned = Scan.from_ranges(readings[::-1], float(FULL.beam_angles[-1]), -FULL.beam_spacing, FULL)
    np.testing.assert_array_equal(turned.ranges, found.ranges)


def test_a_beam_without_a_measurement_changes_no_cell() -> None:
    grid = jx.OccupancyGrid.unknown((40, 40), jx.OccupancyGrid(np.zeros((1, 1)), 0.2).frame)
    pose = jnp.asarray([4.0, 4.0, 0.0])
    nothing = Scan.from_ranges([math.nan] * 36, -math.pi, math.pi / 18, FULL)
    sighting = FULL.sight(grid, nothing, pose)
    after = update_grid(grid, sighting, jx.InverseSensorModel())
    changed = np.argwhere(np.asarray(after.probability) != 0.5)
    # The cell of the robot itself may count as passed.
    assert len(changed) <= 1
    empty = Scan.from_ranges([math.inf] * 36, -math.pi, math.pi / 18, FULL)
    assert not np.asarray(empty.is_return).any()
    free = update_grid(grid, FULL.sight(grid, empty, pose), jx.InverseSensorModel())
    assert int(jnp.sum(free.is_free)) > 400


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"ranges": np.ones((1, 1))}, r"ranges has shape \(1, 1\); accepted: \(R,\) with R >= 1"),
        ({"ranges": []}, r"ranges has shape \(0,\)"),
        ({"angle_min": math.nan}, "angle_min is nan"),
        ({"angle_increment": 0.0}, "angle_increment is 0.0; accepted: an angle that is not 0"),
        ({"range_min": -1.0}, "range_min is -1.0"),
        ({"range_max": 0.0}, "range_max is 0.0; accepted: more than range_min"),
    ],
)
def test_bad_input_is_named(changes, message: str) -> None:
    good = {"ranges": [1.0], "angle_min": 0.0, "angle_increment": 0.1, "sensor": FULL}
    with pytest.raises(ValueError, match=message):
        Scan.from_ranges(**{**good, **changes})
