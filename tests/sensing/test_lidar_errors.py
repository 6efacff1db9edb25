"""Least range, missing and false returns, and the floor of a tilted lidar."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore.sensing.beams import Scan
from jaxplore.sensing.lidar_errors import NEAR_FLOOR, LidarErrors, floor_distance

BEAMS, REACH = 4000, 6.0
ANGLES = np.linspace(-np.pi, np.pi, BEAMS, endpoint=False, dtype=np.float32)
traces = []


@jax.jit
def apply(errors, ranges, is_return, key):
    traces.append(1)
    height = jnp.asarray(0.3)
    return errors.apply(Scan(ranges, is_return), jnp.asarray(ANGLES), height, REACH, key)


def seen(seed: int = 0, distance: float = 3.0, **numbers: float) -> Scan:
    ranges = np.full(BEAMS, distance, np.float32)
    is_return = ranges < REACH
    found = apply(LidarErrors(**numbers), ranges, is_return, jax.random.key(seed))
    return Scan(np.asarray(found.ranges), np.asarray(found.is_return))


def test_without_errors_a_scan_is_as_it_was() -> None:
    for distance in (3.0, REACH):
        found = seen(distance=distance)
        np.testing.assert_array_equal(found.ranges, np.float32(distance))
        np.testing.assert_array_equal(found.is_return, distance < REACH)


def test_shares_are_those_given() -> None:
    found = seen(1, missing=0.3)
    is_none = found.ranges == 0.0
    assert is_none.mean() == pytest.approx(0.3, abs=0.03)
    np.testing.assert_array_equal(found.is_return, ~is_none)
    np.testing.assert_array_equal(found.ranges[~is_none], 3.0)
    found = seen(2, false_returns=0.2)
    is_false = found.ranges < 3.0
    assert is_false.mean() == pytest.approx(0.2, abs=0.03)
    assert found.is_return.all()
    # They are anywhere on the way.
    assert np.quantile(found.ranges[is_false], [0.25, 0.75]) == pytest.approx([0.75, 2.25], abs=0.2)
    assert seen(2, REACH, false_returns=0.2).is_return.mean() == pytest.approx(0.2, abs=0.03)


def test_what_is_too_near_is_no_measurement() -> None:
    assert not seen(distance=0.25, least_range=0.3).is_return.any()
    assert (seen(distance=0.25, least_range=0.3).ranges == 0.0).all()
    assert seen(distance=0.35, least_range=0.3).is_return.all()
    # Nothing was met, which is not near.
    np.testing.assert_array_equal(seen(distance=REACH, least_range=0.3).ranges, REACH)


@pytest.mark.parametrize(("pitch", "roll"), [(0.1, 0.0), (-0.1, 0.0), (0.0, 0.1), (0.08, -0.12)])
def test_the_floor_is_where_rotated_beams_meet_it(pitch: float, roll: float) -> None:
    # The rotation about y (left) by the pitch, after that about x (ahead) by the roll.
    about_y = np.array(
        [[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]]
    )
    about_x = np.array(
        [[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]]
    )
    angles = ANGLES.astype(np.float64)
    beams = np.stack([np.cos(angles), np.sin(angles), np.zeros(BEAMS)])
    fall = -(about_y @ about_x @ beams)[2]
    expected = np.where(fall > 1e-6, 0.3 / np.where(fall > 1e-6, fall, 1.0), np.inf)
    found = floor_distance(angles, 0.3, pitch, roll)
    np.testing.assert_allclose(found, expected, rtol=1e-6)
    # No reading is left from there on, and none before is lost.
    scan = seen(distance=4.0, pitch=pitch, roll=roll)
    is_near = expected * NEAR_FLOOR <= 4.0
    assert 0 < is_near.sum() < BEAMS
    is_clear = np.abs(expected * NEAR_FLOOR - 4.0) > 1e-3
    np.testing.assert_array_equal(scan.is_return[is_clear], ~is_near[is_clear])


def test_other_numbers_do_not_compile_again() -> None:
    seen(missing=0.1)
    before = len(traces)
    seen(missing=0.2, least_range=0.1, pitch=0.05)
    assert len(traces) == before
