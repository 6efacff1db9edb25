"""Informative MPPI: what its strategic layer finds, when, and what becomes of it."""

import dataclasses
import json
import math
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.interpolate

from jaxplore import (
    MPPI,
    BiasedProposal,
    Cost,
    DifferentialDrive,
    FieldSensor,
    GaussianProposal,
    InverseSensorModel,
    Knots,
    Lidar,
    OccupancyGrid,
    Perception,
    PoseInformation,
    Quadrotor,
    Smooth,
    Softmax,
    StateCost,
    Unicycle,
    three_zones,
)
from jaxplore.belief.belief import Belief
from jaxplore.costs import LocalInformationCost, PotentialCost, StrategyReferenceCost
from jaxplore.information import LocalFieldSensor, UniformNoise
from jaxplore.planning import (
    GradientReference,
    InformativeMPPI,
    QuadrotorFollower,
    ShortRangeField,
    follower_for,
)
from jaxplore.planning.strategy.references import ClimbingReference, StrategicReference

pytestmark = pytest.mark.long

HORIZON, NUM_SAMPLES, DT, PERIOD, EVERY = 8, 32, 0.05, 0.02, 5
ALTITUDE = -2.0
WORLD = dataclasses.replace(three_zones(), resolution=0.2)
ROBOT = Quadrotor()
MODEL = InverseSensorModel.line_of_sight()
START = jnp.asarray(ROBOT.at_pose(0.8, 3.2, 0.5 * math.pi, ALTITUDE))
BOUNDS = np.asarray([ROBOT.control_min, ROBOT.control_max])


class AgeCost(Cost):
    """What all rollouts pay alike: the age of the reference."""

    def stage(self, state, control, t, belief):
        return belief.reference_age


class Straight(StrategicReference):
    """Straight ahead and up, whatever is known: what a user might write, and little to compile."""

    gradient_reference: GradientReference

    def __call__(self, belief, potential, start):
        pace = self.gradient_reference
        ahead = pace.speed * pace.dt * jnp.arange(1.0, 1.0 + pace.num_steps)
        return start.position + ahead[:, None] * jnp.asarray([0.8, 0.6, -0.2])


def mppi_with(cost: Cost, parameterisation=None, mesh=None) -> MPPI:
    hover = jnp.broadcast_to(ROBOT.default_control, (HORIZON, 4))
    proposal = GaussianProposal(jnp.asarray([2.0, 1.0, 1.0, 1.0]))
    return MPPI(
        ROBOT,
        cost,
        horizon=HORIZON,
        num_samples=NUM_SAMPLES,
        dt=DT,
        control_period=PERIOD,
        proposal=BiasedProposal(proposal, hover, 0.5, likelihood_ratio=False),
        parameterisation=parameterisation,
        weighting=Softmax(1.0),
        mesh=mesh,
    )


def small(parameterisation, mesh=None) -> InformativeMPPI:
    """Return a controller whose sensors are as simple as can be."""
    lidar = Lidar(1, 0.6)
    return InformativeMPPI(
        mppi_with(StrategyReferenceCost() + LocalInformationCost(), parameterisation, mesh),
        LocalFieldSensor(PoseInformation(lidar, MODEL), 0.2, spacing=2.5, num_headings=2),
        ShortRangeField(FieldSensor(lidar, 0.2, 2, 2, method="scan"), 4, 2),
        MODEL,
        reference=Straight(GradientReference(2.0, HORIZON, DT)),
        follower=QuadrotorFollower(),
        strategy_period=EVERY * PERIOD,
        altitude=ALTITUDE,
    )


def perception() -> Perception:
    return Perception(
        Lidar(24, 3.0), 0.2, 0.2, sensor_model=MODEL, num_directions=8, goal=WORLD.goal[:2]
    )


TRACES: list[str] = []


@eqx.filter_jit
def step(controller, state, observation, belief, key):
    TRACES.append("step")
    return controller.step(state, observation, belief, key=key)


@eqx.filter_jit
def strategy_of(controller, belief, observation):
    return controller.strategic_plan(belief, observation)


