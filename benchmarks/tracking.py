"""Tracks of people in simulated scans against the truth: CLEAR MOT and errors of velocities."""

import json
import sys
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxplore.belief.tracks import ObstacleTracker, Tracks
from jaxplore.maps.clearance import clearance_field
from jaxplore.maps.generators.office import office
from jaxplore.maps.generators.people import walking_people
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.parts import MovingObstacles
from jaxplore.sensing.fan import disc_distance
from jaxplore.sensing.lidar import Lidar

PERIOD = 0.1
"""Time between two scans [s]."""
WITHIN = 0.5
"""Distance up to which a track is that of a person [m]."""
SEEN = 3
"""Number of beams that make a person count as seen."""


class ClearMot(NamedTuple):
    """The counts of CLEAR MOT (Bernardin and Stiefelhagen, "Evaluating multiple object tracking
    performance: the CLEAR MOT metrics", EURASIP Journal on Image and Video Processing, 2008).

    Args:
        objects: sum over the frames of the objects.
        misses: objects without a track.
        false_positives: tracks without an object.
        switches: times at which an object got the track of another identity.
        distance: sum of the distances of matched pairs [m].
        pairs: pairs of an object and a track, as (frame, object, row of the track).
    """

    objects: int
    misses: int
    false_positives: int
    switches: int
    distance: float
    pairs: list[tuple[int, int, int]]

    @property
    def accuracy(self) -> float:
        """MOTA, 1 - (misses + false positives + switches) / objects."""
        errors = self.misses + self.false_positives + self.switches
        return 1.0 - errors / max(self.objects, 1)

    @property
    def precision(self) -> float:
        """MOTP, the mean distance of matched pairs [m]."""
        return self.distance / max(len(self.pairs), 1)


def clear_mot(
    objects: np.ndarray,
    is_seen: np.ndarray,
    tracks: np.ndarray,
    identity: np.ndarray,
    is_known: np.ndarray,
    within: float = WITHIN,
) -> ClearMot:
    """Compare tracks with the truth.

    In each frame a pair of the frame before stays one as long as it is within the distance. The
    others are matched such that as many as possible are, at the least sum of distances.

    Args:
        objects: (T, M, 2) true positions [m].
        is_seen: (T, M) objects that count.
        tracks: (T, N, 2) positions of the tracks [m].
        identity: (T, N) their identities.
        is_known: (T, N) tracks that count.
        within: greatest distance of a pair [m].
    """
    from scipy.optimize import linear_sum_assignment

    misses = false_positives = switches = 0
    total, pairs = 0.0, []
    last: dict[int, int] = {}
    for frame in range(len(objects)):
        here, there = np.flatnonzero(is_seen[frame]), np.flatnonzero(is_known[frame])
        away = np.linalg.norm(objects[frame][here, None] - tracks[frame][None, there], axis=-1)
        matched: dict[int, int] = {}
        for i, each in enumerate(here):
            same = np.flatnonzero(identity[frame][there] == last.get(int(each), -1))
            if same.size and away[i, same[0]] <= within:
                matched[i] = int(same[0])
        left = [i for i in range(len(here)) if i not in matched]
        free = [j for j in range(len(there)) if j not in matched.values()]
        cost = np.where(away <= within, away, 1e6)[np.ix_(left, free)]
        for i, j in np.stack(linear_sum_assignment(cost), axis=-1).tolist():
            if cost[i, j] <= within:
                matched[left[i]] = free[j]
        for i, j in matched.items():
            name = int(identity[frame][there[j]])
            switches += last.get(int(here[i]), name) != name
            last[int(here[i])] = name
            total += float(away[i, j])
            pairs.append((frame, int(here[i]), int(there[j])))
        misses += len(here) - len(matched)
        false_positives += len(there) - len(matched)
    return ClearMot(int(is_seen.sum()), misses, false_positives, switches, total, pairs)


class Watched(NamedTuple):
    """What is kept of each scan: the truth, and the tracks."""

    positions: jax.Array
    velocities: jax.Array
    is_seen: jax.Array
    tracks: jax.Array
    identity: jax.Array
    is_known: jax.Array


