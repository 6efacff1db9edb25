"""What the robot learns at a control period: scans at one rate, fields at another."""

import dataclasses
import itertools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxplore._types import Count, Flag, GridMask, Key, Pose, Scalar
from jaxplore.belief.belief import Belief
from jaxplore.belief.obstacles import Obstacles
from jaxplore.belief.perception import Perception
from jaxplore.control.guard import BLIND, MISFIT, ScanPoints
from jaxplore.control.plausibility import MAX_MISFIT, RETRY_SECONDS, is_jump
from jaxplore.dynamics.base import Dynamics
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.report.exploration.data import MapProgress
from jaxplore.sensing.base import Sensor
from jaxplore.sensing.beams import Scan
from jaxplore.sensing.mount import ScanMotion
from jaxplore.simulation.exploration.clock import when_due
from jaxplore.simulation.exploration.located import Localisation, Located
from jaxplore.simulation.exploration.progress import MapSums, map_progress, observed
from jaxplore.simulation.exploration.scan_points import scan_points
from jaxplore.simulation.exploration.state import ExplorationState
from jaxplore.simulation.exploration.true_objects import TrueObjects
from jaxplore.simulation.exploration.true_world import TrueWorld
from jaxplore.simulation.state import Moment


class Scanned(NamedTuple):
    """What a robot knows after a control period's scans, before its fields follow.

    Args:
        state: state of the task, with the obstacles predicted and the scans in the map.
        pose: pose at which the robot takes itself to be [m, m, rad].
        is_placed: whether it is finite.
        is_taken: whether scans that were due were taken.
    """

    state: ExplorationState
    pose: Pose
    is_placed: Flag
    is_taken: Flag


