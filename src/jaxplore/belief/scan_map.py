"""The map of a belief made anew from stored scans, after closed loops have moved them."""

import equinox as eqx
import jax

from jaxplore._types import Count, Pose
from jaxplore.belief.belief import Belief
from jaxplore.belief.perception import Perception
from jaxplore.localisation.closing import LoopCloser
from jaxplore.localisation.localiser import Localiser, LocaliserState
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.sensing.base import update_grid


def close_loops(
    closer: LoopCloser,
    localiser: Localiser,
    known: LocaliserState,
    perception: Perception,
    belief: Belief,
    prior: OccupancyGrid,
    start: Pose,
) -> tuple[LocaliserState, Belief]:
    """Close loops, on the host; return the state, and the belief with the map of moved scans.

    The belief is the same object if no scan has moved. `prior` is the map that the robot knew in
    advance, and `start` the pose at the start.
    """
    known = closer.find_loops(localiser, known, perception.sensors)
    settled = closer.optimise_poses(localiser, known, perception.sensors)
    if settled is None:
        return known, belief
    grid = _map_scans((localiser, perception), settled, prior, start)
    return settled, _remap(perception, belief, grid, settled.pose)


@eqx.filter_jit
def _map_scans(
    given: tuple[Localiser, Perception], known: LocaliserState, prior: OccupancyGrid, start: Pose
) -> OccupancyGrid:
    """Return the map of all stored scans at their poses."""
    _, perception = given
    scans = known.scans

    def add(index: Count, grid: OccupancyGrid) -> OccupancyGrid:
        pose = scans.poses[index]
        stored = scans.scan(index, perception.sensors)
        for sensor, scan in zip(perception.sensors, stored, strict=True):
            sighting = sensor.sight(grid, scan, pose, perception.ground)
            grid = update_grid(grid, sighting, perception.sensor_model)
        return grid

    grid: OccupancyGrid = jax.lax.fori_loop(
        0, scans.number, add, perception.free_below_robot(prior, start)
    )
    return grid


@eqx.filter_jit
def _remap(perception: Perception, belief: Belief, grid: OccupancyGrid, pose: Pose) -> Belief:
    return perception.remap(belief, grid, pose)
