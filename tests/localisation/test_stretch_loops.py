"""Loops of whole stretches: a robot that comes back metres from where it thinks it is."""

import math
from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
import pytest
from tests.localisation.motions import add_motions

from jaxplore.localisation import Localiser, LocaliserState, LoopCloser, Odometry
from jaxplore.localisation.pose_graph import Graph
from jaxplore.localisation.stretch_loops import _agree, _select_confirmed, _Stretch
from jaxplore.maps.frame import GridFrame
from jaxplore.sensing import Lidar, Scan

pytestmark = pytest.mark.long

pytest.importorskip("gtsam")
SENSOR = Lidar(180, max_range=5.0)
LOCALISER = Localiser(Odometry(), memory=6.0, capacity=128)
CLOSER = LoopCloser(2.0, farthest=6.0)
STEP = 0.5
SIDES = (12.0, 8.0)
"""Length and width of the track, along the middle of a ring of corridors [m]."""


def box(*corners: float) -> np.ndarray:
    low, high = np.array(corners[:2]), np.array(corners[2:])
    points = np.array([low, [high[0], low[1]], high, [low[0], high[1]]])
    return np.stack([points, np.roll(points, -1, axis=0)], axis=1)


RING = [box(-1.0, -1.0, 13.0, 9.0), box(1.0, 1.0, 11.0, 7.0)]
BOXES = [box(3.0, -1.0, 3.6, -0.5), box(7.0, 0.6, 7.4, 1.0), box(12.6, 2.0, 13.0, 3.5)]
BOXES += [box(9.0, 8.4, 10.2, 9.0), box(4.0, 7.0, 4.3, 7.4), box(-1.0, 5.0, -0.6, 5.4)]
WALLS = np.concatenate(RING + BOXES)
# The same ring with other things in it.
OTHER = np.concatenate([box(-1.4, -2.4, 13.8, 9.0), box(1.0, 1.3, 11.0, 6.2), *BOXES[:1]])


def track(number: int) -> np.ndarray:
    """Return poses (N, 3) a step apart along the ring."""
    poses = []
    for at in range(number):
        lap, along = divmod(at * STEP, 2.0 * sum(SIDES))
        side = 0
        while along >= SIDES[side % 2]:
            along -= SIDES[side % 2]
            side += 1
        corner = [(0.0, 0.0), (SIDES[0], 0.0), SIDES, (0.0, SIDES[1])][side]
        yaw = 0.5 * math.pi * side
        x, y = corner[0] + along * math.cos(yaw), corner[1] + along * math.sin(yaw)
        poses.append([x, y, yaw + 2.0 * math.pi * lap])
    return np.array(poses)


TRUE = track(112)


def motions_of(poses: np.ndarray) -> np.ndarray:
    before = np.concatenate([poses[:1], poses[:-1]])
    cos, sin = np.cos(before[:, 2]), np.sin(before[:, 2])
    dx, dy, turn = (poses - before).T
    return np.stack([cos * dx + sin * dy, cos * dy - sin * dx, turn], axis=1)


def state_of(scans: list[Scan]) -> LocaliserState:
    """Return a state whose stored scans have poses that drift by metres in a lap."""
    number = len(TRUE)
    motions = motions_of(TRUE)
    # The first lap is right. Then the wheels slip, over metres.
    late = (np.arange(number) > 76)[:, None] & (np.arange(number) < 84)[:, None]
    motions = motions + late * np.array([-0.3, 0.1, 0.02])
    poses = add_motions(TRUE[0], motions)
    covariance = np.diag([0.15, 0.15, 0.02]) ** 2
    frame = GridFrame(0.1, (-5.0, -6.0, 0.0))
    state = LOCALISER.init(jnp.asarray(TRUE[0], jnp.float32), frame, (200, 240), (SENSOR,))
    stored = state.scans
    for index, scan in enumerate(scans):
        stored = stored.with_scan(
            jnp.asarray(True),
            *(jnp.asarray(each[index], jnp.float32) for each in (poses, motions)),
            jnp.asarray(covariance, jnp.float32),
            jnp.asarray(STEP * index, jnp.float32),
            [scan],
        )
    return state._replace(scans=stored, pose=stored.poses[number - 1])


def check_motions(pairs: np.ndarray, measured: np.ndarray) -> None:
    """Check that the motions of closed loops are the true ones."""
    for (older, newer), motion in zip(pairs, measured[: len(pairs)], strict=True):
        true = motions_of(TRUE[[older, newer]])[1]
        assert np.hypot(*(motion - true)[:2]) < 0.15
        assert abs(math.remainder(motion[2] - true[2], math.tau)) < 0.03


@pytest.mark.parametrize("is_same", [True, False])
def test_a_robot_that_slipped_by_metres_finds_the_place(
    scan_of: Callable[..., Scan], is_same: bool
) -> None:
    late = WALLS if is_same else OTHER
    scans = [
        scan_of(WALLS if at < 77 else late, pose, SENSOR, 0.01, at) for at, pose in enumerate(TRUE)
    ]
    state = state_of(scans)
    assert math.hypot(*(np.asarray(state.pose, float) - TRUE[-1])[:2]) > 2.0
    found = CLOSER.find_loops(LOCALISER, state, (SENSOR,))
    pairs = np.asarray(found.closures.pairs)[: int(found.closures.number)]
    if not is_same:
        assert not (pairs[:, 1] >= 84).any()
        return
    assert (pairs[:, 1] >= 84).sum() >= 2
    check_motions(pairs, np.asarray(found.closures.motions, float))
    # The scans are examined one by one only once the poses are right.
    assert int(found.closures.examined) == 0
    settled = CLOSER.optimise_poses(LOCALISER, found, (SENSOR,))
    assert settled is not None
    assert math.hypot(*(np.asarray(settled.pose, float) - TRUE[-1])[:2]) < 0.5
    # Without stretches at most single scans find their place, by luck, and the places are right.
    single = LoopCloser(2.0).find_loops(LOCALISER, state, (SENSOR,)).closures
    alone = np.asarray(single.pairs)[: int(single.number)]
    check_motions(alone, np.asarray(single.motions, float))
    assert (alone[:, 1] >= 84).sum() < (pairs[:, 1] >= 84).sum()


def test_a_stretch_counts_only_if_another_one_agrees() -> None:
    poses = np.stack([np.arange(60.0), np.zeros(60), np.zeros(60)], axis=1)
    empty = np.zeros((0, 3))
    graph = Graph(poses, empty, np.zeros((0, 3, 3)), np.zeros((0, 2)), empty, np.zeros((0, 3, 3)))

    def stretch(middle: int, *off: float) -> _Stretch:
        return _Stretch(np.array([middle]), middle, poses[middle] + np.array(off), 1.0)

    right = [stretch(10, 4.0, 1.0, 0.0), stretch(15, 4.2, 1.1, 0.01)]
    wrong = stretch(20, 9.0, 1.0, 0.0)
    assert _agree(graph, *right)
    assert not _agree(graph, right[1], wrong)
    way = poses[:, 0]
    assert _select_confirmed(graph, way, [*right, wrong]) == right
    assert _select_confirmed(graph, way, [right[0], wrong]) == []
    assert _select_confirmed(graph, way, right[:1]) == []
    # One that agrees is too far along the way to say anything.
    assert _select_confirmed(graph, way, [right[0], stretch(40, 4.0, 1.0, 0.0)]) == []