@eqx.filter_jit
def begin(perception, grid, pose) -> Belief:
    return perception.init(grid, pose)


@eqx.filter_jit
def states_of(initial, controls):
    """Return the states (T, nx) that controls lead to."""

    def advance(state, control):
        after = ROBOT.step(state, control, jnp.asarray(DT))
        return after, after

    return jax.lax.scan(advance, initial, controls)[1]


@eqx.filter_jit
def follow(follower, state, path):
    return follower(ROBOT, state, path, jnp.asarray(DT))


def followed(path: np.ndarray, age: float = 0.0) -> jax.Array:
    """Return the controls of the follower from the start along a path of some age.

    Row i is where to be at (i + 1) dt after the path was made; the ends hold.
    """
    return follow(QuadrotorFollower(), START, jnp.asarray(wanted(path, age), jnp.float32))


def wanted(path: np.ndarray, age: float) -> np.ndarray:
    times = DT * np.arange(1, HORIZON + 1)
    return np.stack([np.interp(times + age, times, column) for column in path.T], axis=1)


def run(controller, beliefs, observations, seed: int = 0):
    """Return what each step gives: control, state after it, info."""
    state, found = controller.init(), []
    for number, (belief, observation) in enumerate(zip(beliefs, observations, strict=True)):
        key = jax.random.fold_in(jax.random.key(seed), number)
        control, state, info = step(controller, state, observation, belief, key)
        found.append((control, state, info))
    return found


@pytest.fixture(scope="module")
def two_layer() -> InformativeMPPI:
    """Return a controller that climbs the field around it."""
    cost = (
        1.0 * PotentialCost()
        + 1.0 * LocalInformationCost()
        + 10.0 * StateCost({"z": 1.0}, {"z": ALTITUDE})
        + 5.0 * StrategyReferenceCost()
        + 0.0 * AgeCost()
    )
    far, near = Lidar(4, 3.0, 0.5 * math.pi), Lidar(4, 1.5, 0.5 * math.pi)
    return InformativeMPPI(
        mppi_with(cost),
        LocalFieldSensor(PoseInformation(far, MODEL), 0.2, extent=3.2, spacing=0.8),
        ShortRangeField(FieldSensor(near, 0.2, 12, 2, method="scan"), 16, 8),
        MODEL,
        reference=ClimbingReference(GradientReference(2.0, HORIZON, DT)),
        follower=QuadrotorFollower(),
        strategy_period=EVERY * PERIOD,
        altitude=ALTITUDE,
    )


@pytest.fixture(scope="module")
def smooth() -> InformativeMPPI:
    return small(Smooth())


@pytest.fixture(scope="module")
def belief() -> Belief:
    return begin(perception(), WORLD.prior(), jnp.asarray([0.8, 3.2, 0.0]))


@pytest.fixture(scope="module")
def known() -> Belief:
    """The belief of a robot that has seen everything."""
    return begin(perception(), WORLD.truth(), jnp.asarray([0.8, 3.2, 0.0]))


def changed(belief: Belief, grid: OccupancyGrid, **others: Any) -> Belief:
    return dataclasses.replace(belief, grid=grid, **others)


def revealed(belief: Belief, until: float) -> Belief:
    """Return the belief after all columns up to an x have been seen."""
    columns = np.arange(belief.grid.shape[1]) * 0.2 - 1.0 < until
    values = np.where(columns, WORLD.truth().probability, belief.grid.probability)
    return changed(belief, OccupancyGrid(values, 0.2, belief.grid.frame.origin))


def paid(controller: InformativeMPPI, **weights: float) -> InformativeMPPI:
    """Return the controller with these weights by term, 0 for all others."""
    names = [name for name, _ in controller.mppi.cost.terms()]
    assert set(weights) <= set(names)

    def leaves(each):
        return [term.weight for _, term in each.mppi.cost.terms()]

    def collect(cost) -> list:
        if hasattr(cost, "weight"):
            return [cost.weight]
        return [weight for part in cost.costs for weight in collect(part)]

    values = [jnp.asarray(weights.get(name, 0.0), jnp.float32) for name in names]
    assert len(leaves(controller)) == len(values)
    return eqx.tree_at(lambda each: collect(each.mppi.cost), controller, values)


