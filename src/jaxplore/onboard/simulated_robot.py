"""A simulated robot that obeys velocity commands: the plant on the other side of a pilot."""

import collections
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxplore import _checks, _kinds
from jaxplore._types import ControlVector, Key, Pose, Scalar, StateVector
from jaxplore.control.base import Info
from jaxplore.dynamics.base import Dynamics
from jaxplore.geometry.motion import compose
from jaxplore.onboard.frames import EvenFrames
from jaxplore.onboard.motors import Motors
from jaxplore.onboard.odometry import extrapolate_pose
from jaxplore.onboard.steps import initial
from jaxplore.report.compute import Timing
from jaxplore.report.exploration.recording import ExplorationRecording
from jaxplore.report.recording import Frame
from jaxplore.sensing.beams import Scan
from jaxplore.sensing.lidar import Lidar
from jaxplore.simulation.chunks import ChunkedRun
from jaxplore.simulation.exploration.judge import Judge
from jaxplore.simulation.exploration.part_truth import Vantage
from jaxplore.simulation.exploration.progress import map_progress
from jaxplore.simulation.exploration.scenario import ExplorationScenario
from jaxplore.simulation.exploration.state import ExplorationState
from jaxplore.simulation.loop import step_keys
from jaxplore.simulation.state import LoopState, Moment

NEWTON_STEPS = 3
"""Steps of the search for a control; one is exact where no bound is met."""
DRIFT_KEY = 7
"""Number that is folded into the key of a run for the errors of its odometry."""


class RobotMeasurement(NamedTuple):
    """What a robot measures at a time.

    `pose` (3,) is that by the odometry. `true_pose` (3,) is the true one in the coordinates of the
    map, for what stands in for a SLAM. `twist` (3,) is in the frame of the robot. The scan is None
    between scans; `scan_age` is the time since its first reading [s]. Units are m, rad, m/s and
    rad/s.
    """

    pose: np.ndarray
    twist: np.ndarray
    scan: Scan | None
    true_pose: np.ndarray
    scan_age: float = 0.0


