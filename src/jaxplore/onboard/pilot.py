"""The pilot of a robot: scans and odometry in, checked velocity commands out."""

import math
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxplore import _checks, _kinds
from jaxplore._types import Key
from jaxplore._xla import on_device
from jaxplore.control.base import Controller
from jaxplore.control.guard import MotionGuard
from jaxplore.control.stops import GOOD, MISFIT
from jaxplore.control.validation import StopCheck
from jaxplore.costs.occlusion import OcclusionCost
from jaxplore.dynamics.base import Dynamics
from jaxplore.dynamics.goal import Motion
from jaxplore.localisation.particle_localiser import ParticleLocaliser
from jaxplore.onboard import steps
from jaxplore.onboard.data_check import DataCheck
from jaxplore.onboard.drive_clock import DriveClock, Instant, Stamps
from jaxplore.onboard.frames import drive_frame
from jaxplore.onboard.localisation import MapPoses
from jaxplore.onboard.log import DriveLog
from jaxplore.onboard.mapper import Mapper
from jaxplore.onboard.odometry import PoseHistory, robot_state
from jaxplore.onboard.options import Command, Mode, PilotOptions
from jaxplore.onboard.scan_points import (
    CHECKED_SECONDS,
    RecentPoints,
    TakenScan,
    lidar_pose,
    no_points,
)
from jaxplore.onboard.session import Kept, LastPlace, Session, name_arrays
from jaxplore.onboard.tasks import DriveTask, Exploring, TaskControl
from jaxplore.report.exploration.data import ExplorationFrame
from jaxplore.report.exploration.recording import ExplorationRecording
from jaxplore.robot.localisation import Localisation
from jaxplore.sensing.beams import Scan
from jaxplore.sensing.sweep import Sweep
from jaxplore.simulation.exploration.scenario import ExplorationScenario

NUM_SENT = 16
"""Greatest number of commands on their way that a prediction takes into account."""


class _Sent(NamedTuple):
    """A command: the control, and the time from which it has effect [s]."""

    control: np.ndarray
    effect: float