def without_noise(controller: InformativeMPPI, fraction: float) -> InformativeMPPI:
    return eqx.tree_at(
        lambda each: (each.mppi.proposal.fraction, each.mppi.proposal.proposal.noise_std),
        controller,
        (jnp.asarray(fraction, jnp.float32), jnp.full(4, 1e-6, jnp.float32)),
    )


def test_the_strategy_is_renewed_when_due_and_kept_in_between(two_layer, belief) -> None:
    beliefs = [revealed(belief, 0.1 * number) for number in range(25)]
    places = [ROBOT.at_pose(0.8 + 0.04 * number, 3.2, 1.0, ALTITUDE) for number in range(25)]
    found = run(two_layer, beliefs, places)
    kept: Any = None
    for number, (_, state, _) in enumerate(found):
        assert int(state.age) == number % EVERY + 1
        if number % EVERY == 0:
            expected = strategy_of(two_layer, beliefs[number], places[number])
            for a, b in zip(jax.tree.leaves(state.plan), jax.tree.leaves(expected), strict=True):
                np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-5)
            # The map has changed where it matters: what is kept is not what would be found now.
            if number > 0:
                assert np.abs(state.plan.best.values - kept.best.values).max() > 0.1
            kept = state.plan
        for a, b in zip(jax.tree.leaves(state.plan), jax.tree.leaves(kept), strict=True):
            np.testing.assert_array_equal(a, b)


def test_the_reference_ages_between_strategies(two_layer, belief) -> None:
    controller = paid(two_layer, AgeCost=1.0)
    found = run(controller, [belief] * 13, [START] * 13)
    ages = np.asarray([info.costs / HORIZON for _, _, info in found])
    expected = (np.arange(13) % EVERY) * PERIOD
    np.testing.assert_allclose(ages, np.tile(expected[:, None], (1, NUM_SAMPLES)), atol=1e-6)


def test_an_aged_reference_is_read_where_it_has_got_to(two_layer, belief) -> None:
    """Following it, the plan without noise starts where the robot should be now."""
    controller = without_noise(paid(two_layer, StrategyReferenceCost=1.0), 1.0)
    found = run(controller, [belief] * 5, [START] * 5)
    path = np.asarray(found[0][1].plan.reference, float)
    for number, (_, _, info) in enumerate(found):
        controls = followed(path, number * PERIOD)
        np.testing.assert_allclose(info.controls, controls, rtol=1e-4, atol=1e-4)
        states = np.asarray(states_of(START, controls))
        cost = ((states[:, :2] - wanted(path, number * PERIOD)[:, :2]) ** 2).sum()
        np.testing.assert_allclose(info.costs, cost, rtol=1e-3, atol=1e-5)


def zone_distance(points: np.ndarray, zone) -> np.ndarray:
    low, high = np.asarray(zone[:2]), np.asarray(zone[2:])
    return np.linalg.norm(np.maximum(np.maximum(low - points, points - high), 0.0), axis=-1)


def test_the_field_peaks_at_an_unknown_zone_until_it_is_seen(two_layer, belief, known) -> None:
    before = strategy_of(two_layer, belief, START)
    values = np.asarray(before.best.values)
    row, column = np.unravel_index(values.argmax(), values.shape)
    top = np.asarray(before.best.frame.cell_centre(jnp.asarray([[row, column]])))
    assert zone_distance(top, WORLD.zones[0])[0] < 1.0
    assert values.max() > 3.0
    np.testing.assert_array_equal(values, np.asarray(before.potential.values).max(axis=-1))
    # More than a range away from the zone there is next to nothing to learn.
    rows, columns = np.mgrid[: values.shape[0], : values.shape[1]]
    nodes = before.best.frame.cell_centre(jnp.asarray(np.stack([rows, columns], axis=-1)))
    far = zone_distance(np.asarray(nodes), WORLD.zones[0]) > 3.0
    assert far.sum() > 5
    assert values[far].max() < 0.02 * values.max()
    seen = changed(belief, revealed(belief, 4.2).grid)
    after = strategy_of(two_layer, seen, START)
    assert float(after.best.values.max()) < 0.05 * values.max()


