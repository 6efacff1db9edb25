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
    Rows,
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
from jaxplore.control.stops import BLIND, GOOD, MISFIT
from jaxplore.dynamics.goal_check import (
    GOAL_RADIUS,
    GOAL_SPEED,
    GOAL_TOLERANCE,
    GoalCheck,
    Motion,
)
from jaxplore.dynamics.quadrotor import Quadrotor, attitude_upwards, position_upwards
from jaxplore.maps.datum import ORIGIN, Datum
from jaxplore.maps.voxel_grid import FREE_BELOW, OCCUPIED_ABOVE, VoxelGrid
from jaxplore.maps.window import read_first
from jaxplore.report.volume.data import FREE, OCCUPIED, UNKNOWN, VolumeFrame, VolumeMetrics
from jaxplore.report.volume.data import VolumeRecord as VolumeRecord
from jaxplore.report.volume.recording import VolumeRecording
from jaxplore.robot.clock import whole_steps
from jaxplore.robot.robot import FITTING, is_mapped_after, tell, unfit_after
from jaxplore.robot.volume_points import num_volume_points, volume_points
from jaxplore.sensing.volume import VolumeSensor
from jaxplore.simulation.chunks import ChunkedRun
from jaxplore.simulation.disturbances import Place
from jaxplore.simulation.exploration.finish import default_give_up_after
from jaxplore.simulation.exploration.part_truth import PartTruth, as_truths, init_truths, what_moves
from jaxplore.simulation.exploration.scenario import TOLD_NOISE
from jaxplore.simulation.scenario import Inspect, Scenario
from jaxplore.simulation.state import Moment
from jaxplore.simulation.volume.observable import find_fitting_places, observable
from jaxplore.simulation.volume.people import Cylinders

KEEP_OUT = "keep_out"
"""Name of the part of boxes that the robot must not enter."""
TOUCHING = 1.0
"""Reach of the box in which the distance to solid voxels is examined [m]."""


class VolumeState(NamedTuple):
    """State of the exploration of a volume.

    `num_known` observable voxels are known to be free, and `gain` is the last rise of their share.
    `is_seen` (M,) says which targets have been seen. `motion` is that of the last step; None
    without a goal. `truths` are the states of what is true beside the map, by name. `points` are of
    the newest scan, and `unfit` is for how long scans have not fitted the map [s], negative while
    they do; both are None without a guard.
    """

    robot: StateVector
    belief: VolumeBelief
    num_known: Count
    gain: Gain
    is_seen: Bool[Array, " M"]
    truths: dict[str, Any]
    motion: Motion | None = None
    points: ScanPoints | None = None
    unfit: Scalar | None = None


