"""The cost of driving fast past places that can hide somebody."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import DifferentialDrive, State
from jaxplore.belief.belief import Belief
from jaxplore.belief.tracks import ObstacleTracker
from jaxplore.costs import OcclusionCost
from jaxplore.sensing.clusters import Edges

ROBOT = DifferentialDrive(radius=0.3)
COST = OcclusionCost(1.6, 1.0, 0.2, 0.3)
TRACKS = ObstacleTracker(2).init()


@jax.jit
def price(values, position, is_there):
    tracks = TRACKS._replace(edges=Edges(position, is_there))
    nothing = jnp.zeros(2)
    return COST.stage(State(values, ROBOT), nothing, jnp.zeros(()), Belief(tracks=tracks))


def paid(speed: float, *edges: tuple[float, float], is_there: bool = True) -> float:
    places = np.full((8, 2), 50.0, np.float32)
    places[: len(edges)] = np.array(edges).reshape(-1, 2)
    there = (np.arange(8) < len(edges)) & is_there
    return float(price(np.float32([0.0, 0.0, 0.4, speed, 0.0]), places, there))


@pytest.mark.parametrize("distance", [0.5, 0.8, 1.2, 2.0, 3.0, 5.0])
@pytest.mark.parametrize("speed", [0.2, 0.6, 1.0])
def test_it_costs_what_is_too_fast_to_stop_for_somebody(distance: float, speed: float) -> None:
    # The greatest speed at which both ways fit into the distance, by bisection.
    low, high = 0.0, 10.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        needed = middle**2 / 2.0 + 1.6 * (0.2 + middle)
        low, high = (middle, high) if needed <= distance - 0.3 else (low, middle)
    expected = max(0.0, speed - max(low, 0.3)) ** 2
    assert paid(speed, (0.0, distance)) == pytest.approx(expected, abs=1e-4)
    # The nearest edge counts, wherever it is.
    assert paid(speed, (9.0, 9.0), (-distance, 0.0)) == pytest.approx(expected, abs=1e-4)


def test_edges_that_are_not_there_cost_nothing() -> None:
    assert paid(1.0) == 0.0
    assert paid(1.0, (0.5, 0.0), is_there=False) == 0.0
    assert paid(1.0, (0.5, 0.0)) == pytest.approx(0.49, abs=1e-5)