def test_the_reference_climbs(two_layer, belief) -> None:
    found = strategy_of(two_layer, belief, START)
    path = np.concatenate([START[None, :3], found.reference])
    heights = np.asarray(jax.jit(jax.vmap(found.best))(jnp.asarray(path[:, :2])))
    assert (np.diff(heights) >= -1e-4).all()
    assert heights[-1] > heights[0] + 1.0
    np.testing.assert_array_equal(path[:, 2], ALTITUDE)
    moves = np.linalg.norm(np.diff(path[:, :2], axis=0), axis=1)
    assert moves.max() <= 2.0 * DT + 1e-4


@pytest.mark.parametrize("place", [(0.8, 3.2), (2.0, 1.0), (7.0, 8.0)])
def test_what_is_explored_is_worth_nothing_and_the_goal_is_next(place, two_layer, known) -> None:
    assert bool(known.is_explored)
    state = ROBOT.at_pose(*place, 0.0, ALTITUDE)
    found = strategy_of(two_layer, known, state)
    np.testing.assert_array_equal(found.potential.values, 0.0)
    np.testing.assert_array_equal(found.best.values, 0.0)
    path = np.concatenate([np.asarray(state)[None, :2], np.asarray(found.reference)[:, :2]])
    togo = np.asarray(jax.jit(jax.vmap(known.guidance))(jnp.asarray(path)))
    assert (np.diff(togo) < 0.0).all()
    moves = np.linalg.norm(np.diff(path, axis=0), axis=1)
    if place != (2.0, 1.0):  # in sight of the goal: the distance itself falls, nearly as fast
        away = np.linalg.norm(path - np.asarray(WORLD.goal[:2]), axis=1)
        assert away[-1] < away[0] - 0.85 * moves.sum()
    np.testing.assert_allclose(moves, 2.0 * DT, rtol=0.3)


def test_nothing_is_paid_for_information_once_all_is_explored(two_layer, belief) -> None:
    """The map still has its unknown zones: only what the belief says of itself differs."""
    done = dataclasses.replace(belief, is_explored=jnp.array(True))
    for term in ("PotentialCost", "LocalInformationCost"):
        controller = paid(two_layer, **{term: 1.0})
        (_, _, before), (_, _, after) = (
            run(controller, [each], [START])[0] for each in (belief, done)
        )
        assert (np.asarray(before.costs) < -0.5).all()
        np.testing.assert_array_equal(after.costs, 0.0)


# ShortRangeField


@eqx.filter_jit
def look(field, belief, position):
    return field(belief, MODEL, position)


@eqx.filter_jit
def beams_of(scan, grid, positions, headings):
    """Return what each beam of each scan is worth (N, B)."""

    def one(position, heading):
        return scan.view(grid, position, heading).value.sum(axis=-1)

    return jax.vmap(one)(positions, headings)


TURNED = OccupancyGrid(
    np.random.default_rng(0).choice([0.01, 0.2, 0.5, 0.5, 0.8], (60, 70)).astype(np.float32),
    0.2,
    (1.0, -2.0, 0.7),
)


class Look:
    """Short looks around a place of a random, turned map, and some of their nodes."""

    def __init__(self, lidar: Lidar, directions: int, headings: int, belief: Belief) -> None:
        self.lidar, self.directions = lidar, directions
        self.sensor = FieldSensor(lidar, 0.2, directions, 2, noise=UniformNoise(0), method="scan")
        self.place = TURNED.frame.to_world(jnp.asarray([30.3, 34.8]))
        short_range = ShortRangeField(self.sensor, 10, headings)
        self.field = look(short_range, changed(belief, TURNED), self.place)
        rng = np.random.default_rng(1)
        self.node = rng.integers(0, self.field.values.shape, (40, 3))
        self.values = np.asarray(self.field.values)[tuple(self.node.T)]
        self.positions = self.field.frame.cell_centre(jnp.asarray(self.node[:, :2]))
        self.headings = self.field.headings[self.node[:, 2]]

    def beams(self, lidar: Lidar, headings) -> np.ndarray:
        scan = PoseInformation(lidar, MODEL, noise=UniformNoise(0))
        return np.asarray(beams_of(scan, TURNED, self.positions, headings))


