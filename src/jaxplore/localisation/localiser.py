"""Where a robot is: odometry between scans, matching of scans, and scans that are stored."""

from collections.abc import Sequence
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, Count, Flag, Key, Pose, Scalar
from jaxplore.geometry.motion import Matrix, between, compose, propagate_covariance, rotation
from jaxplore.localisation.estimator import PoseEstimator
from jaxplore.localisation.odometry import Odometry
from jaxplore.localisation.odometry_model import ErrorEstimate, OdometryModel, Reckoning
from jaxplore.localisation.scan_matching import ScanMatcher
from jaxplore.localisation.stored_scans import Closures, StoredScans
from jaxplore.localisation.surface import USUAL_NOISE, EndPoints, SurfaceMap
from jaxplore.maps.frame import GridFrame
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.sensing.beams import Beams, Scan

LEAST_MATCHED = 20
"""Number of end points on known surfaces below which a scan does not correct the pose."""
FLOOR = (0.002, 0.002, 0.0005)
"""Least standard deviations of a motion between stored scans [m, m, rad]: errors of the map."""
MOST_CLOSURES = 2048
"""Greatest number of closed loops."""
AROUND = 64
"""Number of stored scans that a robot takes for its surroundings where it finds itself again."""
SPARE = 64
"""Number of scans for which there must be room; otherwise every second one is left out."""


class LocaliserState(NamedTuple):
    """What a localiser knows.

    Args:
        pose: estimated pose (x, y, yaw) [m, m, rad].
        covariance: (3, 3) covariance of the motion since the last stored scan, in the world.
        drift: (3, 3) covariance of the pose relative to the start, or to what closed loops say.
        way: length of the robot's way by its odometry [m].
        surface: surfaces seen of late.
        scans: scans along the way.
        closures: closed loops.
        share: share of the newest scan that lies on known surfaces.
        errors: what is known of the odometry's errors; None where nothing is estimated of them.
    """

    pose: Pose
    covariance: Matrix
    drift: Matrix
    way: Scalar
    surface: SurfaceMap
    scans: StoredScans
    closures: Closures
    share: Scalar
    errors: ErrorEstimate | None

    @property
    def uncertainty(self) -> Scalar:
        """Standard deviation of the position relative to the map [m]: the root of the mean of its
        variances along x and y."""
        total = self.drift + self.covariance
        return jnp.sqrt(0.5 * (total[0, 0] + total[1, 1]))

    @property
    def is_known(self) -> Flag:
        """Whether the robot may drive by the pose: always, for the map is made at that pose."""
        return jnp.array(True)


