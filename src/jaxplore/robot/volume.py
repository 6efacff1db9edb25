"""A robot in a volume: what it measures goes in, what it knows comes out.

It knows no truth, as `jaxplore.robot.robot.Robot`, its twin in the plane.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore._types import Flag, Scalar, StateVector
from jaxplore.belief.obstacles import Obstacles
from jaxplore.belief.volume import VolumePerception
from jaxplore.belief.volume_belief import VolumeBelief
from jaxplore.control.guard import GuardState, ScanPoints
from jaxplore.control.stops import is_scan_placed
from jaxplore.dynamics.quadrotor import Quadrotor, attitude_upwards, position_upwards
from jaxplore.geometry.level_motion import LevelPose, turn
from jaxplore.localisation.volume_localiser import VolumeLocaliser, VolumeLocaliserState
from jaxplore.robot.clock import when_due
from jaxplore.robot.robot import FITTING, Told, is_mapped_after, tell, unfit_after
from jaxplore.robot.volume_points import num_volume_points, volume_points
from jaxplore.sensing.volume import Rotation, VolumeScan, VolumeSensor


class VolumeMeasurement(NamedTuple):
    """All that a robot in a volume measures in a control period, and what is due in it.

    Args:
        state: (nx,) measured state, also where the guard does not trust it.
        is_blind: whether there is no measurement.
        scans: newest scan of each sensor; it is from this period if scans are due.
        is_scan_due: whether scans are due.
        since_scan: time since scans were last due [s].
        are_fields_due: whether an update of the fields is due.
        since_fields: time since the last one [s].
        elapsed: time since the measurement before [s].
        time: time since the start [s].
        guard: judgement of the guard; None without one.
        told: moving obstacles of which the robot is told; None where nothing moves.
        looks: what the instruments of parts say, by the name of the part; None without any.
    """

    state: StateVector
    is_blind: Flag
    scans: tuple[VolumeScan, ...]
    is_scan_due: Flag
    since_scan: Scalar
    are_fields_due: Flag
    since_fields: Scalar
    elapsed: Scalar
    time: Scalar
    guard: GuardState | None = None
    told: Told | None = None
    looks: Mapping[str, Any] | None = None


class VolumeRobotState(NamedTuple):
    """What a robot in a volume knows.

    Args:
        belief: map, fields and what else it believes of the volume.
        points: points of the newest scan, for the guard; None without one.
        unfit: time for which scans have not fitted the map [s], negative while they do; None if
            they are all mapped.
        place: what it knows of its pose; None if its odometry tells the pose.
    """

    belief: VolumeBelief
    points: ScanPoints | None = None
    unfit: Scalar | None = None
    place: VolumeLocaliserState | None = None


class VolumeSight(NamedTuple):
    """Where and whether the scans of a period are taken.

    Args:
        state: (nx,) state in which the robot takes itself to be.
        is_placed: whether nothing but a scan speaks against it.
        is_taken: whether scans that are due are mapped.
    """

    state: StateVector
    is_placed: Flag
    is_taken: Flag

    @property
    def place(self) -> tuple[Float[Array, "3"], Rotation]:
        """Position (x, y, z) with z up [m], and the rotation from the body to the world."""
        return position_upwards(self.state), attitude_upwards(self.state)


class VolumeRobot(NamedTuple):
    """What runs on board of a robot in a volume to perceive.

    In a control period `examine`, `locate`, `track_told`, `map_scans` and `update_fields` follow
    each other. `localiser` is how the robot finds its pose; None if its odometry tells it.
    """

    model: Quadrotor
    sensors: tuple[VolumeSensor, ...]
    perception: VolumePerception
    localiser: VolumeLocaliser | None = None

    def init(
        self, belief: VolumeBelief, start: StateVector, *, is_guarded: bool
    ) -> VolumeRobotState:
        """Return what the robot knows before the first scan in the state `start` (nx,), with what
        a guard needs if there is one."""
        place = None
        if self.localiser is not None:
            place = self.localiser.init(level_pose(self.model, start), belief.grid)
        if not is_guarded:
            return VolumeRobotState(belief, place=place)
        points = ScanPoints.blank(num_volume_points(self.sensors), 0.0, dimensions=3)
        return VolumeRobotState(belief, points, jnp.asarray(FITTING), place)

    def observe_state(self, own: VolumeRobotState, state: StateVector) -> StateVector:
        """Return the state (nx,) that the robot takes to be its own.

        What is neither position nor yaw is measured as it is in the true state (nx,): the velocity
        in the frame of the robot, roll, pitch and body rates.
        """
        return state if own.place is None else move_to(self.model, state, own.place.pose)

    def predict(self, own: VolumeRobotState, motion: LevelPose) -> VolumeRobotState:
        """Return what the robot knows after a motion (dx, dy, dz, dyaw) by its odometry."""
        assert self.localiser is not None
        assert own.place is not None
        return own._replace(place=self.localiser.predict(own.place, motion))

    def locate(
        self, own: VolumeRobotState, measured: VolumeMeasurement, sight: VolumeSight
    ) -> tuple[VolumeRobotState, VolumeSight]:
        """Correct the pose by scans that are due, if the robot finds its pose by them."""
        localiser = self.localiser
        if localiser is None or own.place is None:
            return own, sight
        # The scan is from the attitude that is measured; the yaw of it is found.
        _, rotation = sight.place
        level = turn(-self.model.heading(sight.state)) @ rotation

        def correct(place: VolumeLocaliserState) -> tuple[VolumeLocaliserState]:
            return (localiser.correct(place, measured.scans, self.sensors, level),)

        (place,) = when_due(measured.is_scan_due, sight.is_taken, correct, (own.place,))
        found = move_to(self.model, sight.state, place.pose)
        state = jnp.where(sight.is_placed, found, sight.state)
        return own._replace(place=place), sight._replace(state=state)

    def examine(
        self, own: VolumeRobotState, measured: VolumeMeasurement
    ) -> tuple[VolumeRobotState, VolumeSight]:
        """Predict the obstacles, keep the points of a scan for the guard, and judge the scan."""
        guard, state, is_placed = measured.guard, measured.state, jnp.array(True)
        is_taken = is_placed
        if guard is not None:
            # While only scans speak against a pose, they say there when they fit again.
            is_trusted = is_scan_placed(guard.stop)
            is_placed = is_trusted & jnp.isfinite(measured.state).all()
            state = jnp.where(is_placed, measured.state, guard.expected)
        if guard is not None and own.points is not None and own.unfit is not None:
            since, poses = measured.since_scan, (measured.state, guard.expected)

            def judge(_: ScanPoints, unfit: Scalar) -> tuple[ScanPoints, Scalar]:
                # A stopped robot brakes by its scans, which need no place in the map.
                scans = self.sensors, measured.scans
                points = volume_points(own.belief, *scans, *poses, measured.time, since)
                after = unfit_after(unfit, points.misfit, since)
                return points, jnp.where(is_placed, after, FITTING)

            points, unfit = when_due(
                measured.is_scan_due, ~measured.is_blind, judge, (own.points, own.unfit)
            )
            own = own._replace(points=points, unfit=unfit)
            is_taken = is_placed & is_mapped_after(unfit)
        # The obstacles are predicted at every measurement, also between scans.
        if own.belief.obstacles is not None:
            later = own.belief.obstacles.advance(measured.elapsed)
            own = own._replace(belief=dataclasses.replace(own.belief, obstacles=later))
        return own, VolumeSight(state, is_placed, ~measured.is_blind & is_taken)

    def track_told(self, own: VolumeRobotState, measured: VolumeMeasurement) -> VolumeRobotState:
        """Update the obstacles of which the robot is told, if it is told of them."""
        told, known = measured.told, own.belief.obstacles
        if told is None or known is None:
            return own

        # A robot that finds its pose places them from there.
        place = None if own.place is None else own.place.pose[jnp.array([0, 1, 3])]

        def update(before: Obstacles) -> tuple[Obstacles]:
            return (tell(before, told, place),)

        (after,) = when_due(measured.is_scan_due, ~measured.is_blind, update, (known,))
        return own._replace(belief=dataclasses.replace(own.belief, obstacles=after))

    def map_scans(
        self, own: VolumeRobotState, measured: VolumeMeasurement, sight: VolumeSight
    ) -> VolumeRobotState:
        """Update map and parts by scans that are due, and store the window of a map that moves."""

        def observe(before: VolumeBelief) -> tuple[VolumeBelief]:
            after = self.perception.update(before, *sight.place, measured.scans)
            states, looks = dict(after.parts), measured.looks or {}
            for part in self.perception.parts:
                if part.name in looks:
                    own = states[part.name]
                    states[part.name] = part.look(own, looks[part.name], measured.time)
            return (dataclasses.replace(after, parts=states),)

        belief, stored = own.belief.split()
        (belief,) = when_due(measured.is_scan_due, sight.is_taken, observe, (belief,))
        return own._replace(belief=eqx.combine(belief, stored).store_window())

    def update_fields(
        self, own: VolumeRobotState, measured: VolumeMeasurement, sight: VolumeSight
    ) -> VolumeRobotState:
        """Derive the fields of the belief, if they are due and `sight.is_placed`."""
        belief, stored = own.belief.split()
        heading, (position, _) = self.model.heading(sight.state), sight.place

        def derive(before: VolumeBelief) -> tuple[VolumeBelief]:
            whole = eqx.combine(before, stored)
            since = measured.since_fields
            return (self.perception.update_fields(whole, position, heading, since).split()[0],)

        (belief,) = when_due(measured.are_fields_due, sight.is_placed, derive, (belief,))
        return own._replace(belief=eqx.combine(belief, stored))


def level_pose(model: Quadrotor, state: StateVector) -> LevelPose:
    """Return the pose (x, y, z, yaw) of a state (nx,), with z up [m, m, m, rad]."""
    return jnp.append(position_upwards(state), model.heading(state))


def move_to(model: Quadrotor, state: StateVector, pose: LevelPose) -> StateVector:
    """Return a state (nx,) turned about the vertical to a pose (x, y, z, yaw), with z up."""
    x, y, z, yaw = jnp.unstack(pose)
    return model.with_pose(state, jnp.stack([x, y, yaw])).at[2].set(-z)
