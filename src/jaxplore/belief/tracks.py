"""Find and track what moves, from scans: returns that the map does not explain."""

import dataclasses
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxplore import _checks
from jaxplore._limits import MOST_TRACKS
from jaxplore._types import ArrayLike, Count, Pose, Scalar
from jaxplore.belief.obstacles import Obstacles
from jaxplore.geometry.outlines import Outlines
from jaxplore.maps.field import ScalarField
from jaxplore.sensing.base import Sensor
from jaxplore.sensing.beams import Scan
from jaxplore.sensing.clusters import (
    Clusters,
    Edges,
    cluster_points,
    find_hiding_edges,
    has_neighbour,
)

UNASSIGNED = -1
"""Column of a row without one."""
FORBIDDEN = 1e4
"""Cost of a pair that may not be, far above all others."""
FEWEST_BEAMS = 90
"""Number of directions of a scan from which on somebody shows in two of them: 0.6 m within 4 m."""
EXPLAINED = 0.2
"""Distance from the nearest cell that is not known to be free up to which the map explains a
return [m]: two cells of 0.1 m, for the noise of ranges and of the pose."""
LOOK_BACK = 0.5
"""Time between the former maps that are kept [s]. The older one is 0.5 s to 1 s old."""
GATE = 11.83
"""Squared Mahalanobis distance within which a true measurement lies in 997 of 1000 cases (two
degrees of freedom)."""
CONFIRMED = 3
"""Number of measurements after which a track is believed."""
LEAST_POINTS = 2
"""Number of points of a cluster below which it may be a false reading."""
WIDEST = 1.2
"""Width above which a cluster is no person but a wall that was not there before [m]."""
GAP = 0.3
"""Greatest distance of neighbouring points of a person [m]."""
STILL_SPEED = 0.2
"""Speed below which something stands [m/s]."""
CUT = 10.0
"""Factor on the variance of the position of a cluster that is half hidden."""
SMOOTHING = 0.2
"""Weight of a new measurement of the radius."""
LEAST_RADIUS, GREATEST_RADIUS = 0.1, 0.6
"""Bounds of a radius that is measured [m]."""
SAME = 0.3
"""Distance below which two tracks are of the same [m]."""
NUM_EDGES = 8
"""Number of edges that are kept, of those behind which something can be hidden."""
FORGOTTEN = 3.0
"""Time out of sight after which a track is forgotten [s]."""


