"""What can be true of poses and scans: known cases, on the host and traced."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import Lidar, OccupancyGrid
from jaxplore.belief.belief import Belief
from jaxplore.control.plausibility import MAX_MISFIT, is_jump, is_moving, pose_error, scan_misfit
from jaxplore.maps.clearance import clearance_field
from jaxplore.sensing.beams import Scan

CELL = 0.1
LIDAR = Lidar(num_beams=72, max_range=4.0, range_noise=0.0)


def room(unknown: slice | None = None) -> Belief:
    """A known room of 6 x 4 m with walls all around; some rows may be unknown."""
    cells = np.full((44, 64), 0.01, np.float32)
    cells[:2] = cells[-2:] = 0.99
    cells[:, :2] = cells[:, -2:] = 0.99
    if unknown is not None:
        cells[unknown] = 0.5
    grid = OccupancyGrid(cells, CELL)
    return Belief(grid=grid, clearance=clearance_field(~grid.is_free, grid.frame, 1.0))


def seen_from(x: float, y: float, yaw: float, noise: float = 0.0) -> Scan:
    """The exact scan of the empty room, by plane geometry."""
    angles = yaw + LIDAR.beam_angles.astype(np.float64)
    cos, sin = np.cos(angles), np.sin(angles)
    with np.errstate(divide="ignore"):
        to_x = np.where(cos > 0, (6.2 - x) / cos, (0.2 - x) / cos)
        to_y = np.where(sin > 0, (4.2 - y) / sin, (0.2 - y) / sin)
    reach = np.minimum(to_x, to_y)
    reach = reach + noise * np.random.default_rng(0).normal(size=reach.shape)
    is_return = reach < LIDAR.max_range
    ranges = np.where(is_return, reach, LIDAR.max_range).astype(np.float32)
    return Scan(jnp.asarray(ranges), jnp.asarray(is_return))


misfit = jax.jit(lambda belief, scan, pose: scan_misfit(belief, LIDAR, scan, pose))


def test_a_scan_fits_where_it_was_taken() -> None:
    for x, y, yaw in ((2.0, 1.5, 0.3), (5.0, 3.0, -2.0)):
        assert float(misfit(room(), seen_from(x, y, yaw), jnp.array([x, y, yaw]))) == 0.0
        # Within the errors that odometry and lidar may have.
        near = jnp.array([x + 0.1, y - 0.1, yaw + 0.05])
        assert float(misfit(room(), seen_from(x, y, yaw, noise=0.05), near)) < 0.1


def test_a_scan_does_not_fit_at_another_pose() -> None:
    scan = seen_from(2.0, 1.5, 0.3)
    for pose in ((4.0, 3.0, 0.3), (2.0, 1.5, 0.3 + np.pi / 2), (3.5, 2.5, 1.2)):
        assert float(misfit(room(), scan, jnp.array(pose))) > 0.3
    # Something that stands around the robot: no return fits.
    close = Scan(jnp.full(72, 0.5), jnp.ones(72, bool))
    assert float(misfit(room(), close, jnp.array([3.0, 2.0, 0.0]))) > MAX_MISFIT


def test_unknown_space_contradicts_nothing() -> None:
    everywhere = room(unknown=slice(0, 44))
    scan = Scan(jnp.full(72, 0.7), jnp.ones(72, bool))
    assert float(misfit(everywhere, scan, jnp.array([3.0, 2.0, 0.0]))) == 0.0
    # Nor do a few returns, no returns, or a pose that there is not.
    few = Scan(jnp.full(72, 0.5), jnp.arange(72) < 5)
    assert float(misfit(room(), few, jnp.array([3.0, 2.0, 0.0]))) == 0.0
    scan = Scan(jnp.full(72, 0.5), jnp.ones(72, bool))
    assert float(misfit(room(), scan, jnp.full(3, jnp.nan))) == 0.0


@pytest.mark.parametrize("xp", [np, jnp])
def test_poses(xp) -> None:
    here = xp.asarray([1.0, 2.0, 3.1])
    distance, turn = pose_error(here, xp.asarray([4.0, 6.0, -3.1]))
    assert float(distance) == pytest.approx(5.0)
    assert float(turn) == pytest.approx(2 * np.pi - 6.2, abs=1e-5)
    assert not is_jump(here, xp.asarray([1.4, 2.0, -3.1]))
    assert is_jump(here, xp.asarray([1.6, 2.0, 3.1]))
    assert is_jump(here, xp.asarray([1.0, 2.0, 2.2]))
    assert is_jump(here, xp.asarray([np.nan, 2.0, 3.1]))
    for twist, expected in (
        ((0.09, 0.0, 0.19), False),
        ((0.08, -0.08, 0.0), True),
        ((0.0, 0.0, -0.3), True),
    ):
        assert bool(is_moving(xp.asarray(twist))) is expected
    assert is_moving(xp.asarray([0.06, 0.0, 0.0]), 0.5)


def test_poses_far_from_the_origin_keep_their_precision_on_the_host() -> None:
    there = np.array([500_000.0, 4_649_776.0, 0.0])
    distance, _ = pose_error(there, there + np.array([0.25, 0.0, 0.0]))
    assert distance == 0.25
