"""The exploration scenario: a robot with sensors in an unknown world."""

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplore import _checks, _kinds
from jaxplore._describe import describe_fields
from jaxplore._trees import HostOnly, with_field
from jaxplore._types import (
    ArrayLike,
    ControlVector,
    Count,
    Flag,
    GridMask,
    Key,
    Position,
    Rows,
    Scalar,
    StateVector,
    Vector,
)
from jaxplore._xla import on_device
from jaxplore.belief.belief import Belief
from jaxplore.belief.perception import Perception
from jaxplore.belief.perception_checks import as_sensors
from jaxplore.belief.tracks import ObstacleTracker
from jaxplore.control.base import Controller, Info
from jaxplore.control.guard import ScanPoints
from jaxplore.dynamics.base import Dynamics
from jaxplore.dynamics.goal_check import (
    GOAL_RADIUS,
    GOAL_SPEED,
    GOAL_TOLERANCE,
    GoalCheck,
    Motion,
)
from jaxplore.maps.collision import clearance_reach
from jaxplore.maps.datum import ORIGIN, Datum
from jaxplore.maps.ground import Ground
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.maps.terrain import TerrainMap
from jaxplore.report.exploration.data import ExplorationFrame, ExplorationRecord
from jaxplore.report.exploration.metrics import ExplorationMetrics
from jaxplore.report.exploration.recording import ExplorationRecording
from jaxplore.report.recording import Frame
from jaxplore.robot.clock import whole_steps
from jaxplore.robot.localisation import Localisation, correct_state
from jaxplore.robot.robot import Robot
from jaxplore.sensing.base import Sensor
from jaxplore.sensing.lidar import is_any_turning
from jaxplore.simulation.chunks import ChunkedRun
from jaxplore.simulation.disturbances import Place
from jaxplore.simulation.exploration import checks
from jaxplore.simulation.exploration.agent_view import ExplorationView
from jaxplore.simulation.exploration.finish import (
    NEVER,
    TARGETS,
    choose_target,
    default_give_up_after,
    default_objective,
    has_coverage_target,
    is_finished,
)
from jaxplore.simulation.exploration.frames import crop_frame, frame_arrays
from jaxplore.simulation.exploration.instruments import Instruments
from jaxplore.simulation.exploration.judge import Judge, thin
from jaxplore.simulation.exploration.map_arrays import MapArrays
from jaxplore.simulation.exploration.motion import move
from jaxplore.simulation.exploration.moving_discs import MovingDiscs
from jaxplore.simulation.exploration.odometer import Odometer, estimator_key
from jaxplore.simulation.exploration.part_truth import (
    PartTruth,
    Site,
    as_truths,
    init_truths,
    what_moves,
)
from jaxplore.simulation.exploration.progress import MapSums
from jaxplore.simulation.exploration.rates import Rates
from jaxplore.simulation.exploration.reachability import drivable_cells, with_closed
from jaxplore.simulation.exploration.recording import make_recording, part_reports
from jaxplore.simulation.exploration.state import ExplorationState, Sensed, initial_state
from jaxplore.simulation.exploration.true_world import TrueWorld
from jaxplore.simulation.robot_fields import robot_fields
from jaxplore.simulation.scenario import Inspect, Scenario
from jaxplore.simulation.state import LoopState, Moment

TARGET_COVERAGE = 0.99
"""Share at which an exploration ends that is not ended by its robot."""
TOLD_NOISE = (0.05, 0.1)
"""Default of `tracking_noise` where the robot is told."""


