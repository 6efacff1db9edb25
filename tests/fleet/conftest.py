import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import DifferentialDrive, Lidar, OccupancyGrid, Perception, explorer
from jaxplore.control.fleet_controller import same_for_all
from jaxplore.costs.moving import MovingObstacleCost
from jaxplore.simulation.exploration.scenario import ExplorationScenario
from jaxplore.simulation.fleet.radio import Radio
from jaxplore.simulation.fleet.scenario import Fleet
from jaxplore.simulation.loop import initial_loop_state, run_chunk

STARTS = ((1.0, 1.0, 0.3), (1.0, 2.0, -0.4), (1.9, 1.5, 0.1))
CHUNK = 10
"""Steps of a chunk; those of `simulate` at this rate, so `parts_program.py` runs these programs."""


def two_rooms() -> OccupancyGrid:
    """6 x 3 m: two rooms and a door."""
    world = np.zeros((30, 60), np.float32)
    world[0], world[-1], world[:, 0], world[:, -1] = 1.0, 1.0, 1.0, 1.0
    world[:, 30] = 1.0
    world[12:20, 30] = 0.0
    return OccupancyGrid(world, 0.1)


@pytest.fixture(scope="session")
def alone() -> ExplorationScenario:
    """Return the exploration of one small robot; all fleets here are made of it."""
    robot = DifferentialDrive(max_speed=1.0, radius=0.15)
    lidar = Lidar(num_beams=36, max_range=1.5, range_noise=0.01)
    perception = Perception(lidar, 0.1, 0.15, num_directions=4, max_clearance=0.5)
    return ExplorationScenario(
        two_rooms(), robot, lidar, STARTS[0], perception=perception, control_rate=20.0,
        field_rate=4.0,
    )  # fmt: skip


@pytest.fixture(scope="session")
def drive(alone):
    """Return the controller of one robot, among others or alone."""
    cost = MovingObstacleCost(nearness=None, clearance=0.6)

    def make(*, has_others: bool):
        sizes = {"horizon": 10, "num_samples": 32}
        return explorer(
            alone.robot, has_moving_obstacles=has_others, moving_obstacle_cost=cost, **sizes
        )

    return make


@pytest.fixture(scope="session")
def fleet(alone, drive):
    """Return a maker of a fleet of equal robots and its controller."""

    def make(starts=STARTS[:2], radio=None, coordination="claims", **options):
        scenario = Fleet(
            alone, starts, radio=radio, coordination=coordination, plan_length=10, **options
        )
        controller = drive(has_others=scenario.num_robots > 1)
        return same_for_all(controller, scenario.robot), scenario

    return make


def advanced(controller, scenario, steps, seed=0):
    """Return the state and the records after some steps, in chunks of one compiled loop."""
    controller, key = controller.at_period(scenario.control_period), jax.random.key(seed)
    state, records = initial_loop_state(controller, scenario, key), []
    for _ in range(steps // CHUNK):
        given = controller, scenario, key, jnp.int32(CHUNK)
        state, rows, _ = run_chunk(given, state, CHUNK)
        records.append(jax.tree.map(np.asarray, rows))
    return state, jax.tree.map(lambda *rows: np.concatenate(rows), *records)


@pytest.fixture(scope="session")
def run():
    return advanced


@pytest.fixture(scope="session")
def paired(fleet):
    """Return the state and the records of robots after some seconds."""

    @functools.cache
    def make(radio_range: float):
        return advanced(*fleet(STARTS[:2], Radio(radio_range, uses_sight=False)), 100)

    return make
