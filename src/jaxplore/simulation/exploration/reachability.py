"""Cells of the true world that the robot can reach."""

import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxplore.belief.perception import Perception
from jaxplore.belief.roadmap import Locomotion, TurnsOnTheSpot
from jaxplore.dynamics.base import Dynamics
from jaxplore.geometry.footprint import Footprint, Rectangle
from jaxplore.maps.clearance import clearance_field
from jaxplore.maps.collision import clearance_reach, disc_clearance
from jaxplore.maps.datum import ORIGIN, Datum
from jaxplore.maps.frame import GridFrame
from jaxplore.maps.ground import Ground
from jaxplore.maps.occupancy_grid import FREE_THRESHOLD, OCCUPIED_THRESHOLD, OccupancyGrid


def reachable_cells(
    world: OccupancyGrid, start: np.ndarray, radius: float, datum: Datum = ORIGIN
) -> np.ndarray:
    """Compute the cells (H, W) that the centre of a disc can reach from a start (x, y, ...) [m].

    They are free cells whose centres are at least `radius` [m] from the nearest solid cell's face
    (centre distance less half a cell), 8-connected to the start. Cells that are not known to be
    free are solid, as is everything off the map. A diagonal step passes a corner, and none of the
    cells that touch it may be solid, as on the lattice of the fields (`clear_corners`). `datum` is
    for messages.

    Raises:
        ValueError: a start where the disc cannot stand.
    """
    free = _free_cells(world)
    place = np.asarray(to_grid(world.frame, np.asarray(start[:2], np.float32)))
    row, column = (int(index) for index in np.floor(place))
    where = f"start is ({_format_pose(start[:2], datum)})"
    if not (0 <= row < free.shape[0] and 0 <= column < free.shape[1]):
        corners = np.asarray(
            world.frame.to_world(
                jnp.asarray(
                    [[0, 0], free.shape, [0, free.shape[1]], [free.shape[0], 0]], jnp.float32
                )
            )
        )
        ends = datum.round_to_map(np.stack([corners.min(axis=0), corners.max(axis=0)]))
        x, y = (f"{_number(low)} to {_number(high)}" for low, high in ends.T.tolist())
        raise ValueError(f"{where}, off the map; accepted: free space within x {x}, y {y}")
    if not free[row, column]:
        kind = (
            "in a wall"
            if float(world.probability[row, column]) > OCCUPIED_THRESHOLD
            else "in unknown space"
        )
        raise ValueError(
            f"{where}, {kind}; accepted: free space{_nearest(world, free, radius, start, datum)}"
        )
    distance = _face_distance(free, world.resolution)
    # The tolerance is for rounding: a passage that is exactly wide enough must stay open.
    room = free & (distance >= radius - 1e-6)
    # The start is between cell centres, so the cells around it are seeds as well: those to which a
    # step leads from its own cell.
    near = np.zeros_like(free)
    for down, right in itertools.product((-1, 0, 1), repeat=2):
        corner = free[
            max(0, row + min(down, 0)) : row + max(down, 0) + 1,
            max(0, column + min(right, 0)) : column + max(right, 0) + 1,
        ]
        if corner.all() and row + down < free.shape[0] and column + right < free.shape[1]:
            near[max(0, row + down), max(0, column + right)] = True
    labels = _label_connected(room, free)
    beginnings = np.unique(labels[near & room])
    # Seeds are cell centres, so the start between them may still touch something. Only the cells
    # around it are passed on, so that maps of all sizes share a program.
    reach = clearance_reach(radius, world.resolution)
    near_start = (slice(row, row + 2 * reach + 1), slice(column, column + 2 * reach + 1))
    clearance = _clearance(
        np.pad(~free, reach, constant_values=True)[near_start],
        (place - (row, column) + reach).astype(np.float32),
        np.float32(radius),
        resolution=world.resolution,
        reach=reach,
    )
    if beginnings.size == 0 or float(clearance) < 0.0:
        raise ValueError(
            f"{where}, where a robot of radius {radius:g} m touches something; "
            f"accepted: free space{_nearest(world, free, radius, start, datum)}"
        )
    return np.isin(labels, beginnings)


def drivable_cells(
    world: OccupancyGrid,
    start: np.ndarray,
    robot: Dynamics,
    perception: Perception,
    datum: Datum,
) -> np.ndarray:
    """Compute the cells (H, W) that a robot can reach from a start (x, y, yaw) [m, m, rad].

    They are those of `reachable_cells`. If the robot cannot turn on the spot, they are also those
    of the road map of its fields on the true map that it can drive to.

    Raises:
        ValueError: a start where the robot cannot stand, or from which it cannot drive as far as
            it is long.
    """
    cells = reachable_cells(world, start, float(robot.radius), datum)
    if isinstance(perception.locomotion, TurnsOnTheSpot):
        return cells
    padded = world.pad()
    # With the clearance of its paths, so that coverage asks for nothing that they do not enter.
    lengths = np.asarray(
        _car_lengths(
            padded,
            jnp.asarray(start, jnp.float32),
            perception.required_clearance,
            perception.locomotion,
            perception.max_clearance,
            perception.field_sensor.stride,
        )
    )
    stride = perception.field_sensor.stride
    by_cell = np.isfinite(lengths).repeat(stride, axis=0).repeat(stride, axis=1)
    both: np.ndarray = cells & by_cell[: cells.shape[0], : cells.shape[1]]
    # A car in a room of its own length can move a little to and fro, and still goes nowhere.
    place = np.asarray(to_grid(world.frame, np.asarray(start[:2], np.float32)))
    cells_away = np.hypot(*(np.argwhere(both) + 0.5 - place).T).max(initial=0.0)
    farthest = float(cells_away) * world.resolution
    length, width = _size(robot.footprint)
    if farthest < length:
        raise ValueError(
            f"start is ({_format_pose(start, datum)}), from where a car of {length:g} m by "
            f"{width:g} m with a turning radius of {float(robot.turning_radius):.2f} m gets "
            f"{farthest:.1f} m far at most; accepted: a start from which it gets at least its own "
            "length, or a smaller car"
        )
    return both