class SimulatedRobot:
    """A robot in the world of a scenario that obeys velocity commands.

    The robot's own controller sets the control that comes closest to the commanded velocity within
    the limits of the model. A watchdog brakes without a command for `watchdog` seconds. The robot
    keeps the map of what its lidar has seen, placed by the true pose, by which the run is judged.

    Args:
        scenario: world, robot, lidar, start and rates.
        key: random key of the run.
        delay: time between a command and its effect [s]; whole control periods.
        drift: standard deviation of the scale errors of the odometry's distances and turns, drawn
            once; 0 for a perfect odometry.
        watchdog: time without a command after which the robot brakes [s].
        mount: pose (x, y, yaw) of the lidar on the robot [m, m, rad].
        motors: motors of the base; their delay comes on top of `delay`. They obey at once when
            absent.
        is_turning: whether the lidar turns once between two scans. Each beam is then measured from
            where the lidar is when it points there, to within half a control period, and a scan is
            there when its last beam is.

    Attributes:
        num_contacts: number of periods in which something solid stopped the robot.
        watchdog_stops: number of times that the watchdog stopped the robot.

    Raises:
        ValueError: an argument of another class; a negative delay or drift; a watchdog that is not
            positive; a lidar of the scenario with a mount of its own.
    """

    @_kinds.check_arguments
    def __init__(
        self,
        scenario: ExplorationScenario,
        key: Key,
        *,
        delay: float = 0.0,
        drift: float = 0.0,
        watchdog: float = 0.25,
        mount: Sequence[float] = (0.0, 0.0, 0.0),
        is_turning: bool = False,
        motors: Motors | None = None,
    ) -> None:
        _kinds.key("key", key)
        first = scenario.sensors[0]
        if isinstance(first, Lidar) and first.mount is not None:
            raise ValueError(
                "the lidar of the scenario has a mount; accepted: none, but the arguments mount "
                "and is_turning"
            )
        self.scenario, self._key = scenario.with_target_coverage(), key
        self.period = scenario.period
        self._motors = Motors() if motors is None else motors
        delay = _checks.number("delay", delay, at_least=0.0) + self._motors.delay
        periods = round(delay / self.period)
        self._pending = collections.deque([np.zeros(3)] * periods)
        self._watchdog = _checks.number("watchdog", watchdog, above=0.0)
        self.mount = _checks.pose("mount", mount)
        self.is_turning = _kinds.flag("is_turning", is_turning)
        self._turn: list[Scan] = []
        scale = _checks.number("drift", drift, at_least=0.0)
        errors = jax.random.normal(jax.random.fold_in(key, DRIFT_KEY), (2,))
        distance, turn = (1.0 + scale * np.asarray(errors, np.float64)).tolist()
        self._scale = np.array([distance, distance, turn])
        self._before: ExplorationState = initial(scenario, key)
        self.state = self._before
        self._pose = np.asarray(scenario.robot.pose(scenario.start), np.float64)
        # What leaves the robot is in the coordinates of the map.
        self._odometry = np.array(scenario.datum.to_map(self._pose))
        self._twist = self._velocity = np.zeros(3)
        self._commanded, self._commanded_at = np.zeros(3), -math.inf
        self._records: list[Any] = []
        self.frames = EvenFrames()
        self.num_steps = 0
        self.watchdog_stops = self.num_contacts = 0

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self.num_steps * self.period

    @property
    def coverage(self) -> float:
        """Share of the reachable cells that the lidar has seen to be free."""
        return float(self.state.progress.coverage)

    @property
    def velocity(self) -> np.ndarray:
        """Velocity (vx, vy, omega) by the odometry, in the frame of the robot."""
        return self._twist

    @property
    def is_finished(self) -> bool:
        """Whether the task of the scenario is finished."""
        return not bool(self.scenario.is_unfinished(self.state))

    def prepare(self) -> None:
        """Compile everything that a step calls."""
        moment = self._moment()
        measured = _measure(self.scenario, self.state, moment, self._key, self.mount)
        looked = _scan(self.scenario, self.state, moment, self._key, self.mount)
        moved = _advance(self.scenario, self.state, moment, jnp.zeros(3))
        shown = _frame(self.scenario, self.state, moment, self._key)
        jax.block_until_ready((measured, looked, moved, shown))  # type: ignore[no-untyped-call]

    def set_velocity(self, twist: np.ndarray) -> None:
        """Take a command; one that is not finite counts as none.

        Args:
            twist: (3,) velocity (vx, vy, omega) in the frame of the robot.
        """
        given = np.asarray(twist, np.float64)
        if given.shape == (3,) and np.isfinite(given).all():
            self._commanded, self._commanded_at = given, self.time

    def step(self) -> RobotMeasurement:
        """Measure, then advance by a control period; return what was measured at its start."""
        scenario = self.scenario
        measure_key, _ = step_keys(self._key, jnp.asarray(self.num_steps, jnp.int32))
        scan, age, number = None, 0.0, int(scenario.steps_per_scan)
        given = (scenario, self.state, self._moment(), measure_key, self.mount)
        if self.is_turning:
            self._turn.append(_scan(*given))
        if self.num_steps % number == 0:
            self.state, scan = _measure(*given)
            if self.is_turning:
                scan, age = self._end_turn(number), number * self.period
        place = np.array(scenario.datum.to_map(self._pose))
        measured = RobotMeasurement(self._odometry.copy(), self._twist.copy(), scan, place, age)
        is_late = self.time - self._commanded_at > self._watchdog
        if is_late and self._commanded.any():
            self._commanded = np.zeros(3)
            self.watchdog_stops += 1
        self._pending.append(self._commanded)
        driven = self._motors.respond(self._velocity, self._pending.popleft(), self.period)
        wanted = jnp.asarray(driven, jnp.float32)
        self.state, record, pose, twist = _advance(scenario, self.state, self._moment(), wanted)
        self._records.append(jax.tree.map(np.asarray, record))
        self.num_contacts += bool(record.is_collision)
        self.num_steps += 1
        self._move(np.asarray(pose, np.float64), np.asarray(twist, np.float64))
        return measured

    def recording(self, *, is_interrupted: bool) -> ExplorationRecording:
        """Make the recording of the run.

        Args:
            is_interrupted: whether the run was stopped before its end.
        """
        scenario = self.scenario
        if self._records:
            records = jax.tree.map(lambda *rows: np.stack(rows), *self._records)
        else:
            blank = scenario.blank_records(self.state, None, 1)
            records = jax.tree.map(lambda leaf: np.zeros((0, *leaf.shape[1:]), leaf.dtype), blank)
        robot = scenario.robot
        loop = LoopState(
            self.state,
            (),
            jnp.asarray(self.num_steps, jnp.int32),
            self.state.robot,
            jnp.zeros((0, robot.control_size)),
        )
        run: ChunkedRun[Any, Any, Any] = ChunkedRun(
            loop,
            records,
            self.frames.all,
            Timing(0.0, 0.0, 0, np.zeros(0)),
            self.num_steps,
            is_interrupted,
        )
        return scenario.recording(None, self._before, run)

    def make_frame(self) -> Frame:
        """Make a frame of the present moment, without a plan: the robot does not know it."""
        arrays = _frame(self.scenario, self.state, self._moment(), self._key)
        return self.scenario.make_frame(self.num_steps, arrays)

    def _end_turn(self, number: int) -> Scan | None:
        """Return the scan of a turn of `number` control periods, and begin a new one.

        Each beam is from the period nearest to its time. Before the first turn it returns None.
        """
        scans, self._turn = self._turn, self._turn[-1:]
        if len(scans) <= number:
            return None
        beams = np.arange(len(scans[0].ranges))
        period = np.rint(beams * number / len(beams)).astype(int)
        ranges, is_return = (np.stack(each)[period, beams] for each in zip(*scans, strict=True))
        return Scan(ranges, is_return)

    def _moment(self) -> Moment:
        time = jnp.asarray(self.time, jnp.float32)
        off = jnp.array(False)
        step = jnp.asarray(self.num_steps, jnp.int32)
        return Moment(step, time, self.state.robot, off, off)

    def _move(self, pose: np.ndarray, twist: np.ndarray) -> None:
        """Move the odometry as the robot has moved, with its errors."""
        middle = 0.5 * (pose[2] + self._pose[2])
        cos, sin = math.cos(middle), math.sin(middle)
        x, y, turn = pose - self._pose
        way = np.array([cos * x + sin * y, cos * y - sin * x, turn])
        self._odometry = extrapolate_pose(self._odometry, self._scale * way, 1.0)
        self._pose, self._velocity, self._twist = pose, twist, self._scale * twist


