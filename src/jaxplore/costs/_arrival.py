"""Costs of coming to rest at a goal, shared by the costs that lead to one."""

import jax.numpy as jnp

from jaxplore._types import Position, Scalar
from jaxplore.belief.car_roads import CarGuidance
from jaxplore.belief.guidance import GuidanceField
from jaxplore.costs._distance import offset
from jaxplore.costs._manoeuvre import REACH, manoeuvre
from jaxplore.dynamics.base import State
from jaxplore.dynamics.goal_check import ARM
from jaxplore.geometry.angles import sin_cos
from jaxplore.geometry.vectors import length

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


def with_overrun(state: State, distance: Scalar) -> Scalar:
    """Return a distance to go, plus twice that by which the robot would overrun its end [m].

        d + 2 e(d)

    So a robot brakes in time, also where its braking distance is longer than the horizon.
    """
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
    is_near = (distance < near) & (to_go < DETOUR * distance + SLACK)
    way = field.direction(position)
    inverse = 1.0 / jnp.maximum(distance, 1e-3)
    x, y = (
        jnp.where(is_near, straight * inverse, along)
        for straight, along in zip((x, y), way, strict=True)
    )
    sin, cos = sin_cos(yaw)
    missing = length(x, y) - (cos * x + sin * y)
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
