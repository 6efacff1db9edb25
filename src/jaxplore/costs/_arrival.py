"""Costs of coming to rest at a goal, shared by the costs that lead to one."""

import functools
import math
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxplore._types import Position, Scalar
from jaxplore.belief.car_roads import CarGuidance
from jaxplore.belief.guidance import GuidanceField
from jaxplore.costs._contact import offset
from jaxplore.dynamics.base import State
from jaxplore.dynamics.goal import ARM
from jaxplore.geometry.angles import sin_cos
from jaxplore.geometry.reeds_shepp import lengths
from jaxplore.geometry.vectors import length

NODES, SPACING, TURNS = 41, 0.06, 48
"""Number of nodes of the table along x and y, their distance [m], and number of headings."""
REACH = NODES // 2 * SPACING
"""Greatest distance from the goal along x and along y in the table [m]."""
REVERSAL = 1.0
"""Price of a change between forwards and backwards, that of `CarMotion` [m]. With 0.3 m fewer cars
arrived: 10 of 15 drives, and 11 with 1 m."""
END, END_DISTANCE, END_TURN = 1.5, 0.15, 0.1
"""Price of standing as far from the goal as is allowed [m], and how far that is [m, rad]."""
BRAKING_SHARE = 0.5
"""Share of the deceleration with which a robot plans to brake; the rest is for control."""
OVERRUN = 2.0
"""Cost of each metre by which a robot would overrun a goal, in metres of distance from it."""
NEAR, NEAR_OF_CAR = 0.75, 0.3
"""Distance from a goal at which the straight line leads there, not the nodes of a field [m]; less
for a car, which must manoeuvre."""
DETOUR, SLACK = 2.0, 0.5
"""Longest way, in straight lines and beyond them [m], that is near: longer ones lead round a wall.
Ways count double where they are narrow."""
FADING = 0.3
"""Distance from the goal below which the direction of motion counts less [m]."""
ROUND = 1.0
"""Cost by which the way of a car along a field is longer than in free space before it counts [m].
Read between the poses of a lattice, a field is not exact, and its ways end at those poses."""
SETTLING = 0.3
"""Cost of a squared speed at the goal, so that a robot comes to rest there [s^2/m]."""
HEADING, TURNING_REACH = 0.3, 0.4
"""Cost of facing away from the heading at a goal [m], and the distance from it at which it is 1/e
of that [m]. It falls by at most 0.64 m per metre, so a robot that comes from the other side is
better off at the goal than where it would turn too early."""


