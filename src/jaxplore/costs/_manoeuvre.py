"""Cost of the last manoeuvre of a car, to a goal with a heading, as a table."""

import functools
import math
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxplore._types import Scalar
from jaxplore.geometry.reeds_shepp import lengths

NODES, SPACING, TURNS = 41, 0.06, 48
"""Number of nodes of the table along x and y, their distance [m], and number of headings."""
REACH = NODES // 2 * SPACING
"""Greatest distance from the goal along x and along y in the table [m]."""
REVERSAL = 1.0
"""Price of a change between forwards and backwards, that of `CarMotion` [m]. With 0.3 m fewer cars
arrived: 10 of 15 drives, and 11 with 1 m."""
END, END_DISTANCE, END_TURN = 1.5, 0.15, 0.1
"""Price of standing as far from the goal as is allowed [m], and how far that is [m, rad]."""


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
