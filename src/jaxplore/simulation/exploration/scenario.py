"""The exploration scenario: a robot with sensors in an unknown world."""

import dataclasses
import functools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float

from jaxplore import _checks
from jaxplore._types import (
    ControlVector,
    Count,
    Flag,
    GridMask,
    GridValues,
    Key,
    Pose,
    Position,
    Rows,
    Scalar,
    StateVector,
    Vector,
)
from jaxplore.belief.belief import Belief
from jaxplore.belief.obstacles import Obstacles
from jaxplore.belief.perception import MAX_UNKNOWN, Perception, as_sensors
from jaxplore.belief.zones import unknown_fraction
from jaxplore.control.base import Controller, Info
from jaxplore.dynamics.base import Dynamics
from jaxplore.geometry.angles import sin_cos
from jaxplore.maps.ground import Ground
from jaxplore.maps.occupancy_grid import FREE_THRESHOLD, OccupancyGrid
from jaxplore.maps.terrain import TerrainMap
from jaxplore.report.exploration.belief_picture import belief_picture
from jaxplore.report.exploration.data import ExplorationFrame, ExplorationRecord, MapProgress
from jaxplore.report.exploration.metrics import ExplorationMetrics
from jaxplore.report.exploration.recording import ExplorationRecording
from jaxplore.sensing.base import Scan, Sensor
from jaxplore.simulation.chunks import ChunkedRun
from jaxplore.simulation.exploration.checks import (
    check_goal,
    checked_targets,
    is_same_frame,
    is_same_ground,
    whole_steps,
    with_closed,
)
from jaxplore.simulation.exploration.collision import (
    clearance_reach,
    discs_clearance,
    footprint_clearance,
)
from jaxplore.simulation.exploration.moving_obstacles import MovingObstacles
from jaxplore.simulation.exploration.reachability import reachable_cells
from jaxplore.simulation.faults import Faults
from jaxplore.simulation.outline import footprint_corners
from jaxplore.simulation.scenario import Inspect, Moment, Scenario, state_bounds

WHOLE_MAP = 100.0
"""Total reward for making an unknown map certain."""
START_OF_MOVING = 2**31 - 1
"""Number folded into the key of a run to draw the start of moving obstacles. It is never a step's
number, so the draw is independent of the steps."""


class ExplorationState(NamedTuple):
    """State of the exploration task.

    Args:
        robot: (nx,) true state of the robot.
        belief: the robot's belief.
        progress: statistics of the known map, as of the last map update.
        finished: number of steps since the task was finished; 0 before.
        is_seen: (M,) whether each target has been seen.
        moving_obstacles: moving obstacles with their drawn starts; None without any.
        ranges: (B,) ranges of the last scan, sensor by sensor [m].
    """

    robot: StateVector
    belief: Belief
    progress: MapProgress
    finished: Count
    is_seen: Bool[Array, " M"]
    moving_obstacles: MovingObstacles | None
    ranges: Float[Array, " B"]


