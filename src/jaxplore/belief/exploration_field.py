"""Compute the cost-to-go to remaining information, and to a goal through a partly unknown map."""

from typing import Any

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from jaxplore._types import ArrayLike, Flag, GridMask, Position, Scalar
from jaxplore.belief.guidance import GuidanceField
from jaxplore.belief.roadmap import Locomotion
from jaxplore.maps.clearance import clearance_field
from jaxplore.maps.field import ScalarField
from jaxplore.maps.occupancy_grid import OccupancyGrid

LEFTOVER_DETOUR = 1e3
"""Additional cost-to-go of places with less than `min_information` [m]: they come last."""
GOAL_DETOUR = 5e2
"""Additional cost-to-go of the goal during exploration [m]: after information, before leftovers."""
LEFTOVER_SHARE = 0.03
"""Share of `min_information` below which a place is ignored."""
TIGHT = 5.0
"""Additional cost per metre where the robot just fits, relative to open space. Most rollouts
collide there."""


def exploration_field(
    clearance: ScalarField,
    worth: Float[Array, "rows columns"],
    required: Scalar,
    locomotion: Locomotion,
    *,
    decay_length: Scalar,
    min_information: Scalar,
    stride: int,
    goal: Position | None,
    is_explored: Flag,
    goal_heading: Scalar | None = None,
    start: Position | None = None,
    claims: Float[Array, "rows columns"] | None = None,
    goal_detour: ArrayLike = GOAL_DETOUR,
) -> GuidanceField:
    """Return the cost-to-go to remaining information [m] and the direction of its descent.

    The cost is

        U(x) = min over s of [ d(x, s) - decay_length * ln W(s) ],
        W(s) = I(s) exp(-dwell(s) / patience)

    over positions s in free space. I(s) is the information of a full circle of beams, and `worth`
    is W at the nodes [nat]. d is the length of the shortest path that keeps the robot's clearance
    `required` [m] from all cells that are not free; length counts up to double where the robot just
    fits. U is also `-decay_length` times the logarithm of the greatest
    `W(s) exp(-d(x, s) / decay_length)`: the robot travels `decay_length` [m] farther for e times
    the information. U has local minima only at places with information.

    `dwell` is the time recently spent near a place. A place where the robot stays loses its weight
    and regains it later, so the robot gives up what it cannot observe. Places with W below
    `min_information` [nat], mostly cells near walls that noise changes back and forth, get an
    additional cost of a kilometre: they come last.

    In a fleet, the cost of a place at the end of a path is greater by `claims` [m], what the claims
    of the other robots to it cost (`jaxplore.belief.claims`). It is a cost and no discount of W: a
    place that is claimed by another robot keeps its rank before the places with little information.

    A goal (x, y) [m] is one more source of the field, with a heading there [rad] if one is given.
    It comes after all places with enough information and before the places with little, by its
    additional cost `goal_detour` [m], and it is the only source once the map is explored
    (`is_explored`).

    `clearance` is the distance to the nearest cell that is not free [m]. Nodes are `stride` cells
    apart; static. For `start`, the position of the robot, see `Roadmap.field`.
    """
    roads = locomotion.roadmap(clearance, required, stride)
    source = information_sources(worth, decay_length, min_information)
    if claims is not None:
        source = source + claims
    if goal is not None:
        at_goal = roads.sources_at(goal, goal_heading) + goal_detour
        # Once all is explored, the goal is the only source.
        source = jnp.minimum(jnp.where(is_explored, jnp.inf, source), at_goal)
    return roads.field(source, start)


def information_sources(
    worth: Float[Array, "*nodes"], decay_length: Scalar, min_information: Scalar
) -> Float[Array, "*nodes"]:
    """Return the cost of each place as the end of a path, `-decay_length ln W` [m], with W its
    `worth`, the discounted information. Where W is below `min_information` it gets the additional
    cost `LEFTOVER_DETOUR`; below `LEFTOVER_SHARE` of that it is infinite."""
    # The bound keeps the logarithm finite where there is no information.
    reward = decay_length * jnp.log(jnp.maximum(worth, 1e-6))
    detour = jnp.where(worth < min_information, LEFTOVER_DETOUR, 0.0)
    return jnp.where(worth >= LEFTOVER_SHARE * min_information, detour - reward, jnp.inf)


def leads_to_goal(field: GuidanceField, position: Position) -> Flag:
    """Return whether the next source that an exploration field leads to is its goal.

    It is if the cost-to-go shows that only the goal or leftovers are reachable.
    """
    # Half the detour tells sources that have one, the goal and leftovers, from all others. Off the
    # map the cost is `outside`, which says nothing about the sources.
    cost = field(position)
    return (cost > 0.5 * GOAL_DETOUR) & (cost < field.outside)


def leads_to_information(cost: Any) -> Any:
    """Return whether a cost-to-go at the robot [m] leads to a place with at least
    `min_information`. Otherwise there is nothing left to learn: places with little information, and
    the goal, have a detour of their own, and without any place the cost is infinite or
    `outside`."""
    return cost < 0.5 * LEFTOVER_DETOUR


def goal_field(
    grid: OccupancyGrid,
    blocked: GridMask | None,
    goal: Position,
    required: Scalar,
    locomotion: Locomotion,
    *,
    unknown_factor: Scalar,
    max_clearance: float,
    stride: int,
    start: Position | None = None,
    heading: Scalar | None = None,
) -> GuidanceField:
    """Return the cost-to-go to a goal [m] and the direction of its descent.

    The cost is the weighted length of the shortest path on which the robot fits between *occupied*
    cells; unknown cells are passable (free-space assumption). No path enters the cells `blocked`.
    If a path turns out to be blocked, the next field leads around. A robot that follows the field
    reaches the goal, or has observed that no path exists.

    Path length is weighted by `1 + 5 t^4`, with the tightness t from 0 in open space to 1 where the
    robot just fits, with the clearance `required` [m]. Most rollouts collide in tight passages, so
    a longer but wider path is preferred. In unknown space the length is also weighted by
    `1 + unknown_factor`.

    Source: Koenig and Smirnov, "Sensor-based planning with the freespace assumption", ICRA 1997.

    The clearance is computed up to `max_clearance` [m], and nodes are `stride` cells apart; both
    static. For `start`, the position of the robot, see `Roadmap.field`. Paths end with `heading`
    [rad]; with any when None.
    """
    solid = grid.is_occupied if blocked is None else grid.is_occupied | blocked
    clearance = clearance_field(solid, grid.frame, max_clearance)
    rows, columns = (-(-side // stride) for side in grid.shape)
    height, width = grid.shape
    # A node stands for a block of cells: weight it by the share of unknown cells in its block.
    is_unknown = ~grid.is_free & ~grid.is_occupied
    padded = jnp.pad(is_unknown, ((0, rows * stride - height), (0, columns * stride - width)))
    share = jnp.mean(padded.reshape(rows, stride, columns, stride), axis=(1, 3), dtype=jnp.float32)
    roads = locomotion.roadmap(
        clearance,
        required,
        stride,
        lambda tightness: 1.0 + TIGHT * tightness**4,
        1.0 + unknown_factor * share,
    )
    return roads.field(roads.sources_at(goal, heading), start)