@pytest.fixture(scope="module")
def quarter(belief) -> Look:
    """Sectors whose middles are beams: 20 of 18 degrees, as 6 beams over 90 degrees are apart."""
    return Look(Lidar(6, 1.5, 0.5 * math.pi), 20, 20, belief)


def test_a_look_all_around_is_a_scan_ray_by_ray(belief) -> None:
    """Every beam is the middle of a sector, at every heading: nothing is left to discretisation."""
    found = Look(Lidar(12, 1.5), 12, 6, belief)
    # Beams of the scan begin at -pi from the heading, the sectors' middles at 15 degrees.
    beams = found.beams(found.lidar, found.headings + math.pi / 12)
    np.testing.assert_allclose(found.values, beams.sum(axis=1), rtol=1e-3, atol=1e-4)
    assert np.ptp(found.values) > 0.1


def test_a_look_counts_the_beams_on_its_edges_half(quarter) -> None:
    """The sectors within the view are 5 beams apart of 6: the first and the last count half."""
    beams = quarter.beams(quarter.lidar, quarter.headings)
    share = np.asarray([0.5, 1.0, 1.0, 1.0, 1.0, 0.5])
    np.testing.assert_allclose(quarter.values, beams @ share, rtol=1e-3, atol=1e-4)
    assert (quarter.values > 0.0).sum() > 20


def test_a_look_between_sectors_is_an_integral_over_its_view(belief) -> None:
    """At 16 headings the view's edges cut sectors, which count by what is seen of them."""
    found = Look(Lidar(6, 1.5, 0.5 * math.pi), 20, 16, belief)
    # A scan of all sectors' middles, whose beams are as far apart.
    width = 2.0 * math.pi / 20
    origin = float(TURNED.frame.origin[2])
    first = jnp.full(40, origin + math.pi + 0.5 * width, jnp.float32)
    sectors = found.beams(Lidar(20, 1.5), first)
    turns = found.node[:, 2] * (2.0 * math.pi / 16)
    within = (np.arange(20000) + 0.5) / 20000 - 0.5
    angles = np.mod(turns[:, None] + 0.5 * math.pi * within, 2.0 * math.pi)
    at = (angles / width).astype(int)
    expected = np.take_along_axis(sectors, at, axis=1).mean(axis=1) * (0.5 * math.pi / width)
    np.testing.assert_allclose(found.values, expected, rtol=1e-3, atol=1e-4)


def test_a_look_ends_with_its_window(quarter) -> None:
    field = quarter.field
    assert field.values.shape == (10, 10, 20)
    robot = TURNED.frame.to_cell(quarter.place)
    middle = TURNED.frame.to_cell(field.frame.cell_centre(jnp.asarray([5, 5])))
    np.testing.assert_array_equal(middle, robot)
    read = jax.jit(jax.vmap(field, in_axes=(0, None)))
    edges = jnp.asarray(
        [[0.5, 0.5], [9.5, 9.5], [0.45, 5.0], [9.55, 5.0], [5.0, -4.0], [5.0, 30.0]]
    )
    values = np.asarray(read(field.frame.to_world(edges), field.frame.origin[2]))
    np.testing.assert_allclose(values[:2], np.asarray(field.values)[[0, 9], [0, 9], 0], atol=1e-3)
    np.testing.assert_array_equal(values[2:], 0.0)


# The samples around the follower's controls


