import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests import kinds
from tests.kinds import STARTS

from jaxplore.simulation.exploration.scenario import ExplorationScenario
from jaxplore.simulation.fleet.radio import Radio
from jaxplore.simulation.loop import initial_loop_state, run_chunk

CHUNK = 10
"""Steps of a chunk; those of `simulate` at this rate, so `parts_program.py` runs these programs."""


@pytest.fixture(scope="session")
def alone() -> ExplorationScenario:
    """Return the exploration of one small robot; all fleets here are made of it."""
    return kinds.alone()


@pytest.fixture(scope="session")
def drive(alone):
    """Return the controller of one robot, among others or alone."""
    return functools.partial(kinds.fleet_explorer, alone.robot)


@pytest.fixture(scope="session")
def fleet(alone):
    """Return a maker of a fleet of equal robots and its controller."""
    return functools.partial(kinds.fleet, alone)


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
