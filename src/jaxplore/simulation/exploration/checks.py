"""Checks of the arguments of an exploration scenario."""

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from jaxplore import _checks
from jaxplore._types import GridMask, Position, Rows
from jaxplore.dynamics.base import Dynamics
from jaxplore.maps.ground import Ground
from jaxplore.maps.occupancy_grid import FREE_THRESHOLD, OccupancyGrid


def check_goal(
    goal: Position, world: OccupancyGrid, robot: Dynamics, reachable: GridMask, radius: float
) -> None:
    """Check that the robot can reach a goal.

    Args:
        goal: goal position (x, y) [m].
        world: true map.
        robot: true model of the robot.
        reachable: (H, W) cells that the robot's centre can reach.
        radius: distance at which the goal counts as reached [m].

    Raises:
        ValueError: no reachable cell is within the radius.
    """
    rows, columns = np.nonzero(np.asarray(reachable))
    centres = world.frame.cell_centre(jnp.asarray(np.stack([rows, columns], axis=-1)))
    nearest = float(jnp.min(jnp.linalg.norm(centres - goal, axis=-1)))
    if nearest > radius:
        raise ValueError(
            f"goal is {goal.tolist()}, which a robot of radius {float(robot.radius):g} m "
            f"cannot reach from its start: {nearest:.2f} m is the nearest it gets; accepted: a "
            f"goal within {radius:g} m of where it can go"
        )


def checked_targets(targets: Rows | None, world: OccupancyGrid) -> Float[Array, "M 2"]:
    """Check that targets are in free space, and return them (M, 2); M = 0 when absent.

    Raises:
        ValueError: another shape; a target that is not in free space.
    """
    if targets is None:
        return jnp.zeros((0, 2))
    given = np.asarray(targets, np.float32)
    if given.ndim != 2 or given.shape[0] < 1 or given.shape[1] != 2:
        raise ValueError(f"targets has shape {given.shape}; accepted: (M, 2) with M >= 1")
    for index, spot in enumerate(given):
        if not np.isfinite(spot).all() or float(world.at(jnp.asarray(spot))) >= FREE_THRESHOLD:
            raise ValueError(
                f"targets[{index}] is {spot.tolist()}; accepted: a place in free space"
            )
    return jnp.asarray(given)


def is_same_ground(ground: Ground | None, other: Ground | None) -> bool:
    """Check whether two grounds are equal, or both absent."""
    if ground is None or other is None:
        return ground is other
    layers = ((each.elevation, each.is_traversable) for each in (ground, other))
    (height, open_), (other_height, other_open) = layers
    return np.array_equal(height, other_height) and np.array_equal(open_, other_open)


def with_closed(world: OccupancyGrid, ground: Ground) -> OccupancyGrid:
    """Return the world with untraversable cells as walls."""
    closed = jnp.where(ground.is_traversable, world.probability, 1.0)
    return OccupancyGrid(closed, world.resolution, world.frame.origin)


def is_same_frame(grid: OccupancyGrid, other: OccupancyGrid) -> bool:
    """Check whether two maps have the same origin and resolution."""
    is_same = np.allclose(grid.frame.origin, other.frame.origin, rtol=1e-6, atol=1e-6)
    return is_same and grid.resolution == other.resolution


def whole_steps(name: str, rate: float, control_rate: float) -> Array:
    """Return the number of control periods in a period of a slower rate.

    Args:
        name: name of the slower rate, for the error message.
        rate: slower rate [Hz].
        control_rate: rate of the controls [Hz].

    Raises:
        ValueError: a rate that is not a whole fraction of the control rate.
    """
    checked = _checks.number(name, rate, above=0.0, at_most=control_rate)
    ratio = control_rate / checked
    if abs(ratio - round(ratio)) > 1e-3 * ratio:
        raise ValueError(
            f"{name} is {rate!r}; accepted: a whole fraction of the control rate of "
            f"{control_rate:g} Hz, such as {control_rate / max(1, round(ratio)):g}"
        )
    return jnp.asarray(round(ratio), jnp.int32)
