"""The tracker of moving obstacles, against a Kalman filter in double precision and the truth."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from benchmarks.tracking import clear_mot

from jaxplore.belief.tracks import CONFIRMED, FORGOTTEN, ObstacleTracker
from jaxplore.maps.clearance import clearance_field
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.sensing.lidar import Lidar

SENSOR = Lidar(180, 8.0, range_noise=0.0)
TRACKER = ObstacleTracker(8)
PERIOD = 0.1
POSE = np.float32([8.0, 8.0, 0.0])


def hall(*walls: tuple[slice, slice]) -> OccupancyGrid:
    """Return a hall of 16 m by 16 m with walls in some cells."""
    probability = np.zeros((160, 160), np.float32)
    for wall in walls:
        probability[wall] = 1.0
    return OccupancyGrid(probability, 0.1)


EMPTY = hall()
WALL = hall((slice(100, 104), slice(84, 110)))
"""A wall from x = 8.4 m to 11 m, at y = 10 m to 10.4 m."""


@jax.jit
def look(tracks, grid, known, discs, elapsed, key):
    scan = SENSOR.scan(grid, jnp.asarray(POSE), key=key, movers=discs, is_told=False)
    clearance = clearance_field(~known.is_free, known.frame, 1.0)
    tracks, is_moving = TRACKER.update(tracks, SENSOR, scan, clearance, jnp.asarray(POSE), elapsed)
    return tracks, is_moving, scan, TRACKER.obstacles(tracks)


def walk(paths, grid=EMPTY, known=None, radius: float = 0.3):
    """Return what is found in each scan of discs at (T, M, 2) places, with a map of what stands."""
    known = grid if known is None else known
    tracks, found = TRACKER.init(), []
    for places in paths:
        discs = np.concatenate([places, np.full((len(places), 1), radius)], 1)
        step = look(
            *(tracks, grid, known, np.float32(discs), np.float32(PERIOD)),
            jax.random.key(len(found)),
        )
        found.append((*jax.tree.map(np.asarray, step[:3]), step[3]))
        tracks = step[0]
    return found


def kalman(measured: np.ndarray, tracker: ObstacleTracker):
    """Return mean (4,) and covariance (4, 4) of a filter in double precision."""
    dt, q, r = PERIOD, float(tracker.agility), float(tracker.position_std) ** 2
    eye = np.eye(2)
    step = np.kron(np.array([[1, dt], [0, 1]]), eye)
    noise = q * np.kron(np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]]), eye)
    see = np.kron(np.array([[1.0, 0.0]]), eye)
    mean = np.append(measured[0], [0.0, 0.0])
    spread = np.kron(np.diag([r, float(tracker.max_speed) ** 2]), eye)
    for each in measured[1:]:
        mean, spread = step @ mean, step @ spread @ step.T + noise
        gain = spread @ see.T @ np.linalg.inv(see @ spread @ see.T + r * eye)
        mean = mean + gain @ (each - see @ mean)
        spread = (np.eye(4) - gain @ see) @ spread
    return mean, spread


def test_the_filter_is_that_of_double_precision() -> None:
    time = PERIOD * np.arange(20)
    path = np.stack([6.0 + 1.2 * time, 10.0 - 0.4 * time], -1)[:, None]
    found = walk(path)
    measured = []
    for _, is_moving, scan, _ in found:
        angles = SENSOR.beam_angles.astype(np.float64)[is_moving]
        points = scan.ranges[is_moving, None] * np.stack([np.cos(angles), np.sin(angles)], -1)
        middle, width = points.mean(axis=0), np.linalg.norm(points[0] - points[-1])
        away = 0.25 * np.pi * np.clip(0.5 * width, 0.1, 0.6) * middle / np.linalg.norm(middle)
        measured.append(POSE[:2] + middle + away)
    mean, spread = kalman(np.array(measured), TRACKER)
    tracks = found[-1][0]
    (row,) = np.flatnonzero(tracks.is_alive)
    np.testing.assert_allclose(tracks.mean[row], mean, atol=1e-3)
    np.testing.assert_allclose(np.kron(tracks.covariance[row], np.eye(2)), spread, atol=1e-5)
    # And it is near the truth.
    np.testing.assert_allclose(tracks.mean[row, :2], path[-1, 0], atol=0.1)
    np.testing.assert_allclose(tracks.mean[row, 2:], [1.2, -0.4], atol=0.2)
    known = found[-1][3]
    assert np.asarray(known.is_known).sum() == 1
    np.testing.assert_allclose(known.extents[row], 0.3, atol=0.08)


def test_a_track_is_believed_after_three_scans_and_ends_when_nothing_is_there() -> None:
    nobody = np.full((10, 1, 2), 100.0)
    found = walk(np.concatenate([np.full((4, 1, 2), (10.0, 9.0)), nobody]))
    known = [int(np.asarray(each[3].is_known).sum()) for each in found]
    assert known[:4] == [0] * (CONFIRMED - 1) + [1, 1]
    # It ends after `patience`, half a second in which the beams pass through its place.
    gone = known[4:]
    assert gone[0] == 1
    assert gone[-1] == 0
    assert sum(gone) == pytest.approx(float(TRACKER.patience) / PERIOD, abs=1)
    # Nothing of a single scan is believed.
    once = walk(np.concatenate([np.full((1, 1, 2), (10.0, 9.0)), nobody]))
    assert not any(np.asarray(each[3].is_known).any() for each in once)


def test_who_walks_behind_a_wall_is_kept_and_found_again() -> None:
    time = PERIOD * np.arange(45)
    path = np.stack([6.8 + 1.5 * time, np.full_like(time, 11.0)], -1)[:, None]
    found = walk(path, WALL)
    is_hidden = [not each[1].any() for each in found]
    assert 5 <= sum(is_hidden) < 10 * FORGOTTEN
    names = {
        int(name)
        for each in found
        for name in each[0].identity[each[0].is_alive & (each[0].hits >= CONFIRMED)]
    }
    assert names == {1}
    there = np.linalg.norm(found[-1][0].mean[found[-1][0].is_alive, :2] - path[-1], axis=-1)
    assert there.min() < 0.2


def test_two_who_pass_each_other_keep_their_tracks() -> None:
    time = PERIOD * np.arange(30)
    first = np.stack([6.0 + 1.2 * time, np.full_like(time, 10.6)], -1)
    second = np.stack([10.0 - 1.2 * time, np.full_like(time, 9.6)], -1)
    path = np.stack([first, second], 1)
    found = walk(path)
    state = [each[0] for each in found]
    mot = clear_mot(
        path,
        np.ones(path.shape[:2], bool),
        np.stack([each.mean[:, :2] for each in state]),
        np.stack([each.identity for each in state]),
        np.stack([each.is_alive & (each.hits >= CONFIRMED) for each in state]),
    )
    assert mot.switches == 0
    assert mot.false_positives == 0
    # The farther one is hidden for a while, which costs nothing; only the births are missed.
    assert mot.misses <= 2 * CONFIRMED


def test_walls_are_no_people_and_hide_some() -> None:
    nobody = np.full((3, 1, 2), 100.0)
    known_wall = walk(nobody, WALL)
    assert not any(each[1].any() for each in known_wall)
    # The nearest return beside a jump is on a face of the wall, of 0.4 m.
    edges = known_wall[-1][0].edges
    there = edges.position[edges.is_there]
    for corner in ((8.4, 10.0), (11.0, 10.0)):
        assert np.linalg.norm(there - corner, axis=1).min() < 0.3
    # A wall that was not there before is wider than anybody.
    for each in walk(np.full((4, 1, 2), 100.0), WALL, EMPTY):
        assert not each[1].any()
        assert not each[0].is_alive.any()


def test_who_stands_is_mapped_and_who_walks_is_not() -> None:
    standing = walk(np.full((40, 1, 2), (10.0, 9.0)))
    is_left_out = [bool(each[1].any()) for each in standing]
    assert all(is_left_out[:15])
    assert not any(is_left_out[30:])
    time = PERIOD * np.arange(30)
    walking = walk(np.stack([6.0 + 1.2 * time, np.full_like(time, 9.5)], -1)[:, None])
    assert all(each[1].any() for each in walking)
    for _, is_moving, scan, _ in walking:
        # Nothing but the person is there, so every return is of what moves.
        np.testing.assert_array_equal(is_moving, scan.is_return & (scan.ranges < 3.0))


FORMER = clearance_field(~EMPTY.is_free, EMPTY.frame, 1.0)


def test_who_comes_from_unknown_space_does_not_take_his_cells_along() -> None:
    # The map has the cells of the last scan as occupied: alone it explains every step of 5 cm.
    tracks, found = TRACKER.init(FORMER), []
    for step in range(12):
        y = 10.5 - 0.05 * step
        behind = int(10 * y) - 1
        known = hall((slice(behind, behind + 6), slice(76, 84)))
        discs = np.float32([[8.0, y, 0.3]])
        key = jax.random.key(step)
        tracks, is_moving, scan, obstacles = look(
            tracks, EMPTY, known, discs, np.float32(PERIOD), key
        )
        found.append(bool(is_moving.any()))
        assert scan.is_return.any()
    assert all(found[:5])
    np.testing.assert_array_equal(obstacles.is_known.sum(), 1)
    # Without former maps nothing of him is seen to move.
    _, is_moving, *_ = look(
        TRACKER.init(), EMPTY, known, discs, np.float32(PERIOD), jax.random.key(0)
    )
    assert not is_moving.any()


def test_a_lone_return_is_nobody_and_two_neighbours_are_somebody() -> None:
    angles = SENSOR.beam_angles.astype(np.float64)
    for ranges, number in (({40: 2.0}, 0), ({40: 2.0, 41: 2.02}, 2), ({40: 2.0, 41: 3.0}, 0)):
        points = np.tile(POSE[:2], (SENSOR.num_beams, 1)).astype(np.float32)
        is_point = np.zeros(SENSOR.num_beams, bool)
        for beam, away in ranges.items():
            points[beam] += away * np.array([np.cos(angles[beam]), np.sin(angles[beam])])
            is_point[beam] = True
        given = jnp.asarray(points), jnp.asarray(is_point)
        speeds = TRACKER.possible_speeds(TRACKER.init(FORMER), FORMER, *given)
        assert int((speeds > 0.0).sum()) == number
        assert float(speeds.max()) in (0.0, float(TRACKER.max_speed))


def counted(objects, is_seen, tracks, identity, is_known, within):
    """Return misses, false positives and switches, with all matchings of a frame enumerated."""
    last, misses, false_positives, switches = {}, 0, 0, 0
    for frame in range(len(objects)):
        here, there = np.flatnonzero(is_seen[frame]), np.flatnonzero(is_known[frame])
        away = {
            (i, j): np.linalg.norm(objects[frame, i] - tracks[frame, j])
            for i in here
            for j in there
        }
        kept = {
            i: j
            for i in here
            for j in there
            if identity[frame, j] == last.get(i) and away[i, j] <= within
        }
        rest = [i for i in here if i not in kept]
        free = [j for j in there if j not in kept.values()]
        best = None
        for chosen in itertools.product([None, *free], repeat=len(rest)):
            used = [j for j in chosen if j is not None]
            pairs = {i: j for i, j in zip(rest, chosen, strict=True) if j is not None}
            if len(set(used)) < len(used) or any(away[p] > within for p in pairs.items()):
                continue
            rank = (-len(pairs), sum(away[p] for p in pairs.items()))
            if best is None or rank < best[0]:
                best = rank, pairs
        assert best is not None
        matched = kept | best[1]
        for i, j in matched.items():
            switches += i in last and last[i] != identity[frame, j]
            last[i] = identity[frame, j]
        misses += len(here) - len(matched)
        false_positives += len(there) - len(matched)
    return misses, false_positives, switches


@pytest.mark.parametrize("seed", range(20))
def test_clear_mot_is_that_of_an_enumeration(seed: int) -> None:
    rng = np.random.default_rng(seed)
    frames, number = 12, 3
    objects = np.cumsum(rng.normal(0.0, 0.2, (frames, number, 2)), axis=0)
    order = np.stack([rng.permutation(number) for _ in range(frames)])
    is_still = rng.random(frames) < 0.7
    order[is_still] = np.arange(number)
    tracks = np.take_along_axis(objects, order[..., None], 1) + rng.normal(
        0.0, 0.3, (frames, number, 2)
    )
    identity = order + 3 * (rng.random((frames, number)) < 0.1)
    is_seen, is_known = rng.random((2, frames, number)) < 0.8
    found = clear_mot(objects, is_seen, tracks, identity, is_known, 0.5)
    expected = counted(objects, is_seen, tracks, identity, is_known, 0.5)
    assert (found.misses, found.false_positives, found.switches) == expected
    assert found.accuracy == pytest.approx(1.0 - sum(expected) / is_seen.sum())
