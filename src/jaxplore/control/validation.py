"""Check that the robot can stop after a command, and brake in the best way if it cannot."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, ControlVector, Count, Flag, Scalar, StateVector
from jaxplore.dynamics.base import Dynamics, State
from jaxplore.maps.collision import discs_clearance
from jaxplore.maps.volume_field import VolumeField

AT_REST = 1e-4
"""Greatest change of the pose of a robot at rest within a step [m, rad]."""
FAR = 1e3
"""Distance to which points are moved that do not count [m]."""
TOUCH = 100.0
"""Distance from who moves for which a robot would come a metre closer to a wall than its margin."""
ROUNDING = 2e-5
"""Greatest error of a distance in single precision some hundred metres from the origin [m]."""


class Validated(NamedTuple):
    """A command that was checked.

    Args:
        control: (nu,) the command, or the one that brakes in the best way.
        is_replaced: whether the robot could not have stopped after the command.
        gap: least distance of the robot's edge from a point until it stands [m].
    """

    control: ControlVector
    is_replaced: Flag
    gap: Scalar


class StopCheck(eqx.Module):
    """Checks commands of any controller against the newest measurements themselves.

    A command is safe if the robot, after executing it and then braking as hard as it can, has kept
    a margin from all measured points until it stands. It may brake straight or along one of
    `num_turns` trajectories that steer to either side. So every safe command leaves a way to stop
    (passive safety). If it is not safe, it is replaced by the beginning of the braking trajectory
    that keeps the greatest distance. A robot that is within the margin already may move if it gets
    no closer.

    A point that may move with a speed s is a disc that grows until the robot stands, because it may
    go anywhere: after the time t since it was measured it has the radius s t. So the robot is at
    rest before anything that it has seen, and that is no faster, can touch it.

    A robot that `evades` may also execute a command after which it comes to rest no nearer to what
    moves than if it braked at once, and keeps the margin from walls. So it makes way for somebody
    who comes closer than it could be sure to stand. Without it, it stands, and is walked into.

    In a volume points are (x, y, z) with z up, the robot is a ball, and it must not come nearer to
    what the map does not know to be free either.

    Points at which the robot was when it began, such as reflections from its own body, must be left
    out by the caller.

    Source: Fraichard and Asama, "Inevitable collision states - a step towards safer robots?",
    Advanced Robotics 18(10), 2004; Bouraine, Fraichard and Salhi, "Provably safe navigation for
    mobile robots with limited field-of-views in dynamic environments", Autonomous Robots 32, 2012
    (passive safety).

    Args:
        margin: distance from points to keep [m].
        time_step: time between the examined positions [s].
        horizon: time in which the robot must come to rest [s].
        num_turns: number of braking trajectories, with steering from full right to full left;
            static.
        evades: whether the robot makes way for what moves; static.

    Raises:
        ValueError: a negative margin, a time that is not positive, fewer than one trajectory.
    """

    margin: Scalar
    time_step: Scalar
    num_steps: int = eqx.field(static=True)
    num_turns: int = eqx.field(static=True)
    evades: bool = eqx.field(static=True)

    def __init__(
        self,
        margin: ArrayLike = 0.03,
        time_step: float = 0.05,
        horizon: float = 2.5,
        num_turns: int = 9,
        *,
        evades: bool = False,
    ) -> None:
        self.margin = _checks.scalar("margin", margin, at_least=0.0)
        self.time_step = _checks.scalar("time_step", time_step, above=0.0)
        span = _checks.number("horizon", horizon, above=0.0)
        self.num_steps = max(1, round(span / float(time_step)))
        self.num_turns = _checks.positive_int("num_turns", num_turns)
        self.evades = _kinds.flag("evades", evades)

    def __call__(
        self,
        robot: Dynamics,
        state: StateVector,
        control: ControlVector,
        duration: Scalar,
        points: Float[Array, "P D"],
        is_point: Bool[Array, " P"],
        speeds: Float[Array, " P"] | None = None,
        age: Scalar | None = None,
        is_wall: Bool[Array, " P"] | None = None,
        room: VolumeField | None = None,
    ) -> Validated:
        """Check a command.

        Args:
            robot: model of the robot.
            state: (nx,) state in which the command takes effect.
            control: (nu,) the command.
            duration: time until the next command takes effect [s].
            points: (P, 2) measured points, in a volume (P, 3) with z up [m].
            is_point: (P,) points that count.
            speeds: (P,) speeds with which they may move [m/s]; 0 when absent.
            age: time from their measurement to the state [s]; 0 when absent.
            is_wall: (P,) points that stand, which the robot shall not touch while it evades what
                moves; none when absent.
            room: in a volume, distance to what is not known to be free [m]; not checked when
                absent.
        """
        seen = _Surroundings.of(robot, state, points, is_point, speeds, age, is_wall, room)
        # In the middle of a long command the robot may be closer than at its end.
        half = robot.step(state, control, 0.5 * duration)
        after = robot.step(half, control, 0.5 * duration)
        here = seen.gap(robot, seen.place(robot, state), seen.age)
        passed = seen.gap(robot, seen.place(robot, half), seen.age + 0.5 * duration)
        # A robot within the margin may move if it gets no closer, but for rounding. With more it
        # would creep on in each control period.
        enough = jnp.minimum(self.margin, here - ROUNDING)
        is_command = jnp.isfinite(control).all()
        later = seen._replace(age=seen.age + duration)
        straight, walls = self._brake_with(robot, after, jnp.zeros(()), later)
        planned = jnp.minimum(passed, straight)
        if self.evades:
            at, between = seen.place(robot, state), seen.place(robot, half)
            walls = jnp.minimum(seen.wall_gap(robot, between), walls)
            is_room = walls >= jnp.minimum(self.margin, seen.wall_gap(robot, at) - ROUNDING)
            # Where it would stand after the command, and where if it braked at once.
            ends = [self._come_to_rest(robot, each, jnp.zeros(()), seen) for each in (after, state)]
            after_it, at_once = (seen.mover_gap(robot, poses[-1]) for poses, _ in ends)
            evades = is_room & (after_it >= at_once - ROUNDING)
            planned = jnp.where(evades, jnp.maximum(planned, enough), planned)

        # After most commands the robot can brake straight. If not, it may brake with a turn after
        # the command (stage 0), and if that does not do, in its place (stage 1). The stages are one
        # loop, so that the turns are one program.
        def is_tried(carry: tuple[Count, ControlVector, Scalar]) -> Flag:
            stage, _, gap = carry
            return (stage < 2) & ~(is_command & (gap >= enough))

        def turn(
            carry: tuple[Count, ControlVector, Scalar],
        ) -> tuple[Count, ControlVector, Scalar]:
            stage, _, _ = carry
            is_first = stage == 0
            start = jnp.where(is_first, after, state)
            around = seen._replace(age=jnp.where(is_first, later.age, seen.age))
            stopping, gap = self._brake(robot, start, duration, around)
            gap = jnp.where(is_first, jnp.minimum(passed, gap), gap)
            return stage + 1, jnp.where(is_first, control, stopping), gap

        first = jnp.where(is_command, 0, 1).astype(jnp.int32)
        stage, kept, least = jax.lax.while_loop(is_tried, turn, (first, control, planned))
        return Validated(kept, stage == 2, least)

    def brake(
        self,
        robot: Dynamics,
        state: StateVector,
        duration: Scalar,
        points: Float[Array, "P D"],
        is_point: Bool[Array, " P"],
        room: VolumeField | None = None,
    ) -> ControlVector:
        """Return the control (nu,) that begins the best braking trajectory.

        Args:
            robot: model of the robot.
            state: (nx,) state in which it takes effect.
            duration: time until the next command takes effect [s].
            points: (P, 2) measured points, in a volume (P, 3) with z up [m].
            is_point: (P,) points that count.
            room: in a volume, distance to what is not known to be free [m].
        """
        seen = _Surroundings.of(robot, state, points, is_point, room=room)
        return self._brake(robot, state, duration, seen)[0]

    @property
    def turns(self) -> Float[Array, " B"]:
        """Shares of the steering of the braking trajectories."""
        return jnp.linspace(-1.0, 1.0, self.num_turns) if self.num_turns > 1 else jnp.zeros(1)

    def _brake(
        self, robot: Dynamics, state: StateVector, duration: Scalar, seen: "_Surroundings"
    ) -> tuple[ControlVector, Scalar]:
        """Return the control that begins the best braking trajectory, and its least gap."""
        turns = self.turns
        gaps, rooms = jax.vmap(lambda turn: self._brake_with(robot, state, turn, seen))(turns)
        # Of equal ones the straightest: distances are rounded to a millimetre for that. First of
        # all one that touches no wall: that contact is sure, and somebody may go elsewhere.
        touches = jnp.maximum(self.margin - rooms, 0.0)
        best = jnp.argmax(jnp.round(gaps, 3) - 1e-4 * jnp.abs(turns) - TOUCH * touches)
        return robot.stopping_control(state, duration, turns[best]), gaps[best]

    def _brake_with(
        self, robot: Dynamics, start: StateVector, turn: Scalar, seen: "_Surroundings"
    ) -> tuple[Scalar, Scalar]:
        """Return the least gap of the robot while it brakes, and its least distance from walls."""
        poses, moved = self._come_to_rest(robot, start, turn, seen)
        index = jnp.arange(1 + self.num_steps, dtype=jnp.int32)
        times = seen.age + jnp.minimum(index, moved).astype(jnp.float32) * self.time_step
        gaps = jax.vmap(lambda pose, time: seen.gap(robot, pose, time))(poses, times)
        # A robot that touches a wall already may leave it.
        return gaps.min(), jax.vmap(lambda pose: seen.wall_gap(robot, pose))(poses[1:]).min()

    def _come_to_rest(
        self, robot: Dynamics, start: StateVector, turn: Scalar, seen: "_Surroundings"
    ) -> tuple[Float[Array, "S 3"], Count]:
        """Return where the robot is while it brakes, the last place repeated, and the step in which
        it comes to rest."""

        def step(
            carry: tuple[StateVector, Float[Array, "S 3"], Count, Flag],
        ) -> tuple[StateVector, Float[Array, "S 3"], Count, Flag]:
            at, poses, number, _ = carry
            after = robot.step(at, robot.stopping_control(at, self.time_step, turn), self.time_step)
            pose = seen.place(robot, after)
            is_moving = jnp.any(jnp.abs(pose - seen.place(robot, at)) > AT_REST)
            return after, poses.at[number + 1].set(pose), number + 1, is_moving

        def goes_on(carry: tuple[StateVector, Float[Array, "S 3"], Count, Flag]) -> Flag:
            return carry[3] & (carry[2] < self.num_steps)

        # The loop ends when the robot stands, and has no points in it: all poses are compared with
        # all points at once.
        blank = jnp.broadcast_to(seen.place(robot, start), (1 + self.num_steps, 3))
        carry = start, blank, jnp.zeros((), jnp.int32), jnp.array(True)
        _, poses, number, is_moving = jax.lax.while_loop(goes_on, step, carry)
        index = jnp.arange(1 + self.num_steps, dtype=jnp.int32)
        poses = poses[jnp.minimum(index, number)]
        # Who touches a robot that stands does so by himself.
        return poses, jnp.where(is_moving, number, number - 1)


class _Surroundings(NamedTuple):
    """What a scan has met: points, the speeds with which they may move, and walls among them.

    Points that do not count are far away, because shapes are static. `age` is the time since their
    measurement [s]. `room` is the distance to what is not known to be free, in a volume [m].
    """

    points: Float[Array, "P D"]
    speeds: Float[Array, " P"]
    walls: Float[Array, "P D"] | None
    age: Scalar
    room: VolumeField | None

    @classmethod
    def of(
        cls,
        robot: Dynamics,
        state: StateVector,
        points: Float[Array, "P D"],
        is_point: Bool[Array, " P"],
        speeds: Float[Array, " P"] | None = None,
        age: Scalar | None = None,
        is_wall: Bool[Array, " P"] | None = None,
        room: VolumeField | None = None,
    ) -> "_Surroundings":
        """Return what a robot in a state has around it, see `StopCheck`."""
        far = FAR + State(state, robot, None).place(points.shape[1])
        return cls(
            jnp.where(is_point[:, None], points, far),
            jnp.zeros(points.shape[0]) if speeds is None else speeds,
            None if is_wall is None else jnp.where(is_wall[:, None], points, far),
            jnp.zeros(()) if age is None else age,
            room,
        )

    def place(self, robot: Dynamics, state: StateVector) -> Float[Array, "3"]:
        """Return where a robot is: (x, y, yaw) in the plane, (x, y, z) in a volume."""
        if self.points.shape[1] == 2:
            return robot.pose(state)
        return State(state, robot, None).place(3)

    def gap(self, robot: Dynamics, place: Float[Array, "3"], time: Scalar) -> Scalar:
        """Return the distance of the robot's edge from the nearest point, a time after it was
        measured."""
        least = _least_gap(self.points, self.speeds * time, place, robot)
        if self.room is None:
            return least
        return jnp.minimum(least, self.room(place) - robot.footprint.radius)

    def wall_gap(self, robot: Dynamics, place: Float[Array, "3"]) -> Scalar:
        if self.walls is None:
            return jnp.asarray(jnp.inf)
        least = _least_gap(self.walls, jnp.zeros(self.walls.shape[0]), place, robot)
        if self.room is None:
            return least
        return jnp.minimum(least, self.room(place) - robot.footprint.radius)

    def mover_gap(self, robot: Dynamics, place: Float[Array, "3"]) -> Scalar:
        """Return the distance of the robot's edge from where the nearest thing that moves was
        measured."""
        still = jnp.where(self.speeds > 0.0, 0.0, -FAR)
        return _least_gap(self.points, still, place, robot)


def _least_gap(
    points: Float[Array, "P D"],
    radii: Float[Array, " P"],
    place: Float[Array, "3"],
    robot: Dynamics,
) -> Scalar:
    """Return the distance of a robot's edge from the nearest disc, in a volume ball."""
    if points.shape[1] == 2:
        return discs_clearance(points, radii, place[:2], place[2], robot.footprint)
    # By columns: rows of three numbers would not be computed side by side.
    squared = sum((column - own) ** 2 for column, own in zip(points.T, place, strict=True))
    return jnp.min(jnp.sqrt(squared) - radii, initial=jnp.inf) - robot.footprint.radius