class Localiser(PoseEstimator):
    """Estimates the pose of a robot by odometry and scans, while it maps.

    Between scans the pose and its covariance follow the odometry. A scan is matched to the surfaces
    that were seen of late (`SurfaceMap`), which corrects the pose; then it is added to them. Every
    so often a scan is stored. Loops are closed outside of compiled code, see
    `jaxplore.localisation.closing`, and move the stored scans.

    Args:
        odometry: errors of the odometry; those of wheels, `Odometry`, when absent.
        matcher: matches scans; with the default numbers when absent.
        spacing: way after which a scan is stored [m].
        turn: turn after which a scan is stored [rad].
        memory: way after which surfaces no longer serve to match scans [m].
        capacity: greatest number of stored scans; static.
        filling: number of points with which a surface between two beams is written, the first one
            counted; more than 1 where beams are further apart than cells; static.
        noise: standard deviation of the ranges of the sensors [m].

    Raises:
        ValueError: a part of another class, a number that is not positive.
    """

    is_mapping: ClassVar[bool] = True

    odometry: OdometryModel
    matcher: ScanMatcher
    spacing: Scalar
    turn: Scalar
    memory: Scalar
    noise: Scalar
    capacity: int = eqx.field(static=True)
    filling: int = eqx.field(static=True)

    @_kinds.check_arguments
    def __init__(
        self,
        odometry: OdometryModel | None = None,
        *,
        matcher: ScanMatcher | None = None,
        spacing: ArrayLike = 0.25,
        turn: ArrayLike = 0.25,
        memory: ArrayLike = 15.0,
        capacity: int = 4096,
        filling: int = 1,
        noise: ArrayLike = USUAL_NOISE,
    ) -> None:
        self.odometry = Odometry() if odometry is None else odometry
        self.matcher = ScanMatcher() if matcher is None else matcher
        self.spacing = _checks.scalar("spacing", spacing, above=0.0)
        self.turn = _checks.scalar("turn", turn, above=0.0)
        self.memory = _checks.scalar("memory", memory, above=0.0)
        self.capacity = _checks.positive_int("capacity", capacity)
        self.noise = _checks.scalar("noise", noise, above=0.0)
        self.filling = _checks.positive_int("filling", filling)

    @property
    def expected_odometry(self) -> OdometryModel:
        """Errors of the odometry that it expects: `odometry`."""
        return self.odometry

    def check_map(self, prior: OccupancyGrid | None) -> None:
        """Accept any map that the robot knows in advance; see `PoseEstimator.check_map`."""

    def start(
        self, pose: Pose, grid: OccupancyGrid, sensors: Sequence[Beams], key: Key | None
    ) -> LocaliserState:
        """Return the state at the start; see `init`, and `PoseEstimator.start`."""
        return self.init(pose, grid.frame, grid.shape, sensors)

    @_kinds.check_arguments
    def init(
        self, pose: Pose, frame: GridFrame, shape: tuple[int, int], sensors: Sequence[Beams]
    ) -> LocaliserState:
        """Return the state at the start.

        Args:
            pose: pose (x, y, yaw) of the start, which defines the frame of the map.
            frame: pose and cell size of the map.
            shape: its rows and columns.
            sensors: the sensors; scans of the first one are matched.

        Raises:
            ValueError: something else than a pose, a frame, a shape or sensors.
        """
        pose = _checks.pose("pose", pose)
        shape = _checks.rows_and_columns("shape", shape)
        nothing = jnp.zeros(())
        return LocaliserState(
            pose,
            floor(),
            jnp.zeros((3, 3)),
            nothing,
            SurfaceMap.empty(frame, shape, self.memory),
            StoredScans.none(self.capacity, sensors),
            Closures.none(MOST_CLOSURES),
            nothing,
            self.odometry.estimate(),
        )

    @_kinds.check_arguments
    def predict(self, state: LocaliserState, motion: Pose, elapsed: Scalar) -> LocaliserState:
        """Return the state after a motion.

        Args:
            state: state before it.
            motion: motion (dx, dy, dyaw) by the odometry, in the frame of the robot.
            elapsed: time that it took [s].

        Raises:
            ValueError: something else than a state.
        """
        known = Reckoning(state.pose, state.covariance, state.errors, state.way)
        return state._replace(**self.odometry.predict(known, motion, elapsed)._asdict())

    @_kinds.check_arguments
    def correct(
        self, state: LocaliserState, scans: Sequence[Scan], sensors: Sequence[Beams]
    ) -> LocaliserState:
        """Return the state after scans: the pose corrected, and the surfaces of the first added.

        Args:
            state: state before the scans.
            scans: a scan of each sensor.
            sensors: the sensors.

        Raises:
            ValueError: something else than a state, scans or sensors.
        """
        ends = self.end_points(scans[0], sensors[0])
        match = self.matcher(state.surface, ends, state.pose, state.covariance, state.way)
        number = jnp.sum(ends.is_point, dtype=jnp.float32)
        is_matched = match.share * number >= LEAST_MATCHED
        pose = jnp.where(is_matched, match.pose, state.pose)
        covariance = jnp.where(is_matched, match.covariance, state.covariance)
        errors = state.errors
        if errors is not None:
            errors = errors.correct(state.pose, state.covariance, pose, covariance)
        state = state._replace(
            pose=pose,
            covariance=covariance,
            errors=errors,
            surface=state.surface.with_scan(pose, self._fill(ends, sensors[0]), state.way),
            share=match.share,
        )
        return self._store(state, scans)

    def _store(self, state: LocaliserState, scans: Sequence[Scan]) -> LocaliserState:
        """Return the state with the scans stored if the robot has moved far enough."""
        before = state.scans.poses[state.scans.last]
        way = state.way - state.scans.way[state.scans.last]
        motion = between(before, state.pose)
        is_first = state.scans.number == 0
        is_due = is_first | (way >= self.spacing) | (jnp.abs(motion[2]) >= self.turn)

        back = rotation(before[2]).T
        local = back @ (state.covariance + floor()) @ back.T
        # Nothing was measured before the first scan.
        local = jnp.where(is_first, floor(), local)
        moved = jnp.where(is_first, 0.0, motion)
        drift = propagate_covariance(before, moved, state.drift, local)
        stored = state.scans.with_scan(is_due, state.pose, moved, local, state.way, scans)
        errors = state.errors
        if errors is not None:
            # From here on the pose counts from this scan.
            cross = jnp.where(is_due, 0.0, errors.cross)
            errors = errors._replace(cross=cross)
        return state._replace(
            errors=errors,
            scans=stored,
            covariance=jnp.where(is_due, floor(), state.covariance),
            drift=jnp.where(is_due & ~is_first, drift, state.drift),
        )

    @_kinds.check_arguments
    def start_at(
        self, state: LocaliserState, pose: Pose, covariance: Matrix, sensors: Sequence[Beams]
    ) -> LocaliserState:
        """Return the state of a robot that has found itself on the map that it made before.

        The next scans are matched to the surfaces of the stored scans around it, which are made
        anew. The way from the newest of these to the next one that is stored is an edge of the pose
        graph, as exact as the pose that was found.

        Args:
            state: state when it was there last.
            pose: pose (x, y, yaw) that was found [m, m, rad].
            covariance: its covariance (3, 3), in the world.
            sensors: the sensors.
        """
        stored = state.scans
        away = jnp.hypot(*jnp.unstack(stored.poses[:, :2] - pose[:2], axis=1))
        is_stored = jnp.arange(stored.capacity) < stored.number
        away = jnp.where(is_stored & (away <= sensors[0].max_range), away, jnp.inf)
        nearest, indices = jax.lax.top_k(-away, min(AROUND, stored.capacity))
        shape: tuple[int, int] = state.surface.sums.shape  # type: ignore[assignment]
        empty = SurfaceMap.empty(state.surface.frame, shape, self.memory)

        def add(at: Count, surface: SurfaceMap) -> SurfaceMap:
            index = indices[at]
            ends = self.end_points(stored.scan(index, sensors)[0], sensors[0])
            # As if they were seen just now.
            return surface.with_scan(stored.poses[index], self._fill(ends, sensors[0]), state.way)

        number = jnp.sum(jnp.isfinite(nearest), dtype=jnp.int32)
        surface: SurfaceMap = jax.lax.fori_loop(0, number, add, empty)
        errors = None if state.errors is None else state.errors.uncouple()
        return state._replace(
            pose=pose, covariance=covariance + floor(), surface=surface, errors=errors
        )

    def surface_of(
        self, state: LocaliserState, first: Count, end: Count, sensors: Sequence[Beams]
    ) -> SurfaceMap:
        """Return the surfaces of stored scans alone, at their poses as estimated now.

        Args:
            state: state with the scans.
            first: index of the first scan.
            end: index behind the last one.
            sensors: the sensors.
        """
        shape: tuple[int, int] = state.surface.sums.shape  # type: ignore[assignment]
        empty = SurfaceMap.empty(state.surface.frame, shape, self.memory)
        stored = state.scans

        def add(index: Count, surface: SurfaceMap) -> SurfaceMap:
            ends = self.end_points(stored.scan(index, sensors)[0], sensors[0])
            ends = self._fill(ends, sensors[0])
            return surface.with_scan(stored.poses[index], ends, stored.way[index])

        surface: SurfaceMap = jax.lax.fori_loop(first, end, add, empty)
        return surface

    def surface_of_scans(
        self,
        state: LocaliserState,
        indices: Int[Array, " P"],
        number: Count,
        sensors: Sequence[Beams],
    ) -> SurfaceMap:
        """Return the surfaces of any stored scans, none of which is stale at the way 0.

        Args:
            state: state with the scans.
            indices: their indices (P,).
            number: how many of these are used, the first ones.
            sensors: the sensors.
        """
        shape: tuple[int, int] = state.surface.sums.shape  # type: ignore[assignment]
        empty = SurfaceMap.empty(state.surface.frame, shape, self.memory)
        stored = state.scans

        def add(at: Count, surface: SurfaceMap) -> SurfaceMap:
            index = indices[at]
            ends = self.end_points(stored.scan(index, sensors)[0], sensors[0])
            ends = self._fill(ends, sensors[0])
            return surface.with_scan(stored.poses[index], ends, jnp.zeros(()))

        surface: SurfaceMap = jax.lax.fori_loop(0, number, add, empty)
        return surface

    def end_points(self, scan: Scan, sensor: Beams) -> EndPoints:
        """Return the end points of a scan, with lines as long as its noise needs."""
        return EndPoints.of(sensor, scan, self.noise)

    def _fill(self, ends: EndPoints, sensor: Beams) -> EndPoints:
        return ends.fill(self.filling, self.noise, is_full_circle=sensor.is_full_circle)


