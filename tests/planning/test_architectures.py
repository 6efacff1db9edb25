"""Both architectures in the closed loop: against a plain Python loop over their parts, and whether
they explore."""

import dataclasses
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import map_coordinates
from tests.kinds import (
    FIELDS,
    FLIGHT,
    QUADROTOR,
    SCANNER,
    SIGHT,
    ZONES,
    flight_controller,
    flight_scenario,
)

from jaxplore import (
    Ackermann,
    ExplorationScenario,
    KinematicBicycle,
    Lidar,
    OccupancyGrid,
    Perception,
    Quadrotor,
    informative_mppi,
)
from jaxplore.belief import unknown_fraction
from jaxplore.belief.belief import StrategicBelief
from jaxplore.belief.car import car_motion
from jaxplore.belief.zones import Zones
from jaxplore.control.mixtures import BiasedProposal
from jaxplore.dynamics.base import State
from jaxplore.information.heading_field import HeadingField
from jaxplore.planning import InformativeMPPI, ReferenceStart
from jaxplore.planning.presets.flight import Flight
from jaxplore.planning.presets.quadrotor import ARCHITECTURES, zone_choice
from jaxplore.report.exploration.data import ExplorationRecord
from jaxplore.simulation.loop import copy_tree, initial_loop_state, run_chunk

pytestmark = pytest.mark.long

CHUNK, PERIOD = 50, 0.05
every = pytest.mark.parametrize("architecture", ARCHITECTURES)


@pytest.fixture(scope="module")
def scenario() -> ExplorationScenario:
    return flight_scenario()


@pytest.fixture(scope="module")
def controllers(scenario) -> dict[str, InformativeMPPI]:
    period = scenario.control_period
    return {name: flight_controller(name).at_period(period) for name in ARCHITECTURES}


def run(
    controller: InformativeMPPI, scenario: ExplorationScenario, seed: int, steps: int
) -> ExplorationRecord:
    """Return the records of a run, which may end earlier."""
    state, key, rows, done = (
        initial_loop_state(controller, scenario),
        jax.random.key(seed),
        [],
        CHUNK,
    )
    for _ in range(0, steps, CHUNK):
        if int(done) < CHUNK:
            break
        state, records, done = run_chunk(
            (controller, scenario, key, jnp.asarray(CHUNK)), copy_tree(state), CHUNK
        )
        rows.append(jax.tree.map(lambda leaf, n=int(done): np.asarray(leaf)[:n], records))
    return jax.tree.map(lambda *parts: np.concatenate(parts), *rows)


def hot(controller: InformativeMPPI) -> InformativeMPPI:
    """Return a controller whose weights do not magnify what rounding does to costs."""
    return eqx.tree_at(
        lambda c: c.mppi.weighting.temperature, controller, jnp.asarray(100.0, jnp.float32)
    )


scan = eqx.filter_jit(Lidar.scan)
observe = eqx.filter_jit(Perception.observe)
update_fields = eqx.filter_jit(Perception.update_fields)
move = eqx.filter_jit(Quadrotor.step)


@eqx.filter_jit
def far_field(sensor, grid, position) -> HeadingField:
    return sensor.field(grid, position)


@eqx.filter_jit
def near_field(field, belief, position) -> HeadingField:
    return field(belief, SIGHT, position)


@eqx.filter_jit
def climb(reference, belief, potential, start):
    return reference(belief, potential, start)


@eqx.filter_jit
def follow(follower, state, wanted, dt):
    return follower(QUADROTOR, state, wanted, dt)


@eqx.filter_jit
def plan(mppi, *arguments, key):
    return mppi.step(*arguments, key=key)


def same(found, expected, rtol: float = 1e-4) -> None:
    np.testing.assert_allclose(found, expected, rtol=rtol, atol=1e-4)


class Strategy(NamedTuple):
    potential: HeadingField
    reference: np.ndarray


def pose_of(state) -> jax.Array:
    values = np.asarray(state, float)
    w, x, y, z = values[6:10]
    yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return jnp.asarray([values[0], values[1], yaw], jnp.float32)


