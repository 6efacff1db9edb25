from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
import pytest
from benchmarks.bound.problem import Problem

from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.sensing.lidar import Lidar
from jaxplore.simulation.exploration.reachability import reachable_cells

SIDE, RADIUS, RANGE = 0.1, 0.2, 3.0


@pytest.fixture
def make_problem() -> Callable[..., Problem]:
    """The problem of a disc of radius 0.2 m with a lidar of 3 m on a map of 0.1 m cells."""

    def make(
        solid: np.ndarray,
        start: tuple[float, float],
        origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
        **changes: object,
    ) -> Problem:
        world = OccupancyGrid(jnp.asarray(solid, jnp.float32), SIDE, origin)
        place = np.asarray(world.frame.to_world(jnp.asarray(start, jnp.float32)))
        given = {
            "world": world,
            "sensors": (Lidar(num_beams=64, max_range=RANGE, range_noise=0.02),),
            "reachable": reachable_cells(world, place, RADIUS),
            "start": np.asarray(start, np.float64),
            "speed": 1.0,
            "acceleration": 1.0,
            "scan_period": 0.1,
            "radius": RADIUS,
        }
        return Problem(**{**given, **changes})

    return make
