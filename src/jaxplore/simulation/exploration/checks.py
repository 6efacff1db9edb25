"""Checks of the arguments of an exploration scenario."""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from jaxplore import _checks
from jaxplore._types import ArrayLike, GridMask, Position, Rows, Scalar, StateVector
from jaxplore._xla import on_device
from jaxplore.belief.car import car_motion
from jaxplore.belief.perception import MAX_UNKNOWN, Perception
from jaxplore.dynamics.base import Dynamics
from jaxplore.dynamics.goal_check import GoalCheck
from jaxplore.maps.datum import DECIMALS, Datum
from jaxplore.maps.ground import Ground
from jaxplore.maps.occupancy_grid import FREE_THRESHOLD, OccupancyGrid
from jaxplore.maps.terrain import TerrainMap
from jaxplore.sensing.base import Sensor
from jaxplore.simulation.exploration.reachability import to_grid

probability_at = jax.jit(OccupancyGrid.at)


def grid_and_ground(world: OccupancyGrid | TerrainMap) -> tuple[OccupancyGrid, Ground | None]:
    """Return the grid of a map, and its ground; None if it is level."""
    return (world.grid, world.ground) if isinstance(world, TerrainMap) else (world, None)


def check_goal(
    goal: Position,
    world: OccupancyGrid,
    robot: Dynamics,
    reachable: np.ndarray | GridMask,
    radius: float,
    datum: Datum,
    name: str = "goal",
) -> None:
    """Check that a goal is in free space, and within `radius` [m] of a reachable cell's centre."""
    # In single precision 0.05 would be told as 0.05000000074505806.
    told = np.round(datum.round_to_map(goal).astype(np.float64), DECIMALS).tolist()
    if float(probability_at(world, goal)) >= FREE_THRESHOLD:
        raise ValueError(f"{name} is {told}; accepted: a place in free space")
    centres = np.argwhere(np.asarray(reachable)) + 0.5
    away = np.linalg.norm(centres - np.asarray(to_grid(world.frame, goal)), axis=-1)
    nearest = world.resolution * float(away.min())
    if nearest > radius:
        raise ValueError(
            f"{name} is {told}, which a robot of radius "
            f"{float(robot.radius):g} m cannot reach from its start: {nearest:.2f} m is the "
            f"nearest it gets; accepted: a {name} within {radius:g} m of where it can go"
        )


def check_targets(targets: Rows | None, world: OccupancyGrid, datum: Datum) -> Float[Array, "M 2"]:
    """Check that targets are in free space, and return them (M, 2); M = 0 when absent."""
    if targets is None:
        return on_device(np.zeros((0, 2), np.float32))
    given = _checks.floats("targets", targets, "(M, 2) with M >= 1")
    if given.ndim != 2 or given.shape[0] < 1 or given.shape[1] != 2:
        raise ValueError(f"targets has shape {given.shape}; accepted: (M, 2) with M >= 1")
    check_spots("targets", given, world, datum)
    return on_device(given.copy())


def check_spots(name: str, spots: np.ndarray, world: OccupancyGrid, datum: Datum) -> None:
    """Check that positions (M, 2) [m], relative to a datum, are in free space."""
    for index, spot in enumerate(spots):
        if (
            not np.isfinite(spot).all()
            or float(probability_at(world, jnp.asarray(spot))) >= FREE_THRESHOLD
        ):
            raise ValueError(
                f"{name}[{index}] is {datum.round_to_map(spot).tolist()}; accepted: a place in "
                "free space"
            )


def check_unknown(max_unknown: ArrayLike | None, *, is_apart: bool) -> Scalar:
    """Check the share of unknown cells in [0, 1] below which a map is explored, or choose it.

    When absent, it is 1 if the goal has a cost-to-go of its own (`is_apart`), or else
    `MAX_UNKNOWN`.
    """
    if max_unknown is None:
        max_unknown = 1.0 if is_apart else MAX_UNKNOWN
    return _checks.scalar("max_unknown", max_unknown, at_least=0.0, at_most=1.0)


def check_coverage(target_coverage: ArrayLike | None) -> Scalar:
    """Check a target coverage in (0, 1]; when absent, return one that coverage never reaches."""
    if target_coverage is None:
        return on_device(np.asarray(2.0, np.float32))
    return _checks.scalar("target_coverage", target_coverage, above=0.0, at_most=1.0)