def spline_of(controls: np.ndarray, num_knots: int) -> np.ndarray:
    """Return the cubic spline through knots that is nearest to controls."""
    knots = np.linspace(0, HORIZON - 1, num_knots)
    matrix = scipy.interpolate.CubicSpline(knots, np.eye(num_knots), bc_type="natural")(
        np.arange(HORIZON)
    )
    hover = np.asarray(ROBOT.default_control, float)
    nearest = np.linalg.lstsq(matrix, controls - hover, rcond=None)[0]
    return np.clip(hover + matrix @ (np.clip(hover + nearest, *BOUNDS) - hover), *BOUNDS)


@pytest.mark.parametrize("name", ["direct", "smooth", "knots"])
def test_without_noise_the_plan_is_what_the_follower_does(
    name: str, two_layer, smooth, belief
) -> None:
    controller = {"direct": two_layer, "smooth": smooth}.get(name) or small(Knots(4))
    calm = without_noise(controller, 1.0)
    # The first steps of a strategy, and later ones, whose nominal is not hovering any more.
    for number, (control, state, info) in enumerate(run(calm, [belief] * 2, [START] * 2)):
        path = np.asarray(state.plan.reference, float)
        expected = np.asarray(followed(path, number * PERIOD), float)
        assert np.ptp(expected, axis=0).max() > 0.1
        if name == "knots":
            expected = spline_of(expected, 4)
        np.testing.assert_allclose(info.controls, expected, rtol=1e-3, atol=1e-3)
        np.testing.assert_array_equal(control, info.controls[0])
    # With noise it is within the bounds.
    places = [START, ROBOT.at_pose(2.5, 3.0, 0.0, ALTITUDE), ROBOT.at_pose(3.5, 6.0, 2.0, -1.0)]
    for control, _, info in run(controller, [belief] * 3, places):
        assert bool(info.is_finite)
        assert ((info.controls >= BOUNDS[0]) & (info.controls <= BOUNDS[1])).all()
        assert np.isfinite(control).all()


@pytest.mark.parametrize("fraction", [0.5, 0.25, 0.0])
def test_so_many_samples_are_around_the_follower(fraction: float, two_layer, belief) -> None:
    """Without noise there are two samples, the follower's and hovering; they cost differently."""
    controller = without_noise(paid(two_layer, StrategyReferenceCost=1.0), fraction)
    ((_, state, info),) = run(controller, [belief], [START])
    path = np.asarray(state.plan.reference)
    states = np.asarray(states_of(START, followed(path)))
    near = ((states[:, :2] - path[:, :2]) ** 2).sum()
    far = ((np.asarray(START)[:2] - path[:, :2]) ** 2).sum()
    assert near < 0.7 * far
    count = round(fraction * NUM_SAMPLES)
    expected = np.asarray([near] * count + [far] * (NUM_SAMPLES - count))
    np.testing.assert_allclose(info.costs, expected, rtol=1e-3)


@eqx.filter_jit
def inspected(controller, state, observation, belief, key):
    return controller.inspect(state, observation, belief, key=key, num_trajectories=NUM_SAMPLES)


