import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore.maps.world import MovingObstacle
from jaxplore.parts import MovingObstacles

PATHS = (
    MovingObstacle(((0.0, 0.0), (4.0, 0.0), (4.0, 3.0)), 1.5, 0.3),  # a round of 12 m
    MovingObstacle(((1.0, 1.0), (1.0, 3.0)), 0.5, 0.2),  # back and forth, 4 m
    MovingObstacle(((7.0, -2.0),), 2.0, 0.5),  # a point
    MovingObstacle(((0.0, 5.0), (1.0, 5.0), (1.0, 6.0), (0.0, 6.0)), 0.0, 0.1),  # no speed
    MovingObstacle(
        ((2.0, 2.0), (2.0, 2.0), (3.0, 2.0), (3.0, 2.0), (2.0, 2.0)), 0.7, 0.4
    ),  # repeated
    MovingObstacle(((-1.5, 0.3), (2.2, 4.1), (-3.0, 1.7), (0.4, -2.6), (1.1, 0.9)), 1.1, 0.6),
)
MOVERS = MovingObstacles(PATHS)
PHASE = np.array([0.25, 0.9, 0.5, 0.6, 0.1, 0.33])
at = jax.jit(jax.vmap(MovingObstacles.at, in_axes=(None, 0)))
discs = jax.jit(jax.vmap(lambda movers, time: movers.at(time).discs, in_axes=(None, 0)))


def walk(mover, times, phase=0.0):
    """Return positions (T, 2), by interpolation along the closed polyline in double precision."""
    loop = np.array([*mover.path, mover.path[0]])
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(loop, axis=0), axis=1))])
    travelled = phase * arc[-1] + mover.speed * times
    rest = travelled % arc[-1] if arc[-1] > 0 else np.zeros_like(travelled)
    return np.stack([np.interp(rest, arc, loop[:, axis]) for axis in (0, 1)], axis=-1)


def rounds():
    """Return the length of each round [m]."""
    loops = [np.array([*mover.path, mover.path[0]]) for mover in PATHS]
    return np.array([np.linalg.norm(np.diff(loop, axis=0), axis=1).sum() for loop in loops])


TIMES = np.float32(np.random.default_rng(0).uniform(0.0, 60.0, 500))


@pytest.mark.parametrize("phase", [None, PHASE])
def test_positions_are_a_walk_along_the_path(phase):
    found = at(MovingObstacles(PATHS, phase), TIMES)
    assert found.positions.shape == found.velocities.shape == (500, 6, 2)
    for index, mover in enumerate(PATHS):
        start = 0.0 if phase is None else phase[index]
        expected = walk(mover, TIMES.astype(np.float64), start)
        np.testing.assert_allclose(found.positions[:, index], expected, atol=1e-4)


def test_velocity_is_the_derivative_of_the_position():
    found, moved = at(MOVERS, TIMES), 0
    for index, mover in enumerate(PATHS):
        times, step = TIMES.astype(np.float64), 1e-3
        before, here, after = (walk(mover, times + by) for by in (-step, 0.0, step))
        # At a corner the two one-sided differences are not the same.
        is_straight = np.abs(after - 2 * here + before).max(axis=-1) < 1e-9
        assert is_straight.mean() > 0.9
        expected = (after - before)[is_straight] / (2 * step)
        np.testing.assert_allclose(found.velocities[is_straight, index], expected, atol=1e-5)
        moved += mover.speed > 0 and len(mover.path) > 1
    speeds = np.linalg.norm(found.velocities, axis=-1)
    np.testing.assert_allclose(speeds, np.tile([1.5, 0.5, 0, 0, 0.7, 1.1], (500, 1)), rtol=1e-5)
    assert moved == 4


def test_known_places_and_turns():
    found = at(MOVERS, np.float32([0.0, 2.0, 4.0, 8.0]))
    np.testing.assert_allclose(found.positions[:, 0], [[0, 0], [3, 0], [4, 2], [0, 0]], atol=1e-5)
    np.testing.assert_allclose(found.positions[:, 1], [[1, 1], [1, 2], [1, 3], [1, 1]], atol=1e-5)
    # At a corner, the velocity of the segment that begins there.
    np.testing.assert_allclose(found.velocities[:, 1, 1], [0.5, 0.5, -0.5, 0.5], atol=1e-6)
    np.testing.assert_array_equal(found.positions[:, 2], [[7, -2]] * 4)
    np.testing.assert_array_equal(found.velocities[:, 2:4], np.zeros((4, 2, 2)))