def remaining(field: HeadingField, belief, patience: float) -> HeadingField:
    """Return a field that fades with the time spent near a node, and with all explored is 0."""
    values, frame = np.array(field.values, float), belief.information.frame
    nodes = np.stack(np.meshgrid(*map(np.arange, values.shape[:2]), indexing="ij"), axis=-1)
    places = np.asarray(frame.to_grid(field.frame.cell_centre(jnp.asarray(nodes))), float) - 0.5
    left = np.exp(-np.asarray(belief.dwell, float) / patience)
    # Half a node beyond the outermost ones the edge's value holds, farther out nothing is lost.
    within = ((places > -0.5) & (places < np.array(left.shape) - 0.5)).all(axis=-1)
    found = map_coordinates(left, np.moveaxis(places, -1, 0), order=1, mode="nearest")
    share = np.where(within, found, 1.0)[..., None]
    values = np.zeros_like(values) if bool(belief.is_explored) else share * values
    return HeadingField(jnp.asarray(values, jnp.float32), field.frame)


def strategy_by_parts(controller, belief, state) -> Strategy:
    field = far_field(controller.potential_sensor, belief.grid, state[:2])
    field = remaining(field, belief, 3.0)
    if controller.reference is None:
        return Strategy(field, np.zeros((1, 3), np.float32))
    at = jnp.asarray([state[0], state[1], -2.0])
    start = ReferenceStart(at, pose_of(state)[2], jnp.zeros(()))
    return Strategy(field, np.asarray(climb(controller.reference, belief, field.best, start)))


def known_by_parts(controller, belief, state, strategy: Strategy, age: float) -> StrategicBelief:
    local = remaining(near_field(controller.short_range_field, belief, state[:2]), belief, 3.0)
    return StrategicBelief(
        **{field.name: getattr(belief, field.name) for field in dataclasses.fields(belief)},
        potential=strategy.potential,
        best=strategy.potential.best,
        local=local,
        reference=jnp.asarray(strategy.reference),
        reference_period=jnp.asarray(PERIOD),
        reference_age=jnp.asarray(age, jnp.float32),
    )


def control_by_parts(controller, known: StrategicBelief, memory, state, age: float, key):
    """Look, climb, follow and plan, one after the other."""
    mppi = controller.mppi
    if controller.follower is not None:
        path = np.asarray(known.reference, float)
        there_at = PERIOD * np.arange(1, len(path) + 1) - age
        times = PERIOD * np.arange(1, mppi.horizon + 1)
        wanted = np.stack([np.interp(times, there_at, column) for column in path.T], axis=1)
        controls = follow(controller.follower, state, jnp.asarray(wanted, jnp.float32), mppi.dt)
        mppi = eqx.tree_at(lambda each: each.proposal.reference, mppi, controls)
    return plan(mppi, memory, state, known, key=key)


def test_the_compiled_loop_is_a_plain_loop_over_the_parts(controllers, scenario) -> None:
    """Step by step from the same state: what rounding does to a run would grow. Of two-layer: the
    parts of parallel are among its own."""
    controller, perception = hot(controllers["two-layer"]), scenario.perception
    world, period, key = ZONES.truth(), jnp.asarray(PERIOD), jax.random.key(3)
    after, robots = initial_loop_state(controller, scenario), []
    for step in range(CHUNK):
        before = after
        after, records, done = run_chunk(
            (controller, scenario, key, jnp.asarray(1)), copy_tree(before), CHUNK
        )
        assert int(done) == 1
        scan_key, control_key = jax.random.split(jax.random.fold_in(key, step))
        belief, state = before.task.belief, before.task.robot
        pose = pose_of(state)
        if step % 2 == 0:
            seen = scan(SCANNER, world, pose, key=scan_key)
            belief = observe(perception, belief, seen, pose)
        if step % 4 == 3 or step == 0:
            belief = update_fields(perception, belief, pose, 4.0 * period)
        if step % 4 == 0:
            strategy = strategy_by_parts(controller, belief, state)
        same(after.task.belief.grid.probability, belief.grid.probability)
        same(after.task.belief.guidance.values, belief.guidance.values)
        same(after.controller.plan.potential.values, strategy.potential.values)
        same(after.controller.plan.reference, strategy.reference)
        age = (step % 4) * PERIOD
        known = known_by_parts(controller, belief, state, strategy, age)
        control, memory, info = control_by_parts(
            controller, known, before.controller.mppi, state, age, control_key
        )
        same(records.control[0], control)
        same(records.effective_sample_size[0], info.effective_sample_size, rtol=1e-3)
        same(after.controller.mppi.nominal, memory.nominal)
        same(after.task.robot, move(QUADROTOR, state, control, period))
        assert not records.is_collision[0]
        assert float(records.unknown_map[0]) == pytest.approx(float(unknown_fraction(belief.grid)))
        robots.append(np.asarray(after.task.robot))
    # It moved and saw something: a loop that stands still compares nothing.
    assert np.linalg.norm(robots[-1][:2] - robots[0][:2]) > 0.5
    assert float(unknown_fraction(belief.grid)) < 0.9 * float(unknown_fraction(scenario.prior))


