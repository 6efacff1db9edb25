"""A robot: what it measures goes in, what it knows comes out."""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore._types import Flag, Pose, Scalar
from jaxplore.belief.belief import Belief
from jaxplore.belief.obstacles import Obstacles
from jaxplore.belief.perception import Perception
from jaxplore.control.guard import BLIND, GOOD, MISFIT, GuardState, ScanPoints
from jaxplore.control.plausibility import MAX_MISFIT, RETRY_SECONDS, is_jump
from jaxplore.dynamics.base import Dynamics
from jaxplore.geometry.motion import between, compose, placed
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.robot.clock import when_due
from jaxplore.robot.knowledge import Knowledge
from jaxplore.robot.localisation import Localisation, PoseKnowledge
from jaxplore.robot.scan_points import scan_points
from jaxplore.sensing.base import Sensor
from jaxplore.sensing.beams import Scan
from jaxplore.sensing.detector import Detections


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


class Look(NamedTuple):
    """What a camera reports of objects.

    Args:
        detections: reports of the detector.
        place: (N, 2) positions of the objects [m].
        position: position from which they were seen (x, y) [m].
    """

    detections: Detections
    place: Float[Array, "N 2"]
    position: Float[Array, "2"]


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
        time: time since the start [s].
        guard: judgement of the guard; None without one.
        told: moving obstacles; None for a robot that finds them in its scans.
        look: reports of objects; None for a robot that recognises none.
    """

    pose: Pose
    is_blind: Flag
    scans: tuple[Scan, ...]
    is_scan_due: Flag
    since_scan: Scalar
    are_fields_due: Flag
    since_fields: Scalar
    time: Scalar
    guard: GuardState | None = None
    told: Told | None = None
    look: Look | None = None


class RobotState(NamedTuple):
    """What a robot knows.

    Args:
        belief: map, fields and what else it believes of the world.
        knowledge: what is left to learn.
        points: end points of the newest scan, for the guard; None without one.
        place: what it knows of its pose; None if its odometry tells the pose.
    """

    belief: Belief
    knowledge: Knowledge
    points: ScanPoints | None = None
    place: PoseKnowledge | None = None


class Sight(NamedTuple):
    """Where and whether the scans of a period are taken.

    Args:
        pose: pose at which the robot takes itself to be by the odometry [m, m, rad].
        is_placed: whether it is finite.
        is_fit: whether the scan fits the map, or the world has changed.
        is_taken: whether scans that are due are taken.
    """

    pose: Pose
    is_placed: Flag
    is_fit: Flag
    is_taken: Flag


class Robot(NamedTuple):
    """What runs on board to perceive. It knows what it measures, and nothing of the truth.

    In a control period `examine`, `map_scans`, `track_told` and `update_fields` follow each other.

    Args:
        model: model of the robot.
        sensors: the sensors.
        perception: update of the belief from scans.
        period: control period [s].
        localisation: how the robot finds its pose; None if its odometry tells it.
        prior: map that the robot knew in advance, for one that finds its pose.
        counts_walls: whether it counts the walls that it knows.
    """

    model: Dynamics
    sensors: tuple[Sensor, ...]
    perception: Perception
    period: Scalar
    localisation: Localisation | None = None
    prior: OccupancyGrid | None = None
    counts_walls: bool = False

    def examine(self, own: RobotState, measured: Measurement) -> tuple[RobotState, Sight]:
        """Predict the obstacles, keep the points of a scan for the guard, and judge the scan.

        Args:
            own: what the robot knows.
            measured: what it measures.
        """
        here, guard, is_fit = measured.pose, measured.guard, jnp.array(True)
        pose = here
        if guard is not None and own.points is not None:
            expected = self.model.pose(guard.expected)

            def examine(_: ScanPoints) -> tuple[ScanPoints]:
                found = scan_points(
                    *(own.belief, self.sensors, measured.scans, here, expected),
                    *(measured.time, measured.since_scan, self.perception.tracker),
                )
                return (found,)

            # A stopped robot brakes by its scans, which need no place in the map.
            (points,) = when_due(measured.is_scan_due, ~measured.is_blind, examine, (own.points,))
            own = own._replace(points=points)
            # A scan that does not fit is not mapped. If only the scan speaks against a pose at
            # which the robot has stood for a while, it is the world that has changed.
            is_changed = (guard.stop == MISFIT) & (guard.since > RETRY_SECONDS)
            is_fit = (points.misfit <= MAX_MISFIT) | is_changed
            # The scan that ends a dropout is mapped at once.
            is_changed |= guard.stop == BLIND
            pose = jnp.where((guard.stop == GOOD) | is_changed, here, jnp.nan)
        is_placed = jnp.isfinite(pose).all()
        # The tracker predicts the obstacles at every control period, also between scans.
        if own.belief.obstacles is not None:
            later = own.belief.obstacles.after(self.period)
            own = own._replace(belief=dataclasses.replace(own.belief, obstacles=later))
        is_taken = is_placed & is_fit
        if self.localisation is not None:
            is_taken = is_taken | (not self.localisation.localiser.is_mapping)
        return own, Sight(pose, is_placed, is_fit, ~measured.is_blind & is_taken)

    def map_scans(
        self, own: RobotState, measured: Measurement, sight: Sight
    ) -> tuple[RobotState, Flag]:
        """Update pose and map by scans that are due; return whether they are in the map.

        Args:
            own: what the robot knows.
            measured: what it measures.
            sight: where and whether the scans are taken.
        """

        def sense(
            belief: Belief, place: PoseKnowledge | None, _: Flag
        ) -> tuple[Belief, PoseKnowledge | None, Flag]:
            scans, is_mapped = measured.scans, jnp.array(True)
            if place is None or self.localisation is None:
                belief = self._observe(belief, measured, sight.pose)
            else:
                before, is_mapping = place.known, self.localisation.localiser.is_mapping
                place = self.localisation.correct(place, scans, self.sensors)
                now = place.known
                if not is_mapping:
                    is_elsewhere = ~before.is_known | is_jump(before.pose, now.pose)
                    belief = self._reset(belief, is_elsewhere & now.is_known)
                    is_mapped = sight.is_placed & sight.is_fit & now.is_known
                # Another estimator got the scan only because it fits.
                belief = (
                    self._observe(belief, measured, now.pose)
                    if is_mapping
                    else jax.lax.cond(
                        is_mapped,
                        lambda same: self._observe(same, measured, now.pose),
                        lambda same: same,
                        belief,
                    )
                )
            recognition, look = self.perception.recognition, measured.look
            if look is not None and recognition is not None and belief.objects is not None:
                known = recognition.update(belief.objects, *look, measured.time)
                belief = dataclasses.replace(belief, objects=known)
            return belief, place, is_mapped

        belief, place, is_mapped = when_due(
            measured.is_scan_due,
            sight.is_taken,
            sense,
            (own.belief, own.place, jnp.array(False)),
        )
        return own._replace(belief=belief, place=place), is_mapped

    def _observe(self, belief: Belief, measured: Measurement, pose: Pose) -> Belief:
        return self.perception.observe(
            belief, measured.scans, pose, measured.since_scan, measured.time
        )

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
        """Update the obstacles of which the robot is told, if it is told of them.

        Args:
            own: what the robot knows.
            measured: what it measures.
            sight: where and whether the scans are taken.
        """
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
        """Derive the fields if they are due, and what is left to learn.

        Args:
            own: what the robot knows.
            measured: what it measures.
            sight: where the robot is.
        """
        place = own.place
        here = sight.pose if place is None else place.known.pose

        def derive(current: Belief) -> tuple[Belief]:
            if place is not None and self.localisation is not None:
                current = self.localisation.inform(place, current)
            return (self.perception.update_fields(current, here, measured.since_fields),)

        (belief,) = when_due(measured.are_fields_due, sight.is_placed, derive, (own.belief,))
        return own._replace(belief=belief)

    def learn(
        self, own: RobotState, measured: Measurement, position: Float[Array, "2"]
    ) -> RobotState:
        """Update what is left to learn.

        Args:
            own: what the robot knows.
            measured: what it measures.
            position: where it takes itself to be (x, y) [m].
        """
        known = own.knowledge.after(own.belief, position, self.period)
        if self.counts_walls:
            known = jax.lax.cond(
                measured.is_scan_due,
                lambda: known.count_walls(own.belief.grid),
                lambda: known,
            )
        return own._replace(knowledge=known)


def tell(known: Obstacles, told: Told, place: Pose | None = None) -> Obstacles:
    """Return the obstacles after a measurement of those in sight.

    Args:
        known: obstacles as the robot knows them.
        told: the measurement.
        place: pose from which the robot places them (x, y, yaw) [m, m, rad]; that of the
            measurement when absent.
    """
    positions, velocities = told.positions, told.velocities
    if place is not None:
        # What brings the true pose to the known one moves the obstacles as well.
        moving = compose(place, between(told.pose, jnp.zeros(3)))
        positions = placed(moving, positions)
        velocities = placed(moving * jnp.array([0.0, 0.0, 1.0]), velocities)
    # The robot predicts the obstacles at every step, so none of the time is left here.
    return known.update(positions, velocities, told.is_seen, told.noise, jnp.zeros(()))
