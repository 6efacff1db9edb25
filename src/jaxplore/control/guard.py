"""Stop a robot whose pose, scan or motion cannot be true, and estimate the delay of commands."""

import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, ControlVector, Count, Scalar, StateVector, Twist
from jaxplore.control.latency import predict_state
from jaxplore.control.plausibility import MAX_AGE, is_jump, is_moving
from jaxplore.control.stops import (
    AGE_ROUNDING,
    BLIND,
    GOOD,
    JUMPED,
    Evidence,
    StopState,
    next_stop,
)
from jaxplore.control.validation import StopCheck, Validated
from jaxplore.costs.occlusion import OcclusionCost
from jaxplore.dynamics.base import Dynamics, State
from jaxplore.maps.volume_field import VolumeField
from jaxplore.sensing.clusters import Edges

LATE = 1.5
"""Multiple of the time between two scans that a scan may be old, where that is more than the age
that is accepted."""
MEMORY_SECONDS = 0.3
"""Time constant with which errors of predictions are forgotten [s]."""
BETTER = 0.25
"""Share of the error of the known delay below which another delay is taken to be the true one."""
NOISE = 1e-6
"""Squared relative error of a prediction that is rounding."""
WALL_MARGIN = 0.0
"""Margin of the check of commands [m]: less than the margins of costs, or both would be at odds."""
PASSING = 0.45
"""Speed at which the guard lets a robot pass any place that can hide somebody [m/s]. It is more
than the slowest speed of `OcclusionCost`, which a controller weighs against its way: the explorer
passes at 0.43 m/s, and at 0.3 m/s would lose a quarter of it."""
LEAST_CHANGE = 1e-6
"""Difference of speeds below which braking is no slower than a command [m/s]."""
_POSE = ("x", "y", "z", "yaw")


class ScanPoints(NamedTuple):
    """The newest scan, as a `MotionGuard` needs it.

    Args:
        points: (P, 2) end points of the beams, placed by the expected pose [m]; in a volume (P, 3)
            with z up.
        is_point: (P,) beams that ended at something.
        misfit: share of the returns that contradict the map, see `plausibility.scan_misfit`.
        time: time of the scan [s]; infinite where the robot has no scans.
        interval: time between two scans [s].
        speeds: (P,) speeds with which points may move [m/s], 0 of walls; None where points say
            nothing of commands, as on hills, which return beams like walls.
        room: in a volume, distance to what the map does not know to be free [m]; else None.
    """

    points: Float[Array, "P D"]
    is_point: Bool[Array, " P"]
    misfit: Scalar
    time: Scalar
    interval: Scalar
    speeds: Float[Array, " P"] | None = None
    room: VolumeField | None = None

    @classmethod
    def blank(
        cls,
        number: int,
        time: float = math.inf,
        *,
        is_on_hills: bool = False,
        dimensions: int = 2,
    ) -> "ScanPoints":
        """Return `number` points that do not count, of a scan at a time; of none when absent."""
        nothing, at = jnp.zeros(()), jnp.asarray(time, jnp.float32)
        speeds = None if is_on_hills else jnp.zeros(number)
        is_point = jnp.zeros(number, bool)
        return cls(jnp.zeros((number, dimensions)), is_point, nothing, at, nothing, speeds)


class GuardState(NamedTuple):
    """State of a `MotionGuard`.

    Args:
        expected: (nx,) state that the model expects now; the observed one where it is trusted.
        velocity: (3,) rates of x, y and yaw that the model expects [m/s, m/s, rad/s].
        commands: (N, nu) commands that were sent, the newest last; the default control where the
            robot was told to brake.
        errors: (N,) recent squared errors of the predicted speeds if commands take effect after
            0, 1, ..., N - 1 control periods.
        stops: whether the robot is stopped, and what has led to it.
    """

    expected: StateVector
    velocity: Twist
    commands: Float[Array, "N nu"]
    errors: Float[Array, " N"]
    stops: StopState

    @property
    def stop(self) -> Count:
        """Why the robot is stopped, an index into `stops.REASONS`; 0 if it is not."""
        return self.stops.code


