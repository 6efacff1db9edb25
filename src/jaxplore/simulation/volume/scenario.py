"""The scenario of a quadrotor that explores an unknown volume."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, UInt8

from jaxplore import _checks, _kinds
from jaxplore._trees import HostOnly
from jaxplore._types import (
    ArrayLike,
    ControlVector,
    Count,
    Flag,
    Key,
    Scalar,
    StateVector,
    Vector,
)
from jaxplore._xla import on_device
from jaxplore.belief.gain import Gain
from jaxplore.belief.obstacles import Obstacles
from jaxplore.belief.volume import VolumePerception
from jaxplore.belief.volume_belief import VolumeBelief
from jaxplore.control.base import Controller, Info
from jaxplore.control.guard import ScanPoints
from jaxplore.dynamics.goal import Goal, Motion
from jaxplore.dynamics.quadrotor import Quadrotor, attitude_upwards, position_upwards
from jaxplore.geometry.level_motion import LevelPose, between, compose
from jaxplore.localisation.volume_localiser import VolumeLocaliser
from jaxplore.maps.datum import ORIGIN, Datum
from jaxplore.maps.voxel_grid import FREE_BELOW, OCCUPIED_ABOVE, VoxelGrid
from jaxplore.report.volume.data import FREE, OCCUPIED, UNKNOWN, VolumeFrame, VolumeMetrics
from jaxplore.report.volume.data import VolumeRecord as VolumeRecord
from jaxplore.report.volume.recording import VolumeRecording
from jaxplore.robot.clock import when_due, whole_steps
from jaxplore.robot.robot import Told
from jaxplore.robot.volume import (
    VolumeMeasurement,
    VolumeRobot,
    VolumeRobotState,
    VolumeSight,
    level_pose,
)
from jaxplore.sensing.volume import VolumeScan, VolumeSensor
from jaxplore.simulation.chunks import ChunkedRun
from jaxplore.simulation.disturbances import Place
from jaxplore.simulation.exploration.finish import default_give_up_after
from jaxplore.simulation.exploration.frames import part_frames
from jaxplore.simulation.exploration.motion import move_parts, update_parts
from jaxplore.simulation.exploration.odometer import Odometer
from jaxplore.simulation.exploration.part_truth import (
    Drive,
    PartTruth,
    Site,
    Vantage,
    as_truths,
    init_truths,
    what_moves,
)
from jaxplore.simulation.exploration.recording import part_reports
from jaxplore.simulation.exploration.scenario import TOLD_NOISE
from jaxplore.simulation.scenario import Inspect, Scenario
from jaxplore.simulation.state import Moment
from jaxplore.simulation.volume.checks import check_reachable, show_place
from jaxplore.simulation.volume.observable import find_fitting_places, observable
from jaxplore.simulation.volume.people import Cylinders
from jaxplore.simulation.volume.true_volume import TrueVolume

KEEP_OUT = "keep_out"
"""Name of the part of boxes that the robot must not enter."""
TOUCHING = 1.0
"""Reach of the box in which the distance to solid voxels is examined [m]."""


class TrueFlight(NamedTuple):
    """Where a robot that does not know its pose was, and what its scans give there.

    `reckoned` is its pose by the odometry alone, and `odometer` has the errors of that.
    `reference` is the map that the scans give at the true poses.
    """

    reckoned: LevelPose
    odometer: Odometer
    reference: VoxelGrid


class VolumeState(NamedTuple):
    """State of the exploration of a volume: what is true, what the robot knows, what is judged.

    `own` is what the robot knows. `num_known` observable voxels are known to be free, and `gain` is
    the last rise of their share. `truths` are the states of what is true beside the map, by name.
    `motion` is that of the last step; None without a goal. `flight` is where the robot was; None if
    it knows its pose.
    """

    robot: StateVector
    own: VolumeRobotState
    num_known: Count
    gain: Gain
    truths: dict[str, Any]
    motion: Motion | None = None
    flight: TrueFlight | None = None

    @property
    def belief(self) -> VolumeBelief:
        """What the robot believes."""
        return self.own.belief


class VolumeScenario(Scenario):
    """Exploration of an unknown volume by a quadrotor with depth cameras or lidars.

    The volume has z up, the model of the quadrotor has z down (NED): a height is `-z` of the state.
    Voxels that the world does not know to be free are solid. *Observable* are the free voxels that
    a level sensor sees from some place where the robot fits and that is connected with the start;
    coverage is the share of them that the robot's map knows to be free. The exploration is finished
    at the target coverage, and given up when the coverage has not risen by 0.1 % for
    `give_up_after`: what is left cannot be seen from where the robot fits. A truth
    that ends the task, such as `jaxplore.parts.Targets`, takes the place of the coverage, and the
    exploration is not given up then. With a goal the robot flies
    there, through what it does not know as well, and the run is finished when it has come to rest
    there (`Goal`); it is not given up.

    With a localiser the robot starts at a known pose, and then knows its odometry and its scans
    alone: it flies and maps by its estimate. Coverage is then that of the map that its scans give
    at their true poses.

    Args:
        world: the true volume, hidden from the robot.
        robot: true model of the robot.
        sensors: one sensor or several; the information is that of the first one.
        start: start (x, y, z, yaw) with z up [m, m, m, rad], level and at rest.
        perception: update of the belief; made for the sensors and the world when absent.
        localiser: how the robot finds its pose, whose `odometry` is the true one as well; it knows
            its pose when absent.
        control_rate: rate of the controls [Hz].
        sensing_rate: rate of scans and map updates [Hz]; a whole fraction of the control rate.
        field_rate: rate of updates of the information and guidance [Hz], likewise.
        target_coverage: share of the observable volume at which the exploration is finished.
        give_up_after: time without a rise of the coverage after which the exploration is given up
            [s]; when absent a minute and the time of a flight along the diagonal of the volume and
            back at 1 m/s.
        goal: goal, or its position (x, y, z) with z up [m]; none when absent.
        truths: what is true of the robot's parts (`jaxplore.parts`), or of the world beside the
            map: `jaxplore.MovingObstacles`, here upright cylinders from the lower face of the
            volume to 1.8 m above it. The robot is told of those in sight, and the map keeps nothing
            of them.
        tracking_noise: standard deviations of positions [m] and velocities [m/s] that the robot is
            told.
        datum: point of a file's coordinates to which all positions here are relative; frames and
            recordings are in those of the file.

    Raises:
        ValueError: a part of another class, a start that is off the volume or so close to a solid
            voxel that the robot touches it, a rate that is no whole fraction, a coverage outside
            (0, 1], a window of the perception that is too small, targets beside a goal, a goal
            where the robot cannot get from its start, a perception made for another goal, a start
            or a goal in keep-out boxes; a truth of a part that the robot does not have, or that
            cannot be in this volume; a localiser beside a window of the perception.
    """

    frame_type = VolumeFrame
    metrics_type = VolumeMetrics

    world: VoxelGrid
    robot: Quadrotor
    sensors: tuple[VolumeSensor, ...]
    perception: VolumePerception
    localiser: VolumeLocaliser | None
    start: StateVector
    control_period: Scalar
    steps_per_scan: Count
    steps_per_field: Count
    target_coverage: Scalar
    give_up_after: Scalar
    observable: Bool[Array, "D H W"]
    num_observable: Scalar
    goal: Goal | None
    truths: tuple[PartTruth, ...]
    tracking_noise: Float[Array, "2"]
    reach: int = eqx.field(static=True)

    @_kinds.check_arguments
    def __init__(
        self,
        world: VoxelGrid,
        robot: Quadrotor,
        sensors: VolumeSensor | Sequence[VolumeSensor],
        start: Vector,
        *,
        perception: VolumePerception | None = None,
        localiser: VolumeLocaliser | None = None,
        control_rate: float = 20.0,
        sensing_rate: float = 10.0,
        field_rate: float = 5.0,
        target_coverage: ArrayLike = 0.95,
        give_up_after: ArrayLike | None = None,
        goal: Vector | Goal | None = None,
        truths: Sequence[PartTruth] = (),
        tracking_noise: Vector = TOLD_NOISE,
        datum: Datum = ORIGIN,
    ) -> None:
        self.tracking_noise = _checks.vector("tracking_noise", tracking_noise, 2, at_least=0.0)
        self.placed = HostOnly(datum)
        several = isinstance(sensors, Sequence)
        given = tuple(sensors) if isinstance(sensors, Sequence) else (sensors,)
        for each in given:
            _kinds.instance("sensors", each, VolumeSensor)
        if several and not given:
            raise ValueError("sensors is empty; accepted: one sensor or more")
        self.world, self.robot, self.sensors = world, robot, given
        place = np.asarray(_checks.vector("start", start, 4), np.float64)
        radius = float(robot.radius)
        solid = ~np.asarray(world.is_free)
        side = world.resolution
        begin = _start_voxel(solid, world, place, radius, datum)
        barred = None if perception is None else perception.barred_voxels(world)
        is_barred = np.zeros(world.shape, bool) if barred is None else np.asarray(barred)
        if is_barred[tuple(np.floor(begin).astype(int))]:
            raise ValueError(
                f"start is {show_place(place, datum)}, in a keep-out box; accepted: outside of all"
            )
        places = find_fitting_places(solid | is_barred, begin, radius / side)
        views = [(each.max_range / side, *each.elevations) for each in given]
        seen = observable(solid, places, views)
        counted = seen & ~is_barred
        self.observable = on_device(counted)
        self.num_observable = on_device(np.asarray(np.count_nonzero(counted), np.float32))
        self.start = robot.at_pose(place[0], place[1], place[3], -place[2])
        self.goal = None if goal is None else Goal.check(goal, 3)
        if self.goal is not None:
            has_targets = any(isinstance(each, PartTruth) and each.ends_task for each in truths)
            _check_goal(self.goal, world, places, is_barred, radius, datum, has_targets=has_targets)
        perception = _check_perception(perception, given, world, robot, self.goal)
        perception.window_shape(world.shape, side)
        self.perception, self.localiser = perception, localiser
        if localiser is not None and perception.extents is not None:
            raise ValueError(
                f"window is {list(perception.extents)} beside a localiser, which finds the pose on "
                "the whole map; accepted: one of them"
            )
        given_truths = as_truths(truths, perception.parts)
        site = Site(world, robot, perception, place, given_truths, places, datum, seen)
        self.truths = tuple(each.bind(site) for each in given_truths)
        rate = _checks.number("control_rate", control_rate, above=0.0)
        self.control_period = on_device(np.asarray(1.0 / rate, np.float32))
        self.steps_per_scan = whole_steps("sensing_rate", sensing_rate, rate)
        self.steps_per_field = whole_steps("field_rate", field_rate, rate)
        self.target_coverage = _checks.scalar(
            "target_coverage", target_coverage, above=0.0, at_most=1.0
        )
        if give_up_after is None:
            give_up_after = default_give_up_after(world, robot)
        self.give_up_after = _checks.scalar("give_up_after", give_up_after, above=0.0)
        self.reach = math.ceil(max(TOUCHING, 2.0 * radius) / world.resolution)

    @property
    def steps_per_measurement(self) -> int:
        """Control periods between two scans."""
        return int(self.steps_per_scan)

    @property
    def cell_size(self) -> float:
        """Side of a voxel [m]."""
        return self.world.resolution

    def init(self, key: Key | None) -> tuple[VolumeState, VolumeBelief]:
        """Return the initial state, and the belief that knows where the robot is to be free."""
        blank = eqx.tree_at(
            lambda each: each.log_odds, self.world, jnp.zeros_like(self.world.log_odds)
        )
        belief = self.perception.init(blank, position_upwards(self.start))
        known = jnp.sum(belief.whole.is_free & self.observable, dtype=jnp.int32)
        gain = Gain(known.astype(jnp.float32) / self.num_observable, jnp.zeros(()))
        begin = level_pose(self.robot, self.start)
        known_of_parts = {
            each.name: own
            for each in self.truths
            if (own := each.init_part(self.perception.part_named(each.name), begin)) is not None
        }
        belief = belief.with_parts(known_of_parts)
        nothing, truths = jnp.zeros(()), init_truths(self.truths, begin, key)
        motion = None if self.goal is None else Motion(nothing, nothing)
        moving = what_moves(self.truths, truths, nothing)
        if moving is not None:
            obstacles = Obstacles.unseen(moving.radius)
            belief = dataclasses.replace(belief, obstacles=obstacles)
        own = self.onboard.init(belief, self.start, is_guarded=self.guard is not None)
        flight = None
        if self.localiser is not None:
            odometer = Odometer.at_start(self.localiser.odometry, key)
            flight = TrueFlight(begin, odometer, belief.grid)
        return VolumeState(self.start, own, known, gain, truths, motion, flight), belief

    def measure_state(self, state: VolumeState) -> StateVector:
        """Return the state (nx,) that the robot takes to be its own."""
        return self.onboard.observe_state(state.own, state.robot)

    @property
    def onboard(self) -> VolumeRobot:
        """What runs on board of the robot, which knows no truth."""
        return VolumeRobot(self.robot, self.sensors, self.perception, self.localiser)

    def scan_points(self, state: VolumeState, moment: Moment | None = None) -> ScanPoints:
        """Return the newest scan for the guard, with the room of the map."""
        points = state.own.points
        if points is None:
            return ScanPoints.blank(1)
        if moment is None:
            return points._replace(room=state.belief.clearance)
        comes = (moment.step % self.steps_per_scan == 0) & ~moment.is_blind
        return points._replace(time=jnp.where(comes, moment.time, points.time))

    def perceive(
        self, state: VolumeState, moment: Moment, key: Key
    ) -> tuple[VolumeState, VolumeBelief]:
        """Scan and update the map at the sensing rate, derive the fields at the field rate."""
        onboard, measured = self.onboard, self.measure(state, moment, key)
        own, sight = onboard.examine(state.own, measured)
        own, sight = onboard.locate(own, measured, sight)
        own = onboard.track_told(own, measured)
        num_known, flight = state.num_known, state.flight
        if flight is None:
            before, own = self._count_before(own, measured, sight)
            own = onboard.map_scans(own, measured, sight)
            (after,) = self._count_known(own.belief, measured, sight)
            num_known = num_known + after - before
        else:
            own = onboard.map_scans(own, measured, sight)
            flight, num_known = self._map_truly(state, flight, measured, sight)
        own = onboard.update_fields(own, measured, sight)
        state = state._replace(
            own=own,
            num_known=num_known,
            flight=flight,
            truths=self._judge_parts(state, own, moment, measured),
        )
        errand = own.belief.errand
        is_sent = None if errand is None else errand.is_due
        gain = state.gain.update(self.coverage(state), self.control_period, is_sent)
        return state._replace(gain=gain), own.belief

    def measure(self, state: VolumeState, moment: Moment, key: Key) -> VolumeMeasurement:
        """Return what the robot measures in the true volume.

        Odometry faults are in the observed state of the moment: scans are taken in the true state
        and mapped in the observed one, so they distort the map.
        """
        truth, robot, sensors = (
            self.truth(state, moment.step, moment.time),
            state.robot,
            self.sensors,
        )

        def take() -> tuple[tuple[VolumeScan, ...], Told | None, dict[str, Any]]:
            told = truth.tell(sensors, robot, self.tracking_noise, key)
            if told is not None and self.localiser is not None:
                told = told._replace(pose=self.robot.pose(robot))
            given = truth, sensors, level_pose(self.robot, robot), key
            looks = {
                each.name: each.measure(
                    self.perception.part_named(each.name), state.truths.get(each.name), *given
                )
                for each in self.truths
            }
            looks = {name: look for name, look in looks.items() if look is not None}
            return truth.scans(sensors, robot, key), told, looks

        is_due = moment.step % self.steps_per_scan == 0
        # What is not due is not read.
        blank = jax.tree.map(
            lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), eqx.filter_eval_shape(take)
        )
        scans, told, looks = when_due(is_due, ~moment.is_blind, lambda *_: take(), blank)
        period = self.control_period
        return VolumeMeasurement(
            moment.observed if moment.measured is None else moment.measured,
            moment.is_blind,
            scans,
            is_due,
            period * self.steps_per_scan.astype(jnp.float32),
            moment.step % self.steps_per_field == 0,
            period * self.steps_per_field.astype(jnp.float32),
            period,
            moment.time,
            moment.guard,
            told,
            looks,
        )

    def _count_known(
        self, belief: VolumeBelief, measured: VolumeMeasurement, sight: VolumeSight
    ) -> tuple[Count]:
        """Count the observable voxels that are known to be free, of those that scans may change, if
        they are taken."""

        def count(_: Count) -> tuple[Count]:
            window = self.perception.scan_window(belief.grid, *sight.place)
            wanted = belief.place_window(window).read(self.observable)
            is_known = (window.read(belief.grid.log_odds) < FREE_BELOW) & wanted
            return (jnp.sum(is_known, dtype=jnp.int32),)

        nothing = (jnp.zeros((), jnp.int32),)
        return when_due(measured.is_scan_due, sight.is_taken, count, nothing)

    def _count_before(
        self, own: VolumeRobotState, measured: VolumeMeasurement, sight: VolumeSight
    ) -> tuple[Count, VolumeRobotState]:
        """Count the known voxels before the robot maps its scans.

        What the robot knows is returned as well, and depends on the count: nothing reads the old
        map any more, so it is changed in place. XLA would copy it otherwise.
        """
        (count,) = self._count_known(own.belief, measured, sight)
        barrier = jax.lax.optimization_barrier
        count, log_odds = barrier((count, own.belief.grid.log_odds))  # type: ignore[no-untyped-call]
        belief = eqx.tree_at(lambda each: each.grid.log_odds, own.belief, log_odds)
        return count, own._replace(belief=belief)

    def _map_truly(
        self,
        state: VolumeState,
        flight: TrueFlight,
        measured: VolumeMeasurement,
        sight: VolumeSight,
    ) -> tuple[TrueFlight, Count]:
        """Return the map that the scans give at the true poses, and how many observable voxels are
        known to be free in it."""
        place = position_upwards(state.robot), attitude_upwards(state.robot)

        def add(reference: VoxelGrid, known: Count) -> tuple[VoxelGrid, Count]:
            window = self.perception.scan_window(reference, *place)
            wanted, before = window.read(self.observable), window.read(reference.log_odds)
            model = self.perception.sensor_model
            for sensor, scan in zip(self.sensors, measured.scans, strict=True):
                reference = sensor.update(reference, *place, scan, model, window)
            now, then = (
                jnp.sum((each < FREE_BELOW) & wanted, dtype=jnp.int32)
                for each in (window.read(reference.log_odds), before)
            )
            return reference, known + now - then

        given = flight.reference, state.num_known
        reference, known = when_due(measured.is_scan_due, sight.is_taken, add, given)
        return flight._replace(reference=reference), known

    def _judge_parts(
        self,
        state: VolumeState,
        own: VolumeRobotState,
        moment: Moment,
        measured: VolumeMeasurement,
    ) -> dict[str, Any]:
        """Return the states of the truths of parts after scans, given what the robot knows."""
        judging = [each for each in self.truths if each.is_judging]
        if not judging:
            return state.truths
        truth, known = self.truth(state, moment.step, moment.time), own.belief.parts
        vantage = Vantage(truth, self.sensors, state.robot, self.perception.parts, known)

        def judge(before: dict[str, Any]) -> tuple[dict[str, Any]]:
            said = {
                each.name: each.judge(
                    each.witness(before[each.name], vantage),
                    known.get(each.name),
                    *(self.observable, self.num_observable, moment.time),
                )
                for each in judging
            }
            return ({**before, **said},)

        return when_due(measured.is_scan_due, ~moment.is_blind, judge, (state.truths,))[0]

    def advance(
        self, state: VolumeState, control: ControlVector, moment: Moment, info: Info
    ) -> tuple[VolumeState, VolumeRecord]:
        """Move the robot and record the step.

        If the move would touch something solid, the robot stops instead, and the step counts as a
        collision.
        """
        moved = self.robot.step(state.robot, control, self.control_period)
        # People move during the step as well, so contact is with where they are at its end.
        truth = self.truth(state, moment.step, moment.time + self.control_period)
        drive = Drive(self.robot, state.robot, moved, control, truth, self.control_period)
        drive = move_parts(self.truths, state.truths, drive)
        after, is_collision = truth.check_move(self.robot, state.robot, drive.after, self.reach)
        truths, parts = update_parts(self.truths, state.truths, drive._replace(after=after))
        record = VolumeRecord(
            state=after,
            control=control,
            coverage=self.coverage(state),
            clearance=truth.clearance(self.robot, after, self.reach),
            is_collision=is_collision,
            effective_sample_size=info.effective_sample_size,
            is_finite=info.is_finite,
            is_untraversable=self._is_barred(after),
            stop=moment.stop,
            parts=parts,
        )
        state, record = self._follow_odometry(state, record, moment.step)
        if self.goal is not None:
            motion = Motion.between(self.robot, state.robot, after, self.control_period)
            state = state._replace(motion=motion)
        return state._replace(robot=after, truths=truths), record

    def _follow_odometry(
        self, state: VolumeState, record: VolumeRecord, step: Count
    ) -> tuple[VolumeState, VolumeRecord]:
        """Let a robot that finds its pose measure a step to the true state of a record."""
        flight, localiser = state.flight, self.localiser
        if flight is None or localiser is None:
            return state, record
        poses = level_pose(self.robot, state.robot), level_pose(self.robot, record.state)
        motion, odometer = flight.odometer.measure_motion(
            localiser.odometry, between(*poses), step, self.control_period
        )
        own = self.onboard.predict(state.own, motion)
        assert own.place is not None
        flight = flight._replace(reckoned=compose(flight.reckoned, motion), odometer=odometer)
        record = record._replace(estimate=own.place.pose, reckoned=flight.reckoned)
        return state._replace(own=own, flight=flight), record

    def is_unfinished(self, state: VolumeState) -> Flag:
        """Check whether the exploration is neither finished nor given up, and nothing that is true
        of a part ends it."""
        is_going_on = self._is_unfinished(state)
        for each in self.truths:
            is_over = each.is_over(state.truths.get(each.name))
            is_going_on = is_going_on if is_over is None else is_going_on & ~is_over
        return is_going_on

    def _is_unfinished(self, state: VolumeState) -> Flag:
        if self.goal is not None:
            return ~self._is_there(self.goal, state)
        told = [each.is_finished(state.truths.get(each.name)) for each in self.truths]
        ends = [each for each in told if each is not None]
        if ends:
            return ~jnp.stack(ends).all()
        return (self.coverage(state) < self.target_coverage) & ~self.is_given_up(state)

    def is_given_up(self, state: VolumeState) -> Flag:
        """Check whether the coverage has not risen for `give_up_after`, below its target."""
        if self.goal is not None or any(each.ends_task for each in self.truths):
            return jnp.array(False)
        is_below = self.coverage(state) < self.target_coverage
        return is_below & (state.gain.since >= self.give_up_after)

    def progress(self, state: VolumeState) -> tuple[float, str]:
        """Return the share of the target coverage, and the coverage in words."""
        coverage = float(self.coverage(state))
        if self.goal is not None:
            place = np.asarray(position_upwards(state.robot))
            away = float(np.linalg.norm(place - np.asarray(self.goal.position)))
            first = np.asarray(position_upwards(self.start) - self.goal.position)
            share = 1.0 - away / max(1e-6, float(np.linalg.norm(first)))
            return min(1.0, max(0.0, share)), f"goal {away:5.1f} m away"
        return min(1.0, coverage / float(self.target_coverage)), f"coverage {coverage:6.1%}"

    def coverage(self, state: VolumeState) -> Scalar:
        """Return the share of the observable volume that is known to be free."""
        return state.num_known.astype(jnp.float32) / self.num_observable

    @property
    def place(self) -> Place:
        """What disturbances are checked by."""
        return Place(self.robot, self.datum, self.world)

    def truth(self, state: VolumeState, step: Count, time: Scalar) -> TrueVolume:
        """Return the true volume at a time since the start [s], with the walls that have appeared
        before a step."""
        elapsed = self.control_period * step.astype(jnp.float32)
        world = self.disturbances.world(self.world, elapsed)
        moving = what_moves(self.truths, state.truths, time)
        people = None if moving is None else Cylinders.of(moving, self.world)
        return TrueVolume(world, people)

    def frame(
        self, state: VolumeState, moment: Moment, inspect: Inspect | None, key: Key
    ) -> dict[str, Any]:
        """Return two slices of the map through the robot, its occupied voxels, and the plan."""
        grid = state.belief.whole
        voxel = jnp.floor(grid.to_grid(position_upwards(state.robot))).astype(jnp.int32)
        depth, height, _ = grid.shape
        layer, row = jnp.clip(voxel[0], 0, depth - 1), jnp.clip(voxel[1], 0, height - 1)
        plan, moving = jnp.zeros((0, 3)), what_moves(self.truths, state.truths, moment.time)
        if inspect is not None:
            states = inspect(moment.observed, state.belief).nominal.states
            plan = jax.vmap(position_upwards)(states)
        return {
            "state": state.robot,
            "level": voxel_states(grid.log_odds[layer]),
            "upright": voxel_states(grid.log_odds[:, row]),
            "voxels": jnp.packbits(grid.is_occupied.reshape(-1)),
            "plan": plan,
            "parts": part_frames(self.truths, state.belief.parts, state.truths),
            "movers": jnp.zeros((0, 3)) if moving is None else moving.discs,
        }

    def recording(
        self,
        controller: Controller | None,
        before: VolumeState,
        run: ChunkedRun[Any, VolumeRecord, VolumeFrame],
    ) -> VolumeRecording:
        """Make the recording of a run."""
        last = run.state.task
        local = VolumeRecording(
            **run.common(self.period),
            world=np.asarray(self.world.is_occupied),
            belief=np.asarray(voxel_states(run.state.task.belief.whole.log_odds)),
            observable=np.asarray(self.observable),
            resolution=self.world.resolution,
            origin=np.asarray(self.world.origin, np.float64),
            start=np.asarray(self.start),
            state_names=self.robot.state_names,
            initial_coverage=float(self.coverage(before)),
            target_coverage=float(self.target_coverage),
            robot_radius=float(self.robot.radius),
            goal=None if self.goal is None else np.asarray(self.goal.position),
            is_at_goal=self.goal is not None and not bool(self._is_unfinished(last)),
            parts=part_reports(
                *(self.truths, self.perception, last.belief.parts, last.truths, last.belief.whole)
            ),
            boxes=np.zeros((0, 6)) if self.keep_out is None else np.asarray(self.keep_out.boxes),
            given_up_step=run.num_steps if bool(self.is_given_up(run.state.task)) else None,
        )
        return local.move(self.datum.offset)

    @property
    def metric_groups(self) -> tuple[str, ...]:
        """Names of the truths of parts, whose metrics are groups of their own."""
        return tuple(each.name for each in self.truths)

    @property
    def keep_out(self) -> Any:
        """The part of the boxes that the robot must not enter; None without any."""
        return next((part for part in self.perception.parts if part.name == KEEP_OUT), None)

    def _is_barred(self, state: StateVector) -> Flag | None:
        """Check whether a part of the robot is in a keep-out box; None without any."""
        boxes = self.keep_out
        if boxes is None:
            return None
        is_barred: Flag = boxes.distance(position_upwards(state)) < self.robot.radius
        return is_barred

    def _is_there(self, check: Goal, state: VolumeState) -> Flag:
        """Check whether the robot has come to rest at its goal."""
        assert state.motion is not None
        # A robot that finds its pose is where it takes itself to be.
        pose = level_pose(self.robot, self.measure_state(state))
        there: Flag = check.is_reached(pose, state.motion)
        return there


def voxel_states(log_odds: Float[Array, "*N"]) -> UInt8[Array, "*N"]:
    """Return the state of each voxel: `UNKNOWN`, `FREE` or `OCCUPIED`."""
    solid = jnp.where(log_odds > OCCUPIED_ABOVE, OCCUPIED, UNKNOWN)
    kinds = jnp.where(log_odds < FREE_BELOW, FREE, solid)
    return kinds.astype(jnp.uint8)


def _check_goal(
    check: Goal,
    world: VoxelGrid,
    places: np.ndarray,
    is_barred: np.ndarray,
    radius: float,
    datum: Datum,
    *,
    has_targets: bool,
) -> None:
    """Check that a robot that knows the world would come to rest at a goal (`resting_place`).

    `places` (D, H, W) are the voxels at whose centres it can get, and `radius` is its own [m].
    """
    at = show_place(np.asarray(check.position), datum)
    if check.max_unknown is not None:
        raise ValueError(
            f"max_unknown of goal is {float(check.max_unknown):g}; accepted in a volume: none"
        )
    if has_targets:
        raise ValueError(f"goal is {at} beside targets; accepted: one of them")
    voxel = np.asarray(jnp.floor(world.to_grid(check.position))).astype(int)
    if ((voxel >= 0) & (voxel < world.shape)).all() and is_barred[tuple(voxel)]:
        raise ValueError(f"goal is {at}, in a keep-out box; accepted: outside of all")
    place = np.asarray(check.position)
    solid = ~np.asarray(world.is_free) | is_barred
    check_reachable("goal", place, world, solid, places, radius, float(check.radius), datum)


def _check_perception(
    perception: VolumePerception | None,
    sensors: tuple[VolumeSensor, ...],
    world: VoxelGrid,
    robot: Quadrotor,
    check: Goal | None,
) -> VolumePerception:
    """Check that a perception has the goal of a scenario, or make one when absent."""
    goal, heading = (None, None) if check is None else (check.position, check.heading)
    if perception is None:
        ends = {} if check is None else {"goal_radius": check.radius}
        return VolumePerception(
            sensors, world.resolution, robot.radius, goal=goal, goal_heading=heading, **ends
        )
    pairs = [("goal", perception.goal, goal), ("goal_heading", perception.goal_heading, heading)]
    if check is not None:
        pairs.append(("goal_radius", perception.goal_radius, check.radius))
    for name, own, wanted in pairs:
        values = [None if each is None else each.tolist() for each in (own, wanted)]
        if values[0] != values[1]:
            raise ValueError(
                f"perception has the {name} {values[0]}; accepted: the scenario's, {values[1]}"
            )
    return perception


def _start_voxel(
    solid: np.ndarray, world: VoxelGrid, start: np.ndarray, radius: float, datum: Datum
) -> np.ndarray:
    """Return the start in grid coordinates (z, y, x) [voxels].

    Raises:
        ValueError: a start off the volume or too close to a solid voxel.
    """
    side, origin = world.resolution, np.asarray(world.origin, np.float64)
    grid = ((start[:3] - origin) / side)[::-1]
    voxel = np.floor(grid).astype(int)
    where = f"start is {show_place(start, datum)}"
    if not ((voxel >= 0) & (voxel < solid.shape)).all():
        ends = origin + np.array(solid.shape[::-1]) * side
        lows, highs = datum.round_to_map(origin), datum.round_to_map(ends)
        x, y, z = (f"{low:.10g} to {high:.10g}" for low, high in zip(lows, highs, strict=True))
        raise ValueError(f"{where}, off the volume; accepted: x {x}, y {y}, z {z}")
    reach = math.ceil(radius / side) + 1
    low, high = np.maximum(voxel - reach, 0), np.minimum(voxel + reach + 1, solid.shape)
    near = np.argwhere(solid[tuple(slice(a, b) for a, b in zip(low, high, strict=True))]) + low
    gap = np.maximum(np.maximum(near - grid, grid - near - 1.0), 0.0)
    rim = np.minimum(grid, solid.shape - grid).min()
    if min(rim, np.linalg.norm(gap, axis=1).min(initial=np.inf)) * side < radius:
        raise ValueError(
            f"{where}, within {radius:g} m of a solid voxel; accepted: free space of the robot's "
            "radius"
        )
    return np.asarray(grid)