def start_state(robot: Dynamics, pose: np.ndarray, altitude: float) -> StateVector:
    """Return the state (nx,) at rest at a pose, and at an altitude [m] if the robot has one."""
    state = robot.at_pose(*(float(value) for value in pose))
    height = _checks.number("altitude", altitude)
    if "z" not in robot.state_names:
        return state
    return robot.with_component(state, "z", height)


def check_keep_out(
    perception: Perception,
    world: OccupancyGrid,
    pose: np.ndarray,
    targets: Float[Array, "M 2"],
    datum: Datum,
) -> GridMask | None:
    """Return the cells (H, W) that the robot must not enter; None if it may enter all.

    Raises:
        ValueError: a start (x, y, yaw) [m, m, rad] in one of them, or all targets.
    """
    closed = perception.closed_cells(world)
    if closed is None:
        return None
    places = np.concatenate([np.asarray(pose[:2], np.float32)[None], np.asarray(targets)])
    cells = world.frame.to_cell(jnp.asarray(places))
    is_in = np.asarray(world.contains(cells) & closed[tuple(jnp.moveaxis(cells, -1, 0))])
    if is_in[0]:
        x, y = datum.round_to_map(pose[:2]).tolist()
        raise ValueError(f"start is ({x:g}, {y:g}), in a keep-out area; accepted: outside of all")
    if len(targets) and is_in[1:].all():
        raise ValueError(
            f"targets are {len(targets)}, all in keep-out areas; accepted: one outside at least"
        )
    return closed


def check_perception(
    perception: Perception | None,
    sensors: tuple[Sensor, ...],
    world: OccupancyGrid,
    robot: Dynamics,
    ground: Ground | None,
    check: GoalCheck | None,
    max_unknown: Scalar,
    *,
    is_localising: bool,
) -> Perception:
    """Check that a perception was made for a scenario, or make it when absent.

    Its goal and heading, ranges, resolution and ground must be those of the scenario. `robot`,
    `max_unknown` and `is_localising` are only read to make one.
    """
    goal, heading = (None, None) if check is None else (check.position, check.heading)
    if perception is None:
        return Perception(
            sensors,
            world.resolution,
            robot.radius,
            goal=goal,
            goal_heading=heading,
            max_unknown=max_unknown,
            ground=ground,
            car=car_motion(robot),
            is_localising=is_localising,
        )
    # Arrays compare element by element, so their values are compared as lists.
    for name, own, given in (
        ("goal", perception.goal, goal),
        ("goal_heading", perception.goal_heading, heading),
    ):
        values = [None if each is None else each.tolist() for each in (own, given)]
        if values[0] != values[1]:
            raise ValueError(
                f"perception has the {name} {values[0]}; accepted: the scenario's, {values[1]}"
            )
    ranges, known = (
        [sensor.max_range for sensor in each] for each in (sensors, perception.sensors)
    )
    if known != ranges or perception.resolution != world.resolution:
        raise ValueError(
            f"perception is for ranges of {known} m and cells of {perception.resolution:g} m; "
            f"accepted: those of the scenario, {ranges} m and {world.resolution:g} m"
        )
    if not _is_same_ground(perception.ground, ground):
        kind = "no" if perception.ground is None else "another"
        raise ValueError(f"perception has {kind} ground; accepted: that of the world")
    return perception


def check_prior(prior: OccupancyGrid | None, world: OccupancyGrid, datum: Datum) -> OccupancyGrid:
    """Check that a prior map has the cells of the world; when absent, return an unknown map."""
    if prior is None:
        return OccupancyGrid.unknown(world.crop(world.probability).shape, world.frame)
    shape, accepted_shape = (each.crop(each.probability).shape for each in (prior, world))
    # A world that is padded already may come with a prior that is.
    if shape not in (accepted_shape, world.shape):
        raise ValueError(f"prior has shape {shape}; accepted: the world's, {accepted_shape}")
    is_near = np.allclose(prior.frame.origin, world.frame.origin, rtol=1e-6, atol=1e-6)
    if not is_near or prior.resolution != world.resolution:
        given, accepted = (
            datum.round_to_map(each.frame.origin).tolist() for each in (prior, world)
        )
        raise ValueError(
            f"prior has cells of {prior.resolution:g} m at {given}; "
            f"accepted: the world's, {world.resolution:g} m at {accepted}"
        )
    return prior


def _is_same_ground(ground: Ground | None, other: Ground | None) -> bool:
    """Check whether two grounds are equal, or both absent."""
    if ground is None or other is None:
        return ground is other
    layers = ((each.elevation, each.is_traversable) for each in (ground, other))
    (height, open_), (other_height, other_open) = layers
    return np.array_equal(height, other_height) and np.array_equal(open_, other_open)
