"""Closed loops: a robot with drift around a block, and a place that is another one."""

import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.localisation.motions import add_motions

from jaxplore.localisation import (
    Localiser,
    LocaliserState,
    LoopCloser,
    Odometry,
    ScanMatcher,
)
from jaxplore.maps.frame import GridFrame
from jaxplore.report import absolute_error
from jaxplore.sensing import Lidar, Scan

pytestmark = pytest.mark.long

pytest.importorskip("gtsam")
SENSOR = Lidar(120, max_range=3.0)
SENSORS = (SENSOR,)
STEP, NOISE = 0.25, 0.02
# A turn that the localiser does not know of, beside noise of a hundredth.
DRIFT = math.radians(1.5)
LOCALISER = Localiser(
    Odometry(0.03, 0.03),
    matcher=ScanMatcher(search_points=60),
    spacing=0.02,
    memory=4.0,
    capacity=128,
)
CLOSER = LoopCloser(
    2.0, spacing=1.0, matcher=ScanMatcher(steps=5, spacing=0.125, turn_spacing=0.05)
)
# The track around the block, with round corners.
CORNERS = np.array([[1.0, 1.0], [7.0, 1.0], [7.0, 5.0], [1.0, 5.0]])


def block(*box: float) -> np.ndarray:
    low, high = np.array(box[:2]), np.array(box[2:])
    points = np.array([low, [high[0], low[1]], high, [low[0], high[1]]])
    return np.stack([points, np.roll(points, -1, axis=0)], axis=1)


# A ring of corridors with a few boxes, all different.
WALLS = np.concatenate(
    [
        block(0.0, 0.0, 8.0, 6.0),
        block(2.0, 2.0, 6.0, 4.0),
        block(2.6, 0.0, 3.0, 0.3),
        block(5.0, 1.7, 5.6, 2.0),
        block(7.7, 2.4, 8.0, 3.2),
        block(4.2, 5.6, 4.5, 6.0),
        block(0.0, 3.4, 0.4, 3.7),
    ]
)
OTHER = np.concatenate([block(-0.5, -0.2, 4.2, 2.9), block(1.8, 1.6, 2.1, 1.9)])


def track(laps: float) -> np.ndarray:
    """Return poses (N, 3) along the corridors, a step apart."""
    radius, poses = 0.5, []
    for corner in range(4):
        start, end = CORNERS[corner], CORNERS[(corner + 1) % 4]
        direction = (end - start) / np.linalg.norm(end - start)
        yaw = corner * 0.5 * math.pi
        straight = np.arange(radius, np.linalg.norm(end - start) - radius, STEP)
        poses += [[*(start + away * direction), yaw] for away in straight]
        turn = np.arange(0.0, 0.5 * math.pi, STEP / radius)
        left = np.array([-direction[1], direction[0]])
        centre = end - radius * direction + radius * left
        poses += [
            [*(centre + radius * (np.sin(a) * direction - np.cos(a) * left)), yaw + a] for a in turn
        ]
    lap = np.array(poses)
    number = round(laps * len(lap))
    turns = np.arange(number) // len(lap)
    return lap[np.arange(number) % len(lap)] + np.outer(turns, [0.0, 0.0, 2.0 * math.pi])


def motions_of(poses: np.ndarray, seed: int) -> np.ndarray:
    """Return motions (N, 3) between poses with drift; zero for the first."""
    before = np.concatenate([poses[:1], poses[:-1]])
    cos, sin = np.cos(before[:, 2]), np.sin(before[:, 2])
    dx, dy, turn = (poses - before).T
    exact = np.stack([cos * dx + sin * dy, cos * dy - sin * dx, turn], axis=1)
    length = np.hypot(dx, dy)
    noise = 0.01 * np.random.default_rng(seed).standard_normal(exact.shape)
    drifted = exact * [1.02, 1.02, 1.0] + noise * np.sqrt(length)[:, None]
    drifted[:, 2] += DRIFT * length
    return drifted


@eqx.filter_jit
def step(
    localiser: Localiser, state: LocaliserState, motion: jax.Array, scan: Scan
) -> LocaliserState:
    moved = localiser.predict(state, motion, jnp.asarray(1.0))
    return localiser.correct(moved, [scan], SENSORS)