class VolumeScenario(Scenario):
    """Exploration of an unknown volume by a quadrotor with depth cameras or lidars.

    The volume has z up, the model of the quadrotor has z down (NED): a height is `-z` of the state.
    Voxels that the world does not know to be free are solid. *Observable* are the free voxels that
    a level sensor sees from some place where the robot fits and that is connected with the start;
    coverage is the share of them that the robot's map knows to be free. The exploration is finished
    at the target coverage, and given up when the coverage has not risen by 0.1 % for
    `give_up_after`: what is left cannot be seen from where the robot fits. With targets it is
    finished when a sensor has seen all of them, and not given up. With a goal the robot flies
    there, through what it does not know as well, and the run is finished when it has come to rest
    there (`GoalCheck`); it is not given up.

    Args:
        world: the true volume, hidden from the robot.
        robot: true model of the robot.
        sensors: one sensor or several; the information is that of the first one.
        start: start (x, y, z, yaw) with z up [m, m, m, rad], level and at rest.
        perception: update of the belief; made for the sensors and the world when absent.
        control_rate: rate of the controls [Hz].
        sensing_rate: rate of scans and map updates [Hz]; a whole fraction of the control rate.
        field_rate: rate of updates of the information and guidance [Hz], likewise.
        target_coverage: share of the observable volume at which the exploration is finished.
        give_up_after: time without a rise of the coverage after which the exploration is given up
            [s]; when absent a minute and the time of a flight along the diagonal of the volume and
            back at 1 m/s.
        targets: (M, 3) positions (x, y, z) of targets to find, with z up [m]; none when absent.
        goal: goal position (x, y, z) with z up [m]; none when absent.
        goal_radius: distance within which the goal is reached by a robot at rest [m].
        goal_heading: heading at the goal [rad]; any when absent.
        goal_tolerance: greatest error of the heading at the goal [rad].
        goal_speed: speed up to which the robot is at rest at the goal [m/s].
        truths: what is true beside the map: `jaxplore.MovingObstacles`, here upright cylinders from
            the lower face of the volume to 1.8 m above it. The robot is told of those in sight, and
            the map keeps nothing of them.
        tracking_noise: standard deviations of positions [m] and velocities [m/s] that the robot is
            told.
        datum: point of a file's coordinates to which all positions here are relative; frames and
            recordings are in those of the file.

    Raises:
        ValueError: a part of another class, a start that is off the volume or so close to a solid
            voxel that the robot touches it, a rate that is no whole fraction, a coverage outside
            (0, 1], a window of the perception that is too small, a target that is not in an
            observable voxel, targets beside a goal, a goal where the robot cannot get from its
            start, a perception made for another goal, a start, a goal or all targets in keep-out
            boxes.
    """

    frame_type = VolumeFrame
    metrics_type = VolumeMetrics

    world: VoxelGrid
    robot: Quadrotor
    sensors: tuple[VolumeSensor, ...]
    perception: VolumePerception
    start: StateVector
    control_period: Scalar
    steps_per_scan: Count
    steps_per_field: Count
    target_coverage: Scalar
    give_up_after: Scalar
    observable: Bool[Array, "D H W"]
    num_observable: Scalar
    targets: Float[Array, "M 3"]
    goal_check: GoalCheck | None
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
        control_rate: float = 20.0,
        sensing_rate: float = 10.0,
        field_rate: float = 5.0,
        target_coverage: ArrayLike = 0.95,
        give_up_after: ArrayLike | None = None,
        targets: Rows | None = None,
        goal: Vector | None = None,
        goal_radius: ArrayLike = GOAL_RADIUS,
        goal_heading: ArrayLike | None = None,
        goal_tolerance: ArrayLike = GOAL_TOLERANCE,
        goal_speed: ArrayLike = GOAL_SPEED,
        truths: Sequence[PartTruth] = (),
        tracking_noise: Vector = TOLD_NOISE,
        datum: Datum = ORIGIN,
    ) -> None:
        self.truths = as_truths(truths, ())
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
                f"start is {_show(place, datum)}, in a keep-out box; accepted: outside of all"
            )
        places = find_fitting_places(solid | is_barred, begin, radius / side)
        views = [(each.max_range / side, *each.elevations) for each in given]
        seen = observable(solid, places, views)
        self.targets = _check_targets(targets, world, seen, is_barred, datum)
        counted = seen & ~is_barred
        self.observable = on_device(counted)
        self.num_observable = on_device(np.asarray(np.count_nonzero(counted), np.float32))
        self.start = robot.at_pose(place[0], place[1], place[3], -place[2])
        ends = goal_radius, goal_heading, goal_tolerance, goal_speed
        check = GoalCheck.of((0.0, 0.0, 0.0) if goal is None else goal, *ends, dimensions=3)
        self.goal_check = None if goal is None else check
        if goal is not None:
            has_targets = bool(self.targets.size)
            _check_goal(check, world, places, is_barred, radius, datum, has_targets=has_targets)
        perception = _check_perception(perception, given, world, robot, self.goal_check)
        perception.window_shape(world.shape, side)
        self.perception = perception
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
        is_seen = jnp.zeros(self.targets.shape[0], bool)
        nothing = jnp.zeros(())
        truths = init_truths(self.truths, self.robot.pose(self.start), key)
        moving = what_moves(self.truths, truths, nothing)
        motion = None if self.goal_check is None else Motion(nothing, nothing)
        if moving is not None:
            obstacles = Obstacles.unseen(moving.radius)
            belief = dataclasses.replace(belief, obstacles=obstacles)
        state = VolumeState(self.start, belief, known, gain, is_seen, truths, motion)
        if self.guard is not None:
            points = ScanPoints.blank(num_volume_points(self.sensors), 0.0, dimensions=3)
            state = state._replace(points=points, unfit=jnp.asarray(FITTING))
        return state, belief

    def scan_points(self, state: VolumeState, moment: Moment | None = None) -> ScanPoints:
        """Return the newest scan for the guard, with the room of the map."""
        points = state.points
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
        observed, is_placed, unfit = moment.observed, None, state.unfit
        if moment.measured is not None and moment.guard is not None:
            # While only scans speak against a pose, they say there when they fit again.
            stop = moment.guard.stop
            is_trusted = (stop == GOOD) | (stop == MISFIT) | (stop == BLIND)
            is_placed = is_trusted & jnp.isfinite(moment.measured).all()
            observed = jnp.where(is_placed, moment.measured, moment.guard.expected)
        at, turn = position_upwards(observed), attitude_upwards(observed)
        elapsed = self.control_period * self.steps_per_field.astype(jnp.float32)
        truly, truly_turned = position_upwards(state.robot), attitude_upwards(state.robot)
        people = self._people(state, moment.time)

        interval = self.control_period * self.steps_per_scan.astype(jnp.float32)
        # None, which has no arrays, in place of what only a guard needs.
        type Given = tuple[VolumeBelief, Count, ScanPoints | None, Scalar | None]

        def scan_once(given: Given) -> Given:
            before, known, points, unfit = given
            keys, world = jax.random.split(key, len(self.sensors)), self.world_at(moment.step)
            scans = [
                sensor.scan(world, truly, truly_turned, key=each)
                for sensor, each in zip(self.sensors, keys, strict=True)
            ]
            if people is not None:
                scans = [
                    people.block(scan, sensor, truly, truly_turned)
                    for scan, sensor in zip(scans, self.sensors, strict=True)
                ]
                assert before.obstacles is not None
                seen = self.sensors, world, truly, truly_turned, self.tracking_noise, key
                told = tell(before.obstacles, people.tell(*seen))
                before = dataclasses.replace(before, obstacles=told)

            def map_scans(given: tuple[VolumeBelief, Count]) -> tuple[VolumeBelief, Count]:
                before, known = given
                window = self.perception.scan_window(before.grid, at, turn)
                old, log_odds = read_first(window, before.grid.log_odds)
                before = eqx.tree_at(lambda each: each.grid.log_odds, before, log_odds)
                belief = self.perception.update(before, at, turn, scans)
                wanted = belief.place_window(window).read(self.observable)
                now, then = (
                    jnp.sum((each < FREE_BELOW) & wanted, dtype=jnp.int32)
                    for each in (window.read(belief.grid.log_odds), old)
                )
                return belief, known + now - then

            if unfit is None:
                return *map_scans((before, known)), points, unfit
            assert is_placed is not None
            assert moment.measured is not None
            # A stopped robot brakes by its scans, which need no place in the map.
            poses = moment.measured, moment.guard.expected
            points = volume_points(before, self.sensors, scans, *poses, moment.time, interval)
            unfit = jnp.where(is_placed, unfit_after(unfit, points.misfit, interval), FITTING)
            is_mapped = is_placed & is_mapped_after(unfit)
            mapped = jax.lax.cond(is_mapped, map_scans, lambda same: same, (before, known))
            return *mapped, points, unfit

        is_due = (moment.step % self.steps_per_scan == 0) & ~moment.is_blind
        belief, stored = state.belief.split()
        if belief.obstacles is not None:
            later = belief.obstacles.advance(self.control_period)
            belief = dataclasses.replace(belief, obstacles=later)
        given = belief, state.num_known, state.points, unfit
        belief, known, points, unfit = jax.lax.cond(is_due, scan_once, lambda same: same, given)
        belief, stored = eqx.combine(belief, stored).store_window().split()

        def with_fields(old: VolumeBelief) -> VolumeBelief:
            heading = self.robot.heading(observed)
            whole = eqx.combine(old, stored)
            return self.perception.update_fields(whole, at, heading, elapsed).split()[0]

        is_new = moment.step % self.steps_per_field == 0
        if is_placed is not None:
            is_new = is_new & is_placed
        belief = jax.lax.cond(is_new, with_fields, lambda same: same, belief)
        belief = eqx.combine(belief, stored)
        is_seen = state.is_seen
        if is_seen.size:
            is_seen = jax.lax.cond(
                is_due,
                lambda seen: seen | self.find_targets(truly, truly_turned, moment.step),
                lambda same: same,
                is_seen,
            )
        state = state._replace(
            belief=belief, num_known=known, is_seen=is_seen, points=points, unfit=unfit
        )
        gain = state.gain.update(self.coverage(state), self.control_period)
        return state._replace(gain=gain), belief

    def advance(
        self, state: VolumeState, control: ControlVector, moment: Moment, info: Info
    ) -> tuple[VolumeState, VolumeRecord]:
        """Move the robot and record the step.

        If the move would touch something solid, the robot stops instead, and the step counts as a
        collision.
        """
        world = self.world_at(moment.step)
        moved = self.robot.step(state.robot, control, self.control_period)
        is_finite = jnp.all(jnp.isfinite(moved))
        # People move during the step as well, so contact is with where they are at its end.
        people = self._people(state, moment.time + self.control_period)
        is_collision = is_finite & (self._room(moved, world, people) < 0.0)
        after = jnp.where(is_finite, moved, state.robot)
        after = jnp.where(is_collision, self._stop(state.robot), after)
        record = VolumeRecord(
            state=after,
            control=control,
            coverage=self.coverage(state),
            clearance=self._room(after, world, people),
            is_collision=is_collision,
            effective_sample_size=info.effective_sample_size,
            is_finite=info.is_finite,
            targets_seen=jnp.sum(state.is_seen, dtype=jnp.int32) if state.is_seen.size else None,
            is_untraversable=self._is_barred(after),
            stop=moment.stop,
        )
        if self.goal_check is not None:
            motion = Motion.between(self.robot, state.robot, after, self.control_period)
            state = state._replace(motion=motion)
        return state._replace(robot=after), record

    def find_targets(
        self, position: Float[Array, "3"], rotation: Float[Array, "3 3"], step: Count
    ) -> Bool[Array, " M"]:
        """Return which targets the sensors see.

        Args:
            position: true position (x, y, z) of the robot, with z up [m].
            rotation: rotation from its body to the world.
            step: number of steps since the start, for walls that appear.
        """
        world = self.world_at(step)
        views = [each.sees(world, position, rotation, self.targets) for each in self.sensors]
        return jnp.stack(views).any(axis=0)

    def is_unfinished(self, state: VolumeState) -> Flag:
        """Check whether the exploration is neither finished nor given up."""
        if self.goal_check is not None:
            return ~self._is_there(self.goal_check, state)
        if state.is_seen.size:
            return ~state.is_seen.all()
        return (self.coverage(state) < self.target_coverage) & ~self.is_given_up(state)

    def is_given_up(self, state: VolumeState) -> Flag:
        """Check whether the coverage has not risen for `give_up_after`, below its target."""
        if state.is_seen.size or self.goal_check is not None:
            return jnp.array(False)
        is_below = self.coverage(state) < self.target_coverage
        return is_below & (state.gain.since >= self.give_up_after)

    def progress(self, state: VolumeState) -> tuple[float, str]:
        """Return the share of the target coverage, and the coverage in words."""
        coverage = float(self.coverage(state))
        if self.goal_check is not None:
            place = np.asarray(position_upwards(state.robot))
            away = float(np.linalg.norm(place - np.asarray(self.goal_check.position)))
            first = np.asarray(position_upwards(self.start) - self.goal_check.position)
            share = 1.0 - away / max(1e-6, float(np.linalg.norm(first)))
            return min(1.0, max(0.0, share)), f"goal {away:5.1f} m away"
        return min(1.0, coverage / float(self.target_coverage)), f"coverage {coverage:6.1%}"

    def coverage(self, state: VolumeState) -> Scalar:
        """Return the share of the observable volume that is known to be free."""
        return state.num_known.astype(jnp.float32) / self.num_observable

    def world_at(self, step: Count) -> VoxelGrid:
        """Return the true world in a step, with the walls that have appeared."""
        elapsed = self.control_period * step.astype(jnp.float32)
        return self.disturbances.world(self.world, elapsed)

    @property
    def place(self) -> Place:
        """What disturbances are checked by."""
        return Place(self.robot, self.datum, self.world)

    def clearance(self, state: StateVector, world: VoxelGrid | None = None) -> Scalar:
        """Return the distance from the robot's edge to the nearest solid voxel [m], up to a reach.

        Args:
            state: (nx,) state of the robot.
            world: the true world then; that of the start when absent.
        """
        world = self.world if world is None else world
        grid = world.to_grid(position_upwards(state))
        centre = jnp.floor(jnp.where(jnp.isfinite(grid), grid, 0.0)).astype(jnp.int32)
        reach = self.reach
        offsets = jnp.stack(
            jnp.meshgrid(*[jnp.arange(-reach, reach + 1)] * 3, indexing="ij")
        ).reshape(3, -1)
        voxels = centre[:, None] + offsets
        # Off the volume nothing is known to be free.
        solid = world.at(voxels, outside=0.0) >= FREE_BELOW
        low = voxels.astype(grid.dtype)
        # Distance from the centre of the robot to each voxel, which is a cube.
        gap = jnp.maximum(jnp.maximum(low - grid[:, None], grid[:, None] - low - 1.0), 0.0)
        squared = jnp.where(solid, jnp.sum(gap * gap, axis=0), float(reach**2))
        return jnp.sqrt(jnp.min(squared)) * world.resolution - self.robot.radius

    def _people(self, state: VolumeState, time: Scalar) -> Cylinders | None:
        """Return the moving obstacles at a time since the start [s]; None without any."""
        moving = what_moves(self.truths, state.truths, time)
        return None if moving is None else Cylinders.of(moving, self.world)

    def _room(self, state: StateVector, world: VoxelGrid, people: Cylinders | None) -> Scalar:
        """Return the distance from the robot's edge to the nearest solid voxel or person [m]."""
        room = self.clearance(state, world)
        if people is None:
            return room
        return jnp.minimum(room, people.gap(position_upwards(state)) - self.robot.radius)

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
            "is_found": state.is_seen,
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
            targets=np.asarray(self.targets),
            goal=None if self.goal_check is None else np.asarray(self.goal_check.position),
            is_at_goal=self.goal_check is not None and not bool(self.is_unfinished(last)),
            boxes=np.zeros((0, 6)) if self.keep_out is None else np.asarray(self.keep_out.boxes),
            given_up_step=run.num_steps if bool(self.is_given_up(run.state.task)) else None,
        )
        return local.move(self.datum.offset)

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

    def _is_there(self, check: GoalCheck, state: VolumeState) -> Flag:
        """Check whether the robot has come to rest at its goal."""
        assert state.motion is not None
        heading = self.robot.heading(state.robot)
        pose = jnp.append(position_upwards(state.robot), heading)
        there: Flag = check.is_reached(pose, state.motion)
        return there

    def _stop(self, state: StateVector) -> StateVector:
        """Return the state of a robot that keeps its position and attitude, at rest."""
        still = jnp.asarray([name.startswith(("v", "w")) for name in self.robot.state_names])
        return jnp.where(still, 0.0, state)