@eqx.filter_jit
def watch(
    grid: OccupancyGrid,
    people: MovingObstacles,
    walker: MovingObstacles,
    sensor: Lidar,
    tracker: ObstacleTracker,
    key: jax.Array,
    num_scans: int,
) -> Watched:
    """Track people from a robot that drives along a way, with a map of what stands.

    Args:
        grid: the map.
        people: the people.
        walker: the way of the robot.
        sensor: its lidar.
        tracker: its tracker.
        key: random key of the measurements.
        num_scans: number of scans; static.
    """
    clearance = clearance_field(~grid.is_free, grid.frame, 1.0)

    def step(tracks: Tracks, number: jax.Array) -> tuple[Tracks, Watched]:
        time = PERIOD * number.astype(jnp.float32)
        at, now = walker.at(time), people.at(time)
        heading = jnp.arctan2(at.velocities[0, 1], at.velocities[0, 0])
        pose = jnp.append(at.positions[0], heading)
        scan = sensor.scan(
            grid,
            pose,
            key=jax.random.fold_in(key, number),
            movers=now.discs,
            is_told=False,
        )
        passed = jnp.asarray(PERIOD)
        tracks, _ = tracker.update(tracks, sensor, scan, clearance, pose, passed)
        angles = heading + jnp.asarray(sensor.beam_angles)
        met = jax.vmap(lambda disc: disc_distance(pose[:2], angles, disc[None]))(
            people.at(time).discs
        )
        is_met = jnp.abs(met - scan.ranges) < 0.15
        seen = jnp.sum(is_met, axis=1) >= SEEN
        known = Watched(
            now.positions,
            now.velocities,
            seen,
            tracks.mean,
            tracks.identity,
            # Who is hidden is kept, but counts in neither sum.
            tracks.is_confirmed & (tracks.age <= 0.0),
        )
        return tracks, known

    return jax.lax.scan(step, tracker.init(), jnp.arange(num_scans, dtype=jnp.int32))[1]


def measure(speeds: Sequence[float], seeds: int, num_scans: int = 600) -> list[dict[str, Any]]:
    """Return a row for each speed of eight people in generated offices.

    Args:
        speeds: speeds of the people [m/s].
        seeds: number of offices.
        num_scans: number of scans in each.
    """
    rows = []
    for speed in speeds:
        found, errors = [], []
        for seed in range(seeds):
            grid = office(seed)
            people = MovingObstacles(walking_people(grid, 8, speed=speed, seed=seed))
            robot = MovingObstacles(walking_people(grid, 1, speed=0.8, seed=1000 + seed))
            key = jax.random.key(seed)
            begun = people.with_phase(people.draw(people.phase, key))
            args = (begun, robot, Lidar(), ObstacleTracker(), key, num_scans)
            seen = jax.tree.map(np.asarray, watch(grid, *args))
            mot = clear_mot(
                *(seen.positions, seen.is_seen),
                *(seen.tracks[..., :2], seen.identity, seen.is_known),
            )
            found.append(mot)
            for frame, person, row in mot.pairs:
                error = seen.tracks[frame, row, 2:] - seen.velocities[frame, person]
                errors.append(float(np.hypot(*error)))
        total = np.sum([each[:4] for each in found], axis=0).tolist()
        matched = sum(len(each.pairs) for each in found)
        rows.append(
            {
                "speed": speed,
                "offices": seeds,
                "persons_seen": total[0],
                "mota": 1.0 - sum(total[1:]) / max(total[0], 1),
                "misses": total[1],
                "false_positives": total[2],
                "switches": total[3],
                "motp_m": sum(each.distance for each in found) / max(matched, 1),
                "velocity_error_median": float(np.median(errors)),
                "velocity_error_p90": float(np.quantile(errors, 0.9)),
            }
        )
        print(json.dumps(rows[-1]), flush=True)
    return rows


if __name__ == "__main__":
    measure((0.5, 1.0, 1.5, 2.0), int(sys.argv[1]) if len(sys.argv) > 1 else 5)