@pytest.fixture(scope="module")
def driven(scan_of: Callable[..., Scan]) -> Callable[..., tuple[LocaliserState, np.ndarray]]:
    """Return what drives a robot along poses in walls, with or without closing loops."""

    def drive(
        legs: list[tuple[np.ndarray, np.ndarray]], motions: np.ndarray, closer: LoopCloser | None
    ) -> tuple[LocaliserState, np.ndarray]:
        first = legs[0][1][0]
        frame = GridFrame(0.1, (-2.0, -2.0, 0.0))
        state = LOCALISER.init(jnp.asarray(first, jnp.float32), frame, (104, 124), SENSORS)
        poses = np.concatenate([each for _, each in legs])
        walls = [walls for walls, each in legs for _ in each]
        for index, (pose, seen) in enumerate(zip(poses, walls, strict=True)):
            scan = scan_of(seen, pose, SENSOR, NOISE, index)
            state = step(LOCALISER, state, jnp.asarray(motions[index], jnp.float32), scan)
            if closer is not None and index % 16 == 15:
                state = closer.find_loops(LOCALISER, state, SENSORS)
                moved = closer.optimise_poses(LOCALISER, state, SENSORS)
                state = state if moved is None else moved
        return state, poses

    return drive


@pytest.fixture(scope="module")
def around(driven: Any) -> tuple[LocaliserState, np.ndarray, np.ndarray]:
    """Return the state after one and a quarter laps without closed loops, the true poses and those
    by dead reckoning."""
    poses = track(1.25)
    motions = motions_of(poses, 0)
    state, _ = driven([(WALLS, poses)], motions, None)
    return state, poses, add_motions(poses[0], motions)


def stored(state: LocaliserState) -> np.ndarray:
    return np.asarray(state.scans.poses, float)[: int(state.scans.number)]


def test_scans_reduce_the_drift_of_the_odometry(around: Any) -> None:
    state, poses, by_odometry = around
    assert int(state.scans.number) == len(poses)
    matched = absolute_error(poses, stored(state)).rms
    assert matched < 0.3 * absolute_error(poses, by_odometry).rms
    # The way is that of the odometry.
    length = np.hypot(*np.diff(by_odometry[:, :2], axis=0).T).sum()
    assert float(state.way) == pytest.approx(length, rel=1e-3)
    # The uncertainty that is told bounds the error, and grows along the way.
    error = math.hypot(*(np.asarray(state.pose, float) - poses[-1])[:2])
    assert error < 4.0 * float(state.uncertainty)


def test_closed_loops_bring_the_poses_closer(around: Any) -> None:
    state, poses, _ = around
    examined = CLOSER.find_loops(LOCALISER, state, SENSORS)
    number = int(examined.closures.number)
    assert number >= 3
    # Each loop agrees with the truth.
    pairs = np.asarray(examined.closures.pairs)[:number]
    measured = np.asarray(examined.closures.motions, float)[:number]
    for (older, newer), motion in zip(pairs, measured, strict=True):
        old = poses[older]
        cos, sin = math.cos(old[2]), math.sin(old[2])
        dx, dy, turn = poses[newer] - old
        assert np.hypot(*(motion[:2] - [cos * dx + sin * dy, cos * dy - sin * dx])) < 0.1
        assert abs(math.remainder(motion[2] - turn, math.tau)) < 0.05
        assert float(state.scans.way[newer] - state.scans.way[older]) > float(LOCALISER.memory)
    # A small tolerance, so that the poses move.
    settled = LoopCloser(tolerance=1e-3).optimise_poses(LOCALISER, examined, SENSORS)
    assert settled is not None
    before, after = (absolute_error(poses, stored(each)).rms for each in (state, settled))
    assert after < before
    assert after < 0.08
    # The first scan stays, the robot moves with the last one, and the drift has become less.
    np.testing.assert_allclose(stored(settled)[0], stored(state)[0], atol=1e-6)
    last = int(state.scans.number) - 1
    np.testing.assert_allclose(settled.pose[:2], stored(settled)[last, :2], atol=1e-4)
    assert np.trace(settled.drift[:2, :2]) < np.trace(state.drift[:2, :2])
    # The surfaces are those of the moved scans.
    again = eqx.filter_jit(LOCALISER.surface_of)(
        settled, jnp.asarray(0), settled.scans.number, SENSORS
    )
    np.testing.assert_allclose(settled.surface.sums, again.sums, atol=1e-4)