class ExplorationScenario(Scenario):
    """Exploration of an unknown world by a robot with sensors.

    When it is finished depends on the task:

    - By default, with the target `information`: when the robot has nothing left to learn by its own
      map, as in the node. No place with enough information, see `Perception.min_information`, has
      been reachable for 3 s.
    - With a target coverage: at this coverage, which the true map tells and the robot does not
      know. It is for comparisons.
    - With the target `walls`: when of the cells around its known free space a share
      `target_coverage` are known walls. Where no place is worth a visit any more it goes on for
      `give_up_after`, because little information may be a piece of wall.
    - With a goal: when the robot has reached it (`GoalCheck`), with less than `max_unknown` of the
      map unknown, at the target coverage, or with nothing left to learn. With a goal apart (see
      `Perception`) the robot drives to the goal first and explores on the way.
    - With `targets`: when the first sensor has seen all of them, or recognised all of them if the
      perception has a `Recognition`.
    - With a watch, without target coverage, goal and targets: never before the time limit.

    If only the map counts, the exploration is given up when the coverage, or the share of walls
    that is the target, has not risen by 0.1 % for `give_up_after`: what is left cannot be seen from
    where the robot fits, or is not worth a drive. The run then ends without being finished.

    Cells that the world does not know to be free are solid. *Reachable* are the free cells that the
    centre of the robot's disc can reach from the start. Coverage is the share of them that the
    robot's map knows to be free.

    Cells that the robot must not enter (`jaxplore.parts.KeepOut`) do not count as reachable, and
    count as untraversable.

    The robot knows the ground of a terrain map, but not the obstacles on it. Untraversable cells do
    not stop the robot: it can enter them, which is recorded.

    What is true of the robot's parts, and is not known to it, are `truths`, such as
    `jaxplore.parts.Wheels` for a vehicle that can tip over. A part has one by default.

    Args:
        world: the true map, hidden from the robot; with the ground if it is a terrain map.
        robot: true model of the robot.
        sensors: one sensor or several; the first is the primary one, see `Perception`.
        start: start pose (x, y, yaw) [m, m, rad], at rest.
        perception: update of the belief from scans; made for the sensors and the world when absent.
        control_rate: rate of the controls [Hz].
        sensing_rate: rate of scans and map updates [Hz]; a whole fraction of the control rate.
        field_rate: rate of updates of the information and guidance fields [Hz]; a whole fraction of
            the control rate. The first update is at the first step, the others at the end of each
            period.
        target: what the exploration ends by, `coverage`, `information`, `walls` or `never`; by
            default the coverage if there is a target, else the information, and on a patrol
            nothing.
        target_coverage: share of the reachable cells, or of the walls, at which exploration is
            finished; none when absent.
        give_up_after: time without a rise of the coverage after which the exploration is given up
            [s]; when absent a minute and the time of a drive along the diagonal of the map and
            back.
        prior: map that the robot knows in advance, with the cells of the world; nothing when
            absent.
        goal: goal position (x, y) [m]; none when absent.
        goal_radius: distance within which the goal is reached by a robot at rest [m].
        goal_heading: heading at the goal [rad]; any when absent.
        goal_tolerance: greatest error of the heading at the goal [rad].
        goal_speed: speed up to which the robot is at rest at the goal [m/s].
        max_unknown: share of cells with `4 p (1 - p) > 1/2` below which the map is explored; when
                absent 0.05, or 1 for a goal apart, which then needs no explored map.
        altitude: z of the start, for robots that have one [m].
        hover_time: time that is simulated after the end [s].
        targets: (M, 2) positions of the targets to find [m]; none when absent.
        tracking_noise: standard deviations of positions [m] and velocities [m/s] that the robot is
            told of the moving obstacles in sight, see `jaxplore.MovingObstacles`. When absent it
            finds them in its scans (`ObstacleTracker`), but on a known ground, whose hills return
            beams like what moves, it is told with (0.05, 0.1).
        truths: what is true of the robot's parts (`jaxplore.parts`).
        localisation: how the robot finds its pose, from an odometry with errors and its scans; it
            knows its pose when absent. Coverage is then that of the map that its scans give at
            their true poses.
        datum: point of a map's coordinates to which all positions here are relative; frames and
            recordings are in the map's coordinates.

    Raises:
        ValueError: a part of another class; a perception made for another range, resolution or
            goal; a start that is off the map, in a wall, in unknown space, or so close to either
            that the robot touches it; a rate that is not positive, above the control rate or no
            whole fraction of it; a start or all targets in keep-out areas; a target coverage
            outside (0, 1]; a prior of another shape; a goal off the map, in a wall, or
            where the robot cannot get from its start; a target off the map or in a wall; a truth of
            a part that the robot does not have, or that cannot be in this world.
    """

    frame_type = ExplorationFrame
    metrics_type = ExplorationMetrics

    map_arrays: MapArrays
    robot: Dynamics
    sensors: tuple[Sensor, ...]
    perception: Perception
    start: StateVector
    control_period: Scalar
    steps_per_scan: Count
    steps_per_field: Count
    target_coverage: Scalar
    ends_by: Count
    give_up_after: Scalar
    goal: Position | None
    goal_radius: Scalar
    goal_heading: Scalar | None
    goal_tolerance: Scalar
    goal_speed: Scalar
    max_unknown: Scalar
    hover_steps: Count
    targets: Float[Array, "M 2"]
    tracking_noise: Float[Array, "2"]
    truths: tuple[PartTruth, ...]
    localisation: Localisation | None
    counts_walls: bool = eqx.field(static=True)
    clearance_reach: int = eqx.field(static=True)

    @_kinds.check_arguments
    def __init__(
        self,
        world: OccupancyGrid | TerrainMap,
        robot: Dynamics,
        sensors: Sensor | Sequence[Sensor],
        start: Vector,
        *,
        perception: Perception | None = None,
        control_rate: float = 50.0,
        sensing_rate: float = 10.0,
        field_rate: float = 5.0,
        target: str | None = None,
        target_coverage: ArrayLike | None = None,
        give_up_after: ArrayLike | None = None,
        prior: OccupancyGrid | None = None,
        goal: Vector | None = None,
        goal_radius: ArrayLike = GOAL_RADIUS,
        goal_heading: ArrayLike | None = None,
        goal_tolerance: ArrayLike = GOAL_TOLERANCE,
        goal_speed: ArrayLike = GOAL_SPEED,
        max_unknown: ArrayLike | None = None,
        altitude: float = 0.0,
        hover_time: float = 0.0,
        targets: Rows | None = None,
        tracking_noise: Vector | None = None,
        truths: Sequence[PartTruth] = (),
        localisation: Localisation | None = None,
        datum: Datum = ORIGIN,
    ) -> None:
        all_sensors = as_sensors(sensors)
        _kinds.instance("target", target, str, may_be_none=True)
        pose = np.asarray(_checks.vector("start", start, 3), np.float64)
        _checks.warn_above("yaw of start", pose[2], math.tau, "a yaw is in radians, not in degrees")
        self.placed = HostOnly(datum)
        world, ground = checks.grid_and_ground(world)
        self.robot, self.sensors = robot, all_sensors
        self.localisation = localisation
        self.clearance_reach = clearance_reach(robot.footprint, world.resolution)
        told = TOLD_NOISE if tracking_noise is None else tracking_noise
        self.tracking_noise = _checks.vector("tracking_noise", told, 2, at_least=0.0)
        self.goal = None if goal is None else _checks.vector("goal", goal, 2)
        is_apart = perception is not None and perception.is_goal_apart
        ends = (goal_radius, goal_heading, goal_tolerance, goal_speed)
        check = GoalCheck.of((0.0, 0.0) if goal is None else goal, *ends)
        _, self.goal_radius, heading, self.goal_tolerance, self.goal_speed = check
        self.goal_heading = None if goal is None else heading
        self.max_unknown = checks.check_unknown(max_unknown, is_apart=is_apart)
        perception = checks.check_perception(
            perception,
            self.sensors,
            world,
            robot,
            ground,
            self.goal_check,
            self.max_unknown,
            is_localising=localisation is not None,
        )
        known = checks.check_prior(prior, world, datum)
        if localisation is not None:
            localisation.localiser.check_map(prior)
        self.start = checks.start_state(robot, pose, altitude)
        # The robot can enter untraversable ground, but coverage must not ask it to.
        passable = world if ground is None else with_closed(world, ground)
        self.targets = checks.check_targets(targets, world, datum)
        closed = checks.check_keep_out(perception, world, pose, self.targets, datum)
        if closed is not None:
            passable = passable.with_solid(closed)
        reachable = on_device(drivable_cells(passable, pose, robot, perception, datum))
        if self.goal is not None:
            checks.check_goal(self.goal, world, robot, reachable, float(self.goal_radius), datum)
        site = Site(world, robot, perception, pose, self.targets, np.asarray(reachable), datum)
        self.truths = tuple(each.bind(site) for each in as_truths(truths, perception.parts))
        is_told = tracking_noise is not None or ground is not None
        if is_told or (self._has_moving() and perception.tracker is None):
            perception = with_field(perception, "tracker", None if is_told else ObstacleTracker())
        rate = _checks.number("control_rate", control_rate, above=0.0)
        self.control_period = on_device(np.asarray(1.0 / rate, np.float32))
        self.steps_per_scan = whole_steps("sensing_rate", sensing_rate, rate)
        self.steps_per_field = whole_steps("field_rate", field_rate, rate)
        hover = _checks.number("hover_time", hover_time, at_least=0.0)
        self.hover_steps = on_device(np.asarray(round(hover * rate), np.int32))
        self.target_coverage = checks.check_coverage(target_coverage)
        chosen = choose_target(
            target,
            has_coverage=target_coverage is not None,
            is_patrol=any(part.is_patrol for part in perception.parts),
        )
        self.ends_by = on_device(np.asarray(TARGETS.index(chosen), np.int32))
        self.counts_walls = chosen == "walls"
        if give_up_after is None:
            give_up_after = default_give_up_after(world, robot)
        self.give_up_after = _checks.scalar("give_up_after", give_up_after, above=0.0)
        self.map_arrays = MapArrays(world, known, reachable, ground, closed).pad()
        if ground is not None:
            perception = eqx.tree_at(lambda each: each.ground, perception, self.map_arrays.ground)
        self.perception = perception

    @property
    def goal_check(self) -> GoalCheck | None:
        """Check whether the goal is reached; None without a goal."""
        if self.goal is None:
            return None
        ends = (self.goal_heading, self.goal_tolerance, self.goal_speed)
        return GoalCheck(self.goal, self.goal_radius, *ends)

    @property
    def world(self) -> OccupancyGrid:
        """True map."""
        return self.map_arrays.world.unpad()

    @property
    def prior(self) -> OccupancyGrid:
        """Map that the robot knows in advance."""
        return self.map_arrays.prior.unpad()

    @property
    def reachable(self) -> GridMask:
        """Mask (H, W) of the cells that the robot's centre can reach."""
        return self.map_arrays.crop().reachable

    @property
    def place(self) -> Place:
        """What disturbances are checked by."""
        return Place(self.robot, self.datum, self.map_arrays.world, self.reachable)

    @property
    def ground(self) -> Ground | None:
        """Ground of the map's cells; None if it is level."""
        return self.map_arrays.crop().ground

    def __repr__(self) -> str:
        return describe_fields(self, "world", "robot", "sensors", "start", "goal", "period")

    def with_told_obstacles(self) -> "ExplorationScenario":
        """Return the scenario with a robot that is told of moving obstacles (`tracking_noise`)."""
        told = with_field(self.perception, "tracker", None)
        return with_field(self, "perception", told)

    def with_target_coverage(self) -> "ExplorationScenario":
        """Return the scenario, which ends at a coverage of 0.99 if it has no target coverage.

        It is for those who do not know what a robot can still learn: a fleet, in which another one
        may know it, and a simulated robot whose mind is another program.
        """
        if self.target != "information" or bool(has_coverage_target(self.target_coverage)):
            return self
        end = jnp.asarray(TARGET_COVERAGE, jnp.float32), jnp.zeros_like(self.ends_by)
        ended: ExplorationScenario = eqx.tree_at(
            lambda at: (at.target_coverage, at.ends_by), self, end
        )
        return ended

    @property
    def target(self) -> str:
        """What the exploration ends by, one of `coverage`, `information`, `walls` and `never`."""
        return TARGETS[int(self.ends_by)]

    @property
    def num_targets(self) -> int:
        """Number of targets, M."""
        return int(self.targets.shape[0])

    @property
    def steps_per_measurement(self) -> int:
        """Control periods between two scans."""
        return int(self.steps_per_scan)

    @property
    def cell_size(self) -> float:
        """Side of a cell of the map [m]."""
        return self.map_arrays.world.resolution

    @property
    def objective(self) -> str:
        """Default objective: time to the end, or what is true of a part says, plus contacts."""
        endless = [each.objective for each in self.truths if each.objective is not None]
        return default_objective(self.num_targets, self.goal, self.target, endless)

    @property
    def metric_groups(self) -> tuple[str, ...]:
        """Names of the truths of parts, whose metrics are groups of their own."""
        shown = (each for each in self.truths if type(each).report is not PartTruth.report)
        return tuple(each.name for each in shown)

    @property
    def num_reachable(self) -> Scalar:
        """Number of reachable cells."""
        return jnp.sum(self.map_arrays.reachable, dtype=jnp.float32)

    def init(self, key: Key | None) -> tuple[ExplorationState, Belief]:
        """Return the initial state, and the belief with the prior map."""
        belief = self.perception.init(self.map_arrays.prior, self.robot.pose(self.start))
        begin = self.robot.pose(self.start)
        for each in self.truths:
            own = each.init_part(self.perception.part_named(each.name), begin)
            if own is not None:
                belief = belief.with_parts({each.name: own})
        truths = init_truths(self.truths, begin, key)
        reachable, number = self.map_arrays.reachable, self.num_targets
        place, odometer, pose = None, None, self.robot.pose(self.start)
        if self.localisation is not None:
            place = self.localisation.init(pose, belief.grid, self.sensors, estimator_key(key))
            odometer = Odometer.at_start(self.localisation.odometry, key)
            belief = self.localisation.inform(place, belief)
        state = initial_state(
            self.start,
            belief,
            reachable,
            number,
            what_moves(self.truths, truths, jnp.zeros(())),
            self.sensors,
            pose=pose,
            is_guarded=self.guard is not None,
            is_on_hills=self.perception.ground is not None,
            truths=truths,
            place=place,
            odometer=odometer,
        )._replace(
            landing=self.disturbances.landing(reachable, belief.grid.frame, key),
            control=self.robot.default_control if is_any_turning(self.sensors) else None,
        )
        return state, state.belief

    def _has_moving(self) -> bool:
        """Return whether anything moves in the world beside the robot."""

        def begin() -> MovingDiscs | None:
            begun = init_truths(self.truths, self.robot.pose(self.start), None)
            return what_moves(self.truths, begun, jnp.zeros(()))

        return eqx.filter_eval_shape(begin) is not None

    def measure_state(self, state: ExplorationState) -> StateVector:
        """Return the state (nx,) that the robot takes to be its own; see `Localisation`."""
        place, odometer = state.own.place, state.odometer
        if self.localisation is None or place is None or odometer is None:
            return state.robot
        return self.localisation.observe_state(place, odometer.errors, self.robot, state.robot)

    @property
    def steps_per_revision(self) -> int | None:
        """Control periods between two searches for loops; None without any."""
        if self.localisation is None or self.localisation.closer is None:
            return None
        return max(1, round(1.0 / (self.localisation.closing_rate * self.period)))

    def update_on_host(self, state: LoopState) -> LoopState:
        """Return the state with the map moved where a loop was closed."""
        task, guard = self.close_loops(state.task), state.guard
        moved = self.correction(state.task, task)
        if guard is not None:
            # The correction is no jump of the robot.
            guard = guard._replace(expected=moved(guard.expected))
        return state._replace(task=task, observed=moved(state.observed), guard=guard)

    def close_loops(self, task: ExplorationState) -> ExplorationState:
        """Return the state of the task with the map moved where a loop was closed, on the host."""
        before, track = task.own.place, task.judged.track
        if self.localisation is None or before is None or track is None:
            return task
        place, belief = self.localisation.close_loops(
            *(before, task.belief, self.perception, self.map_arrays.prior),
            self.robot.pose(self.start),
        )
        if int(place.known.scans.number) < int(before.known.scans.number):
            track = thin(track)
        own = task.own._replace(place=place, belief=belief)
        return task._replace(own=own, judged=task.judged._replace(track=track))

    def correction(
        self, before: ExplorationState, after: ExplorationState
    ) -> Callable[[StateVector], StateVector]:
        """Return the function that moves a state (nx,) as `close_loops` has moved the robot."""
        places = before.own.place, after.own.place
        if places[0] is None or places[1] is None:
            return lambda state: state
        poses = places[0].known.pose, places[1].known.pose
        return functools.partial(correct_state, self.robot, before=poses[0], after=poses[1])

    def perceive(
        self, state: ExplorationState, moment: Moment, key: Key
    ) -> tuple[ExplorationState, Belief]:
        """Scan and update the map at the sensing rate, derive the fields at the field rate."""
        gain, onboard = state.gain, self.onboard
        sensed = self.sense(state, self.true_world(state, moment), moment, key)
        own = onboard.track_told(sensed.state.own, sensed.measured, sensed.sight)
        sight = sensed.sight.correct(own.place)
        own = onboard.update_fields(own, sensed.measured, sight)
        state = sensed.state._replace(own=own)
        place = self.robot.position(self.measure_state(state))
        state = state._replace(own=onboard.learn(own, sensed.measured, place))
        if self.counts_walls:
            walls = state.own.knowledge.walls
            gain = gain.update(walls, self.control_period, state.belief.is_sent)
            state = state._replace(gain=gain)
        return state, state.belief

    def sense(
        self,
        state: ExplorationState,
        truth: TrueWorld,
        moment: Moment,
        key: Key,
        *,
        is_told: bool = True,
    ) -> Sensed:
        """Measure, let the robot map its scans, and judge what it knows then.

        Args:
            state: state of the task before.
            truth: the true world at the moment.
            moment: time, step and observed state of the robot.
            key: random key of the step's measurements.
            is_told: whether a robot that finds no moving obstacles itself is told of them; static.
        """
        onboard = self.onboard
        judge = Judge(self.perception, self.map_arrays.reachable, self.truths)
        measured, ranges = self.instruments.measure(state, truth, moment, key, is_told=is_told)
        is_due, pose = measured.is_scan_due, self.robot.pose(state.robot)
        own, sight = onboard.examine(state.own, measured)
        before, place = MapSums.none(), own.place
        if place is None:
            before, own = judge.count_before(own, is_due, sight)
        own, is_mapped = onboard.map_scans(own, measured, sight)
        judged, truths = judge.judge(
            *(state.judged, state.truths, before, own, measured, sight, is_mapped),
            is_due=is_due,
            pose=pose,
            place=place,
            find=lambda: self.sensors[0].sees(truth.grid, pose, self.targets, truth.ground),
        )
        coverage = judged.progress.coverage
        gain = state.gain.update(coverage, self.control_period, own.belief.is_sent)
        state = state._replace(own=own, judged=judged, truths=truths, gain=gain, ranges=ranges)
        return Sensed(state, measured, sight)

    @property
    def instruments(self) -> Instruments:
        """What measures in the true world."""
        return Instruments(self.onboard, self.rates, self.truths, self.tracking_noise)

    @property
    def rates(self) -> Rates:
        """When the robot scans and derives its fields."""
        return Rates(self.control_period, self.steps_per_scan, self.steps_per_field)

    @property
    def onboard(self) -> Robot:
        """What runs on board of the robot, which knows no truth."""
        return Robot(
            self.robot,
            self.sensors,
            self.perception,
            self.localisation,
            None if self.localisation is None else self.map_arrays.prior,
            self.counts_walls,
        )

    def scan_points(self, state: ExplorationState, moment: Moment | None = None) -> ScanPoints:
        """Return the newest scan for the guard."""
        points = state.own.points
        if points is None:
            return ScanPoints.blank(1)
        if moment is None:
            return points
        comes = self.rates.is_scan_due(moment.step) & ~moment.is_blind
        return points._replace(time=jnp.where(comes, moment.time, points.time))

    def advance(
        self, state: ExplorationState, control: ControlVector, moment: Moment, info: Info
    ) -> tuple[ExplorationState, ExplorationRecord]:
        """Move the robot and record the step.

        If the move would touch something solid, the robot stops instead, and the step counts as a
        collision.
        """
        record, truths = self.move(self.robot, state, control, moment, info)
        state, record = self.follow(state, record, truths, control, moment)
        is_over = self.is_finished(state) | (state.finished > 0)
        return state._replace(finished=state.finished + is_over.astype(jnp.int32)), record

    def move(
        self,
        robot: Dynamics,
        state: ExplorationState,
        control: ControlVector,
        moment: Moment,
        info: Info,
    ) -> tuple[ExplorationRecord, dict[str, Any]]:
        """Return the record of a step of a robot by its true model, and the states of the truths of
        its parts; see `motion.move`."""
        # Moving obstacles move during the step as well, so contact is with those at its end.
        truth = self.true_world(state, moment._replace(time=moment.time + self.control_period))
        return move(
            robot,
            state,
            control,
            truth,
            period=self.control_period,
            reach=self.clearance_reach,
            info=info,
            is_faulty=moment.is_faulty,
            stop=moment.stop,
            truths=self.truths,
        )

    def follow(
        self,
        state: ExplorationState,
        record: ExplorationRecord,
        truths: dict[str, Any],
        control: ControlVector,
        moment: Moment,
        has_room: Flag | None = None,
    ) -> tuple[ExplorationState, ExplorationRecord]:
        """Return the state after a step to the state of its record, and the record: the odometry
        measures the step, and a fault may carry the robot away at its end.

        `has_room` says whether it can be put down where the fault carries it; None if it can.
        """
        state = self.follow_odometry(state, record.state, moment.step)
        if state.landing is not None:
            # After the odometry has measured the step: it does not notice.
            is_carried = self.disturbances.is_carried(moment.time, self.control_period)
            is_carried = is_carried if has_room is None else is_carried & has_room
            there = self.robot.with_pose(self.start, state.landing)
            after = jnp.where(is_carried, there, record.state)
            record = record._replace(state=after, is_carried=is_carried)
        motion = Motion.between(self.robot, state.robot, record.state, self.control_period)
        state = state.after_step(record.state, control)._replace(motion=motion, truths=truths)
        return state, record

    def follow_odometry(
        self, state: ExplorationState, after: StateVector, step: Count
    ) -> ExplorationState:
        """Return what a robot that finds its pose knows after a step to a true state (nx,)."""
        own, odometer, judged = state.own, state.odometer, state.judged
        if self.localisation is None or own.place is None or odometer is None:
            return state
        poses = self.robot.pose(state.robot), self.robot.pose(after)
        increment, odometer = odometer.measure(
            self.localisation.odometry, *poses, step, self.control_period
        )
        place = self.localisation.predict(own.place, increment, self.control_period)
        if judged.track is not None:
            judged = judged._replace(track=judged.track.add_motion(increment))
        return state._replace(own=own._replace(place=place), judged=judged, odometer=odometer)

    def is_unfinished(self, state: ExplorationState) -> Flag:
        """Check whether the loop continues: until the task is given up or finished, plus the hover
        time, or what is true of a part ends it.

        A scenario without a goal that is finished at the start takes no step.
        """
        is_over = (state.finished > self.hover_steps) | self.is_given_up(state)
        for each in self.truths:
            ended = each.is_over(state.truths.get(each.name))
            is_over = is_over if ended is None else is_over | ended
        if self.goal is None and self.num_targets == 0:
            is_over = is_over | (self.is_finished(state) & (self.hover_steps == 0))
        return ~is_over

    def is_finished(self, state: ExplorationState) -> Flag:
        """Check whether the task is finished, as the class says; another task overrides it.

        Args:
            state: the task's state, with the map that the robot knows in `belief.grid`.
        """
        is_there = self.is_at_goal(state)
        end = (self.ends_by, self.target_coverage, state.own.knowledge, is_there, self.max_unknown)
        return is_finished(state.progress, state.is_seen, *end, counts_walls=self.counts_walls)

    def is_at_goal(self, state: ExplorationState) -> Flag | None:
        """Check whether the robot is at its goal (`GoalCheck`); None without a goal."""
        check = self.goal_check
        if check is None:
            return None
        # A robot that finds its pose is where it takes itself to be.
        pose = self.robot.pose(self.measure_state(state))
        is_reached: Flag = check.is_reached(pose, state.motion)
        return is_reached

    def is_given_up(self, state: Any) -> Flag:
        """Check whether the exploration is given up, as the class says.

        Args:
            state: the task's state, of one robot or of a fleet that it is one of.
        """
        if self.goal is not None or self.num_targets > 0:
            return jnp.array(False)
        is_judged = (self.ends_by != TARGETS.index(NEVER)) & (state.finished == 0)
        since = state.gain.since
        if self.counts_walls:
            # Walls that are seen from far away through gaps grow for ever, a cell at a time.
            since = jnp.maximum(since, state.own.knowledge.idle)
        is_over: Flag = is_judged & (since >= self.give_up_after)
        return is_over

    def progress(self, state: Any) -> tuple[float, str]:
        """Return a share of 0, because the time left is unknown, and the coverage in words."""
        return 0.0, f"coverage {float(state.coverage):6.1%}"

    def for_batches(self) -> "ExplorationScenario":
        """Return the scenario with a perception that is efficient under `jax.vmap`."""
        batched = self.perception.for_batches()
        same: ExplorationScenario = eqx.tree_at(lambda at: at.perception, self, batched)
        return same

    def frame(
        self, state: ExplorationState, moment: Moment, inspect: Inspect | None, key: Key
    ) -> dict[str, Any]:
        """Return the belief, a scan, and the plan before a step; see `ExplorationFrame`."""
        truth = self.true_world(state, moment)
        # Only the scan of the first sensor is drawn: it is the one that fills the map.
        motion = self.instruments.scan_motion(state, moment)
        scan, *_ = truth.scans(self.sensors, self.robot.pose(state.robot), key, motion)
        plan = None if inspect is None else inspect(moment.observed, state.belief)
        seen = (self.robot, self.sensors[0], state.robot, state.belief, state.is_seen)
        return frame_arrays(*seen, scan, truth.discs, plan, self.truths)

    def make_frame(self, step: int, arrays: Mapping[str, Any]) -> Frame:
        """Make a frame on the host, with the cells that are on the map."""
        return super().make_frame(step, self.crop_frame(arrays))

    def crop_frame(self, arrays: Mapping[str, Any]) -> dict[str, Any]:
        """Return the arrays of a frame with the cells that are on the map."""
        return crop_frame(arrays, self.map_arrays.world, self.perception.field_sensor.stride)

    def agent_view(self, view_cells: int | None) -> ExplorationView:
        """Return exploration as an agent sees it."""
        return ExplorationView(
            self,
            view_cells,
            frame=self.map_arrays.world.frame,
            map_shape=self.world.shape,
            sensors=self.sensors,
            num_reachable=self.num_reachable,
            hover_steps=self.hover_steps,
            targets=self.targets,
            has_goal=self.goal is not None,
        )

    def recording(
        self,
        controller: Controller | None,
        before: ExplorationState,
        run: ChunkedRun[Any, ExplorationRecord, ExplorationFrame],
    ) -> ExplorationRecording:
        """Make the recording of a run."""
        after: ExplorationState = run.state.task
        grid = after.belief.grid
        local = make_recording(
            *(self, run, before.progress, after),
            belief=grid.crop(grid.probability),
            robots=robot_fields(self.robot, self.start),
            parts=part_reports(
                self.truths, self.perception, after.belief.parts, after.truths, grid
            ),
            finished=int(after.finished),
            is_given_up=bool(self.is_given_up(after)),
            localisation=after.localisation,
            member_names=() if controller is None else controller.member_names,
        )
        return local.move(self.datum.offset)

    def true_world(self, state: ExplorationState, moment: Moment) -> TrueWorld:
        """Return the true world at a moment, with the walls that have appeared."""
        moving = eqx.Partial(what_moves, self.truths, state.truths, moment.time)
        return self.world_at(moving, moment)

    def world_at(self, find_moving: Callable[[], MovingDiscs | None], moment: Moment) -> TrueWorld:
        """Return the true world at a moment, with what is found to move; see `true_world`."""
        # Walls follow the number of the step, because `advance` asks for a later time: all parts of
        # a step then see the same walls.
        elapsed = self.control_period * moment.step.astype(jnp.float32)
        grid = self.disturbances.world(self.map_arrays.world, elapsed)
        is_told = self.perception.tracker is None
        arrays = self.map_arrays
        return TrueWorld(grid, arrays.ground, find_moving, is_told, arrays.traversable)
