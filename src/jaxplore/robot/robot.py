"""A robot: what it measures goes in, what it knows comes out.

It knows no truth: a simulation and the pilot of a real robot call the same methods.
"""

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore._types import Flag, Pose, Position, Scalar
from jaxplore.belief.belief import Belief
from jaxplore.belief.exploration_field import leads_to_information
from jaxplore.belief.obstacles import Obstacles
from jaxplore.belief.perception import Perception
from jaxplore.belief.tracks import beam_ends
from jaxplore.belief.zones import UNKNOWN, entropy_proxy
from jaxplore.control.guard import GuardState, ScanPoints
from jaxplore.control.plausibility import MAX_MISFIT, RETRY_SECONDS, is_jump, scan_misfit
from jaxplore.control.stops import is_scan_placed
from jaxplore.dynamics.base import Dynamics
from jaxplore.geometry.motion import between, compose, transform_points
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.robot.clock import when_due
from jaxplore.robot.localisation import Localisation, Motions, PoseKnowledge
from jaxplore.sensing.base import Sensor
from jaxplore.sensing.beams import Scan

FITTING = -1.0
"""Time for which scans have not fitted the map, while they do fit [s]."""


class Knowledge(NamedTuple):
    """What is left to learn.

    Args:
        idle: time since a place was last worth a visit [s].
        walls: share of the cells around known free space that are known to be walls; the others are
            unknown. It is counted for the target `walls` alone.
    """

    idle: Scalar
    walls: Scalar

    @classmethod
    def nothing(cls) -> "Knowledge":
        """Return the knowledge before the first scan."""
        return cls(jnp.zeros(()), jnp.zeros(()))

    def update(self, belief: Belief, position: Position, period: Scalar) -> "Knowledge":
        """Return the knowledge a period [s] later; the robot takes itself to be at `position`."""
        is_worth = leads_to_information(belief.guidance(position))
        if belief.is_sent is not None:
            # It goes on afterwards.
            is_worth = is_worth | belief.is_sent
        return self._replace(idle=jnp.where(is_worth, 0.0, self.idle + period))

    def count_walls(self, grid: OccupancyGrid) -> "Knowledge":
        """Return the knowledge with the share of walls of a map."""
        free = jnp.pad(grid.is_free, 1)
        beside = free[:-2, 1:-1] | free[2:, 1:-1] | free[1:-1, :-2] | free[1:-1, 2:]
        walls, unknown = (
            jnp.sum(beside & each, dtype=jnp.int32)
            for each in (grid.is_occupied, entropy_proxy(grid.probability) > UNKNOWN)
        )
        share = walls.astype(jnp.float32) / jnp.maximum(walls + unknown, 1).astype(jnp.float32)
        return self._replace(walls=share)


def scan_points(
    belief: Belief,
    sensors: Sequence[Sensor],
    scans: Sequence[Scan],
    measured: Pose,
    expected: Pose,
    time: Scalar,
    interval: Scalar,
    perception: Perception,
) -> ScanPoints:
    """Return the end points of the scans, one of each sensor, and how badly they fit the map.

    `belief` is what the robot knows before the scans. They must fit the map at the pose `measured`,
    that of the odometry. The points are placed by the pose `expected`, also where the odometry
    cannot be true. `time` is the time of the scans and `interval` the time between two of them [s].
    Without a tracker of moving obstacles nothing moves. On hills beams end as they do at walls, so
    there the points say nothing of commands.
    """
    points, is_point = [], []
    for sensor, scan in zip(sensors, scans, strict=True):
        points.append(beam_ends(sensor, scan, expected))
        # A beam that ended at a moving obstacle may have no return, but is shorter than the others.
        # One without a measurement has the range 0.
        is_shorter = (scan.ranges > 0.0) & (scan.ranges < sensor.clear_range)
        is_point.append(scan.is_return | is_shorter)
    misfit = scan_misfit(belief, sensors[0], scans[0], measured)
    ends, is_end = jnp.concatenate(points), jnp.concatenate(is_point)
    speeds = None if perception.ground is not None else jnp.zeros(ends.shape[0])
    tracker = perception.tracker
    if tracker is not None and belief.tracks is not None:
        speeds = tracker.possible_speeds(belief.tracks, belief.clearance, ends, is_end)
    return ScanPoints(ends, is_end, misfit, time, interval, speeds)