def voxel_states(log_odds: Float[Array, "*N"]) -> UInt8[Array, "*N"]:
    """Return the state of each voxel: `UNKNOWN`, `FREE` or `OCCUPIED`."""
    solid = jnp.where(log_odds > OCCUPIED_ABOVE, OCCUPIED, UNKNOWN)
    kinds = jnp.where(log_odds < FREE_BELOW, FREE, solid)
    return kinds.astype(jnp.uint8)


def _check_targets(
    targets: Rows | None,
    world: VoxelGrid,
    seen: np.ndarray,
    is_barred: np.ndarray,
    datum: Datum,
) -> Float[Array, "M 3"]:
    """Return targets (M, 3) [m], each in a voxel that a level sensor can see.

    Raises:
        ValueError: another shape, a target elsewhere, or all targets in keep-out boxes.
    """
    if targets is None:
        return on_device(np.zeros((0, 3), np.float32))
    places, outside = _checks.array("targets", targets, ("M", 3), may_be_empty=True), 0
    for index, place in enumerate(np.asarray(places, np.float64)):
        voxel = np.floor((place - np.asarray(world.origin))[::-1] / world.resolution).astype(int)
        is_in = ((voxel >= 0) & (voxel < seen.shape)).all()
        if not is_in or not seen[tuple(voxel)]:
            raise ValueError(
                f"targets[{index}] is {_show(place, datum)}; accepted: a free voxel that a sensor "
                "sees from where the robot can get"
            )
        outside += not is_barred[tuple(voxel)]
    if len(places) and not outside:
        raise ValueError(
            f"targets are {len(places)}, all in keep-out boxes; accepted: one outside at least"
        )
    return places