@every
def test_explores_three_zones_without_touching(architecture: str, controllers, scenario) -> None:
    records = run(controllers[architecture], scenario, 0, 3 * CHUNK)
    assert records.unknown_map[-1] < 0.7 * float(unknown_fraction(scenario.prior))
    assert not records.is_collision.any()
    assert records.is_finite.all()
    assert np.isfinite(records.state).all()
    low, high = QUADROTOR.control_min, QUADROTOR.control_max
    assert ((records.control >= low) & (records.control <= high)).all()


@every
def test_the_same_seed_gives_the_same_run(architecture: str, controllers, scenario) -> None:
    controller = controllers[architecture]
    first, again, other = (run(controller, scenario, seed, CHUNK) for seed in (5, 5, 6))
    for a, b in zip(jax.tree.leaves(first), jax.tree.leaves(again), strict=True):
        np.testing.assert_array_equal(a, b)
    assert not np.array_equal(first.state, other.state)


NUMBERS = {
    "goal": (7.5, 4.0, -1.5),
    "bias_fraction": 0.25,
    "reference_speed": 1.3,
    "reference_weight": 0.5,
    "local_weight": 4.0,
    "field_weight": 7.0,
    "guidance_weight": 3.0,
    "goal_weight": 1.5,
}


@every
def test_no_number_retraces(architecture: str, controllers, scenario) -> None:
    controller = controllers[architecture]
    start, one, key = initial_loop_state(controller, scenario), jnp.asarray(1), jax.random.key(0)
    first, _, _ = run_chunk((controller, scenario, key, one), copy_tree(start), CHUNK)
    compiled = run_chunk._cached._cache_size()
    flight = FLIGHT._replace(
        temperature=2.0,
        noise_std=(1.0, 2.0, 1.5, 0.5),
        altitude=-1.5,
        max_speed=0.7,
        clearance=0.5,
        obstacle_weight=5.0,
        height_weight=3.0,
        speed_weight=2.0,
        control_weight=0.1,
    )
    fields = FIELDS._replace(field_period=0.4)
    other = flight_controller(architecture, flight, fields=fields, **NUMBERS).at_period(PERIOD)
    second, _, _ = run_chunk((other, scenario, key, one), copy_tree(start), CHUNK)
    assert run_chunk._cached._cache_size() == compiled
    assert not np.array_equal(first.task.robot, second.task.robot)


def test_by_heading_rewards_facing_the_unknown(scenario, controllers) -> None:
    controller = flight_controller("parallel", by_heading=True)
    (term,) = (term for name, term in controller.mppi.cost.terms() if name == "PotentialCost")
    (blind,) = (
        term for name, term in controllers["parallel"].mppi.cost.terms() if name == "PotentialCost"
    )
    belief = initial_loop_state(controller, scenario).task.belief
    # Half a metre below a zone that begins at y = 4.
    place = QUADROTOR.at_pose(2.5, 3.2, 0.0)
    strategy = strategy_by_parts(controller, belief, place)
    known = known_by_parts(controller, belief, place, strategy, 0.0)

    def stage(cost, yaw: float) -> float:
        state = State(QUADROTOR.at_pose(2.5, 3.2, yaw), QUADROTOR)
        return float(cost.stage(state, QUADROTOR.default_control, jnp.zeros(()), known))

    facing, away = stage(term, 0.5 * np.pi), stage(term, -0.5 * np.pi)
    assert facing < away - 1.0
    assert stage(blind, 0.5 * np.pi) == stage(blind, -0.5 * np.pi)
    # The best heading is one of those that are evaluated, this one or its neighbours.
    assert stage(blind, 0.0) <= facing + 1e-3


def test_parallel_refuses_a_reference_that_it_would_not_follow() -> None:
    reference = flight_controller("two-layer").reference
    with pytest.raises(ValueError, match="reference is given for the parallel architecture"):
        flight_controller("parallel", reference=reference)


def test_what_the_architectures_differ_in(controllers) -> None:
    two_layer, parallel = (controllers[name] for name in ARCHITECTURES)
    assert isinstance(two_layer.mppi.proposal, BiasedProposal)
    assert two_layer.reference is not None
    assert two_layer.follower is not None
    assert not isinstance(parallel.mppi.proposal, BiasedProposal)
    assert parallel.reference is None
    assert parallel.follower is None
    names = [{name for name, _ in each.mppi.cost.terms()} for each in (two_layer, parallel)]
    assert names[0] - names[1] == {"StrategyReferenceCost"}
    assert not names[1] - names[0]