class Told(NamedTuple):
    """Measured moving obstacles, for a robot that is told of them.

    Args:
        positions: (M, 2) positions [m].
        velocities: (M, 2) velocities [m/s].
        is_seen: (M,) whether each is in sight.
        noise: standard deviation of the positions [m].
        pose: pose of the robot (x, y, yaw) in the frame of the positions [m, m, rad].
    """

    positions: Float[Array, "M 2"]
    velocities: Float[Array, "M 2"]
    is_seen: Array
    noise: Scalar
    pose: Pose


class Measurement(NamedTuple):
    """All that a robot measures in a control period, and what is due in it.

    A simulated robot counts periods. A real one has times of its own, and says how long they were.

    Args:
        pose: pose (x, y, yaw) by the odometry, also where the guard does not trust it [m, m, rad].
        is_blind: whether there is no measurement.
        scans: newest scan of each sensor; it is from this period if scans are due.
        is_scan_due: whether scans are due.
        since_scan: time since scans were last due [s].
        are_fields_due: whether an update of the fields is due.
        since_fields: time since the last one [s].
        elapsed: time since the measurement before [s].
        time: time since the start [s]; None for a drive without an end, whose time has no place in
            single precision: it has no guard and no instruments of parts.
        guard: judgement of the guard; None without one.
        told: moving obstacles; None for a robot that finds them in its scans.
        looks: what the instruments of parts say, by the name of the part; None without any.
        motions: how the robot may have moved since scans were last due, for one that finds its pose
            and has not predicted it meanwhile.
    """

    pose: Pose
    is_blind: Flag
    scans: tuple[Scan, ...]
    is_scan_due: Flag
    since_scan: Scalar
    are_fields_due: Flag
    since_fields: Scalar
    elapsed: Scalar
    time: Scalar | None
    guard: GuardState | None = None
    told: Told | None = None
    looks: Mapping[str, Any] | None = None
    motions: Motions | None = None


class RobotState(NamedTuple):
    """What a robot knows.

    Args:
        belief: map, fields and what else it believes of the world.
        knowledge: what is left to learn.
        points: end points of the newest scan, for the guard; None without one.
        place: what it knows of its pose; None if its odometry tells the pose.
        unfit: time for which scans have not fitted the map [s], negative while they do; None if
            they are all mapped.
    """

    belief: Belief
    knowledge: Knowledge
    points: ScanPoints | None = None
    place: PoseKnowledge | None = None
    unfit: Scalar | None = None


class Sight(NamedTuple):
    """Where and whether the scans of a period are taken.

    Args:
        pose: pose at which the robot takes itself to be [m, m, rad].
        is_placed: whether it is finite, and nothing but a scan speaks against it.
        is_taken: whether scans that are due are taken.
    """

    pose: Pose
    is_placed: Flag
    is_taken: Flag

    @classmethod
    def at(cls, pose: Pose) -> "Sight":
        """Return the sight of a robot at a pose that nothing speaks against."""
        is_placed = jnp.isfinite(pose).all()
        return cls(pose, is_placed, is_placed)

    def correct(self, place: PoseKnowledge | None) -> "Sight":
        """Return the sight of a robot that may have found its pose; None if it does not look."""
        return self if place is None else self._replace(pose=place.known.pose)