class MotionGuard(eqx.Module):
    """Decides in each control period whether the observed pose can be true, and stops the robot if
    not.

    The robot is stopped while

    - the observed state is not finite;
    - the pose is the same for longer than `max_frozen` while the commands should move the robot;
    - the pose is too far from where the commands lead (`plausibility.is_jump`), and 1 s after that;
    - the newest scan is older than `max_age`, or than 1.5 times the time between two scans where
      that is more;
    - on a robot, the scan is the same for longer than `max_frozen` although the robot moves;
    - more than half of the returns of the newest scan contradict the map
      (`plausibility.scan_misfit`).

    A stopped robot brakes along the trajectory that keeps the greatest distance from the points of
    the newest scan (`StopCheck`). It brakes by its own measurement of speed and attitude, that of
    its wheels, or of the inertial unit and the optical flow of a quadrotor, which then hovers. It
    needs no pose for that. It goes on as soon as the pose is finite, changes and fits. A robot that
    stands has the same pose for ever, so after 2 s it tries to move again if its scan fits the map
    there. After 2 s in which only the scans speak against the pose, the world has changed: the
    scans are mapped, until they fit.

    The delay of the commands is estimated. One model step from the last state under each of the
    last N commands predicts the present speeds, and the delay with the least error, averaged over
    0.3 s, is taken if it explains the motion four times better than the known one does. The
    controller then plans from the state in which its command takes effect, `predict_state`.

    A command is checked against the newest scan (`keep_clear`): it is replaced by one that brakes
    if the robot could not stand after it without coming too close to what the scan has met. Where
    people are expected, it is slowed down first near places that can hide somebody (`slow_down`).
    In a volume it is checked against what the map does not know to be free as well.

    Args:
        max_frozen: time for which the pose may be the same while the robot should move [s].
        max_delay: longest delay of commands that is recognised [control periods]; static.
        check: check of commands and braking trajectories; a `StopCheck` without a margin when
            absent.
        max_age: greatest age of a scan [s].
        occlusion: cost whose speeds hold near places that can hide somebody; none when absent.

    Raises:
        ValueError: a time that is not positive, a delay that is not a whole number >= 0.
    """

    max_frozen: Scalar
    max_age: Scalar
    check: StopCheck
    occlusion: OcclusionCost | None
    max_delay: int = eqx.field(static=True)

    @_kinds.check_arguments
    def __init__(
        self,
        max_frozen: ArrayLike = 0.05,
        max_delay: int = 15,
        check: StopCheck | None = None,
        *,
        max_age: ArrayLike = MAX_AGE,
        occlusion: OcclusionCost | None = None,
    ) -> None:
        self.max_frozen = _checks.scalar("max_frozen", max_frozen, above=0.0)
        self.max_age = _checks.scalar("max_age", max_age, above=0.0)
        self.max_delay = _checks.whole_number("max_delay", max_delay, at_least=0)
        self.check = StopCheck(WALL_MARGIN) if check is None else check
        self.occlusion = occlusion

    def init(self, robot: Dynamics, state: StateVector) -> GuardState:
        """Return the state of the guard of a robot at rest.

        Args:
            robot: model of the robot.
            state: (nx,) state of the robot.
        """
        number = 1 + self.max_delay
        return GuardState(
            state,
            jnp.zeros(3),
            jnp.broadcast_to(robot.default_control, (number, robot.control_size)),
            jnp.zeros(number),
            StopState.initial(),
        )

    def judge(
        self,
        robot: Dynamics,
        state: GuardState,
        observed: StateVector,
        last: StateVector,
        scan: ScanPoints,
        time: Scalar,
        period: Scalar,
    ) -> GuardState:
        """Judge an observed state.

        Args:
            robot: model of the robot.
            state: the guard's state.
            observed: (nx,) observed state.
            last: (nx,) the last one that was finite.
            scan: the newest scan.
            time: present time [s].
            period: control period [s].
        """
        most = jnp.maximum(self.max_age, LATE * scan.interval) + AGE_ROUNDING
        pose, before = robot.pose(observed), state.stop
        is_same = (pose == robot.pose(last)).all()
        is_lost = ~jnp.isfinite(observed).all()
        no = jnp.array(False)
        found = Evidence(
            elapsed=period,
            is_lost=is_lost,
            is_same=is_same,
            is_driven=is_moving(state.velocity),
            is_jump=is_jump(robot.pose(state.expected), pose) & ~is_lost,
            is_blind=time - scan.time > most,
            is_scan_same=no,
            is_repeat=no,
            misfit=scan.misfit,
        )
        stops = next_stop(state.stops, found, self.max_frozen)
        stop = stops.code
        errors = self._errors(robot, state, observed, last, period)
        # After a stop, or while the odometry repeats itself, a difference says nothing about the
        # model.
        is_whole = (stop == GOOD) & (before == GOOD) & ~is_same
        # A pose after a jump is a pose again, and so is one without scans. Of a lost or frozen one
        # the prediction goes on.
        is_pose = (stop == GOOD) | (stop == JUMPED) | (stop == BLIND)
        return state._replace(
            expected=jnp.where(is_pose, observed, state.expected),
            errors=jnp.where(is_whole, errors, state.errors),
            stops=stops,
        )

    def delay(self, state: GuardState, known: Count) -> Count:
        """Return the estimated delay of the commands [control periods].

        Args:
            state: the guard's state.
            known: delay that the controller knows of [control periods].
        """
        at_known = state.errors[jnp.minimum(known, state.errors.shape[0] - 1)]
        best = jnp.argmin(state.errors).astype(jnp.int32)
        is_better = state.errors[best] < BETTER * (at_known - NOISE)
        return jnp.where(is_better & (best > known), best, known)

    def predict(
        self, robot: Dynamics, state: GuardState, known: Count, period: Scalar
    ) -> StateVector:
        """Return the state (nx,) from which the controller plans: that in which its command takes
        effect, less the delay that it knows of.

        Args:
            robot: model of the robot.
            state: the guard's state.
            known: delay that the controller knows of [control periods].
            period: control period [s].
        """
        number = state.commands.shape[0]
        age = number - jnp.arange(number)
        is_due = (age <= self.delay(state, known)) & (age > known)
        durations = jnp.where(is_due, period, 0.0)
        return predict_state(robot, state.expected, state.commands, durations, period)

    def slow_down(
        self,
        robot: Dynamics,
        start: StateVector,
        control: ControlVector,
        edges: Edges | None,
        period: Scalar,
    ) -> ControlVector:
        """Return the command (nu,), or one between it and the hardest braking, after which the
        robot could stand before somebody who comes out of hiding, or is no faster than `PASSING`.

        With v the speed after a period of the command u, v_0 that after a period of the braking
        u_0, and a the allowed one, `OcclusionCost.allowed_speed` or `PASSING` if that is more:

            u + s (u_0 - u),   s = (v - a) / (v - v_0), limited to [0, 1]

        A robot whose speed or acceleration is a control has the speed a then. One that cannot be so
        slow after a period brakes.

        Args:
            robot: model of the robot.
            start: (nx,) state in which the command takes effect.
            control: (nu,) the command; one that is not finite stays.
            edges: edges behind which somebody can be hidden; None if nobody is expected.
            period: control period [s].
        """
        if self.occlusion is None or edges is None:
            return control
        stopping = robot.stopping_control(start, period)
        after = robot.step(start, control, period)
        allowed = self.occlusion.allowed_speed(State(after, robot, control), edges)
        speed = _speed(robot, after, control)
        braked = _speed(robot, robot.step(start, stopping, period), stopping)
        excess = speed - jnp.maximum(allowed, PASSING)
        share = jnp.clip(excess / jnp.maximum(speed - braked, LEAST_CHANGE), 0.0, 1.0)
        # What is not finite compares as false: such a command stays as it is.
        return jnp.where(excess > 0.0, control + share * (stopping - control), control)

    def keep_clear(
        self,
        robot: Dynamics,
        start: StateVector,
        control: ControlVector,
        scan: ScanPoints,
        age: Scalar,
        period: Scalar,
    ) -> Validated:
        """Return the command (nu,), or the one that brakes, where the robot could not stand before
        it comes within the margin of `StopCheck` of a point, or before what moves could reach it.

        Args:
            robot: model of the robot.
            start: (nx,) state in which the command takes effect.
            control: (nu,) the command; one that is not finite stays.
            scan: the newest scan.
            age: time from the scan to the effect of the command [s].
            period: control period [s].
        """
        given = Validated(control, jnp.array(False), jnp.asarray(math.inf, jnp.float32))
        if scan.speeds is None:
            return given
        is_wall = scan.is_point & (scan.speeds == 0.0)
        points = scan.points, scan.is_point, scan.speeds, age, is_wall, scan.room
        args = robot, start, control, period, *points
        # As for braking: a loop of one iteration or none.
        is_needed = jnp.isfinite(control).all()
        if scan.room is None:
            is_needed = scan.is_point.any() & is_needed
        checked: Validated = jax.lax.fori_loop(
            0, jnp.where(is_needed, 1, 0), lambda *_: self.check(*args), given
        )
        return checked

    def add_command(self, robot: Dynamics, state: GuardState, control: ControlVector) -> GuardState:
        """Note a command that was sent; NaN where the robot was told to brake."""
        # The next plan is made when the robot is at rest, where the default control keeps it.
        control = jnp.where(jnp.isfinite(control), control, robot.default_control)
        return state._replace(commands=jnp.concatenate([state.commands[1:], control[None]]))

    def brake(
        self,
        robot: Dynamics,
        state: GuardState,
        measured: StateVector,
        scan: ScanPoints,
        period: Scalar,
    ) -> ControlVector:
        """Return the control (nu,) with which the robot's base brakes.

        Args:
            robot: model of the robot.
            state: the guard's state.
            measured: (nx,) true state, of which the base measures all but the pose.
            scan: the newest scan.
            period: control period [s].
        """
        there = self._place(robot, state, measured)
        return self.check.brake(robot, there, period, scan.points, scan.is_point, scan.room)

    def advance(
        self,
        robot: Dynamics,
        state: GuardState,
        measured: StateVector,
        control: ControlVector,
        period: Scalar,
    ) -> GuardState:
        """Return the guard's state after a control period: where the robot is expected then.

        Args:
            robot: model of the robot.
            state: the guard's state.
            measured: (nx,) true state before the period, of which the base measures all but the
                pose.
            control: (nu,) control of the period while the robot is stopped.
            period: control period [s].
        """
        is_good = state.stop == GOOD
        delay = self.delay(state, jnp.zeros((), jnp.int32))
        due = state.commands[state.commands.shape[0] - 1 - delay]
        begin = jnp.where(is_good, state.expected, self._place(robot, state, measured))
        after = robot.step(begin, jnp.where(is_good, due, control), period)
        moved = robot.pose(after) - robot.pose(begin)
        turn = jnp.arctan2(jnp.sin(moved[2]), jnp.cos(moved[2]))
        velocity = moved.at[2].set(turn) / period
        return state._replace(expected=after, velocity=velocity)

    def _place(self, robot: Dynamics, state: GuardState, measured: StateVector) -> StateVector:
        """Return the expected pose with the speeds and the attitude that the base measures."""
        is_pose = jnp.asarray([name in _POSE for name in robot.state_names])
        return jnp.where(is_pose, state.expected, measured)

    def _errors(
        self,
        robot: Dynamics,
        state: GuardState,
        observed: StateVector,
        last: StateVector,
        period: Scalar,
    ) -> Float[Array, " N"]:
        """Return the squared errors of the predictions under each delay, in shares of what the
        controls can change in a control period."""
        bounds = jnp.stack([robot.control_max, robot.control_min])
        tried = jnp.concatenate([state.commands[::-1], bounds])
        after = jax.vmap(lambda control: robot.step(last, control, period))(tried)
        reach = jnp.abs(after[-2] - after[-1])
        # The pose is measured with noise; where the state has speeds, they tell more.
        names = robot.state_names
        is_used = jnp.asarray([name not in _POSE for name in names])
        if all(name in _POSE for name in names):
            is_used = ~is_used
        is_used = is_used & (reach > 1e-6)
        away = (after[:-2] - observed) / jnp.where(is_used, reach, 1.0)
        error = jnp.sum(jnp.where(is_used, away * away, 0.0), axis=-1)
        kept = jnp.exp(-period / MEMORY_SECONDS)
        mixed = kept * state.errors + (1.0 - kept) * error
        return jnp.where(jnp.isfinite(mixed), mixed, state.errors)


def _speed(robot: Dynamics, state: StateVector, control: ControlVector) -> Scalar:
    """Return how fast a robot moves over the ground [m/s]."""
    ahead, left, _ = robot.twist(state, control)
    return jnp.sqrt(ahead * ahead + left * left)