@pytest.mark.parametrize(
    "view",
    [0.5 * np.pi, np.pi, 2.0 * np.pi],
)
def test_a_short_look_has_a_direction_for_every_beam(view: float) -> None:
    found = FIELDS._replace(field_of_view=view).short_range_field(0.2).sensor
    assert found.table.num_directions == round(2.0 * np.pi / Lidar(4, 1.5, view).beam_spacing)


CARS = {
    "ackermann": Ackermann(max_speed=1.0, min_speed=-0.5),
    "bicycle": KinematicBicycle(max_speed=1.0, min_speed=-0.5),
}
CAR_PERCEPTION = Perception(
    SCANNER,
    0.2,
    0.25,
    sensor_model=SIGHT,
    num_directions=8,
    car=car_motion(CARS["ackermann"]),
)


def hall() -> OccupancyGrid:
    """Return a hall of 8 m x 4 m of which the east is unknown."""
    p = np.full((20, 40), 0.01, np.float32)
    p[0] = p[-1] = p[:, 0] = p[:, -1] = 0.99
    p[1:-1, 28:-1] = 0.5
    return OccupancyGrid(p, 0.2)


@pytest.fixture(scope="module")
def known_hall():
    return eqx.filter_jit(Perception.init)(CAR_PERCEPTION, hall(), jnp.asarray([2.0, 2.0, 3.1]))


def car_controller(architecture: str, name: str) -> InformativeMPPI:
    zones = Zones.from_rectangles([(5.6, 0.2, 7.8, 3.8)], hall())
    choice = zone_choice(zones, (1.0, 1.0), CAR_PERCEPTION, SCANNER)
    return informative_mppi(
        CARS[name],
        "parallel" if architecture == "parallel" else "two-layer",
        target_choice=choice if architecture == "sequential" else None,
        resolution=0.2,
        sensor_model=SIGHT,
        flight=Flight(horizon=10, num_samples=16, max_speed=1.0),
        fields=FIELDS,
    )


def drives_along_the_lattice(reference, belief) -> None:
    """It leads to what is unknown, from a pose that faces away from it, as a car can drive: half a
    metre a second backwards, a metre a second forwards, and less where it turns back."""
    path = np.asarray(reference)[:, :2]
    step = np.linalg.norm(np.diff(path, axis=0), axis=1)
    assert step.max() < 0.05 + 1e-4
    assert step.sum() > 0.8
    cost = np.asarray(jax.vmap(belief.guidance)(jnp.asarray(path)))
    assert cost[-1] < cost[0] - 0.4


# One model for each program; the others are traced, which checks all shapes and types.
@pytest.mark.parametrize(
    ("architecture", "name"), [("two-layer", "bicycle"), ("parallel", "ackermann")]
)
def test_cars_are_driven(architecture: str, name: str, known_hall) -> None:
    robot, controller = CARS[name], car_controller(architecture, name)
    control, after, info = eqx.filter_jit(controller.step)(
        controller.init(), robot.at_pose(2.0, 2.0, 3.1), known_hall, key=jax.random.key(0)
    )
    assert (control >= robot.control_min).all()
    assert (control <= robot.control_max).all()
    assert np.isfinite(info.controls).all()
    if architecture == "two-layer":
        drives_along_the_lattice(after.plan.reference, known_hall)


def test_cars_go_from_zone_to_zone(known_hall) -> None:
    controller = car_controller("sequential", "ackermann")
    at = CARS["ackermann"].at_pose(2.0, 2.0, 3.1)
    reference = eqx.filter_jit(lambda *given: controller.strategic_plan(*given).reference)
    drives_along_the_lattice(reference(known_hall, at), known_hall)


@pytest.mark.parametrize(
    ("architecture", "name"),
    [
        ("two-layer", "ackermann"),
        ("parallel", "bicycle"),
        ("sequential", "ackermann"),
        ("sequential", "bicycle"),
    ],
)
def test_every_architecture_takes_every_car(architecture: str, name: str, known_hall) -> None:
    robot, controller = CARS[name], car_controller(architecture, name)
    control, after, _ = eqx.filter_eval_shape(
        controller.step,
        controller.init(),
        robot.at_pose(2.0, 2.0, 3.1),
        known_hall,
        key=jax.random.key(0),
    )
    assert control.shape == (2,)
    assert jax.tree.structure(after) == jax.tree.structure(controller.init())