class Robot(NamedTuple):
    """What runs on board to perceive. It knows what it measures, and nothing of the truth.

    In a control period `examine`, `map_scans`, `track_told` and `update_fields` follow each other.

    `localisation` is how the robot finds its pose; None if its odometry tells it. `prior` is the
    map that the robot knew in advance, if it finds its pose. `counts_walls` is whether it counts
    the walls that it knows.
    """

    model: Dynamics
    sensors: tuple[Sensor, ...]
    perception: Perception
    localisation: Localisation | None = None
    prior: OccupancyGrid | None = None
    counts_walls: bool = False

    def examine(self, own: RobotState, measured: Measurement) -> tuple[RobotState, Sight]:
        """Predict the obstacles, keep the points of a scan for the guard, and judge the scan.

        If the robot finds its pose, `map_scans` judges the scan, at the pose that the scan gives.
        """
        pose, guard = measured.pose, measured.guard
        if guard is not None:
            # While only scans speak against a pose, they say there when they fit again.
            is_trusted = is_scan_placed(guard.stop)
            pose = jnp.where(is_trusted, pose, jnp.nan)
        sight = Sight.at(pose)
        if guard is not None and own.points is not None:
            assert measured.time is not None
            expected, time = self.model.pose(guard.expected), measured.time

            def keep(_: ScanPoints) -> tuple[ScanPoints]:
                found = scan_points(
                    *(own.belief, self.sensors, measured.scans, measured.pose, expected),
                    *(time, measured.since_scan, self.perception),
                )
                return (found,)

            # A stopped robot brakes by its scans, which need no place in the map.
            (points,) = when_due(measured.is_scan_due, ~measured.is_blind, keep, (own.points,))
            own = own._replace(points=points)
        if own.unfit is not None:
            own = own._replace(unfit=self._judge(own, own.unfit, measured, sight))
        is_taken = sight.is_placed
        if self.localisation is not None:
            is_taken = is_taken | (not self.localisation.localiser.is_mapping)
        elif own.unfit is not None:
            is_taken = is_taken & is_mapped_after(own.unfit)
        # The tracker predicts the obstacles at every measurement, also between scans.
        if own.belief.obstacles is not None:
            later = own.belief.obstacles.advance(measured.elapsed)
            own = own._replace(belief=dataclasses.replace(own.belief, obstacles=later))
        return own, sight._replace(is_taken=~measured.is_blind & is_taken)

    def _judge(self, own: RobotState, unfit: Scalar, measured: Measurement, sight: Sight) -> Scalar:
        """Return for how long scans have not fitted the map [s]; where the pose is not to be
        trusted, they say nothing."""

        def judge(before: Scalar) -> tuple[Scalar]:
            if own.place is not None:
                after = before
            elif own.points is not None:
                after = unfit_after(before, own.points.misfit, measured.since_scan)
            else:
                misfit = self._misfit(own.belief, measured, sight.pose)
                after = unfit_after(before, misfit, measured.since_scan)
            return (jnp.where(sight.is_placed, after, FITTING),)

        return when_due(measured.is_scan_due, ~measured.is_blind, judge, (unfit,))[0]

    def _misfit(self, belief: Belief, measured: Measurement, pose: Pose) -> Scalar:
        """Return the share of the first scan that contradicts the map."""
        return scan_misfit(belief, self.sensors[0], measured.scans[0], pose)

    def map_scans(
        self, own: RobotState, measured: Measurement, sight: Sight
    ) -> tuple[RobotState, Flag]:
        """Update pose and map by scans that are due; return whether they are in the map.

        A robot that finds its pose lets a scan correct it first: what does not fit the map where
        the odometry led may fit where the scan says that the robot is. A scan that does not fit
        there either does not correct the pose of a robot that maps.
        """

        def sense(before: RobotState, _: Flag) -> tuple[RobotState, Flag]:
            own, is_looking = before, jnp.array(True)
            if own.place is None or self.localisation is None:
                belief = self._observe(own.belief, measured, sight.pose)
                own, is_mapped = own._replace(belief=belief), is_looking
            else:
                own, is_mapped = self._locate(own, measured, sight)
                is_looking = is_mapped | (not self.localisation.localiser.is_mapping)
            states, looks, known = own.belief.parts, measured.looks or {}, {}
            for part in self.perception.parts:
                if part.name in looks and part.name in states:
                    assert measured.time is not None
                    former = states[part.name]
                    after = part.look(former, looks[part.name], measured.time)
                    chosen = jax.tree.map(functools.partial(jnp.where, is_looking), after, former)
                    known[part.name] = chosen
            return own._replace(belief=own.belief.with_parts(known)), is_mapped

        return when_due(measured.is_scan_due, sight.is_taken, sense, (own, jnp.array(False)))

    def _locate(
        self, own: RobotState, measured: Measurement, sight: Sight
    ) -> tuple[RobotState, Flag]:
        """Find the pose by scans, and map them there if they fit; return whether they do."""
        place, localisation, scans = own.place, self.localisation, measured.scans
        assert place is not None
        assert localisation is not None
        if measured.motions is None:
            found = localisation.correct(place, scans, self.sensors)
        else:
            place, found = localisation.follow(place, measured.motions, scans, self.sensors)
        before, now, is_mapping = place.known, found.known, localisation.localiser.is_mapping
        is_placed = jnp.isfinite(now.pose).all()
        # On a known map a filter may find the robot elsewhere than it thought. What it had mapped
        # there is wrong then.
        if not is_mapping:
            is_elsewhere = ~before.is_known | is_jump(before.pose, now.pose)
            belief = self._reset(own.belief, is_elsewhere & now.is_known)
            own = own._replace(belief=belief)
            is_placed = sight.is_placed & now.is_known
        # A scan that does not fit is not mapped, see `is_mapped_after`; without a guard all are.
        if own.unfit is None:
            is_fit = is_placed
        else:
            misfit = self._misfit(own.belief, measured, now.pose)
            after = unfit_after(own.unfit, misfit, measured.since_scan)
            own = own._replace(unfit=jnp.where(is_placed, after, FITTING))
            if own.points is not None:
                points = own.points._replace(misfit=misfit)
                own = own._replace(points=points)
            is_fit = is_placed & is_mapped_after(after)
            # The pose that such a scan gave is dropped too: the map would follow it.
            if is_mapping:
                found = jax.tree.map(functools.partial(jnp.where, is_fit), found, place)
        belief = jax.lax.cond(
            is_fit,
            lambda same: self._observe(same, measured, now.pose),
            lambda same: same,
            own.belief,
        )
        return own._replace(place=found, belief=belief), is_fit

    def _observe(self, belief: Belief, measured: Measurement, pose: Pose) -> Belief:
        since, time = measured.since_scan, measured.time
        return self.perception.observe(belief, measured.scans, pose, since, time)

    def _reset(self, belief: Belief, is_found: Flag) -> Belief:
        """Return the belief with the prior map if the robot has just found itself elsewhere: what
        it mapped before may be at a wrong place."""
        prior = self.prior
        assert prior is not None
        reset: Belief = jax.lax.cond(
            is_found, lambda each: self.perception.with_map(each, prior), lambda same: same, belief
        )
        return reset

    def track_told(self, own: RobotState, measured: Measurement, sight: Sight) -> RobotState:
        """Update the obstacles of which the robot is told, if it is told of them."""
        told, known = measured.told, own.belief.obstacles
        if told is None or known is None:
            return own
        place = None if own.place is None else own.place.known.pose

        def update(before: Obstacles) -> tuple[Obstacles]:
            return (tell(before, told, place),)

        is_due = measured.is_scan_due
        (after,) = when_due(is_due, sight.is_taken, update, (known,))
        return own._replace(belief=dataclasses.replace(own.belief, obstacles=after))

    def update_fields(self, own: RobotState, measured: Measurement, sight: Sight) -> RobotState:
        """Derive the fields of the belief, if they are due and `sight.is_placed`."""
        place = own.place

        def derive(current: Belief) -> tuple[Belief]:
            if place is not None and self.localisation is not None:
                current = self.localisation.inform(place, current)
            return (self.perception.update_fields(current, sight.pose, measured.since_fields),)

        (belief,) = when_due(measured.are_fields_due, sight.is_placed, derive, (own.belief,))
        return own._replace(belief=belief)

    def learn(
        self, own: RobotState, measured: Measurement, position: Float[Array, "2"]
    ) -> RobotState:
        """Update what is left to learn; the robot takes itself to be at `position` [m]."""
        known = own.knowledge.update(own.belief, position, measured.elapsed)
        if self.counts_walls:
            known = jax.lax.cond(
                measured.is_scan_due,
                lambda: known.count_walls(own.belief.grid),
                lambda: known,
            )
        return own._replace(knowledge=known)