@functools.lru_cache(maxsize=16)
def manoeuvre_table(radius: float) -> np.ndarray:
    """Return the costs (2, TURNS, NODES, NODES) by heading, y and x of a car around a goal [m].

    The goal is at the origin and has the heading 0. The cost is that of the cheapest way of Reeds
    and Shepp with the turning radius `radius` [m] to a pose p near the goal, forwards or backwards
    first, plus a price of standing at p:

        min over p of  length + 1 m * reversals + 1.5 m ((|p| / 0.15 m)^2 + (turn of p / 0.1)^2)

    Without that price each millimetre beside the goal would cost a whole manoeuvre.
    """
    along = SPACING * (np.arange(NODES) - NODES // 2)
    turn, y, x = np.meshgrid(math.tau / TURNS * np.arange(TURNS), along, along, indexing="ij")
    cos, sin = np.cos(turn), np.sin(turn)
    # The pose of the goal from the car.
    to_goal = (-(cos * x + sin * y) / radius, (sin * x - cos * y) / radius, -turn)
    table = radius * lengths(*to_goal, REVERSAL / radius)
    # The way to another end is that of a car at another pose to the goal.
    for axis in (2, 3):
        ends = []
        for nodes in range(-2, 3):
            moved = table.take(np.clip(np.arange(NODES) - nodes, 0, NODES - 1), axis=axis)
            ends.append(moved + END * (nodes * SPACING / END_DISTANCE) ** 2)
        table = np.min(ends, axis=0)
    ends = [table]
    for angle in END_TURN * np.array([-1.0, -0.5, 0.5, 1.0]):
        cos, sin = np.cos(angle), np.sin(angle)
        pose = (cos * x + sin * y, cos * y - sin * x, turn - angle)
        turned = np.stack([_read(each.ravel(), *pose, 0, np) for each in table])
        ends.append(turned + END * (angle / END_TURN) ** 2)
    return np.min(ends, axis=0).astype(np.float32)


def manoeuvre(radius: float, x: Scalar, y: Scalar, turn: Scalar, speed: Scalar) -> Scalar:
    """Return the cost of the last manoeuvre of a car [m]; see `manoeuvre_table`.

    Beyond the table it is that at its edge. `radius` is the turning radius [m]; static. The car is
    `x` ahead of the goal and `y` on its left [m], and its heading is `turn` from that at the goal
    [rad]. Its forward speed [m/s] tells the direction of travel.
    """
    table = jnp.asarray(manoeuvre_table(radius).ravel())
    # A pose that is not finite has no index.
    x, y, turn = (jnp.where(jnp.isfinite(each), each, 0.0) for each in (x, y, turn))
    cost: Array = _read(table, x, y, turn, jnp.where(speed < 0.0, TURNS, 0), jnp)
    return cost


def _read(table: Any, x: Any, y: Any, turn: Any, first: Any, xp: Any) -> Any:
    """Interpolate in a flat table, with NumPy or JAX; `first` is the layer of the heading 0."""

    def place(value: Any) -> tuple[Any, Any]:
        at = xp.clip(value / SPACING + NODES // 2, 0.0, NODES - 1.001)
        low = xp.floor(at)
        return low.astype(np.int32), at - low

    angle = turn * (TURNS / math.tau)
    below = xp.floor(angle)
    (row, down), (column, right) = place(y), place(x)

    def at(heading: Any) -> Any:
        corner = ((first + xp.mod(heading, TURNS)) * NODES + row) * NODES + column
        upper, lower = (
            table[each] + right * (table[each + 1] - table[each])
            for each in (corner, corner + NODES)
        )
        return upper + down * (lower - upper)

    heading = below.astype(np.int32)
    before, after = at(heading), at(heading + 1)
    return before + (angle - below) * (after - before)


def with_overrun(state: State, distance: Scalar) -> Scalar:
    """Return a distance to go, plus twice the `overrun` of its end [m]: so a robot brakes in time,
    also where its braking distance is longer than the horizon."""
    return distance + OVERRUN * overrun(state, distance)


def overrun(state: State, distance: Scalar) -> Scalar:
    """Return the distance by which a robot would overrun a point if it braked from now on [m]:

        e(d) = max(s - d, 0),   s = v^2 / a

    with d the distance to the point [m], and s the distance in which the robot comes to rest with
    half of its deceleration a (`Dynamics.deceleration`).
    """
    return jnp.maximum(state.stopping_distance / BRAKING_SHARE - distance, 0.0)


def homing_cost(
    state: State,
    field: GuidanceField,
    to_go: Scalar,
    goal: Position,
    heading: Scalar | None,
    turning: Scalar,
) -> Scalar:
    """Return the cost of driving to a goal and coming to rest there [m].

    It is `with_overrun` of the distance to go, plus `turning` [m] times what is missing of facing
    the way, plus 0.3 s^2/m of the squared speed within about 0.3 m of the goal. Close to the goal
    the distance and the way are those of the straight line, as the nodes of a field are coarser
    than the radius of a goal. Farther away the distance is `to_go`, the cost-to-go beyond that at
    the goal [m]. A heading at the goal [rad] adds `0.3 exp(-(d / 0.4)^2) |turn| / pi`.

    A car that can reverse comes to a goal with a heading by `manoeuvre` instead: see
    `_parking_cost`.
    """
    if heading is not None and isinstance(field, CarGuidance) and field.roads.can_reverse:
        return _parking_cost(state, field, to_go, goal, heading)
    position, yaw, dynamics = state.position, state.heading, state.dynamics
    x, y = (-each for each in offset(state, goal))
    distance = length(x, y)
    near = jnp.where(dynamics.turning_radius > 0.0, NEAR_OF_CAR, NEAR)
    # Behind a wall the straight line is short and the way is long: the field goes on to lead there.
    is_near = (distance < near) & (to_go < DETOUR * distance + SLACK)
    way = field.direction(position)
    inverse = 1.0 / jnp.maximum(distance, 1e-3)
    x, y = (
        jnp.where(is_near, straight * inverse, along)
        for straight, along in zip((x, y), way, strict=True)
    )
    sin, cos = sin_cos(yaw)
    missing = length(x, y) - (cos * x + sin * y)
    # At the goal the way has no direction any more, and a robot would turn for nothing.
    fading = jnp.minimum(distance / FADING, 1.0)
    total = with_overrun(state, jnp.where(is_near, distance, to_go)) + turning * fading * missing
    nearness = jnp.exp(-((distance / FADING) ** 2))
    total = total + SETTLING * nearness * _squared_motion(state)
    if heading is None:
        return total
    turn = jnp.abs(jnp.arctan2(*sin_cos(yaw - heading))) / jnp.pi
    return total + HEADING * jnp.exp(-((distance / TURNING_REACH) ** 2)) * turn


def _parking_cost(
    state: State, field: CarGuidance, to_go: Scalar, goal: Position, heading: Scalar
) -> Scalar:
    """Return the cost of a car of driving to a goal with a heading and coming to rest there [m].

    Within 0.9 m of the goal it is `with_overrun` of

        max(way, to_go - 1 m)

    with `way` the cost of the manoeuvre in free space. The cost-to-go counts where walls make it
    much longer. A mere choice between both would have a step, and the car would stand before it.
    """
    x, y = offset(state, goal)
    sin, cos = sin_cos(heading)
    radius = field.roads.radius * field.frame.resolution
    pose = (cos * x + sin * y, cos * y - sin * x, state.heading - heading)
    way = manoeuvre(radius, *pose, state.speed)
    inside = (REACH - length(x, y)) / FADING
    share = jnp.where(inside > 0.0, jnp.minimum(inside, 1.0), 0.0)
    near = jnp.maximum(way, to_go - ROUND)
    total = with_overrun(state, to_go + share * (near - to_go))
    return total + SETTLING * jnp.exp(-((way / FADING) ** 2)) * _squared_motion(state)


def _squared_motion(state: State) -> Scalar:
    """Return the square of what must vanish at rest: the speed, and that of what turns with it."""
    names = state.dynamics.state_names
    total = state.squared_speed
    if "vz" in names:
        total = total + state["vz"] ** 2
    # In the order of the state: that of a set would be another program in each process.
    for name in names:
        if name in ("omega", "wx", "wy", "wz"):
            total = total + (ARM * state[name]) ** 2
    return total