def _show(place: np.ndarray, datum: Datum) -> str:
    """Return the coordinates (x, y, z) of a place in the file's, for a message."""
    # To the millimetre: single precision has no more.
    rounded = (round(float(each), 3) for each in datum.round_to_map(place[:3]))
    return f"({', '.join(f'{each:.10g}' for each in rounded)})"


def _check_goal(
    check: GoalCheck,
    world: VoxelGrid,
    places: np.ndarray,
    is_barred: np.ndarray,
    radius: float,
    datum: Datum,
    *,
    has_targets: bool,
) -> None:
    """Check that a goal is within its radius of a voxel at whose centre the robot can get.

    `places` (D, H, W) are these voxels, and `radius` is that of the robot [m].
    """
    at = _show(np.asarray(check.position), datum)
    if has_targets:
        raise ValueError(f"goal is {at} beside targets; accepted: one of them")
    voxel = np.asarray(jnp.floor(world.to_grid(check.position))).astype(int)
    if ((voxel >= 0) & (voxel < world.shape)).all() and is_barred[tuple(voxel)]:
        raise ValueError(f"goal is {at}, in a keep-out box; accepted: outside of all")
    side = world.resolution
    goal = np.asarray(check.position, np.float64) - np.asarray(world.origin, np.float64)
    centres = (np.argwhere(places)[:, ::-1] + 0.5) * side
    nearest = float(np.linalg.norm(centres - goal, axis=1).min())
    # Between the centres of voxels there is room as well.
    most = max(float(check.radius), side)
    if nearest > most:
        raise ValueError(
            f"goal is {at}, which a robot of radius {radius:g} m cannot reach from its start: "
            f"{nearest:.2f} m is the nearest it gets; accepted: a goal within "
            f"{most:g} m of where it can go"
        )


def _check_perception(
    perception: VolumePerception | None,
    sensors: tuple[VolumeSensor, ...],
    world: VoxelGrid,
    robot: Quadrotor,
    check: GoalCheck | None,
) -> VolumePerception:
    """Check that a perception has the goal of a scenario, or make one when absent."""
    goal, heading = (None, None) if check is None else (check.position, check.heading)
    if perception is None:
        return VolumePerception(
            sensors, world.resolution, robot.radius, goal=goal, goal_heading=heading
        )
    for name, own, wanted in (
        ("goal", perception.goal, goal),
        ("goal_heading", perception.goal_heading, heading),
    ):
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
    where = f"start is {_show(start, datum)}"
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