class Senses(NamedTuple):
    """The sensors of a robot in the true world, and what updates its belief.

    Args:
        robot: model of the robot.
        sensors: the sensors; targets are seen by the first.
        perception: update of the belief from scans.
        reachable: (H, W) cells that count for the progress.
        targets: (M, 2) positions of the targets [m].
        objects: objects that the robot recognises by the first sensor, the targets first; None
            without any.
        tracking_noise: standard deviations of the tracker's positions [m] and velocities [m/s].
        period: control period [s].
        steps_per_scan: control periods between two scans.
        steps_per_field: control periods between two updates of the fields.
        localisation: how the robot finds its pose; None if it knows it.
        prior: map that the robot knew in advance, for one that finds its pose.
    """

    robot: Dynamics
    sensors: tuple[Sensor, ...]
    perception: Perception
    reachable: GridMask
    targets: Float[Array, "M 2"]
    objects: TrueObjects | None
    tracking_noise: Float[Array, "2"]
    period: Scalar
    steps_per_scan: Count
    steps_per_field: Count
    localisation: Localisation | None = None
    prior: OccupancyGrid | None = None

    def perceive(
        self, state: ExplorationState, truth: TrueWorld, moment: Moment, key: Key
    ) -> ExplorationState:
        """Scan and update the map at the sensing rate, derive the fields at the field rate.

        Args:
            state: state of the task before.
            truth: the true world at the moment.
            moment: time, step and observed state of the robot.
            key: random key of the step's measurements.
        """
        scanned = self.scanned(state, truth, moment, key)
        state, perception = scanned.state, self.perception
        belief = state.belief
        if perception.tracker is None:
            belief = dataclasses.replace(belief, obstacles=self._told(scanned, truth, moment, key))
        located = state.located
        here = scanned.pose if located is None else located.known.pose

        def derive(current: Belief) -> tuple[Belief]:
            if located is not None and self.localisation is not None:
                current = self.localisation.informed(located, current)
            return (perception.update_fields(current, here, self.since_fields),)

        (belief,) = when_due(self.are_fields_due(moment.step), scanned.is_placed, derive, (belief,))
        return state._replace(belief=belief)

    def _told(
        self, scanned: Scanned, truth: TrueWorld, moment: Moment, key: Key
    ) -> Obstacles | None:
        """Return the known obstacles after a measurement that is due."""
        state = scanned.state

        def track(known: Obstacles | None) -> tuple[Obstacles | None]:
            placed = None if state.located is None else state.located.known.pose
            return (self.tracked(known, truth, self.robot.pose(state.robot), key, placed),)

        (known,) = when_due(
            self.is_scan_due(moment.step), scanned.is_taken, track, (state.belief.obstacles,)
        )
        return known

    def scan_motion(self, state: ExplorationState, moment: Moment) -> ScanMotion | None:
        """Return the motion of the robot during a scan; None if no lidar turns.

        Args:
            state: state of the task.
            moment: time, step and observed state of the robot.
        """
        if state.control is None:
            return None
        # A guard may observe no pose. The velocity is that in the frame of the robot, at any pose.
        seen = moment.observed if moment.measured is None else moment.measured
        known = self.robot.with_pose(seen, jnp.zeros(3))
        true, known = (self.robot.twist(each, state.control) for each in (state.robot, known))
        return ScanMotion(true, known, self.period * self.steps_per_scan.astype(jnp.float32))

    def is_scan_due(self, step: Count) -> Flag:
        """Check whether scans are due at a step."""
        return step % self.steps_per_scan == 0

    def are_fields_due(self, step: Count) -> Flag:
        """Check whether an update of the fields is due at a step.

        The fields are derived one step before a strategic layer of the same rate runs: it reads
        fresh fields, and no single step has the cost of both.
        """
        every = self.steps_per_field
        return (step % every == every - 1) | (step == 0)

    @property
    def since_fields(self) -> Scalar:
        """Time between two updates of the fields [s]."""
        return self.period * self.steps_per_field.astype(jnp.float32)

    def tracked(
        self,
        known: Obstacles | None,
        truth: TrueWorld,
        pose: Pose,
        key: Key,
        known_pose: Pose | None = None,
    ) -> Obstacles | None:
        """Return the known obstacles after a measurement of those in sight; see
        `TrueWorld.tracked`.

        Args:
            known: obstacles as the robot knows them; None without any.
            truth: the true world at the moment.
            pose: true pose of the robot [m, m, rad].
            key: random key of the step's measurements.
            known_pose: pose from which the robot places them; the true one when absent.
        """
        return truth.tracked(known, self.sensors, pose, self.tracking_noise, key, known_pose)

    def scanned(
        self, state: ExplorationState, truth: TrueWorld, moment: Moment, key: Key
    ) -> Scanned:
        """Scan and update the map at the sensing rate, and predict the obstacles; see `perceive`.

        Args:
            state: state of the task before.
            truth: the true world at the moment.
            moment: time, step and observed state of the robot.
            key: random key of the step's measurements.
        """
        perception, period, step = self.perception, self.period, moment.step
        # The scan is taken at the true pose and integrated at the observed one, so that odometry
        # faults distort the map.
        pose = self.robot.pose(moment.observed)
        is_placed = jnp.isfinite(pose).all()
        is_due, guard = self.is_scan_due(step), moment.guard
        at = self.robot.pose(state.robot)

        def motion() -> ScanMotion | None:
            return self.scan_motion(state, moment)

        def sense(
            belief: Belief,
            sums: MapSums,
            _: MapProgress,
            is_seen: Array,
            __: Array,
            located: Located | None,
        ) -> tuple[Belief, MapSums, MapProgress, Array, Array, Located | None]:
            scans = truth.scans(self.sensors, at, key, motion()) if guard is None else taken()
            since = period * self.steps_per_scan.astype(jnp.float32)
            if located is None or self.localisation is None:
                belief, sums = observed(
                    *(perception, belief, sums, scans, pose, self.reachable, since, moment.time)
                )
            else:
                before = located.known
                located = self.localisation.scanned(located, scans, self.sensors, at)
                known_at = located.known.pose
                if not self.localisation.localiser.is_mapping:
                    is_elsewhere = ~before.is_known | is_jump(before.pose, known_at)
                    belief = self._reset(belief, is_elsewhere & located.known.is_known)
                belief, sums, located = self._mapped(
                    belief, sums, located, scans, is_placed & is_fit, at, since, moment.time
                )
            belief, is_seen = self._looked(belief, is_seen, truth, at, moment.time, key)
            ranges = jnp.concatenate([scan.ranges for scan in scans])
            progress = map_progress(sums, belief, self.reachable, moment.time)
            return belief, sums, progress, is_seen, ranges, located

        def examine(
            _: ScanPoints, __: Array, ___: Array
        ) -> tuple[ScanPoints, Float[Array, " B"], Bool[Array, " B"]]:
            assert guard is not None
            assert moment.measured is not None
            scans = truth.scans(self.sensors, at, key, motion())
            measured, expected = (
                self.robot.pose(each) for each in (moment.measured, guard.expected)
            )
            points = scan_points(
                *(state.belief, self.sensors, scans, measured, expected),
                *(moment.time, period * self.steps_per_scan.astype(jnp.float32)),
                perception.tracker,
            )
            ranges, is_return = (jnp.concatenate(each) for each in zip(*scans, strict=True))
            return points, ranges, is_return

        ranges, is_return = state.ranges, state.ranges > 0.0

        def taken() -> tuple[Scan, ...]:
            """Return the scans that were examined."""
            ends = list(itertools.accumulate(sensor.num_beams for sensor in self.sensors))
            split = (jnp.split(each, ends[:-1]) for each in (ranges, is_return))
            return tuple(itertools.starmap(Scan, zip(*split, strict=True)))

        points, is_fit = state.points, jnp.array(True)
        if guard is not None and state.points is not None:
            # A stopped robot brakes by its scans, which need no place in the map.
            found, ranges, is_return = when_due(
                is_due, ~moment.is_blind, examine, (state.points, ranges, is_return)
            )
            points = found
            # A scan that does not fit is not mapped. If only the scan speaks against a pose at
            # which the robot has stood for a while, it is the world that has changed.
            is_changed = (guard.stop == MISFIT) & (guard.since > RETRY_SECONDS)
            is_fit = (found.misfit <= MAX_MISFIT) | is_changed
            assert moment.measured is not None
            # The scan that ends a dropout is mapped at once.
            is_changed |= guard.stop == BLIND
            pose = jnp.where(is_changed, self.robot.pose(moment.measured), pose)
            is_placed = jnp.isfinite(pose).all()

        belief = state.belief
        # The tracker predicts the obstacles at every control period, also between scans.
        if belief.obstacles is not None:
            belief = dataclasses.replace(belief, obstacles=belief.obstacles.after(period))
        is_taken = is_placed & is_fit
        if self.localisation is not None:
            is_taken = is_taken | (not self.localisation.localiser.is_mapping)
        is_taken = ~moment.is_blind & is_taken
        belief, sums, progress, is_seen, mapped, located = when_due(
            is_due,
            is_taken,
            sense,
            (belief, state.sums, state.progress, state.is_seen, state.ranges, state.located),
        )
        state = state._replace(
            belief=belief,
            sums=sums,
            progress=progress,
            gain=state.gain.after(progress.coverage, period),
            is_seen=is_seen,
            ranges=mapped if guard is None else ranges,
            points=points,
            located=located,
        )
        return Scanned(state, pose, is_placed, is_taken)

    def _reset(self, belief: Belief, is_found: Flag) -> Belief:
        """Return the belief with the prior map if the robot has just found itself elsewhere: what
        it mapped before may be at a wrong place."""
        prior = self.prior
        assert prior is not None
        reset: Belief = jax.lax.cond(
            is_found, lambda each: self.perception.with_map(each, prior), lambda same: same, belief
        )
        return reset

    def _mapped(
        self,
        belief: Belief,
        sums: MapSums,
        located: Located,
        scans: tuple[Scan, ...],
        is_fit: Flag,
        pose: Pose,
        since: Scalar,
        time: Scalar,
    ) -> tuple[Belief, MapSums, Located]:
        """Return the belief with scans at the pose that the robot takes to be its own, and the
        judge's map with them at the true one."""
        localisation, perception = self.localisation, self.perception
        assert localisation is not None

        def add(belief: Belief, sums: MapSums, located: Located) -> tuple[Belief, MapSums, Located]:
            belief = perception.observe(belief, scans, located.known.pose, since, time)
            located, sums = localisation.judged(
                located, sums, perception, scans, pose, self.reachable, belief.grid
            )
            return belief, sums, located

        values = belief, sums, located
        if localisation.localiser.is_mapping:
            # It got the scan only because it fits.
            return add(*values)
        is_mapped = is_fit & located.known.is_known
        added: tuple[Belief, MapSums, Located] = jax.lax.cond(
            is_mapped, add, lambda *same: same, *values
        )
        return added

    def _looked(
        self,
        belief: Belief,
        is_seen: Bool[Array, " M"],
        truth: TrueWorld,
        pose: Pose,
        time: Scalar,
        key: Key,
    ) -> tuple[Belief, Bool[Array, " M"]]:
        """Return the belief with the classes of objects, and which targets were found.

        A target is found when it is seen, or if the robot recognises objects, when it was reported
        as one.
        """
        recognition, number = self.perception.recognition, self.targets.shape[0]
        if self.objects is not None and recognition is not None and belief.objects is not None:
            known = self.objects.looked_at(
                belief.objects, recognition, truth, self.sensors[0], pose, time, key
            )
            is_seen = jnp.isfinite(known.reported_at[:number, recognition.target])
            return dataclasses.replace(belief, objects=known), is_seen
        if number > 0:
            is_seen |= self.sensors[0].sees(truth.grid, pose, self.targets, truth.ground)
        return belief, is_seen