def unfit_after(unfit: Scalar, misfit: Scalar, elapsed: Scalar) -> Scalar:
    """Return for how long scans have not fitted the map [s]; negative if the newest one does.

    `unfit` is the same time before the newest scan. `misfit` is the share of the scan's returns
    that contradict the map. `elapsed` is the time since the scan before it [s].
    """
    longer = jnp.where(unfit < 0.0, 0.0, unfit + elapsed)
    return jnp.where(misfit > MAX_MISFIT, longer, FITTING)


def is_mapped_after(unfit: Scalar) -> Flag:
    """Check whether a scan is mapped, after which `unfit_after` is so long.

    A scan that does not fit is not mapped. If only scans speak against a pose for a while, it is
    the world that has changed.
    """
    return (unfit < 0.0) | (unfit > RETRY_SECONDS)


def tell(known: Obstacles, told: Told, place: Pose | None = None) -> Obstacles:
    """Return the obstacles after a measurement of those in sight.

    `place` is the pose from which the robot places them (x, y, yaw) [m, m, rad]; that of the
    measurement when absent.
    """
    positions, velocities = told.positions, told.velocities
    if place is not None:
        # What brings the true pose to the known one moves the obstacles as well.
        moving = compose(place, between(told.pose, jnp.zeros(3)))
        positions = transform_points(moving, positions)
        velocities = transform_points(moving * jnp.array([0.0, 0.0, 1.0]), velocities)
    # The robot predicts the obstacles at every step, so none of the time is left here.
    return known.update(positions, velocities, told.is_seen, told.noise, jnp.zeros(()))