def test_a_look_into_a_step_shows_what_it_saw(smooth, belief) -> None:
    state, key = smooth.init(), jax.random.key(2)
    _, after, info = step(smooth, state, START, belief, key)
    plan = inspected(smooth, state, START, belief, key)
    np.testing.assert_allclose(plan.nominal.controls, info.controls, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(plan.weights, info.weights, rtol=1e-3, atol=1e-5)
    terms = {name: float(value) for name, value in plan.best.terms.items()}
    assert set(terms) == {"StrategyReferenceCost", "LocalInformationCost"}
    assert sum(terms.values()) == pytest.approx(float(info.costs.min()), rel=1e-3, abs=1e-3)
    # Without noise half of the samples follow, and half hover.
    calm = inspected(without_noise(smooth, 0.5), state, START, belief, key)
    path = np.asarray(after.plan.reference, float)
    found = np.asarray(calm.samples)[:, 1:]
    near, half = np.asarray(states_of(START, followed(path))), NUM_SAMPLES // 2
    assert np.linalg.norm(near[-1] - START) > 0.1
    np.testing.assert_allclose(found[:half], np.tile(near, (half, 1, 1)), atol=1e-3)
    np.testing.assert_allclose(found[half:], np.tile(START, (half, HORIZON, 1)), atol=1e-3)


# Randomness and devices

SCRIPT = """
import json, runpy, sys
import jax, numpy as np
assert jax.device_count() == 8, jax.devices()
test = runpy.run_path(sys.argv[1])
mesh = jax.make_mesh((8,), ("samples",))
print(json.dumps(test["three_plans"](test["small"](test["Smooth"](), mesh))))
"""


def three_plans(controller: InformativeMPPI) -> list:
    """Return the plans of three steps: with a new strategy, and with one that is kept."""
    belief = begin(perception(), WORLD.prior(), jnp.asarray([0.8, 3.2, 0.0]))
    found = run(controller, [belief] * 3, [START] * 3, seed=4)
    return [np.asarray(info.controls).tolist() for _, _, info in found]


def test_eight_devices_do_what_one_does(smooth) -> None:
    environment = {
        **os.environ,
        "XLA_FLAGS": f"{os.environ['XLA_FLAGS']} --xla_force_host_platform_device_count=8",
        "JAX_PLATFORMS": "cpu",
        "PYTHONPATH": str(Path(__file__).resolve().parents[2] / "src"),
    }
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", SCRIPT, __file__],
        capture_output=True,
        text=True,
        env=environment,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    spread = np.asarray(json.loads(done.stdout.splitlines()[-1]))
    alone = np.asarray(three_plans(smooth))
    np.testing.assert_allclose(spread, alone, atol=1e-4)
    assert np.ptp(alone, axis=1).max() > 0.1


def test_the_same_seed_gives_the_same_plan(two_layer) -> None:
    np.testing.assert_array_equal(three_plans(two_layer), three_plans(two_layer))


# What changes nothing, and what is refused


def test_numbers_do_not_retrace(two_layer, belief) -> None:
    run(two_layer, [belief], [START])
    before = len(TRACES)
    reference = ClimbingReference(GradientReference(0.5, HORIZON, 0.1), min_gain=20.0)
    other = eqx.tree_at(
        lambda each: (
            each.reference,
            each.mppi.weighting.temperature,
            each.strategy_period,
            each.altitude,
            each.follower.position_gain,
        ),
        paid(two_layer, PotentialCost=3.0, AgeCost=1.0),
        (reference, *(jnp.asarray(value, jnp.float32) for value in (3.0, 0.4, -1.0, 2.0))),
    ).at_period(0.1)
    run(other, [belief, revealed(belief, 3.0)], [START, START + 0.1], seed=1)
    assert len(TRACES) == before


def test_another_period_changes_nothing_else(two_layer) -> None:
    other = two_layer.at_period(0.05)
    assert float(other.mppi.control_period) == pytest.approx(0.05)
    back = other.at_period(PERIOD)
    assert jax.tree.structure(back) == jax.tree.structure(two_layer)
    for a, b in zip(jax.tree.leaves(back), jax.tree.leaves(two_layer), strict=True):
        np.testing.assert_array_equal(a, b)
    changes = eqx.tree_at(lambda each: each.mppi.control_period, other, jnp.asarray(PERIOD))
    for a, b in zip(jax.tree.leaves(changes), jax.tree.leaves(two_layer), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("period", [0.03, 0.08, 0.2])
def test_a_strategy_takes_whole_control_periods(period: float, two_layer) -> None:
    with pytest.raises(
        ValueError,
        match=rf"strategy_period is 0.1 s; accepted: a whole number of control periods of {period}",
    ):
        two_layer.at_period(period)


def test_a_strategy_may_take_many_control_periods(two_layer) -> None:
    slow = eqx.tree_at(lambda each: each.strategy_period, two_layer, jnp.asarray(60.0, jnp.float32))
    assert float(slow.at_period(0.001).mppi.control_period) == pytest.approx(0.001)


@pytest.mark.parametrize(
    ("biased", "has_reference", "has_follower"),
    [
        (True, False, False),
        (True, True, False),
        (True, False, True),
        (False, False, True),
        (False, True, True),
    ],
)
def test_what_does_not_go_together(
    biased: bool, has_reference: bool, has_follower: bool, two_layer
) -> None:
    mppi = two_layer.mppi
    if not biased:
        mppi = eqx.tree_at(lambda each: each.proposal, mppi, mppi.proposal.proposal)
    with pytest.raises(ValueError, match="accepted: a BiasedProposal with both, or another"):
        InformativeMPPI(
            mppi,
            two_layer.potential_sensor,
            two_layer.short_range_field,
            MODEL,
            reference=two_layer.reference if has_reference else None,
            follower=two_layer.follower if has_follower else None,
            strategy_period=0.1,
        )


def test_a_reference_without_a_follower_is_only_paid_for(two_layer) -> None:
    """Nothing says that samples must be biased towards it."""
    mppi = two_layer.mppi
    mppi = eqx.tree_at(lambda each: each.proposal, mppi, mppi.proposal.proposal)
    controller = InformativeMPPI(
        mppi,
        two_layer.potential_sensor,
        two_layer.short_range_field,
        MODEL,
        reference=two_layer.reference,
        strategy_period=0.1,
    )
    assert controller.init().plan.reference.shape == (HORIZON, 3)


def test_a_belief_is_needed(two_layer) -> None:
    for method in (two_layer.step, two_layer.inspect):
        with pytest.raises(ValueError, match="belief is None; accepted: a Belief"):
            method(two_layer.init(), START, key=jax.random.key(0))


LOST = jnp.full(13, jnp.nan, jnp.float32)
NOWHERE = START.at[:2].set(jnp.nan)
lost = pytest.mark.parametrize("observation", [LOST, NOWHERE], ids=["all", "position"])


@lost
def test_a_lost_observation_is_survived(observation, two_layer, belief) -> None:
    observations = [START, START, observation, START, START]
    found = run(two_layer, [belief] * 5, observations)
    for number, (control, state, info) in enumerate(found):
        assert np.isfinite(control).all()
        assert ((control >= BOUNDS[0]) & (control <= BOUNDS[1])).all()
        assert bool(info.is_finite) == (number != 2)
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(state.mppi))


@lost
def test_lost_when_a_strategy_is_due(observation, two_layer, belief) -> None:
    """Whatever becomes of this strategy, the next one is as good as ever."""
    found = run(two_layer, [belief] * 7, [observation] + [START] * 6)
    for control, state, _ in found:
        assert np.isfinite(control).all()
        assert ((control >= BOUNDS[0]) & (control <= BOUNDS[1])).all()
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(state.mppi))
    expected = strategy_of(two_layer, belief, START)
    np.testing.assert_array_equal(found[1][1].plan.reference, expected.reference)
    assert all(bool(info.is_finite) for _, _, info in found[1:])
    ages = [int(state.age) for _, state, _ in found]
    assert ages == [EVERY + 1, 1, 2, 3, 4, 5, 1]


@lost
def test_a_robot_that_is_lost_keeps_its_strategy(observation, two_layer, belief) -> None:
    found = run(two_layer, [belief] * 7, [START] * EVERY + [observation, START])
    before, during, after = (found[number][1] for number in (EVERY - 1, EVERY, EVERY + 1))
    for a, b in zip(jax.tree.leaves(before.plan), jax.tree.leaves(during.plan), strict=True):
        np.testing.assert_array_equal(a, b)
    assert int(after.age) == 1


@pytest.mark.parametrize("robot", [DifferentialDrive(), Unicycle()])
def test_a_robot_on_the_ground_follows_a_reference_with_heights(robot) -> None:
    path = jnp.stack([0.05 * jnp.arange(1.0, 9.0), jnp.zeros(8), jnp.full(8, ALTITUDE)], axis=1)
    state = robot.at_pose(0.0, 0.0, 0.0)
    found = eqx.filter_jit(follower_for(robot))(robot, state, path, DT)
    flat = eqx.filter_jit(follower_for(robot))(robot, state, path[:, :2], DT)
    np.testing.assert_array_equal(found, flat)
