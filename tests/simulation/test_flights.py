"""Whole flights in short: what `jaxplore run` makes of settings, each architecture and robot, and
what goes wrong in flight."""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.kinds import flight_controller, flight_scenario

from jaxplore import Faults
from jaxplore.control.base import Controller
from jaxplore.report.exploration.data import ExplorationRecord
from jaxplore.simulation.exploration.scenario import ExplorationScenario
from jaxplore.simulation.loop import copy_tree, initial_loop_state, run_chunk
from jaxplore.tasks.registry import build, make_settings, without_unread

pytestmark = pytest.mark.long

SHORT: dict[str, Any] = {
    "map": "zones",
    "rates": {"control": 25.0, "sensing": 25.0, "fields": 5.0},
    "lidar": {"num_beams": 12},
    "fields": {"num_directions": 12},
    "informative": {
        "horizon": 20,
        "dt": 0.08,
        "num_samples": 96,
        "field_beams": 6,
        "field_range": 6.0,
        "field_noise": 0.0,
        "field_spacing": 1.0,
    },
}
CHUNK = 50  # that of the tests of architectures, which are the same programs
STEPS = 75
DELAYS = {"two-layer": 0, "parallel": 0, "random-walk": 2}
"""Control periods between a command and its effect."""


class Flight(NamedTuple):
    records: ExplorationRecord
    positions: np.ndarray
    belief: np.ndarray
    initial_unknown: float


def fly(
    controller: Controller, scenario: ExplorationScenario, faults: Faults | None = None
) -> Flight:
    if faults is not None:
        scenario = scenario.with_disturbances([faults])
    controller, key = controller.at_period(scenario.control_period), jax.random.key(0)
    state = initial_loop_state(controller, scenario)
    unknown, rows = float(state.task.progress.unknown), []
    for begun in range(0, STEPS, CHUNK):
        steps = jnp.asarray(min(CHUNK, STEPS - begun))
        state, records, done = run_chunk(
            (controller, scenario, key, steps), copy_tree(state), CHUNK
        )
        rows.append(jax.tree.map(lambda leaf, n=int(done): np.asarray(leaf)[:n], records))
    records = jax.tree.map(lambda *parts: np.concatenate(parts), *rows)
    positions = np.concatenate([np.asarray(scenario.start)[None], records.state])[:, :2]
    belief = np.asarray(state.task.belief.grid.unpad().probability)
    return Flight(records, positions, belief, unknown)


def check(flight: Flight) -> None:
    """It stays finite and touches nothing."""
    records = flight.records
    assert len(records.state) > STEPS // 2
    assert np.isfinite(records.state).all()
    assert np.isfinite(records.control).all()
    assert not records.is_collision.any()
    assert flight.belief.min() >= 0.0
    assert flight.belief.max() <= 1.0


def experiment(**changes: Any) -> tuple[Controller, ExplorationScenario]:
    made = build(make_settings(without_unread({**SHORT, **changes})))
    return made.controller, made.scenario


def test_a_robot_on_the_ground_goes_from_zone_to_zone() -> None:
    robot = {"model": "differential_drive", "radius": 0.3, "max_speed": 1.0}
    found = fly(*experiment(architecture="sequential", robot=robot))
    check(found)
    assert np.linalg.norm(found.positions[-1] - found.positions[0]) > 0.3
    assert found.records.unknown[-1] < found.initial_unknown


@functools.cache
def flight_of(architecture: str) -> tuple[Controller, ExplorationScenario]:
    """Return a random walk with a guard, from settings, or an architecture that has none."""
    if architecture == "random-walk":
        return experiment(architecture=architecture)
    return flight_controller(architecture), flight_scenario()


def second(architecture: str) -> int:
    """Return the number of steps of a second."""
    return round(1.0 / flight_of(architecture)[1].period)


def nothing(architecture: str) -> np.ndarray:
    return np.zeros(flight_of(architecture)[1].world.shape, bool)


def with_faults(architecture: str, **faults: Any) -> Flight:
    """Return a flight with faults; all of an architecture are one compiled program."""
    given = {"walls": nothing(architecture), "control_delay": DELAYS[architecture], **faults}
    return fly(*flight_of(architecture), Faults(**given))


@functools.cache
def free_flight(architecture: str) -> Flight:
    return with_faults(architecture)


@pytest.mark.parametrize("architecture", DELAYS)
@pytest.mark.parametrize(
    ("faults", "seconds"),
    [
        ({}, 0.0),
        ({"scan_dropout": (1.0, 2.0)}, 1.0),
        ({"lost_odometry": (1.0, 1.5)}, 0.5),
        ({"frozen_odometry": (1.0, 1.5)}, 0.5),
    ],
)
def test_flies_on_through_faults(architecture: str, faults: dict, seconds: float) -> None:
    flight = with_faults(architecture, **faults) if faults else free_flight(architecture)
    check(flight)
    steps = seconds * second(architecture)
    assert abs(int(flight.records.is_faulty.sum()) - steps) <= 1
    assert flight.records.unknown[-1] < flight.initial_unknown
    assert bool(flight.records.is_finite.all()) != ("lost_odometry" in faults)
    late = DELAYS[architecture]
    hovering = np.asarray(flight_of(architecture)[1].robot.default_control)
    np.testing.assert_array_equal(flight.records.control[:late], np.tile(hovering, (late, 1)))


@pytest.mark.parametrize("architecture", DELAYS)
def test_stops_before_a_wall_that_appears(architecture: str) -> None:
    """Across the way of the flight without it, where it is in sight and there is time to stop."""
    free = free_flight(architecture)
    path, begin = free.positions, second(architecture)
    travelled = np.cumsum(np.linalg.norm(np.diff(path[begin:], axis=0), axis=1))
    at = begin + int(np.argmax(travelled >= 2.0))
    assert at > begin  # otherwise nothing would be in the way
    ahead = path[at] - path[at - 5]
    across = np.array([-ahead[1], ahead[0]]) / np.linalg.norm(ahead)
    walls, frame = nothing(architecture), flight_of(architecture)[1].world.frame
    points = path[at] + np.linspace(-0.6, 0.6, 25)[:, None] * across
    rows, columns = np.asarray(frame.to_cell(jnp.asarray(points, jnp.float32))).T
    walls[rows, columns] = True
    assert (walls & (free.belief < 0.25)).sum() > 3  # it is in what would be free
    met = with_faults(architecture, walls=walls, walls_from=1.0)
    check(met)
    assert (met.belief[walls] > 0.65).any()
    np.testing.assert_array_equal(met.positions[:begin], path[:begin])
    both = min(len(path), len(met.positions))
    assert np.abs(met.positions[:both] - path[:both]).max() > 0.3