class ExplorationScenario(Scenario):
    """Exploration of an unknown world by a robot with sensors.

    When it is finished depends on the task:

    - By default: at the target coverage.
    - With a goal: within `goal_radius` of it, with less than `max_unknown` of the map unknown or at
      the target coverage. With a goal apart (see `Perception`) the robot drives to the goal first
      and explores on the way.
    - With `targets`: when the first sensor has seen all of them.
    - Without target coverage, goal and targets, as on a patrol: never before the time limit.

    Cells that the world does not know to be free are solid. *Reachable* are the free cells that the
    centre of the robot's disc can reach from the start. Coverage is the share of them that the
    robot's map knows to be free.

    The robot knows the ground of a terrain map, but not the obstacles on it. Untraversable cells do
    not stop the robot: it can enter them, which is recorded.

    The constructor is long because it checks every argument, and each against the others, before
    anything is simulated.

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
        target_coverage: share of the reachable cells at which exploration is finished; None for
            never.
        prior: map that the robot knows in advance, with the cells of the world; nothing when
            absent.
        goal: goal position (x, y) [m]; none when absent.
        goal_radius: distance at which the goal is reached [m]; when absent 1.5, or 0.25 for a
            goal apart.
        max_unknown: share of cells with `4 p (1 - p) > 1/2` below which the map is explored; when
                absent 0.05, or 1 for a goal apart, which then needs no explored map.
        altitude: z of the start, for robots that have one [m].
        hover_time: time that is simulated after the end [s].
        faults: injected faults; none when absent.
        targets: (M, 2) positions of the targets to find [m]; none when absent.
        moving_obstacles: true moving obstacles; none when absent. The robot's tracker measures
            those in sight of any sensor. Their start is drawn from the run's key.
        tracking_noise: standard deviations of the tracker's positions [m] and velocities [m/s].

    Raises:
        ValueError: a perception made for another range, resolution or goal; a start that is off the
            map, in a wall, in unknown space, or so close to either that the robot touches it; a
            rate that is not positive, above the control rate or no whole fraction of it; a target
            coverage outside (0, 1]; a prior or walls of another shape; a goal off the map, in a
            wall, or where the robot cannot get from its start; a target off the map or in a
            wall.
    """

    frame_type = ExplorationFrame
    metrics_type = ExplorationMetrics

    world: OccupancyGrid
    robot: Dynamics
    sensors: tuple[Sensor, ...]
    perception: Perception
    start: StateVector
    reachable: GridMask
    control_period: Scalar
    steps_per_scan: Count
    steps_per_field: Count
    target_coverage: Scalar
    prior: OccupancyGrid
    goal: Position | None
    goal_radius: Scalar
    max_unknown: Scalar
    hover_steps: Count
    faults: Faults | None
    ground: Ground | None
    targets: Float[Array, "M 2"]
    moving_obstacles: MovingObstacles | None
    tracking_noise: Float[Array, "2"]
    clearance_reach: int = eqx.field(static=True)

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
        target_coverage: ArrayLike | None = 0.99,
        prior: OccupancyGrid | None = None,
        goal: Vector | None = None,
        goal_radius: ArrayLike | None = None,
        max_unknown: ArrayLike | None = None,
        altitude: float = 0.0,
        hover_time: float = 0.0,
        faults: Faults | None = None,
        targets: Rows | None = None,
        moving_obstacles: MovingObstacles | None = None,
        tracking_noise: Vector = (0.05, 0.1),
    ) -> None:
        pose = np.asarray(_checks.vector("start", start, 3), np.float64)
        self.ground = None
        if isinstance(world, TerrainMap):
            self.ground = world.ground
            world = world.grid
        self.world, self.robot, self.sensors = world, robot, as_sensors(sensors)
        is_still = moving_obstacles is None or moving_obstacles.radius.shape[0] == 0
        self.moving_obstacles = None if is_still else moving_obstacles
        self.tracking_noise = _checks.vector("tracking_noise", tracking_noise, 2)
        if (np.asarray(self.tracking_noise) < 0.0).any():
            raise ValueError(
                f"tracking_noise is {self.tracking_noise.tolist()}; accepted: 2 numbers >= 0"
            )
        self.goal = None if goal is None else _checks.vector("goal", goal, 2)
        is_apart = perception is not None and perception.is_goal_apart
        if goal_radius is None:
            goal_radius = 0.25 if is_apart else 1.5
        if max_unknown is None:
            max_unknown = 1.0 if is_apart else MAX_UNKNOWN
        self.goal_radius = _checks.scalar("goal_radius", goal_radius, above=0.0)
        self.max_unknown = _checks.scalar("max_unknown", max_unknown, at_least=0.0, at_most=1.0)
        if perception is None:
            perception = Perception(
                self.sensors,
                world.resolution,
                robot.radius,
                goal=self.goal,
                max_unknown=self.max_unknown,
                ground=self.ground,
            )
        self.perception = perception
        goals = [None if each is None else each.tolist() for each in (perception.goal, self.goal)]
        if goals[0] != goals[1]:
            raise ValueError(
                f"perception has the goal {goals[0]}; accepted: the scenario's, {goals[1]}"
            )
        if self.goal is not None and float(world.at(self.goal)) >= FREE_THRESHOLD:
            raise ValueError(f"goal is {self.goal.tolist()}; accepted: a place in free space")
        self.prior = OccupancyGrid.unknown(world.shape, world.frame) if prior is None else prior
        walls = None if faults is None else faults.walls
        for name, shape in (("prior", self.prior.shape), ("walls", getattr(walls, "shape", None))):
            if shape not in (None, world.shape):
                raise ValueError(f"{name} has shape {shape}; accepted: the world's, {world.shape}")
        if not is_same_frame(self.prior, world):
            raise ValueError(
                f"prior has cells of {self.prior.resolution:g} m at "
                f"{self.prior.frame.origin.tolist()}; accepted: the world's, "
                f"{world.resolution:g} m at {world.frame.origin.tolist()}"
            )
        self.faults = faults
        ranges, known = (
            [sensor.max_range for sensor in each] for each in (self.sensors, perception.sensors)
        )
        if known != ranges or perception.resolution != world.resolution:
            raise ValueError(
                f"perception is for ranges of {known} m and cells of {perception.resolution:g} m; "
                f"accepted: those of the scenario, {ranges} m and {world.resolution:g} m"
            )
        if not is_same_ground(perception.ground, self.ground):
            kind = "no" if perception.ground is None else "another"
            raise ValueError(f"perception has {kind} ground; accepted: that of the world")
        state = robot.at_pose(*(float(value) for value in pose))
        if "z" in robot.state_names:
            z = _checks.number("altitude", altitude)
            state = state.at[robot.state_names.index("z")].set(z)
        self.start = state
        passable = world if self.ground is None else with_closed(world, self.ground)
        self.reachable = jnp.asarray(reachable_cells(passable, pose, float(robot.radius)))
        if self.goal is not None:
            check_goal(self.goal, world, robot, self.reachable, float(self.goal_radius))
        self.targets = checked_targets(targets, world)
        self.clearance_reach = clearance_reach(robot.footprint, world.resolution)
        rate = _checks.number("control_rate", control_rate, above=0.0)
        self.control_period = jnp.asarray(1.0 / rate, jnp.float32)
        self.steps_per_scan = whole_steps("sensing_rate", sensing_rate, rate)
        self.steps_per_field = whole_steps("field_rate", field_rate, rate)
        hover = _checks.number("hover_time", hover_time, at_least=0.0)
        self.hover_steps = jnp.asarray(round(hover * rate), jnp.int32)
        # A value that coverage never reaches: infinity keeps the leaf an array.
        self.target_coverage = (
            jnp.asarray(2.0, jnp.float32)
            if target_coverage is None
            else _checks.scalar("target_coverage", target_coverage, above=0.0, at_most=1.0)
        )

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
        return self.world.resolution

    @property
    def objective(self) -> str:
        """Default objective: time to the end, or the idleness of a patrol, plus contacts."""
        if self.num_targets:
            return "last_target_at + 100*collisions"
        if self.goal is None and float(self.target_coverage) > 1.0:
            return "mean_idleness + 100*collisions"
        return "finished_at + 100*collisions"

    @property
    def num_reachable(self) -> Scalar:
        """Number of reachable cells."""
        return jnp.sum(self.reachable, dtype=jnp.float32)

    def init(self, key: Key | None) -> tuple[ExplorationState, Belief]:
        """Return the initial state, and the belief with the prior map."""
        belief = self.perception.init(self.prior, robot_pose(self.robot, self.start))
        moving = self.moving_obstacles
        if moving is not None:
            if key is not None:
                start_key = jax.random.fold_in(key, START_OF_MOVING)
                phases = jax.random.uniform(start_key, moving.phase.shape)
                moving = eqx.tree_at(lambda some: some.phase, moving, phases)
            belief = dataclasses.replace(belief, obstacles=Obstacles.unseen(moving.radius))
        state = ExplorationState(
            robot=self.start,
            belief=belief,
            progress=self._map_progress(belief, jnp.zeros(())),
            finished=jnp.zeros((), jnp.int32),
            is_seen=jnp.zeros(self.num_targets, bool),
            moving_obstacles=moving,
            ranges=jnp.asarray(self._max_ranges()),
        )
        return state, belief

    def perceive(
        self, state: ExplorationState, moment: Moment, key: Key
    ) -> tuple[ExplorationState, Belief]:
        """Scan and update the map at the sensing rate, derive the fields at the field rate."""
        perception, period = self.perception, self.control_period
        world, step = self.world_at(moment.step), moment.step
        # The scan is taken at the true pose and integrated at the observed one, so that odometry
        # faults distort the map.
        pose = robot_pose(self.robot, moment.observed)
        is_placed = jnp.isfinite(pose).all()

        def sense(
            belief: Belief, _: MapProgress, is_seen: Array, __: Array
        ) -> tuple[Belief, MapProgress, Array, Array]:
            at = robot_pose(self.robot, state.robot)
            scans = self.scans(world, at, state.moving_obstacles, moment.time, key)
            since = period * self.steps_per_scan.astype(jnp.float32)
            belief = perception.observe(belief, scans, pose, since)
            if self.num_targets > 0:
                is_seen |= self.sensors[0].sees(world, at, self.targets, self.ground)
            if state.moving_obstacles is not None:
                belief = self._tracked(world, belief, at, state.moving_obstacles, moment.time, key)
            ranges = jnp.concatenate([scan.ranges for scan in scans])
            return belief, self._map_progress(belief, moment.time), is_seen, ranges

        belief = state.belief
        if belief.obstacles is not None:
            belief = dataclasses.replace(belief, obstacles=belief.obstacles.after(period))
        # The condition depends on the clock alone. The clock is the same for all runs of a batch,
        # so under vmap this stays a branch and a batch senses and derives only as often as one run.
        belief, progress, is_seen, ranges = jax.lax.cond(
            step % self.steps_per_scan == 0,
            lambda *known: jax.lax.cond(~moment.is_blind & is_placed, sense, _same, *known),
            _same,
            belief,
            state.progress,
            state.is_seen,
            state.ranges,
        )
        # The fields are derived one step before a strategic layer of the same rate runs: it reads
        # fresh fields, and no single step has the cost of both.
        every = self.steps_per_field
        elapsed = period * every.astype(jnp.float32)

        def derive(current: Belief) -> tuple[Belief]:
            return (perception.update_fields(current, pose, elapsed),)

        (belief,) = jax.lax.cond(
            (step % every == every - 1) | (step == 0),
            lambda current: jax.lax.cond(is_placed, derive, _same, current),
            _same,
            belief,
        )
        known = state._replace(belief=belief, progress=progress, is_seen=is_seen, ranges=ranges)
        return known, belief

    def advance(
        self, state: ExplorationState, control: ControlVector, moment: Moment, info: Info
    ) -> tuple[ExplorationState, ExplorationRecord]:
        """Move the robot and record the step.

        If the move would touch something solid, the robot stops instead, and the step counts as a
        collision.
        """
        model, period, progress = self.robot, self.control_period, state.progress
        moved = model.step(state.robot, control, period)
        clearance = functools.partial(
            self._clearance,
            self.world_at(moment.step),
            state.moving_obstacles,
            moment.time + period,
        )
        is_finite = jnp.all(jnp.isfinite(moved))
        is_collision = is_finite & (clearance(moved) < 0.0)
        blocked = model.blocked(state.robot, moved)
        robot = jnp.where(is_collision, blocked, jnp.where(is_finite, moved, state.robot))
        is_over = self._is_finished(robot, progress, state.is_seen) | (state.finished > 0)
        record = ExplorationRecord(
            state=robot,
            control=control,
            coverage=progress.coverage,
            entropy=progress.entropy,
            unknown=progress.unknown,
            clearance=clearance(robot),
            is_collision=is_collision,
            is_untraversable=self._is_untraversable(robot),
            effective_sample_size=info.effective_sample_size,
            is_finite=info.is_finite,
            is_faulty=moment.is_faulty,
            members=info.members,
            targets_seen=jnp.sum(state.is_seen, dtype=jnp.int32),
            mean_idleness=progress.mean_idleness,
            worst_idleness=progress.worst_idleness,
        )
        finished = state.finished + is_over.astype(jnp.int32)
        return state._replace(robot=robot, finished=finished), record

    def is_unfinished(self, state: ExplorationState) -> Flag:
        """Check whether the loop continues: until the task is finished, plus the hover time.

        A scenario without a goal whose coverage is reached at the start takes no step.
        """
        is_over = state.finished > self.hover_steps
        if self.goal is None and self.num_targets == 0:
            is_done = state.progress.coverage >= self.target_coverage
            is_over = is_over | (is_done & (self.hover_steps == 0))
        return ~is_over

    def progress(self, state: ExplorationState) -> tuple[float, str]:
        """Return a share of 0, because the time left is unknown, and the coverage as text."""
        return 0.0, f"coverage {float(state.progress.coverage):6.1%}"

    def for_batches(self) -> "ExplorationScenario":
        """Return the scenario with a perception that is efficient under `jax.vmap`."""
        batched = self.perception.for_batches()
        same: ExplorationScenario = eqx.tree_at(lambda at: at.perception, self, batched)
        return same

    def frame(
        self, state: ExplorationState, moment: Moment, inspect: Inspect | None, key: Key
    ) -> dict[str, Any]:
        """Return the belief, a scan, and the plan before a step; see `ExplorationFrame`."""
        pose = robot_pose(self.robot, state.robot)
        world, moving = self.world_at(moment.step), state.moving_obstacles
        # Only the scan of the first sensor is drawn: it is the one that fills the map.
        scan, *_ = self.scans(world, pose, moving, moment.time, key)
        angles = pose[2] + jnp.asarray(self.sensors[0].beam_angles)
        directions = jnp.stack([jnp.cos(angles), jnp.sin(angles)], axis=-1)
        nowhere = jnp.zeros((0, 2))
        arrays = {
            "state": state.robot,
            "probability": jnp.round(255.0 * state.belief.grid.probability).astype(jnp.uint8),
            "information": state.belief.information.total,
            "scan": pose[:2] + scan.ranges[:, None] * directions,
            "samples": jnp.zeros((0, 1, 2)),
            "weights": jnp.zeros(0),
            "plan": nowhere,
            "heading": pose[2],
            "reference": nowhere,
            "movers": nowhere if moving is None else moving.at(moment.time).positions,
            "terms": {},
        }
        if inspect is None:
            return arrays
        plan = inspect(state.robot, state.belief)
        position = jax.vmap(self.robot.position)
        return arrays | {
            "samples": jax.vmap(position)(plan.samples),
            "weights": plan.weights,
            "plan": position(plan.nominal.states),
            "reference": nowhere if plan.reference is None else plan.reference[:, :2],
            "terms": plan.nominal.terms,
        }

    def observation(
        self, state: ExplorationState, moment: Moment, belief: Belief, view_cells: int | None
    ) -> dict[str, Array]:
        """Return the belief, the pose, the state and the last scan.

        `belief` is the occupancy probability of each cell (H, W), or of the cells around the robot
        (N, N), columns ahead and rows to the left. `pose` is the observed pose (x, y, yaw)
        [m, m, rad], yaw in [-pi, pi]. `state` (nx,) is the observed state, with the same yaw.
        `scan` (B,) are the ranges of the last scan, sensor by sensor [m].
        """
        told, grid = moment.observed, belief.grid
        x, y, yaw = robot_pose(self.robot, told)
        yaw = jnp.arctan2(jnp.sin(yaw), jnp.cos(yaw))
        pose = jnp.stack([x, y, yaw])
        is_yaw = jnp.asarray([name == "yaw" for name in self.robot.state_names])
        return {
            "belief": grid.probability if view_cells is None else _around(grid, pose, view_cells),
            "pose": pose,
            "scan": state.ranges,
            "state": jnp.where(is_yaw, yaw, told),
        }

    def observation_bounds(
        self, view_cells: int | None
    ) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Return the bounds of `observation`: the corners of the map, and the sensors' ranges."""
        rows, columns = self.world.shape
        corners = np.array([(0, 0), (0, columns), (rows, 0), (rows, columns)], np.float32)
        placed = np.asarray(self.world.frame.to_world(jnp.asarray(corners)))
        pose = np.append(placed.min(axis=0), -np.pi), np.append(placed.max(axis=0), np.pi)
        low, high = state_bounds(self.robot)
        for name, least, greatest in zip(("x", "y", "yaw"), *pose, strict=True):
            if name in self.robot.state_names:
                column = self.robot.state_names.index(name)
                low[column], high[column] = least, greatest
        shape = self.world.shape if view_cells is None else (view_cells, view_cells)
        reach = self._max_ranges()
        return {
            "belief": (np.zeros(shape, np.float32), np.ones(shape, np.float32)),
            "pose": pose,
            "scan": (np.zeros_like(reach), reach),
            "state": (low, high),
        }

    def reward(self, before: ExplorationState, after: ExplorationState) -> Scalar:
        """Return `100 (H_before - H_after) / (ln 2 * reachable cells)`.

        H is the entropy of the belief over the reachable cells [nat]. The rewards of a run on an
        unknown map add up to about 100, less the share of the first scan. A reward may be negative:
        noise can make cells less certain.
        """
        most = math.log(2.0) * self.num_reachable
        return WHOLE_MAP / most * (before.progress.entropy - after.progress.entropy)

    def is_contact(self, record: ExplorationRecord) -> Flag:
        """Check whether the step would have led to a collision."""
        return record.is_collision

    def has_ended(self, state: ExplorationState, ahead: ExplorationState) -> Flag:
        """Check whether the scenario is finished at the present position."""
        # The state one step ahead includes the present scan, which may complete the coverage or the
        # targets. But there the robot has moved, so a goal is checked at the present position.
        known = ahead if self.goal is None else state
        return known.finished > self.hover_steps

    def facts(self, state: ExplorationState) -> dict[str, Scalar]:
        """Return the coverage, and the entropy over the reachable cells [nat]."""
        return {"coverage": state.progress.coverage, "entropy": state.progress.entropy}

    def picture(self, state: ExplorationState, moment: Moment, trail: np.ndarray) -> np.ndarray:
        """Draw the belief, the trail, the last scan and the robot."""
        pose = np.asarray(robot_pose(self.robot, moment.observed))
        angles = pose[2] + np.concatenate([sensor.beam_angles for sensor in self.sensors])
        directions = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        frame = self.world.frame
        return belief_picture(
            np.asarray(state.belief.grid.probability),
            np.asarray(frame.origin),
            frame.resolution,
            path=trail,
            heading=float(pose[2]),
            radius=float(self.robot.radius),
            footprint=footprint_corners(self.robot.footprint),
            scan=pose[:2] + np.asarray(state.ranges)[:, None] * directions,
        )

    def _max_ranges(self) -> np.ndarray:
        """Return the greatest range (B,) of every beam of every sensor [m]."""
        return np.concatenate(
            [np.full(sensor.num_beams, sensor.max_range, np.float32) for sensor in self.sensors]
        )

    def recording(
        self,
        controller: Controller | None,
        before: ExplorationState,
        run: ChunkedRun[Any, ExplorationRecord, ExplorationFrame],
    ) -> ExplorationRecording:
        """Make the recording of a run."""
        last: ExplorationState = run.state.task
        belief, ground, moving = last.belief, self.ground, self.moving_obstacles
        target = float(self.target_coverage)
        is_finished = int(last.finished) > 0
        return ExplorationRecording(
            **run.common(self.period),
            world=np.asarray(self.world.probability),
            belief=np.asarray(belief.grid.probability),
            reachable=np.asarray(self.reachable),
            origin=np.asarray(self.world.frame.origin),
            resolution=self.world.resolution,
            field_origin=np.asarray(belief.information.frame.origin),
            field_resolution=belief.information.frame.resolution,
            start=np.asarray(self.start),
            initial_coverage=float(before.progress.coverage),
            initial_entropy=float(before.progress.entropy),
            initial_unknown=float(before.progress.unknown),
            goal=None if self.goal is None else np.asarray(self.goal),
            control_half_range=np.asarray(self.robot.control_half_range),
            finished_step=run.num_steps - int(last.finished) + 1 if is_finished else None,
            state_names=self.robot.state_names,
            robot_radius=float(self.robot.radius),
            target_coverage=None if target > 1.0 else target,
            footprint=footprint_corners(self.robot.footprint),
            targets=np.asarray(self.targets),
            elevation=None if ground is None else np.asarray(ground.elevation),
            traversable=None if ground is None else np.asarray(ground.is_traversable),
            idleness=None if belief.idleness is None else np.asarray(belief.idleness),
            mover_radii=np.zeros(0) if moving is None else np.asarray(moving.radius),
            member_names=() if controller is None else controller.member_names,
        )

    def world_at(self, step: Count) -> OccupancyGrid:
        """Return the true map after a number of steps, with the walls that have appeared."""
        if self.faults is None:
            return self.world
        return self.faults.world(self.world, self.control_period * step.astype(jnp.float32))

    def scans(
        self,
        world: OccupancyGrid,
        pose: Pose,
        moving: MovingObstacles | None,
        time: Scalar,
        key: Key,
    ) -> tuple[Scan, ...]:
        """Simulate a scan of each sensor from a pose at a time."""
        discs = None if moving is None else moving.discs(time)
        keys = [key, *(jax.random.fold_in(key, k) for k in range(1, len(self.sensors)))]
        return tuple(
            sensor.scan(world, pose, key=each, ground=self.ground, movers=discs)
            for sensor, each in zip(self.sensors, keys, strict=True)
        )

    def _tracked(
        self,
        world: OccupancyGrid,
        belief: Belief,
        pose: Pose,
        moving: MovingObstacles,
        time: Scalar,
        key: Key,
    ) -> Belief:
        """Update the belief by the tracker's measurements of obstacles in sight of a sensor."""
        assert belief.obstacles is not None
        now = moving.at(time)
        position_std, velocity_std = self.tracking_noise
        keys = jax.random.split(jax.random.fold_in(key, START_OF_MOVING), 2)
        in_sight = [sensor.sees(world, pose, now.positions, self.ground) for sensor in self.sensors]
        obstacles = belief.obstacles.update(
            now.positions + position_std * jax.random.normal(keys[0], now.positions.shape),
            now.velocities + velocity_std * jax.random.normal(keys[1], now.velocities.shape),
            functools.reduce(jnp.logical_or, in_sight),
            position_std,
            jnp.zeros(()),
        )
        return dataclasses.replace(belief, obstacles=obstacles)

    def _map_progress(self, belief: Belief, time: Scalar) -> MapProgress:
        """Compute coverage, entropy, the share of unknown cells and the idleness."""
        reachable = self.reachable
        known = jnp.sum(belief.grid.is_free & reachable, dtype=jnp.float32)
        mean, worst = jnp.zeros(()), jnp.zeros(())
        if belief.idleness is not None:
            idle = jnp.where(reachable, jnp.minimum(belief.idleness, time), 0.0)
            mean, worst = jnp.sum(idle) / self.num_reachable, jnp.max(idle)
        return MapProgress(
            coverage=known / self.num_reachable,
            entropy=jnp.sum(jnp.where(reachable, belief.grid.entropy, 0.0)),
            unknown=unknown_fraction(belief.grid),
            mean_idleness=mean,
            worst_idleness=worst,
        )

    def _clearance(
        self, world: OccupancyGrid, moving: MovingObstacles | None, time: Scalar, robot: StateVector
    ) -> Scalar:
        """Compute the distance from the robot's edge to the nearest solid cell or obstacle [m]."""
        model = self.robot
        position, heading = model.position(robot), model.heading(robot)
        room = footprint_clearance(
            ~world.is_free, world.frame, position, heading, model.footprint, self.clearance_reach
        )
        if moving is None:
            return room
        there = moving.at(time).positions
        gap = discs_clearance(there, moving.radius, position, heading, model.footprint)
        return jnp.minimum(room, gap)

    def _is_untraversable(self, robot: StateVector) -> Flag:
        """Check whether part of the robot is on untraversable ground."""
        if self.ground is None:
            return jnp.array(False)
        model, closed = self.robot, ~self.ground.is_traversable
        position, heading = model.position(robot), model.heading(robot)
        room = footprint_clearance(
            closed, self.world.frame, position, heading, model.footprint, self.clearance_reach
        )
        return room < 0.0

    def _is_finished(
        self, robot: StateVector, progress: MapProgress, is_seen: Bool[Array, " M"]
    ) -> Flag:
        is_covered = progress.coverage >= self.target_coverage
        if self.num_targets > 0:
            is_covered = jnp.all(is_seen)
        if self.goal is None:
            return is_covered
        offset = self.robot.position(robot) - self.goal
        is_there = jnp.sum(offset * offset) < self.goal_radius**2
        if self.num_targets == 0:
            is_covered |= progress.unknown < self.max_unknown
        return is_there & is_covered


def robot_pose(robot: Dynamics, state: StateVector) -> Pose:
    """Return the pose (x, y, yaw) [m, m, rad] of a state."""
    return jnp.concatenate([robot.position(state), robot.heading(state)[None]])


def _around(grid: OccupancyGrid, pose: Pose, size: int) -> GridValues:
    """Sample the map around a pose, columns ahead and rows to the left; 1 off the map."""
    along = grid.resolution * (jnp.arange(size, dtype=jnp.float32) + 0.5 - 0.5 * size)
    left, ahead = jnp.meshgrid(along, along, indexing="ij")
    x, y, yaw = pose
    sin, cos = sin_cos(yaw)
    return grid.at(jnp.stack([x + cos * ahead - sin * left, y + sin * ahead + cos * left], axis=-1))


def _same[*T](*unchanged: *T) -> tuple[*T]:
    return unchanged
