"""Check that the robot can stop after a command, and brake in the best way if it cannot."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxplore import _checks
from jaxplore._types import ArrayLike, ControlVector, Count, Flag, Scalar, StateVector
from jaxplore.dynamics.base import Dynamics
from jaxplore.maps.collision import discs_clearance

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

    Raises:
        ValueError: a negative margin, a time that is not positive, fewer than one trajectory.
    """

    margin: Scalar
    time_step: Scalar
    num_steps: int = eqx.field(static=True)
    num_turns: int = eqx.field(static=True)

    def __init__(
        self,
        margin: ArrayLike = 0.03,
        time_step: float = 0.05,
        horizon: float = 2.5,
        num_turns: int = 9,
    ) -> None:
        self.margin = _checks.scalar("margin", margin, at_least=0.0)
        self.time_step = _checks.scalar("time_step", time_step, above=0.0)
        span = _checks.number("horizon", horizon, above=0.0)
        self.num_steps = max(1, round(span / float(time_step)))
        self.num_turns = _checks.positive_int("num_turns", num_turns)

    def __call__(
        self,
        robot: Dynamics,
        state: StateVector,
        control: ControlVector,
        duration: Scalar,
        points: Float[Array, "P 2"],
        is_point: Bool[Array, " P"],
        speeds: Float[Array, " P"] | None = None,
        age: Scalar | None = None,
        is_wall: Bool[Array, " P"] | None = None,
    ) -> Validated:
        """Check a command.

        Args:
            robot: model of the robot.
            state: (nx,) state in which the command takes effect.
            control: (nu,) the command.
            duration: time until the next command takes effect [s].
            points: (P, 2) measured points [m].
            is_point: (P,) points that count.
            speeds: (P,) speeds with which they may move [m/s]; 0 when absent.
            age: time from their measurement to the state [s]; 0 when absent.
            is_wall: (P,) points that stand, which the robot shall not touch while it evades what
                moves; none when absent.
        """
        # Shapes are static, so points that do not count are moved far away.
        far = FAR + robot.position(state)
        kept = jnp.where(is_point[:, None], points, far)
        walls = None if is_wall is None else jnp.where(is_wall[:, None], points, far)
        still = jnp.zeros(kept.shape[0])
        began = jnp.zeros(()) if age is None else age

        def gap(at: StateVector, time: Scalar) -> Scalar:
            radii = still if speeds is None else speeds * time
            return discs_clearance(
                kept, radii, robot.position(at), robot.heading(at), robot.footprint
            )

        def room(at: StateVector) -> Scalar:
            if walls is None:
                return jnp.asarray(jnp.inf)
            place = robot.position(at), robot.heading(at), robot.footprint
            return discs_clearance(walls, still, *place)

        def braking(start: StateVector, turn: Scalar, time: Scalar) -> tuple[Scalar, Scalar]:
            """Return the least gap of the robot while it brakes, and its least distance from
            walls."""

            def step(
                carry: tuple[StateVector, Scalar, Scalar, Count, Flag],
            ) -> tuple[StateVector, Scalar, Scalar, Count, Flag]:
                at, least, free, number, _ = carry
                after = robot.step(
                    at, robot.stopping_control(at, self.time_step, turn), self.time_step
                )
                is_moving = jnp.any(jnp.abs(robot.pose(after) - robot.pose(at)) > AT_REST)
                # Who touches a robot that stands does so by himself.
                passed = (number + is_moving.astype(jnp.int32)).astype(jnp.float32)
                least = jnp.minimum(least, gap(after, time + passed * self.time_step))
                return after, least, jnp.minimum(free, room(after)), number + 1, is_moving

            def goes_on(carry: tuple[StateVector, Scalar, Scalar, Count, Flag]) -> Flag:
                return carry[4] & (carry[3] < self.num_steps)

            # A robot that touches a wall already may leave it.
            begin = gap(start, time), jnp.asarray(jnp.inf), jnp.zeros((), jnp.int32)
            carry = (start, *begin, jnp.array(True))
            _, least, free, *_ = jax.lax.while_loop(goes_on, step, carry)
            return least, free

        # In the middle of a long command the robot may be closer than at its end.
        half = robot.step(state, control, 0.5 * duration)
        after = robot.step(half, control, 0.5 * duration)
        here = gap(state, began)
        passed = gap(half, began + 0.5 * duration)
        # A robot within the margin may move if it gets no closer, but for rounding. With more it
        # would creep on in each control period.
        enough = jnp.minimum(self.margin, here - ROUNDING)
        is_command = jnp.isfinite(control).all()
        turns = jnp.linspace(-1.0, 1.0, self.num_turns) if self.num_turns > 1 else jnp.zeros(1)

        def turn_after(*_: Any) -> Scalar:
            found = jax.vmap(lambda turn: braking(after, turn, began + duration))(turns)
            return jnp.minimum(passed, jnp.max(found[0]))

        def brake(*_: Any) -> tuple[ControlVector, Scalar]:
            gaps, rooms = jax.vmap(lambda turn: braking(state, turn, began))(turns)
            # Of equal ones the straightest: distances are rounded to a millimetre for that. First
            # of all one that touches no wall: that contact is sure, and somebody may go elsewhere.
            touches = jnp.maximum(self.margin - rooms, 0.0)
            best = jnp.argmax(jnp.round(gaps, 3) - 1e-4 * jnp.abs(turns) - TOUCH * touches)
            return robot.stopping_control(state, duration, turns[best]), gaps[best]

        # Loops of one iteration or none: after most commands the robot can brake straight, and
        # turns cost the most.
        straight, _ = braking(after, jnp.zeros(()), began + duration)
        planned = jnp.minimum(passed, straight)
        is_tried = is_command & ~(planned >= enough)
        planned = jax.lax.fori_loop(0, jnp.where(is_tried, 1, 0), turn_after, planned)
        is_safe = is_command & (planned >= enough)
        kept, least = jax.lax.fori_loop(0, jnp.where(is_safe, 0, 1), brake, (control, planned))
        return Validated(kept, ~is_safe, least)