@eqx.filter_jit
def _scan(
    scenario: ExplorationScenario, state: ExplorationState, moment: Moment, key: Key, mount: Pose
) -> Scan:
    """Scan the true world from the true pose of the lidar."""
    pose = compose(scenario.robot.pose(state.robot), mount)
    return scenario.true_world(state, moment).scans(scenario.sensors[:1], pose, key)[0]


@eqx.filter_jit
def _measure(
    scenario: ExplorationScenario, state: ExplorationState, moment: Moment, key: Key, mount: Pose
) -> tuple[ExplorationState, Scan]:
    """Scan the true world, and map the scan at the true pose of the lidar."""
    truth = scenario.true_world(state, moment)
    pose = compose(scenario.robot.pose(state.robot), mount)
    scans = truth.scans(scenario.sensors, pose, key)
    since = scenario.rates.since_scan
    judge = Judge(scenario.perception, scenario.map_arrays.reachable, scenario.truths)
    before = judge.count_window(state.belief.grid, pose)
    belief = scenario.perception.observe(state.belief, scans, pose, since)
    sums = state.judged.sums.update(before, judge.count_window(belief.grid, pose))
    judged = state.judged._replace(sums=sums, progress=map_progress(sums, belief.grid))
    parts = scenario.perception.parts, belief.parts
    vantage = Vantage(truth, scenario.sensors, pose, *parts)
    truths = judge.judge_parts(state.truths, vantage, sums, moment.time)
    ranges = jnp.concatenate([scan.ranges for scan in scans])
    return state.with_belief(belief)._replace(judged=judged, truths=truths, ranges=ranges), scans[0]


@eqx.filter_jit
def _advance(
    scenario: ExplorationScenario, state: ExplorationState, moment: Moment, wanted: Pose
) -> tuple[ExplorationState, Any, Pose, Pose]:
    """Drive for a period; return the state, the record, the pose and the velocity."""
    robot, period = scenario.robot, scenario.control_period
    control = velocity_control(robot, state.robot, wanted, period)
    nothing = jnp.zeros(())
    info = Info(control[None], nothing[None], nothing[None], nothing, jnp.array(True))
    after, record = scenario.advance(state, control, moment, info)
    return after, record, robot.pose(after.robot), robot.twist(after.robot, control)


@eqx.filter_jit
def _frame(
    scenario: ExplorationScenario, state: ExplorationState, moment: Moment, key: Key
) -> dict[str, Any]:
    return scenario.frame(state, moment, None, key)


def velocity_control(
    robot: Dynamics, state: StateVector, wanted: Pose, period: Scalar
) -> ControlVector:
    """Return the control whose velocity after a period [s] comes closest to a wanted one.

    Velocities (vx, vy, omega) are in the frame of the robot. The search takes Gauss-Newton steps of
    least squares, clipped to the bounds. Where a control has no effect, such as the steering of a
    car that stands, the step has the least norm.
    """

    def velocity(control: ControlVector) -> Pose:
        return robot.twist(robot.step(state, control, period), control)

    # A robot that stands has no slope towards a speed that its model does not have, such as
    # backwards, so the search begins a little beside the idle control.
    control = robot.default_control + 0.05 * robot.control_half_range
    for _ in range(NEWTON_STEPS):
        slope = jax.jacfwd(velocity)(control)
        control = control + jnp.linalg.pinv(slope, rtol=1e-4) @ (wanted - velocity(control))
        control = jnp.clip(control, robot.control_min, robot.control_max)
    return control