def _size(footprint: Footprint) -> tuple[float, float]:
    """Return length and width of a footprint [m]."""
    if isinstance(footprint, Rectangle):
        return float(footprint.length), float(footprint.width)
    return (2.0 * float(footprint.radius),) * 2


@functools.partial(jax.jit, static_argnames=("reach", "stride"))
def _car_lengths(
    world: OccupancyGrid,
    pose: Array,
    required: Array,
    locomotion: Locomotion,
    reach: float,
    stride: int,
) -> Array:
    clearance = clearance_field(~world.is_free, world.frame, reach)
    return locomotion.roadmap(clearance, required, stride).lengths_from(pose)


to_grid = jax.jit(GridFrame.to_grid)
_clearance = functools.partial(jax.jit, static_argnames=("resolution", "reach"))(disc_clearance)


def _label_connected(room: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Label the cells (H, W) of `room` that steps connect, from 1; 0 elsewhere.

    All cells that touch the corner of a diagonal step must be in `free`.
    """
    import scipy.ndimage  # slow to import, and few need it
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    labels, count = scipy.ndimage.label(room)
    is_clear = free[:-1, :-1] & free[:-1, 1:] & free[1:, :-1] & free[1:, 1:]
    pairs = []
    for one, other in (
        ((slice(-1), slice(-1)), (slice(1, None), slice(1, None))),
        ((slice(-1), slice(1, None)), (slice(1, None), slice(-1))),
    ):
        is_step = is_clear & room[one] & room[other]
        pairs.append(np.stack([labels[one][is_step], labels[other][is_step]]))
    first, second = np.unique(np.concatenate(pairs, axis=1), axis=1)
    graph = coo_array((np.ones(len(first)), (first, second)), shape=(count + 1, count + 1))
    _, merged = connected_components(graph, directed=False)
    # No step leads to or from label 0, what is not in `room`, so it stays apart.
    joined: np.ndarray = np.where(room, merged[labels] + 1, 0)
    return joined


def _free_cells(world: OccupancyGrid) -> np.ndarray:
    return np.asarray(world.probability) < FREE_THRESHOLD


def with_closed(world: OccupancyGrid, ground: Ground) -> OccupancyGrid:
    """Return the world with untraversable cells as walls."""
    closed = jnp.where(ground.is_traversable, world.probability, 1.0)
    return world.with_probability(closed)


def _face_distance(free: np.ndarray, resolution: float) -> np.ndarray:
    import scipy.ndimage  # slow to import, and few need it

    # The border of solid cells stands for the space off the map.
    padded = np.pad(free, 1)
    distance = np.asarray(scipy.ndimage.distance_transform_edt(padded))[1:-1, 1:-1]
    return (distance - 0.5) * resolution


def open_spot(world: OccupancyGrid, radius: float) -> tuple[float, float]:
    """Return the position (x, y) with the greatest clearance for a disc [m].

    Raises:
        ValueError: the map has no place for it.
    """
    distance = _face_distance(_free_cells(world), world.resolution)
    row, column = np.unravel_index(int(np.argmax(distance)), distance.shape)
    if distance[row, column] < radius:
        raise ValueError(
            f"the map has no place for a robot of radius {radius:g} m; accepted: a map with "
            "connected free space"
        )
    x, y = np.asarray(world.frame.cell_centre(jnp.asarray([row, column])))
    # The shortest number that is the same in float32: it is shown, and stored in settings.
    return float(str(x)), float(str(y))


def _format_pose(pose: np.ndarray, datum: Datum) -> str:
    """Return a position or a pose in the coordinates of the map, for a message."""
    return ", ".join(map(_number, datum.round_to_map(pose).tolist()))


def _number(value: float) -> str:
    """Return a coordinate with six digits; from 1e5 on, with three after the point."""
    return f"{value:g}" if abs(value) < 1e5 else f"{value:.3f}"


def _nearest(
    world: OccupancyGrid, free: np.ndarray, radius: float, start: np.ndarray, datum: Datum
) -> str:
    """Return a hint for an error message: the nearest position where the robot fits."""
    # The margin covers the rounding of the position in the message to centimetres.
    cells = np.argwhere(free & (_face_distance(free, world.resolution) >= radius + 0.1))
    if cells.size == 0:
        return f"; this map has no place for a robot of radius {radius:g} m"
    centres = np.asarray(world.frame.cell_centre(jnp.asarray(cells)))
    x, y = datum.round_to_map(centres[np.argmin(np.hypot(*(centres - start[:2]).T))])
    return f", for example ({x:.2f}, {y:.2f})"