class SentCommands:
    """Commands that were sent, and when each has effect, a latency later [s]."""

    def __init__(self, robot: Dynamics, latency: float) -> None:
        self._idle = np.asarray(robot.default_control, np.float32)
        self._latency = latency
        self._sent: list[_Sent] = []

    def add(self, control: np.ndarray, now: float, measured: float) -> None:
        """Add a control (nu,) sent now; forget those that no longer acted at `measured` [s]."""
        self._sent.append(_Sent(control, now + self._latency))
        # The last one that has effect before the measurement is still in effect.
        while len(self._sent) > NUM_SENT or (
            len(self._sent) > 1 and self._sent[1].effect <= measured
        ):
            self._sent.pop(0)

    def clear(self) -> None:
        """Forget all commands: the robot brakes."""
        self._sent = []

    def find_pending(self, measured: float, now: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the controls (D, nu) on their way, and for how long each of them (D,) acts [s].

        The time runs from `measured`, that of the newest measured state, until a command that is
        sent now has effect.
        """
        controls = np.tile(self._idle, (NUM_SENT, 1))
        durations, end = np.zeros(NUM_SENT, np.float32), now + self._latency
        for index, each in enumerate(self._sent):
            until = self._sent[index + 1].effect if index + 1 < len(self._sent) else end
            controls[index] = each.control
            durations[index] = max(0.0, min(until, end) - max(each.effect, measured))
        return controls, durations


class Pilot:
    """Drives a robot with the controller of a scenario.

    The pilot keeps the map, calls the controller, and decides whether the robot may move. It reads
    no clock and knows no middleware: times come with the data, so a recorded drive is repeated
    exactly. Clocks may jump, stop and differ (`DriveClock`, `Stamps`). After a jump the robot
    brakes for a second, and what was measured before is forgotten, but not the map.

    Call its methods in this order in each period: `add_odometry` and `add_scan` for what has
    arrived, `command`, and after the command was sent `update_belief`. `update_belief` and
    `make_frame` may be called from another thread than the others.

    The state is predicted to the time when the command takes effect, from the commands on their
    way. Every command is checked against the newest scan (`StopCheck`). Without fresh data, after
    an impossible pose, while scans do not fit the map, or without a finite plan, the command is a
    ramp to zero, and says why.

    Positions are in double precision in the frame of the odometry. Everything compiled is relative
    to the first position. With a localisation only the increments of the odometry count, and
    positions are in the frame of the map, which at the start is that of the odometry.

    On a map that it knows, of a session or of a localisation on known maps, the robot stands until
    it has found itself (`Finder`), and says so. Then positions are in the frame of that map.

    Args:
        scenario: robot, sensor, perception and rates. Its world is not read; its arrays are those
            of the pilot's map, which is centred on the first position.
        controller: controller of the robot.
        key: random key of all steps.
        options: numbers of the pilot; the defaults when absent.
        task: what the robot drives for; exploration when absent.
        localisation: how the robot finds its pose in its map, of which the localiser and what
            closes loops are used; the odometry is taken as true when absent. With a
            `ParticleLocaliser` the map is the prior of the scenario.
        occlusion: cost whose speeds hold near places that can hide somebody, see `MotionGuard`.
        session: what the robot goes on with, and where `snapshot` is kept; nothing when absent.
        finder: finds the robot on the map of a session; a `ParticleLocaliser` when absent.
        is_map_known: whether the prior of the scenario is a known map, relative to the datum. With
            a `ParticleLocaliser` the robot finds itself on it; else poses are in its frame.

    Raises:
        ValueError: an argument of another class, a scenario with several sensors.
    """

    @_kinds.check_arguments
    def __init__(
        self,
        scenario: ExplorationScenario,
        controller: Controller,
        key: Key,
        options: PilotOptions | None = None,
        task: DriveTask | None = None,
        localisation: Localisation | None = None,
        occlusion: OcclusionCost | None = None,
        session: Session | None = None,
        finder: ParticleLocaliser | None = None,
        is_map_known: bool = False,
    ) -> None:
        _kinds.key("key", key)
        if len(scenario.sensors) != 1:
            raise ValueError(
                f"scenario has {len(scenario.sensors)} sensors; accepted: one, the lidar"
            )
        self.scenario, self.controller = scenario, controller
        self.options = PilotOptions() if options is None else options
        self.sensor, self.robot = scenario.sensors[0], scenario.robot
        self.period = scenario.period
        self.guard = MotionGuard(
            self.options.max_frozen,
            check=StopCheck(self.options.margin),
            max_age=self.options.max_age,
            occlusion=occlusion,
        )
        self.is_started = True
        self.log = DriveLog(scenario)
        if task is None:
            given = self.options
            task = Exploring(scenario.perception, given.done_after, returns=given.returns)
        self.task = task
        self._key, self._frame_key = jax.random.split(key)
        self._history = PoseHistory(self.options.max_jump)
        is_internal = localisation is not None
        # When the instruments of parts last measured; a part does without until they have.
        parts = scenario.perception.parts
        self._measured_at = {part.name: -math.inf for part in parts if part.has_instrument}
        self.session = session
        resumed = None if session is None else session.kept
        # On a known map the robot comes back to where it found itself.
        self._home: np.ndarray | None = None if is_map_known else np.zeros(2)
        offset = scenario.datum.offset if is_map_known else None
        if resumed is not None:
            self._home, offset = resumed.home, resumed.offset
            self.task.set_home(resumed.home)
        self._poses = MapPoses(
            *(self._history, scenario.cell_size),
            is_internal=is_internal,
            offset=offset,
            is_shared=is_map_known and not is_internal and session is None,
        )
        self._mapper = Mapper(
            *(scenario, self.log, localisation),
            session=session,
            localiser=finder,
            is_apart=session is not None and not is_internal,
        )
        self._known = self._mapper.known
        self._first_memory: Any = controller.init()
        self._memory: Any = self._first_memory
        self._expected = np.asarray(scenario.start)
        self._sent = SentCommands(self.robot, self.options.time_to_effect)
        self._twist = np.zeros(3)
        self._clock = DriveClock(self.period)
        self._pose_stamps, self._scan_stamps = Stamps(self.period), Stamps(self.period)
        self._planned: tuple[float, np.ndarray] | None = None
        # What has arrived since the last command, and the newest scan.
        self._new: list[TakenScan] = []
        self._scan: TakenScan | None = None
        self._points, self._seen = no_points(), RecentPoints()
        max_range = float(self.sensor.max_range)
        self._data = DataCheck(self.guard, self.options, self._history, max_range)
        self._number = 0
        self.num_replaced = 0
        self._finished, self._stop_code = "", GOOD
        self._has_driven = False

    @property
    def belief(self) -> Any:
        """What the robot knows, relative to the first position."""
        return self._mapper.belief

    @property
    def offset(self) -> np.ndarray:
        """Position (2,) in the frame of the odometry of the origin of the belief [m]."""
        return self._poses.offset

    @property
    def pose(self) -> np.ndarray | None:
        """Newest pose (3,) in the frame of the odometry, or of the map; None before the first."""
        last = self._history.last
        return None if last is None else self._poses.in_map(last.pose, self._mapper.correction)

    @property
    def correction(self) -> np.ndarray:
        """Pose (3,) of the frame of the odometry in that of the map; 0 without a localisation."""
        return self._poses.in_map(np.zeros(3), self._mapper.correction)

    @property
    def has_map_frame(self) -> bool:
        """Whether the frame of the map is another one than that of the odometry."""
        return self._mapper.correction is not None

    @property
    def finds_itself(self) -> bool:
        """Whether the robot begins on a map that it knows, at a place that it does not."""
        return self._mapper.finds_itself

    @property
    def lost(self) -> str:
        """Why the robot must not drive as long as it does not know where it is; empty else."""
        return self._mapper.lost

    def tell_pose(self, pose: np.ndarray) -> None:
        """Take a pose (3,) in the frame of the map at which somebody says that the robot is.

        Scans must fit there before it drives.

        Raises:
            ValueError: a pose that is not finite, a robot that does not find itself on a map.
        """
        given = np.asarray(_checks.pose("pose", pose), np.float64)
        local = given - np.append(self.offset, 0.0)
        self._mapper.tell(lidar_pose(local, self.options.lidar_x, self.options.lidar_y))

    def snapshot(self) -> Kept | None:
        """Return what a session keeps; None before the first scan, and while the robot is lost."""
        known, home = self._mapper.known, self._home
        if self._mapper.lost or home is None or not math.isfinite(known.time):
            return None
        return Kept(name_arrays(known.own), self.offset, home)

    def last_place(self) -> LastPlace | None:
        """Return where the robot is, for its session; None where `snapshot` is."""
        known, last = self._mapper.known, self._history.last
        if last is None or self._mapper.lost or not math.isfinite(known.time):
            return None
        place = self._poses.place(last.pose, known.correction)
        pose = lidar_pose(place, self.options.lidar_x, self.options.lidar_y)
        return LastPlace(pose, self._poses.in_map(np.zeros(3), known.correction))

    @property
    def motion(self) -> Motion:
        """How fast the robot moves by its newest pose."""
        last = self._history.last
        return _motion(np.zeros(3) if last is None else last.twist)

    @property
    def stop_code(self) -> int:
        """Why the data let the robot stand at the last command, see `control.stops.REASONS`."""
        return self._stop_code

    @property
    def finished(self) -> str:
        """Why the robot is done; empty before."""
        return self._finished

    def prepare(self) -> None:
        """Compile everything that the loop calls, so that no command waits for it."""
        self._mapper.prepare(self.task.perception)
        self._data.prepare()
        self.task.prepare(TaskControl(self.controller, self.robot, self._expected))
        planned = self._plan(np.asarray(self._expected, np.float32), 0.0, self.period)
        steps.apply_correction(self.robot, self._expected, np.zeros(3), np.zeros(3))
        shown = self.make_frame()
        jax.block_until_ready((planned, vars(shown)))  # type: ignore[no-untyped-call]

    @property
    def time(self) -> float:
        """Time of the drive at the last command [s], which never goes back, see `DriveClock`."""
        return self._clock.time

    def add_odometry(
        self,
        stamp: float,
        pose: np.ndarray,
        twist: np.ndarray | None,
        received: Instant | None = None,
    ) -> None:
        """Take a pose and a velocity.

        Args:
            stamp: time of the measurement [s].
            pose: (3,) pose (x, y, yaw) in a frame that is fixed in the world [m, m, rad].
            twist: (3,) velocity (vx, vy, omega) in the robot's frame; estimated when absent.
            received: when it arrived; as `DriveClock.arrival` says when absent.
        """
        time = self._pose_stamps.time_of(stamp, *self._clock.arrival(stamp, received))
        if time is None:
            return
        # A pose that was ahead of its time is not newer than this one.
        self._history.forget(after=time)
        is_first = self._history.last is None
        problem = self._poses.add(time, pose, twist)
        if is_first:
            self._mapper.locate(self._poses.offset)
            if self.session is not None and self.session.place is not None:
                former = self.session.place
                self._mapper.expect(former.pose, self._poses.correction_of(former.transform))
        if problem is not None:
            self._data.add_jump(problem)

    def add_scan(
        self,
        stamp: float,
        scan: Scan,
        points: np.ndarray,
        received: Instant | None = None,
        sweep: Sweep | None = None,
        *,
        is_live: bool = False,
    ) -> None:
        """Take a scan; one with a point that is not finite is left out.

        Args:
            stamp: time of the scan [s].
            scan: readings of the beams of the sensor.
            points: (N, 2) all valid returns in the frame of the robot [m].
            received: when it arrived; as `DriveClock.arrival` says when absent.
            sweep: when its directions were measured, for a robot that moves meanwhile; all at the
                time of the scan when absent.
            is_live: whether what measured it works for sure, so that scans may repeat themselves.
        """
        time = self._scan_stamps.time_of(stamp, *self._clock.arrival(stamp, received))
        if time is None or not np.isfinite(points).all():
            return
        former = self._scan
        is_changed = is_live or former is None or not np.array_equal(former.points, points)
        self._data.add_scan(time, points, is_changed=is_changed)
        self._scan = TakenScan(time, scan, points, sweep)
        # While the robot brakes, nobody takes them.
        kept = [each for each in self._new if time - each.time <= CHECKED_SECONDS]
        self._new = [*kept, self._scan]

    def add_look(self, name: str, measured: float, received: Instant | None = None) -> None:
        """Take a measurement by the instrument of a part, see `Part.look`.

        Args:
            name: name of the part.
            measured: what it measures, such as the energy left in a battery [J].
            received: when it arrived; now when absent.

        Raises:
            ValueError: a part without an instrument, or that the robot does not have; a number that
                is not finite.
        """
        value = _checks.number("measured", measured)
        time = self.time if received is None else self._clock.time_at(received)
        if time is None or not math.isfinite(time):
            return
        self._mapper.look(name, value, time)
        self._measured_at[name] = time

    def command(self, now: float | Instant) -> Command:
        """Compute the command for a time.

        Args:
            now: present time by the clock of the stamps [s], or by that and a steady one.

        Raises:
            ValueError: a time that is not finite.
        """
        passed = self._clock.advance(Instant.of(now))
        if self._clock.jump is not None:
            self._forget(self._clock.jump)
        now, before = self._clock.time, self._twist
        command = self._command(now, self.period if self._clock.is_standing else passed)
        command = self._allow_for_motors(before, command)
        self.log.add_command(now, command.twist, str(command.mode), command.reason)
        return command

    def _forget(self, why: str) -> None:
        """Forget what was measured recently, by a clock that has jumped, and brake."""
        for stamps in (self._pose_stamps, self._scan_stamps):
            stamps.forget()
        self._history.forget()
        self._data.forget()
        self._scan, self._new = None, []
        self._seen.forget()
        self._data.add_jump(why)

    def _command(self, now: float, elapsed: float) -> Command:
        self._take_known()
        code, problem = self._data.judge(now, self._twist, is_misfit=self._mapper.is_misfit)
        self._stop_code = code
        # Scans are taken while they do not fit the map, so that the robot sees when they do again.
        is_trusted = code in (GOOD, MISFIT)
        if not is_trusted:
            self._mapper.distrust()
        if self._clock.is_standing:
            is_trusted, problem = False, "the simulated clock stands still"
        problem = problem or self._mapper.lost
        problem = problem or self._instrument_problem(now) or self._place_problem()
        scan_time = self._take_scan(now) if is_trusted else None
        if self._finished:
            return self._ramp_down(now, elapsed, Mode.DONE, self._finished)
        if not self.is_started:
            return self._ramp_down(now, elapsed, Mode.PAUSED, "paused")
        if problem:
            is_blank = self._history.last is None or self._scan is None
            mode = Mode.WAITING if is_blank and not self._twist.any() else Mode.BRAKING
            return self._ramp_down(now, elapsed, mode, problem)
        self._adapt()
        state = self._state(now)
        assert self._history.last is not None
        motion = _motion(self._history.last.twist)
        waits_for = self.task.waits_for(self._local(self._history.last.pose), motion)
        if waits_for:
            return self._ramp_down(now, elapsed, Mode.WAITING, waits_for)
        if not self.options.is_obeyed:
            self._expected = state
            self._sent.clear()
        # The plan is shifted by the elapsed time; after a pause, by not more than two periods.
        planned = self._plan(state, now, min(elapsed, 2.0 * self.period))
        if not bool(planned.is_finite):
            return self._ramp_down(now, elapsed, Mode.BRAKING, "no rollout of the plan is finite")
        self._memory = planned.memory
        self._expected = np.asarray(planned.after)
        controls, twists = np.asarray(planned.controls), np.asarray(planned.twists, np.float64)
        assert self._history.last is not None
        self._has_driven = True
        self._sent.add(controls[0], now, self._history.last.time)
        self._twist = twists[0]
        is_replaced = bool(planned.is_replaced)
        self.num_replaced += is_replaced
        self._planned = None if is_replaced else (now, twists)
        reason = f"too close: {float(planned.gap):.2f} m" if is_replaced else ""
        self.log.add(
            now,
            state,
            controls[0],
            float(planned.effective_sample_size),
            is_finite=True,
            is_faulty=is_replaced,
        )
        return Command(self._twist, Mode.DRIVING, reason, scan_time)

    def next_command(self, now: float | Instant) -> Command:
        """Return the next command of the last plan, where a new one is not ready in time.

        Args:
            now: as of `command`.
        """
        time, before = self._clock.time_at(Instant.of(now)), self._twist
        if self._planned is not None and time is not None:
            began, twists = self._planned
            index = round((time - began) / self.period)
            # No scan checks these commands, so they may not be older than one.
            if 0 <= index < len(twists) and time - began <= self.options.max_age:
                self._twist = twists[index]
                late = Command(self._twist, Mode.DRIVING, "a plan was late", None)
                return self._allow_for_motors(before, late)
        braking = self._ramp_down(self.time, self.period, Mode.BRAKING, "a plan was late")
        return self._allow_for_motors(before, braking)

    def _allow_for_motors(self, before: np.ndarray, command: Command) -> Command:
        """Return what is sent so that the base has a velocity (3,) at the end of the period.

        `before` is the velocity that it was to have before. What is planned and expected is the
        velocity, not what is sent for it.
        """
        motors = self.options.motors
        if motors is None:
            return command
        return command._replace(twist=motors.command_for(before, command.twist, self.period))

    def update_belief(self, now: float | Instant) -> None:
        """Map the newest scan, and update the information and guidance fields if they are due.

        The command that follows from a scan is checked against it, and does not wait for the map.

        Args:
            now: as of `command`.
        """
        time = self._clock.time_at(Instant.of(now))
        perception, last = self.task.perception, self._history.last
        self._mapper.map_scan(perception)
        if last is None or self._mapper.lost:
            return
        if self._home is None:
            self._home = self._poses.place(last.pose, self._mapper.correction)[:2]
            self.task.set_home(self._home)
            perception = self.task.perception
        if not self.task.has_fields:
            return
        pose = self._poses.place(last.pose, self._mapper.correction)
        # Where the clock has jumped since the command, the fields wait for the next one.
        cost = None if time is None else self._mapper.update_fields(perception, time, pose)
        if cost is not None and time is not None:
            sent, motion = self._mapper.belief.is_sent, _motion(last.twist)
            # On its way to a dock, and while it is charged, a robot looks for nothing.
            is_started = self.is_started and not (sent is not None and bool(sent))
            self.finish(
                self.task.update(time, cost, pose[:2], is_started=is_started, motion=motion)
            )

    def finish(self, reason: str) -> None:
        """End the drive: the robot stops and stays.

        Args:
            reason: why, in a few words; with an empty one it goes on.
        """
        self._finished = self._finished or reason

    def make_frame(self) -> ExplorationFrame:
        """Make a frame of the present moment with its plan, as in the animation.

        Its positions are relative to the origin of the belief.
        """
        last = self._history.last
        state = self._expected if last is None else self._state(last.time)
        return drive_frame(
            self.scenario,
            self.controller,
            self._memory,
            on_device(state),
            self._mapper.belief,
            None if self._scan is None else self._scan.scan,
            self._frame_key,
            number=self.log.num_steps,
            reference=self.task.reference,
        )

    def recording(self, *, in_odometry: bool = False) -> ExplorationRecording:
        """Make the recording of the drive; its final map stands for the world.

        Args:
            in_odometry: whether positions are in the frame of the odometry, as a run folder has
                them; else they are relative to the origin of the belief.
        """
        self.log.frames.add_last(self.make_frame())
        offset = self.offset if in_odometry else None
        return self.log.recording(self.belief, is_done=self.task.is_done, offset=offset)

    def _adapt(self) -> None:
        """Let the task change the controller and the model, such as for another path."""
        assert self._history.last is not None
        before = TaskControl(self.controller, self.robot, self._expected)
        place = self._local(self._history.last.pose)[:2].astype(np.float32)
        after = self.task.update_control(before, self._poses.offset, place)
        # Another thread may set parameters meanwhile: what has not changed is not written back.
        if after is not before:
            self.controller, self.robot, self._expected = after

    def _take_known(self) -> None:
        """Take what the map knows by now; what is relative to it moves by a new correction."""
        before, self._known = self._known.correction, self._mapper.known
        after, last = self._known.correction, self._history.last
        if before is None or after is None or before is after or last is None:
            return
        poses = (self._poses.place(last.pose, each) for each in (before, after))
        self._expected = steps.apply_correction(self.robot, self._expected, *poses)
        self._place_points()

    def _place_points(self) -> None:
        """Place the points of the recent scans in the map."""
        pose = self._poses.correct(self._seen.pose, self._known.correction)
        self._points = self._seen.place(pose)

    def _local(self, pose: np.ndarray) -> np.ndarray:
        """Return the place in the map of a pose of the odometry, relative to its origin."""
        return self._poses.place(pose, self._known.correction)

    def _state(self, now: float) -> np.ndarray:
        """Return the newest measured state (nx,), relative to the origin of the belief."""
        last = self._history.last
        assert last is not None
        return robot_state(self.robot, self._local(last.pose), last.twist, self._expected)

    def _take_scan(self, now: float) -> float | None:
        """Take the points of new scans for the check; return the time of the newest."""
        scans, self._new = self._new, []
        if not scans:
            return None
        place = np.array([self.options.lidar_x, self.options.lidar_y])
        last = self._history.last
        twist = np.zeros(3) if last is None else last.twist
        scans = [each.undistort(self.sensor, twist, place) for each in scans]
        for each in scans:
            pose = self._poses.reckon(self._history.at(each.time))
            self._seen.add(each.time, each.points, pose)
        self._place_points()
        new = scans[-1]
        beams = lidar_pose(pose, self.options.lidar_x, self.options.lidar_y)
        self._mapper.add(new.time, new.scan, beams, now, self._poses.joint)
        return new.time

    def _plan(self, state: np.ndarray, now: float, elapsed: float) -> steps.Planned:
        last = self._history.last
        self._number += 1
        # One transfer for all arrays: each one takes a fifth of a millisecond.
        inputs = steps.PlanInputs(
            *jax.device_put(
                (
                    state,
                    self._expected,
                    *self._sent.find_pending(now if last is None else last.time, now),
                    *self._points,
                    np.float32(elapsed),
                    np.int32(self._number),
                    *self._ages(now),
                )
            )
        )
        return steps.plan(
            self.controller,
            self.robot,
            self.guard,
            self.task.perception.tracker,
            self._memory,
            self._known.belief,
            inputs,
            self.scenario.control_period,
            self._key,
        )

    def _instrument_problem(self, now: float) -> str:
        """Return why an instrument of a part lets the robot stand; empty if none does."""
        for name, time in self._measured_at.items():
            age = now - time
            if age > self.options.max_look_age:
                told = f"{age:.0f} s old" if math.isfinite(age) else "not there yet"
                return f"the measurement of the {name} is {told}"
        return ""

    def _place_problem(self) -> str:
        """Return why the robot does not begin where it stands; empty if it does."""
        if self._has_driven or self._history.last is None or not self._mapper.is_located:
            return ""
        place = self._local(self._history.last.pose)[:2]
        return "the robot stands in a keep-out area" if self._mapper.is_closed(place) else ""

    def _ages(self, now: float) -> tuple[np.float32, np.float32]:
        """Return how old the newest scan, and that in the map, are when a command takes effect."""
        scan = now if self._scan is None else self._scan.time
        times = scan, self._known.time if math.isfinite(self._known.time) else now
        newest, mapped = (max(0.0, now - each) + self.options.time_to_effect for each in times)
        return np.float32(newest), np.float32(mapped)

    def _ramp_down(self, now: float, elapsed: float, mode: Mode, reason: str) -> Command:
        """Return the next command of a ramp to zero."""
        self._twist = self.options.slower(self._twist, min(elapsed, 2.0 * self.period))
        # Where a robot is that does not know it is no part of its way.
        if self._history.last is not None and not self._mapper.lost:
            state = self._state(now)
            # From here on the robot is expected to be as fast as it is told.
            pose = self._local(self._history.last.pose)
            self._expected = robot_state(self.robot, pose, self._twist, state)
            self.log.add(
                now,
                state,
                np.asarray(self.robot.default_control),
                0.0,
                is_finite=False,
                is_faulty=mode is Mode.BRAKING,
            )
        # The controller starts anew from rest: its plan was not executed.
        self._planned = None
        self._sent.clear()
        if not self._twist.any():
            self._memory = self._first_memory
        return Command(self._twist, mode, reason, None)


def _motion(twist: np.ndarray) -> Motion:
    """Return how fast a robot moves with a velocity (vx, vy, omega) [m/s, m/s, rad/s]."""
    vx, vy, turn_rate = twist.tolist()
    return Motion(math.hypot(vx, vy), turn_rate)