def assign(cost: Float[Array, "N M"], is_allowed: Bool[Array, "N M"]) -> Int[Array, " N"]:
    """Assign as many rows as possible to columns of their own, at the least sum of costs.

    Return the column of each row, or `UNASSIGNED`. Pairs that are not allowed get a cost of
    `FORBIDDEN` and are taken back in the end. So more pairs are always better than a lower sum, if
    all costs are well below `FORBIDDEN`.

    Source: the shortest augmenting paths of Jonker and Volgenant, "A shortest augmenting path
    algorithm for dense and sparse linear assignment problems", Computing 38, 1987; O(n^3).
    """
    rows, columns = cost.shape
    size = max(rows, columns)
    table = jnp.full((size, size), FORBIDDEN)
    table = table.at[:rows, :columns].set(jnp.where(is_allowed, cost, FORBIDDEN))
    # Column `size` is virtual: each path begins there.
    padded = jnp.concatenate([table, jnp.zeros((size, 1))], axis=1)
    start = (
        jnp.zeros(size),
        jnp.zeros(size + 1),
        jnp.full(size + 1, UNASSIGNED, jnp.int32),
    )

    def add(row: Count, carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        of_rows, of_columns, owner = carry
        owner = owner.at[size].set(row)
        path = (
            jnp.asarray(size, jnp.int32),
            jnp.full(size + 1, jnp.inf),
            jnp.zeros(size + 1, bool),
            jnp.full(size + 1, size, jnp.int32),
            of_rows,
            of_columns,
        )

        def is_open(path: tuple[Count, Array, Array, Array, Array, Array]) -> Array:
            return owner[path[0]] != UNASSIGNED

        def extend(
            path: tuple[Count, Array, Array, Array, Array, Array],
        ) -> tuple[Count, Array, Array, Array, Array, Array]:
            column, least, is_used, before, of_rows, of_columns = path
            is_used = is_used.at[column].set(True)
            own = owner[column]
            reduced = padded[own] - of_rows[own] - of_columns
            is_better = ~is_used & (reduced < least)
            least = jnp.where(is_better, reduced, least)
            before = jnp.where(is_better, column, before)
            free = jnp.where(is_used, jnp.inf, least).at[size].set(jnp.inf)
            following = jnp.argmin(free).astype(jnp.int32)
            step: Scalar = free[following]
            # Rows of used columns are all different, so nothing is added twice.
            raised = jnp.where(is_used, step, 0.0)
            of_rows = of_rows.at[jnp.where(is_used, owner, size)].add(raised, mode="drop")
            of_columns = of_columns - raised
            least = jnp.where(is_used, least, least - step)
            return following, least, is_used, before, of_rows, of_columns

        column, _, _, before, of_rows, of_columns = jax.lax.while_loop(is_open, extend, path)

        def turn(carry: tuple[Count, Array]) -> tuple[Count, Array]:
            at, owner = carry
            return before[at], owner.at[at].set(owner[before[at]])

        _, owner = jax.lax.while_loop(lambda carry: carry[0] != size, turn, (column, owner))
        return of_rows, of_columns, owner

    _, _, owner = jax.lax.fori_loop(0, size, add, start)
    found = jnp.zeros(size, jnp.int32).at[owner[:size]].set(jnp.arange(size, dtype=jnp.int32))
    column = found[:rows]
    in_table = jnp.clip(column, 0, columns - 1)
    may_be = (column < columns) & is_allowed[jnp.arange(rows), in_table]
    return jnp.where(may_be, column, UNASSIGNED)


class Tracks(NamedTuple):
    """N tracks of what moves, and the edges behind which more of it can be hidden.

    Args:
        mean: (N, 4) positions and velocities (x, y, vx, vy) [m, m/s].
        covariance: (N, 2, 2) covariance of position and velocity, the same along x and y.
        radius: (N,) radii [m].
        hits: (N,) number of measurements of each.
        age: (N,) time since the last measurement [s].
        missed: (N,) time for which it was not measured where it should have been in sight [s].
        still: (N,) time for which it has stood [s].
        is_alive: (N,) which of the tracks there are.
        identity: (N,) number of the track; no two tracks of a run share one.
        next_identity: number of the next track.
        time: time of the last scan [s].
        edges: edges behind which something can be hidden.
        former: (2, H, W) clearance at two moments before, the older one first [m]; None without.
    """

    mean: Float[Array, "N 4"]
    covariance: Float[Array, "N 2 2"]
    radius: Float[Array, " N"]
    hits: Int[Array, " N"]
    age: Float[Array, " N"]
    missed: Float[Array, " N"]
    still: Float[Array, " N"]
    is_alive: Bool[Array, " N"]
    identity: Int[Array, " N"]
    next_identity: Int[Array, ""]
    time: Scalar
    edges: Edges
    former: Float[Array, "2 H W"] | None = None

    @property
    def is_confirmed(self) -> Bool[Array, " N"]:
        """Which tracks are believed."""
        return self.is_alive & (self.hits >= CONFIRMED)

    @property
    def speed(self) -> Float[Array, " N"]:
        """Speeds [m/s]."""
        return jnp.hypot(self.mean[:, 2], self.mean[:, 3])


class ObstacleTracker(eqx.Module):
    """Finds what moves in scans, and tracks it.

    1. **Detection.** The map does not explain a return that is farther than 0.2 m from all cells
       that are not known to be free, now or half a second to a second ago: the cells of somebody
       who comes from unknown space are occupied, and would otherwise follow him. Such returns are
       joined along the beams to clusters of at most 1.2 m. A wall that appears is wider.
    2. **Association.** Each cluster is the measurement of at most one track. Pairs are those of the
       least sum of squared Mahalanobis distances (global nearest neighbour), each within a gate.
    3. **Kalman filter** with constant velocity, of which the acceleration is white noise, with the
       variance `agility` per Hz along either axis: `F = [[1, dt], [0, 1]]`,
       `Q = agility [[dt^3/3, dt^2/2], [dt^2/2, dt]]`, `H = [1, 0]`. The centre of a disc of radius
       R is pi R / 4 behind the mean of the points on its near side.
    4. **Births and deaths.** A cluster without a track begins one, which is believed after three
       measurements. A track that is not measured where the beams pass through its place ends after
       `patience`, one that is hidden after 3 s.
    5. **Standing.** The scans of what has stood for `standing` are mapped, like those of a wall.
       Returns of all other tracks are not: the robot keeps no walls of people who have gone.

    Everything has a fixed size: clusters and tracks beyond the number of tracks are left out.

    Sources: Bar-Shalom, Li and Kirubarajan, "Estimation with applications to tracking and
    navigation", 2001, sections 6.2 (white noise acceleration) and 6.6; Wang, Thorpe, Thrun,
    Hebert and Durrant-Whyte, "Simultaneous localization, mapping and moving object tracking",
    IJRR 26(9), 2007 (detection against the map).

    Args:
        num_tracks: number of tracks, N; static.
        radius: radius of what moves before it is measured [m].
        position_std: standard deviation of the position of a cluster along either axis [m].
        agility: power of the acceleration [m^2/s^3].
        max_speed: speed that anything that moves may have at any time [m/s], for the guard and for
            what may come out of hiding; 1.6 m/s is that of ISO 13855.
        patience: time without a measurement, though in sight, after which a track ends [s].
        standing: time after which what stands is mapped [s].

    Raises:
        ValueError: a number that is not accepted.
    """

    num_tracks: int = eqx.field(static=True)
    radius: Scalar
    position_std: Scalar
    agility: Scalar
    max_speed: Scalar
    patience: Scalar
    standing: Scalar

    def __init__(
        self,
        num_tracks: int = 16,
        *,
        radius: ArrayLike = 0.3,
        position_std: ArrayLike = 0.08,
        agility: ArrayLike = 1.0,
        max_speed: ArrayLike = 1.6,
        patience: ArrayLike = 0.5,
        standing: ArrayLike = 2.0,
    ) -> None:
        self.num_tracks = _checks.positive_int("num_tracks", num_tracks, at_most=MOST_TRACKS)
        self.radius = _checks.scalar("radius", radius, above=0.0)
        self.position_std = _checks.scalar("position_std", position_std, above=0.0)
        self.agility = _checks.scalar("agility", agility, above=0.0)
        self.max_speed = _checks.scalar("max_speed", max_speed, above=0.0)
        self.patience = _checks.scalar("patience", patience, above=0.0)
        self.standing = _checks.scalar("standing", standing, above=0.0)

    def init(self, clearance: ScalarField | None = None) -> Tracks:
        """Return the state without a track.

        Args:
            clearance: distance to the nearest cell that is not known to be free, of the first map;
                without it former maps explain everything.
        """
        number = self.num_tracks
        nothing = jnp.zeros(number)
        return Tracks(
            jnp.zeros((number, 4)),
            jnp.broadcast_to(jnp.eye(2), (number, 2, 2)),
            jnp.full(number, self.radius),
            jnp.zeros(number, jnp.int32),
            *(nothing, nothing, nothing),
            jnp.zeros(number, bool),
            jnp.zeros(number, jnp.int32),
            jnp.ones((), jnp.int32),
            jnp.zeros(()),
            Edges.none(NUM_EDGES),
            None if clearance is None else jnp.stack([clearance.values] * 2),
        )

    def obstacles(self, tracks: Tracks) -> Obstacles:
        """Return the believed tracks as moving obstacles, at the time of the last scan."""
        spread = tracks.covariance[:, 0, 0][:, None, None] * jnp.eye(2)
        return Obstacles(
            Outlines.discs(tracks.mean[:, :2], tracks.radius),
            tracks.mean[:, 2:],
            covariance=spread,
            growth=jnp.sqrt(tracks.covariance[:, 1, 1]),
            age=jnp.zeros(self.num_tracks),
            is_known=tracks.is_confirmed,
            memory=FORGOTTEN,
        )

    def update(
        self,
        tracks: Tracks,
        sensor: Sensor,
        scan: Scan,
        clearance: ScalarField,
        pose: Pose,
        elapsed: Scalar,
    ) -> tuple[Tracks, Bool[Array, " B"]]:
        """Update the tracks by a scan.

        Args:
            tracks: the tracks before.
            sensor: sensor of the scan.
            scan: the scan.
            clearance: distance to the nearest cell that is not known to be free, before the scan.
            pose: pose (x, y, yaw) of the sensor [m, m, rad].
            elapsed: time since the last scan [s].

        Returns:
            The tracks, and the returns (B,) of what moves, which belong into no map.
        """
        ends = beam_ends(sensor, scan, pose)
        is_moving = scan.is_return & is_unexplained(tracks, clearance, ends)
        tracks = _remember(tracks, clearance, elapsed)
        clusters = cluster_points(
            *(ends, scan.ranges, is_moving, jnp.asarray(GAP), self.num_tracks),
            is_circle=sensor.is_full_circle,
        )
        is_there = (clusters.num_points >= LEAST_POINTS) & (clusters.width <= WIDEST)
        tracks = self._predict(tracks, elapsed)
        measured = self._centres(clusters, pose)
        tracks, of_cluster = self._associate(tracks, measured, clusters, is_there)
        tracks = self._miss(tracks, sensor, scan, pose, elapsed)
        tracks, of_cluster = self._begin(tracks, measured, is_there, of_cluster)
        tracks = tracks._replace(is_alive=tracks.is_alive & ~_is_double(tracks))
        # What stands for long is mapped, and so is what belongs to no track.
        is_kept = (of_cluster >= 0) & ~(tracks.still[of_cluster] > self.standing)
        of_beam = jnp.concatenate([is_kept, jnp.zeros(1, bool)])[clusters.label]
        edges = find_hiding_edges(
            *(ends, scan.ranges, scan.is_return & ~is_moving, 2.0 * self.radius, NUM_EDGES),
            is_circle=sensor.is_full_circle,
        )
        return tracks._replace(edges=edges), of_beam

    def possible_speeds(
        self,
        tracks: Tracks,
        clearance: ScalarField,
        points: Float[Array, "P 2"],
        is_point: Bool[Array, " P"],
    ) -> Float[Array, " P"]:
        """Return the speeds (P,) with which points may move [m/s]: 0 of what the map explains, and
        of a point without a neighbour that the map does not explain either.

        Others may have `max_speed`, or the speed of the fastest track if that is more. A lone point
        is a false return, such as of dust: the beams beside it meet somebody as well, unless there
        are fewer than `FEWEST_BEAMS`.

        Args:
            tracks: the tracks.
            clearance: distance to the nearest cell that is not known to be free, before the scan
                of the points.
            points: (P, 2) points in the order of their directions [m].
            is_point: (P,) points that count.
        """
        seen = jnp.where(tracks.is_confirmed, tracks.speed, 0.0)
        fastest = jnp.maximum(self.max_speed, jnp.max(seen))
        is_somebody = is_point & is_unexplained(tracks, clearance, points)
        if points.shape[0] >= FEWEST_BEAMS:
            is_somebody = has_neighbour(points, is_somebody, 2.0 * self.radius)
        return jnp.where(is_somebody, fastest, 0.0)

    def _predict(self, tracks: Tracks, elapsed: Scalar) -> Tracks:
        step = jnp.asarray([[1.0, 0.0], [0.0, 1.0]]).at[0, 1].set(elapsed)
        noise = self.agility * jnp.stack(
            [
                jnp.stack([elapsed**3 / 3.0, elapsed**2 / 2.0]),
                jnp.stack([elapsed**2 / 2.0, elapsed]),
            ]
        )
        position = tracks.mean[:, :2] + elapsed * tracks.mean[:, 2:]
        return tracks._replace(
            mean=tracks.mean.at[:, :2].set(position),
            covariance=step @ tracks.covariance @ step.T + noise,
            age=tracks.age + elapsed,
            time=tracks.time + elapsed,
            still=jnp.where(tracks.speed < STILL_SPEED, tracks.still + elapsed, 0.0),
        )

    def _centres(self, clusters: Clusters, pose: Pose) -> Float[Array, "K 2"]:
        """Return the centres of the discs on whose near sides the clusters are."""
        away = clusters.middle - pose[:2]
        distance = jnp.maximum(jnp.linalg.norm(away, axis=-1, keepdims=True), 1e-3)
        radius = jnp.clip(0.5 * clusters.width, LEAST_RADIUS, GREATEST_RADIUS)
        radius = jnp.where(clusters.is_cut, self.radius, radius)
        return clusters.middle + (0.25 * jnp.pi * radius)[:, None] * away / distance

    def _associate(
        self,
        tracks: Tracks,
        measured: Float[Array, "K 2"],
        clusters: Clusters,
        is_there: Bool[Array, " K"],
    ) -> tuple[Tracks, Int[Array, " K"]]:
        """Update the tracks by their clusters; return the track of each cluster, -1 without one."""
        # Of somebody who is half hidden, the middle of what is seen is beside the centre.
        noises = jnp.where(clusters.is_cut, CUT, 1.0) * self.position_std**2
        away = measured[None] - tracks.mean[:, None, :2]
        squared = jnp.sum(away * away, axis=-1) / (tracks.covariance[:, :1, 0] + noises)
        is_allowed = (squared < GATE) & tracks.is_alive[:, None] & is_there[None]
        chosen = assign(squared, is_allowed)
        is_measured = chosen != UNASSIGNED
        index = jnp.maximum(chosen, 0)
        noise = noises[index]
        gain = tracks.covariance[:, :, 0] / (tracks.covariance[:, 0, 0] + noise)[:, None]
        error = jnp.take_along_axis(away, index[:, None, None], axis=1)[:, 0]
        change = jnp.concatenate([gain[:, :1] * error, gain[:, 1:] * error], axis=1)
        # Joseph's form keeps the covariance positive definite in single precision.
        rest = jnp.eye(2) - gain[:, :, None] * jnp.asarray([1.0, 0.0])
        joseph = rest @ tracks.covariance @ jnp.swapaxes(rest, 1, 2)
        joseph = joseph + noise[:, None, None] * gain[:, :, None] * gain[:, None, :]
        width = 0.5 * clusters.width[index]
        seen = jnp.clip(width, LEAST_RADIUS, GREATEST_RADIUS) - tracks.radius
        is_whole = is_measured & ~clusters.is_cut[index]
        tracks = tracks._replace(
            mean=jnp.where(is_measured[:, None], tracks.mean + change, tracks.mean),
            covariance=jnp.where(is_measured[:, None, None], joseph, tracks.covariance),
            radius=jnp.where(is_whole, tracks.radius + SMOOTHING * seen, tracks.radius),
            hits=tracks.hits + is_measured.astype(jnp.int32),
            age=jnp.where(is_measured, 0.0, tracks.age),
            missed=jnp.where(is_measured, 0.0, tracks.missed),
        )
        number = is_there.shape[0]
        rows = jnp.arange(self.num_tracks, dtype=jnp.int32)
        of_cluster = jnp.full(number, -1, jnp.int32)
        of_cluster = of_cluster.at[jnp.where(is_measured, index, number)].set(rows, mode="drop")
        return tracks, of_cluster

    def _miss(
        self, tracks: Tracks, sensor: Sensor, scan: Scan, pose: Pose, elapsed: Scalar
    ) -> Tracks:
        """End tracks that were not measured: at once where the beams pass through their places, and
        late where they are hidden."""
        away = tracks.mean[:, :2] - pose[:2]
        distance = jnp.linalg.norm(away, axis=-1)
        bearing = jnp.arctan2(away[:, 1], away[:, 0]) - pose[2]
        off = bearing[:, None] - jnp.asarray(sensor.beam_angles)
        off = jnp.abs(jnp.arctan2(jnp.sin(off), jnp.cos(off)))
        nearest = jnp.argmin(off, axis=1)
        is_in_view = jnp.min(off, axis=1) <= sensor.beam_spacing
        is_passed = scan.ranges[nearest] > distance + tracks.radius
        # A tentative track has no history that would speak for it.
        is_new = tracks.hits < CONFIRMED
        is_missed = (tracks.age > 0.0) & ((is_in_view & is_passed) | is_new)
        missed = jnp.where(is_missed, tracks.missed + elapsed, tracks.missed)
        is_over = (missed > self.patience) | (tracks.age > FORGOTTEN)
        return tracks._replace(missed=missed, is_alive=tracks.is_alive & ~is_over)

    def _begin(
        self,
        tracks: Tracks,
        measured: Float[Array, "K 2"],
        is_there: Bool[Array, " K"],
        of_cluster: Int[Array, " K"],
    ) -> tuple[Tracks, Int[Array, " K"]]:
        """Begin a track at each cluster without one, as long as there is room."""
        is_birth = is_there & (of_cluster < 0)
        # Shapes are fixed: births take the dead rows in order, and those for which there is none go
        # to a row that does not exist, which is dropped.
        rank = jnp.cumsum(is_birth, dtype=jnp.int32) - 1
        free = jnp.argsort(tracks.is_alive, stable=True).astype(jnp.int32)
        room = jnp.sum(~tracks.is_alive, dtype=jnp.int32)
        is_birth &= rank < room
        row = jnp.where(is_birth, free[jnp.clip(rank, 0, self.num_tracks - 1)], self.num_tracks)
        # One return tells nothing of the speed, so it begins at 0 with the greatest speed as its
        # deviation.
        start = jnp.diag(jnp.stack([self.position_std**2, self.max_speed**2]))
        mean = jnp.concatenate([measured, jnp.zeros_like(measured)], axis=1)
        identity = tracks.next_identity + rank

        def put(values: Array, new: ArrayLike) -> Array:
            return values.at[row].set(new, mode="drop")

        tracks = tracks._replace(
            mean=put(tracks.mean, mean),
            covariance=put(tracks.covariance, start),
            radius=put(tracks.radius, self.radius),
            hits=put(tracks.hits, jnp.ones((), jnp.int32)),
            age=put(tracks.age, 0.0),
            missed=put(tracks.missed, 0.0),
            still=put(tracks.still, 0.0),
            is_alive=put(tracks.is_alive, jnp.array(True)),
            identity=put(tracks.identity, identity),
            next_identity=tracks.next_identity + jnp.sum(is_birth, dtype=jnp.int32),
        )
        return tracks, jnp.where(is_birth, row, of_cluster)


def beam_ends(sensor: Sensor, scan: Scan, pose: Pose) -> Float[Array, "B 2"]:
    """Return the ends (B, 2) of the beams in the frame of a pose of the sensor [m]."""
    angles = pose[2] + jnp.asarray(sensor.beam_angles)
    directions = jnp.stack([jnp.cos(angles), jnp.sin(angles)], axis=-1)
    return pose[:2] + scan.ranges[:, None] * directions


def is_unexplained(
    tracks: Tracks, clearance: ScalarField, points: Float[Array, "P 2"]
) -> Bool[Array, " P"]:
    """Check which points [m] the map does not explain: those in space that it knows to be free, or
    knew to be free a little while ago.

    `clearance` is the distance to the nearest cell that is not known to be free [m]. `tracks` have
    the former maps.
    """
    room = jax.vmap(clearance)(points)
    for values in () if tracks.former is None else tracks.former:
        # The newer map tells of who was first seen in unknown space, and has come nearer since.
        former = dataclasses.replace(clearance, values=values)
        room = jnp.maximum(room, jax.vmap(former)(points))
    return room > EXPLAINED


def _remember(tracks: Tracks, clearance: ScalarField, elapsed: Scalar) -> Tracks:
    """Return the tracks with the present map among the former ones, where a look-back is over."""
    if tracks.former is None:
        return tracks
    before = jnp.floor(tracks.time / LOOK_BACK)
    is_over = jnp.floor((tracks.time + elapsed) / LOOK_BACK) > before
    former = jax.lax.cond(
        is_over,
        lambda each: jnp.stack([each[1], clearance.values]),
        lambda each: each,
        tracks.former,
    )
    return tracks._replace(former=former)


def _is_double(tracks: Tracks) -> Bool[Array, " N"]:
    """Check which tracks (N,) are of the same as an older one."""
    away = jnp.linalg.norm(tracks.mean[:, None, :2] - tracks.mean[None, :, :2], axis=-1)
    is_older = tracks.identity[None] < tracks.identity[:, None]
    both = tracks.is_alive[:, None] & tracks.is_alive[None]
    return jnp.any((away < SAME) & is_older & both, axis=1)