def test_a_path_closes_after_its_period():
    speeds = np.array([mover.speed for mover in PATHS])
    length = rounds()
    for index in np.flatnonzero((speeds > 0) & (length > 0)):
        period = length[index] / speeds[index]
        there = at(MOVERS, TIMES[:100])
        # Single precision moves a disc by some micrometres; its direction turns at a corner only.
        again = at(MOVERS, np.float32(TIMES[:100].astype(np.float64) + period))
        np.testing.assert_allclose(again.positions[:, index], there.positions[:, index], atol=2e-4)
        is_same = np.isclose(again.velocities[:, index], there.velocities[:, index], atol=1e-4)
        assert is_same.all(axis=-1).mean() > 0.98


def test_a_phase_is_a_head_start():
    ahead, speeds = MOVERS.with_phase(PHASE), np.array([mover.speed for mover in PATHS])
    for index in np.flatnonzero(speeds):
        early = PHASE[index] * rounds()[index] / speeds[index]
        found = at(ahead, TIMES[:100]).positions[:, index]
        expected = walk(PATHS[index], TIMES[:100].astype(np.float64) + early)
        np.testing.assert_allclose(found, expected, atol=2e-4)
    np.testing.assert_array_equal(MOVERS.phase, np.zeros(6))  # unchanged
    np.testing.assert_array_equal(ahead.phase, np.float32(PHASE))


def test_rounding_leaves_a_disc_on_its_path():
    # A phase that single precision makes a whole round, and times before the start.
    nearly = MOVERS.with_phase(np.full(6, 1.0 - 1e-9))
    first = np.array([mover.path[0] for mover in PATHS])
    found = at(nearly, np.float32([0.0, -1e-9, -3.0, 3.0]))
    np.testing.assert_allclose(found.positions[0], first, atol=1e-6)
    np.testing.assert_allclose(found.positions[1], first, atol=1e-6)
    for index, mover in enumerate(PATHS):
        np.testing.assert_allclose(
            found.positions[2:, index], walk(mover, np.array([-3.0, 3.0])), atol=1e-5
        )
    assert (np.linalg.norm(found.velocities[:, [0, 1, 4, 5]], axis=-1) > 0.4).all()


def test_discs_are_places_and_radii():
    found = discs(MOVERS, TIMES)
    np.testing.assert_array_equal(found[..., :2], at(MOVERS, TIMES).positions)
    radii = np.float32([mover.radius for mover in PATHS])
    np.testing.assert_array_equal(found[..., 2], np.tile(radii, (500, 1)))


def test_no_movers():
    for none in (
        MovingObstacles([]),
        MovingObstacles([]).with_phase([]),
    ):
        found = none.at(jnp.float32(2.0))
        assert found.positions.shape == found.velocities.shape == (0, 2)
        assert found.discs.shape == (0, 3)


def test_other_paths_speeds_and_phases_do_not_compile_again():
    traces = []

    @jax.jit
    def positions(movers, time):
        traces.append(1)
        return movers.at(time).positions

    two = MovingObstacles(PATHS[:2])
    other = MovingObstacles(
        [
            MovingObstacle(((0.0, 0.0),), 1.0, 1.0),
            MovingObstacle(((0.0, 0.0), (1.0, 1.0), (2.0, 0.0)), 3.0, 0.1),
        ]
    )
    for movers in (two, other, two.with_phase([0.1, 0.2])):
        positions(movers, jnp.float32(1.0))
    assert len(traces) == 1


def test_phases_may_be_traced():
    by_seed = jax.jit(lambda phase: MOVERS.with_phase(phase).at(jnp.float32(0.0)).positions)
    found = by_seed(jnp.asarray(PHASE, jnp.float32))
    for index, mover in enumerate(PATHS):
        expected = walk(mover, np.zeros(()), PHASE[index])
        np.testing.assert_allclose(found[index], expected, atol=1e-5)


@pytest.mark.parametrize(
    ("phase", "named"),
    [
        ([0.1, 0.2, 0.3], r"phase is \[0.1, 0.2, 0.3\]; accepted: 2 finite numbers"),
        (0.5, r"phase is 0.5; accepted: 2 finite"),
        ([0.1, np.nan], r"phase is \[0.1, nan\]; accepted: 2 finite"),
        ([0.1, 1.0], r"phase is \[0.1, 1.0\]; accepted: numbers in \[0, 1\)"),
        ([-0.1, 0.0], r"phase is \[-0.1, 0.0\]; accepted: numbers in \[0, 1\)"),
    ],
)
def test_phases_refused(phase, named):
    with pytest.raises(ValueError, match=named):
        MovingObstacles(PATHS[:2], phase)
    with pytest.raises(ValueError, match=named):
        MovingObstacles(PATHS[:2]).with_phase(phase)
