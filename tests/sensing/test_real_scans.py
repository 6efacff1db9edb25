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
from jaxplore.sensing.no_echo import SCANS, NoEcho

FULL, SECTOR = jx.Lidar(num_beams=36, max_range=5.0), jx.Lidar(19, 5.0, math.pi)
READING = st.one_of(
    st.floats(-1.0, 9.0), st.sampled_from([0.0, math.nan, math.inf, -math.inf, 0.1, 4.0, 5.0, 6.0])
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
    if reading > sensor_range or reading >= most:
        return min(sensor_range, most), False
    return reading, True


@given(
    ranges=st.lists(READING, min_size=1, max_size=80),
    first=st.floats(-4.0, 4.0),
    step=st.floats(0.003, 0.4),
    sign=st.sampled_from([-1.0, 1.0]),
    sensor=st.sampled_from([FULL, SECTOR]),
    most=st.sampled_from([4.0, 5.0, 6.0]),
)
def test_each_beam_has_the_nearest_reading(ranges, first, step, sign, sensor, most) -> None:
    found = Scan.from_ranges(ranges, first, sign * step, sensor, range_min=0.1, range_max=most)
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
        expected = one_beam(angle, ranges, first, sign * step, half, (0.1, most, 5.0))
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


# An open hall with a wall ahead: what drivers report where a beam meets nothing.
CONVENTIONS = {"inf": math.inf, "max": 3.5, "above": 4.5, "a little less": 3.46, "zero": 0.0}
CONVENTIONS["nan"] = math.nan


def hall_readings(nothing: float) -> np.ndarray:
    """Some readings of the wall are near the greatest range of 3.5 m."""
    angles = np.radians(np.arange(360) - 180.0)
    ahead = np.where(np.cos(angles) > 0.87, 3.0 / np.maximum(np.cos(angles), 0.87), math.inf)
    return np.where(np.isfinite(ahead), ahead, nothing)


@pytest.mark.parametrize("name", CONVENTIONS)
def test_open_space_is_found_whatever_the_driver_reports_for_it(name: str) -> None:
    finder, readings = NoEcho("auto", 0.04), hall_readings(CONVENTIONS[name])
    news = []
    for _ in range(SCANS + 1):
        found = finder.with_infinite(readings, 3.5)
        news.append(finder.news)
        finder.news = ""
    np.testing.assert_array_equal(found, hall_readings(math.inf))
    said = [each for each in news if each]
    if name in ("inf", "a little less"):
        assert not said
    elif name in ("zero", "nan"):
        assert "0 or NaN for 84 %" in said[0]
        # Before that such a beam changes no cell.
        assert news.index(said[0]) == SCANS - 1
    else:
        assert "greatest range" in said[0]
    assert len(said) <= 1


def test_readings_of_zero_beside_others_are_no_open_space() -> None:
    """Glass and black furniture, of a lidar that reports open space otherwise, or hardly ever."""
    mixed, rare = hall_readings(math.inf), hall_readings(1.0)
    mixed[:90], rare[:30] = 0.0, 0.0
    for readings in (mixed, rare):
        finder = NoEcho("auto", 0.05)
        for _ in range(2 * SCANS):
            found = finder.with_infinite(readings, 3.5)
        np.testing.assert_array_equal(found, readings)
        assert not finder.news


@pytest.mark.parametrize(
    ("rule", "expected"),
    [
        ("inf", [0.0, math.nan, 1.0, 3.46, 3.5, math.inf]),
        ("max", [0.0, math.nan, 1.0, math.inf, math.inf, math.inf]),
        ("zero", [math.inf, math.inf, 1.0, math.inf, math.inf, math.inf]),
    ],
)
def test_a_rule_holds_from_the_first_scan_on(rule: str, expected: list[float]) -> None:
    given = np.array([0.0, math.nan, 1.0, 3.46, 3.5, math.inf])
    np.testing.assert_array_equal(NoEcho(rule, 0.05).with_infinite(given, 3.5), expected)
    with pytest.raises(ValueError, match="no_echo is 'none'; accepted: auto, inf, max, zero"):
        NoEcho("none")


def test_a_short_lidar_frees_only_what_it_sees() -> None:
    """Of a sensor with a greater range than the lidar."""
    empty = Scan.from_ranges([math.inf] * 36, -math.pi, math.pi / 18, FULL, range_max=3.5)
    np.testing.assert_array_equal(empty.ranges, np.float32(3.5))
    assert not np.asarray(empty.is_return).any()


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