def floor() -> Matrix:
    """Return the least covariance (3, 3) of a motion."""
    return jnp.diag(jnp.array(FLOOR) ** 2)


def is_nearly_full(state: LocaliserState) -> bool:
    """Check whether stored scans should be thinned out before more are stored."""
    return int(state.scans.number) > state.scans.capacity - SPARE


def halve(rows: Array) -> Array:
    """Return every second row, with zeros behind them."""
    kept = rows[::2]
    return jnp.zeros_like(rows).at[: len(kept)].set(kept)


@eqx.filter_jit
def thin_scans(state: LocaliserState) -> LocaliserState:
    """Return the state with every second stored scan left out.

    Motions between neighbours are composed, with their covariances. A closed loop of a scan that is
    left out becomes one of the scan before it.
    """
    scans, closures = state.scans, state.closures
    first, second = scans.motions[1::2], jnp.roll(scans.motions, -1, axis=0)[1::2]
    added = jnp.roll(scans.covariances, -1, axis=0)[1::2]
    # Scan 2 k + 2 follows scan 2 k by the motions 2 k + 1 and 2 k + 2.
    motions = jax.vmap(compose)(first, second)
    covariances = jax.vmap(propagate_covariance)(first, second, scans.covariances[1::2], added)
    capacity = scans.capacity

    def shift_rows(rows: Array, former: Array) -> Array:
        after = rows[: (capacity + 1) // 2 - 1]
        return jnp.zeros_like(former).at[1 : 1 + len(after)].set(after)

    def anchor(pair: Array, motion: Pose) -> Pose:
        older, newer = scans.poses[pair], scans.poses[2 * (pair // 2)]
        before = between(newer[0], older[0])
        return compose(compose(before, motion), between(older[1], newer[1]))

    return state._replace(
        scans=StoredScans(
            halve(scans.poses),
            shift_rows(motions, scans.motions),
            shift_rows(covariances, scans.covariances),
            halve(scans.way),
            halve(scans.ranges),
            halve(scans.is_return),
            (scans.number + 1) // 2,
        ),
        closures=closures._replace(
            pairs=closures.pairs // 2,
            motions=jax.vmap(anchor)(closures.pairs, closures.motions),
            examined=(closures.examined + 1) // 2,
        ),
    )
