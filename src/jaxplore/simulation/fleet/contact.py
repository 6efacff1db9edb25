"""Contact of the robots of a fleet with one another."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxplore._types import Pose, Scalar
from jaxplore.dynamics.formation import Formation


class Parted(NamedTuple):
    """What the moves of the robots come to when those that would touch are stopped.

    `is_contact` (N,) says whether each robot was stopped because it would have touched another one.
    `gap` (N,) is the distance of each robot from the nearest other one [m].
    """

    states: tuple[Array, ...]
    is_contact: Bool[Array, " N"]
    gap: Float[Array, " N"]


def stop_touching(
    formation: Formation,
    radii: Float[Array, " N"],
    before: Sequence[Array],
    moved: Sequence[Array],
) -> Parted:
    """Stop the robots whose moves would make them touch another robot.

    Robots are discs about their positions, with the `radii` (N,) of circles that hold them [m]. All
    moves take place at once, so the order of the robots does not matter. A robot that is stopped
    may be where another one moves, so that one is stopped as well, and so on. None touch in
    `before`.
    """
    places = [
        jnp.stack(
            [robot.position(each) for robot, each in zip(formation.robots, some, strict=True)]
        )
        for some in (before, moved)
    ]
    count = len(formation.robots)
    room = radii[:, None] + radii[None, :] + jnp.where(jnp.eye(count, dtype=bool), -jnp.inf, 0.0)

    def gaps(mine: Float[Array, "N 2"], others: Float[Array, "N 2"]) -> Float[Array, "N N"]:
        offset = mine[:, None] - others[None, :]
        return jnp.sqrt(jnp.sum(offset * offset, axis=-1)) - room

    def find_touching(stopped: Bool[Array, " N"]) -> Bool[Array, " N"]:
        others = jnp.where(stopped[:, None], places[0], places[1])
        return stopped | (gaps(places[1], others) < 0.0).any(axis=1)

    # Whoever stops may stand in the way of another one, so the set is grown until it does not
    # change: at most N times, because none leaves it.
    def more(carry: tuple[Bool[Array, " N"], Bool[Array, " N"]]) -> tuple[Array, Array]:
        return carry[1], find_touching(carry[1])

    nobody = jnp.zeros(count, bool)
    stopped, _ = jax.lax.while_loop(
        lambda carry: jnp.any(carry[0] != carry[1]), more, (nobody, find_touching(nobody))
    )
    states = tuple(
        jnp.where(is_stopped, robot.resolve_collision(old, new), new)
        for robot, old, new, is_stopped in zip(
            formation.robots, before, moved, stopped, strict=True
        )
    )
    final = jnp.where(stopped[:, None], places[0], places[1])
    return Parted(states, stopped, gaps(final, final).min(axis=1))


def find_room(
    landings: Sequence[Pose | None], places: Float[Array, "N 2"], radii: Float[Array, " N"]
) -> Bool[Array, " N"]:
    """Return whether each robot can be put down at its landing [m, m, rad] without touching others.

    It touches neither where the others are (N, 2) [m] nor where they are put down at the same time.
    `radii` (N,) are those of the circles that hold the robots [m]. A robot without a landing (None)
    stays where it is.
    """
    put = jnp.stack(
        [
            place if landing is None else landing[:2]
            for landing, place in zip(landings, places, strict=True)
        ]
    )
    room = radii[:, None] + radii[None, :] + jnp.where(jnp.eye(len(radii)) > 0.0, -jnp.inf, 0.0)

    def is_apart(others: Float[Array, "N 2"]) -> Bool[Array, " N"]:
        offset = put[:, None] - others[None, :]
        return (jnp.sqrt(jnp.sum(offset * offset, axis=-1)) >= room).all(axis=1)

    return is_apart(places) & is_apart(put)


def predict_positions(
    formation: Formation,
    states: Sequence[Array],
    controls: Float[Array, "T nu"],
    num_steps: int,
    dt: Scalar,
) -> Float[Array, "N S 2"]:
    """Return where the robots are at each step of their plans (N, S, 2), now included [m].

    `controls` (T, nu) are those of all robots, `dt` apart [s]; the last ones are kept if S - 1 > T.
    `num_steps` is S; static.
    """
    rows = jnp.minimum(jnp.arange(num_steps - 1), controls.shape[0] - 1)

    def move(now: Array, control: Array) -> tuple[Array, Array]:
        after = formation.step(now, control, dt)
        return after, formation.positions(after)

    now = jnp.concatenate(list(states))
    _, reached = jax.lax.scan(move, now, controls[rows])
    first = formation.positions(now)[None]
    return jnp.swapaxes(jnp.concatenate([first, reached]), 0, 1)