def test_a_match_that_the_pose_graph_contradicts_closes_no_loop(around: Any) -> None:
    """The newest scans see the old place, but the poses say that they are half a metre beside it,
    many standard deviations: such a place only looks the same."""
    state, *_ = around
    way = np.asarray(state.scans.way)
    is_late = way[:, None] > way[int(state.scans.number) - 1] - 3.0
    poses = np.asarray(state.scans.poses) + is_late * np.array([0.35, 0.35, 0.0])
    state = state._replace(scans=state.scans._replace(poses=jnp.asarray(poses, jnp.float32)))
    found = {}
    default = float(CLOSER.most_stds)
    for most in (default, 1e9):
        closer = eqx.tree_at(lambda each: each.most_stds, CLOSER, jnp.asarray(most))
        closures = closer.find_loops(LOCALISER, state, SENSORS).closures
        newer = np.asarray(closures.pairs)[: int(closures.number), 1]
        found[most] = int(is_late[newer].sum())
    assert found[1e9] >= 1
    assert found[default] == 0


def test_old_places_nearby_say_how_much_a_loop_would_tell(around: Any) -> None:
    state, *_ = around
    before = np.asarray(CLOSER.spreads(LOCALISER, state))
    examined = CLOSER.find_loops(LOCALISER, state, SENSORS)
    after = np.asarray(CLOSER.spreads(LOCALISER, examined))
    number, way = int(state.scans.number), np.asarray(state.scans.way)
    away = np.hypot(*(stored(state)[:, :2] - stored(state)[-1, :2]).T)
    expected = (way[number - 1] - way[:number] > float(LOCALISER.memory)) & (
        away <= 2.0 * float(CLOSER.reach)
    )
    assert ((before > 0.0) == np.pad(expected, (0, len(before) - number))).all()
    # Without loops a place is the less certain the longer ago the robot was there.
    told = before[before > 0.0]
    assert (np.diff(told) <= 1e-4).all()
    assert told[0] > 1.1 * told[-1]
    # Closed loops have told what there was to tell.
    assert after.max() < 0.5 * before.max()


def test_closing_along_the_way_keeps_the_map_whole(driven: Any) -> None:
    poses = track(1.25)
    state, _ = driven([(WALLS, poses)], motions_of(poses, 3), CLOSER)
    assert int(state.closures.number) >= 3
    assert absolute_error(poses, stored(state)).rms < 0.08


def test_the_same_scans_are_not_examined_twice(around: Any) -> None:
    state, *_ = around
    once = CLOSER.find_loops(LOCALISER, state, SENSORS)
    assert int(once.closures.examined) == int(state.scans.number)
    twice = CLOSER.find_loops(LOCALISER, once, SENSORS)
    for first, second in zip(jax.tree.leaves(once), jax.tree.leaves(twice), strict=True):
        np.testing.assert_array_equal(first, second)
    # What fits within the tolerance stays; the loops are kept all the same.
    assert LoopCloser(tolerance=100.0).optimise_poses(LOCALISER, once, SENSORS) is None
    assert LoopCloser(tolerance=100.0).close_loops(LOCALISER, state, SENSORS) is None
    assert CLOSER.optimise_poses(LOCALISER, state, SENSORS) is None


def test_another_place_closes_no_loop(driven: Any) -> None:
    """The odometry leads back to the start, where the scans are those of another room."""
    away = track(0.6)
    back = np.column_stack([np.linspace(1.2, 2.6, 6), np.full(6, 1.1), np.zeros(6)])
    jump = motions_of(np.concatenate([away, back]), 0)
    state, poses = driven([(WALLS, away), (OTHER, back)], jump, None)
    # The search for places does look there.
    number = int(state.scans.number)
    found = np.asarray(state.scans.poses)[number - 6 : number, :2]
    nearest = np.hypot(*(found[:, None] - np.asarray(state.scans.poses)[:20, :2]).T)
    assert nearest.min(axis=0).min() < float(CLOSER.reach)
    examined = CLOSER.find_loops(LOCALISER, state, SENSORS)
    pairs = np.asarray(examined.closures.pairs)[: int(examined.closures.number)]
    assert not (pairs[:, 1] >= len(away)).any()
    assert len(poses) == number


def test_other_numbers_do_not_recompile(around: Any, traced: Callable[..., int]) -> None:
    state, *_ = around
    scan = Scan(jnp.full(120, 2.0), jnp.ones(120, bool))

    def move(localiser: Localiser, motion: jax.Array) -> LocaliserState:
        return step(localiser, state, motion, scan)

    localisers = [
        LOCALISER,
        Localiser(Odometry(0.1), matcher=LOCALISER.matcher, capacity=128),
        Localiser(spacing=1.0, turn=1.0, memory=9.0, matcher=LOCALISER.matcher, capacity=128),
    ]
    assert traced(move, [(each, jnp.array([0.1, 0.0, 0.0])) for each in localisers]) == 1
