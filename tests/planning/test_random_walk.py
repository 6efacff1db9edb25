"""The random walk, the two baselines, and the noise that all controllers of a comparison share."""

import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

from jaxplore import (
    MPPI,
    DifferentialDrive,
    Dynamics,
    Euler,
    Flight,
    GoalCost,
    Knots,
    OccupancyGrid,
    PointMass,
    Quadrotor,
    Smooth,
    State,
)
from jaxplore.belief import Belief, GuidanceField
from jaxplore.control import ControlSpace, CubicSpline, Direct, LinearInterpolation, ZeroOrderHold
from jaxplore.control.parameterisations import Parameterisation
from jaxplore.costs import QuadraticControlCost, SpeedLimitCost
from jaxplore.information import InformationField
from jaxplore.maps import ScalarField
from jaxplore.planning import RandomWalk, goal_mppi, random_walk

pytestmark = pytest.mark.long

HORIZON, NUM_SAMPLES, DT, PERIOD, EVERY = 6, 32, 0.1, 0.05, 4
TEMPERATURE, WEIGHT, DISTANCE = 0.7, 1.5, 2.5
ROBOT = PointMass(max_speed=0.5, max_acceleration=2.0, integrator=Euler())
SAFETY = 0.1 * QuadraticControlCost([1.0, 2.0]) + 3.0 * SpeedLimitCost(0.3)


def mppi_with(cost) -> MPPI:
    return MPPI(
        ROBOT,
        cost,
        horizon=HORIZON,
        num_samples=NUM_SAMPLES,
        temperature=TEMPERATURE,
        noise_std=[1.0, 1.5],
        dt=DT,
        control_period=PERIOD,
    )


def walk_with(weight=WEIGHT, distance=DISTANCE, period=EVERY * PERIOD) -> RandomWalk:
    return RandomWalk(mppi_with(SAFETY), weight, distance, period)


def at(x: float, y: float, vx: float = 0.0, vy: float = 0.0) -> jax.Array:
    return jnp.asarray([x, y, vx, vy], jnp.float32)


def places(count: int) -> list[jax.Array]:
    """Return a robot on its way, that never is where it was."""
    return [at(0.3 * number - 1.0, 2.0 - 0.2 * number, 0.1, -0.2) for number in range(count)]


def keys(seed: int, count: int) -> list[jax.Array]:
    return [jax.random.fold_in(jax.random.key(seed), number) for number in range(count)]


TRACES: list[str] = []


@eqx.filter_jit
def step(controller, state, observation, key):
    TRACES.append("step")
    return controller.step(state, observation, key=key)


@eqx.filter_jit
def plan(mppi, state, observation, belief, key):
    return mppi.step(state, observation, belief, key=key)


@jax.jit
def move(state, control):
    """Return the state of the robot after a control period."""
    return ROBOT.step(state, control, jnp.asarray(PERIOD))


@eqx.filter_jit
def inspected(controller, state, observation, key):
    return controller.inspect(state, observation, key=key, num_trajectories=NUM_SAMPLES)


@eqx.filter_jit
def targets_of(controller, observation, many):
    """Return the first target (N, 2) for each key."""

    def one(key):
        _, state, _ = controller.step(controller.init(), observation, key=key)
        return state.target

    return jax.vmap(one)(many)


def run(controller, observations, seed: int = 0) -> list:
    """Return what each step gives: control, state after it, info."""
    state, found = controller.init(), []
    for observation, key in zip(observations, keys(seed, len(observations)), strict=True):
        control, state, info = step(controller, state, observation, key)
        found.append((control, state, info))
    return found


def without_safety(controller: RandomWalk) -> RandomWalk:
    """Return the controller that pays for the distance only."""

    def weights(each):
        return [part.weight for part in each.mppi.cost.costs[1].costs]

    return eqx.tree_at(weights, controller, [jnp.zeros(())] * 2)


def targets(found: list) -> np.ndarray:
    return np.asarray([state.target for _, state, _ in found])


@pytest.fixture(scope="module")
def walk() -> RandomWalk:
    return walk_with()


# When a target is drawn, and where


@pytest.mark.parametrize(
    ("period", "control_period", "every"),
    [
        (0.2, 0.05, 4),
        (0.05, 0.05, 1),
        (0.001, 0.05, 1),  # at least one
        (0.13, 0.05, 3),  # 2.6
        (0.11, 0.05, 2),  # 2.2
        (0.3, 0.1, 3),  # in floating point neither is a whole number
        (0.7, 0.1, 7),
        (2.0, 0.02, 100),
        (1e30, 1e-3, 10**9),
    ],
)
def test_a_target_is_drawn_when_due_and_kept_in_between(
    period: float, control_period: float, every: int
) -> None:
    controller = walk_with(period=period).at_period(control_period)
    count = min(2 * every + 2, 203)
    path = places(count)
    found = run(controller, path)
    kept = np.full(2, np.nan)
    for number, (observation, target) in enumerate(zip(path, targets(found), strict=True)):
        assert int(found[number][1].step) == number + 1
        if number % every == 0:
            assert not np.array_equal(target, kept)
            offset = target.astype(float) - np.asarray(observation[:2], float)
            assert np.linalg.norm(offset) == pytest.approx(DISTANCE, abs=1e-5)
            kept = target
        np.testing.assert_array_equal(target, kept)


@pytest.mark.parametrize("distance", [1e-3, 1.0, 40.0])
def test_a_target_is_this_far_away(distance: float) -> None:
    controller, place = walk_with(distance=distance), at(0.02, -0.01)
    found = targets_of(controller, place, jax.random.split(jax.random.key(1), 2000))
    away = np.linalg.norm(np.asarray(found, float) - np.asarray(place[:2], float), axis=1)
    np.testing.assert_allclose(away, distance, rtol=1e-5)


def test_all_directions_are_as_likely(walk) -> None:
    """2 n R^2 of the mean resultant length R is chi^2 with two degrees of freedom."""
    count = 20_000
    found = targets_of(walk, at(0.0, 0.0), jax.random.split(jax.random.key(2), count))
    angles = np.arctan2(*np.asarray(found, float).T[::-1])
    bound = math.sqrt(math.log(1e6) / count)  # P(R > bound) = exp(-n bound^2) = 1e-6
    for harmonic in (1, 2, 3, 4):
        assert abs(np.exp(1j * harmonic * angles).mean()) < bound
    quadrants = np.bincount(np.floor(angles / (0.5 * np.pi)).astype(int) + 2, minlength=4)
    assert quadrants.shape == (4,)
    np.testing.assert_allclose(quadrants, count / 4, atol=5.0 * math.sqrt(count * 3.0 / 16.0))
    uniform = scipy.stats.uniform(-np.pi, 2.0 * np.pi)
    assert scipy.stats.kstest(angles, uniform.cdf).pvalue > 1e-4


def test_the_direction_depends_on_the_key_only(walk) -> None:
    key, other = keys(3, 2)
    late = run(walk, places(2 * EVERY), seed=9)[-1][1]
    here, there = at(0.0, 0.0), at(3.0, -1.5, 0.3, 0.4)
    # The state of a walk that is well under way has a target and a plan of its own.
    assert int(late.step) % EVERY == 0
    assert np.abs(late.mppi.nominal).max() > 0.1

    def direction(controller, state, place, key):
        _, after, _ = step(controller, state, place, key)
        return (after.target - place[:2]) / controller.distance

    first = direction(walk, walk.init(), here, key)
    for controller, state, place in (
        (walk, walk.init(), there),
        (walk, late, here),
        (walk_with(weight=0.1, distance=7.0, period=0.5), walk.init(), there),
    ):
        np.testing.assert_allclose(direction(controller, state, place, key), first, atol=1e-5)
    assert np.abs(direction(walk, walk.init(), here, other) - first).max() > 0.01


def test_the_same_keys_give_the_same_run(walk) -> None:
    path = places(2 * EVERY + 1)
    first, again, other = (run(walk, path, seed) for seed in (5, 5, 6))
    for a, b in zip(jax.tree.leaves(first), jax.tree.leaves(again), strict=True):
        np.testing.assert_array_equal(a, b)
    assert (np.abs(targets(first) - targets(other)).max(axis=1) > 1e-3).all()
    assert not np.array_equal(first[-1][0], other[-1][0])


# What a step plans


@pytest.mark.parametrize(("weight", "control_period"), [(WEIGHT, PERIOD), (0.2, DT)])
def test_a_step_is_one_of_plain_mppi_towards_the_target(
    weight: float, control_period: float
) -> None:
    controller = walk_with(weight=weight).at_period(control_period)
    path = places(EVERY + 2)
    before = controller.init()
    for observation, key in zip(path, keys(4, len(path)), strict=True):
        control, after, info = step(controller, before, observation, key)
        _, inner_key = jax.random.split(key)
        plain = mppi_with(weight * GoalCost(after.target) + SAFETY).at_period(control_period)
        expected = plan(plain, before.mppi, observation, None, inner_key)
        for a, b in zip(
            jax.tree.leaves((control, after.mppi, info)), jax.tree.leaves(expected), strict=True
        ):
            np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-6)
        before = after
    # It does something, and not the same at any target.
    assert np.abs(before.mppi.nominal).max() > 0.1
    elsewhere = mppi_with(weight * GoalCost(-after.target) + SAFETY).at_period(control_period)
    other, _, _ = plan(elsewhere, before.mppi, path[-1], None, inner_key)
    assert np.abs(other - control).max() > 1e-3


def test_it_goes_to_its_targets() -> None:
    """A mass turns round within half a second, without gain, and then goes at up to 0.5 m/s."""
    controller = without_safety(walk_with(weight=20.0, period=2.0))
    state, observation, before, after = controller.init(), at(0.0, 0.0), [], []
    for key in keys(7, 160):
        control, state, _ = step(controller, state, observation, key)
        before.append(np.linalg.norm(state.target - observation[:2]))
        observation = move(observation, control)
        after.append(np.linalg.norm(state.target - observation[:2]))
    np.testing.assert_allclose(before[::40], DISTANCE, rtol=1e-5)
    gained = np.asarray(before[::40]) - np.asarray(after[39::40])
    assert (gained > 0.5).all()
    assert (gained < 1.0).all()


def test_a_look_into_a_step_shows_what_it_saw(walk) -> None:
    """Also in double precision: what is paid for distances, and how much each rollout counts."""
    controller, before = without_safety(walk), walk.init()
    path = places(EVERY + 1)
    for number, (observation, key) in enumerate(zip(path, keys(8, len(path)), strict=True)):
        _, after, info = step(controller, before, observation, key)
        seen = inspected(controller, before, observation, key)
        np.testing.assert_allclose(seen.nominal.controls, info.controls, rtol=1e-5, atol=1e-6)
        np.testing.assert_allclose(seen.weights, info.weights, rtol=1e-4, atol=1e-6)
        samples = np.asarray(seen.samples, float)
        assert samples.shape == (NUM_SAMPLES, HORIZON + 1, 4)
        np.testing.assert_array_equal(samples[:, 0], np.tile(observation, (NUM_SAMPLES, 1)))
        away = np.linalg.norm(samples[:, 1:, :2] - np.asarray(after.target, float), axis=-1)
        costs = WEIGHT * away.sum(axis=1)
        np.testing.assert_allclose(info.costs, costs, rtol=1e-5)
        if number == 0:  # around no control there is no likelihood ratio
            counts = np.exp((costs.min() - costs) / TEMPERATURE)
            np.testing.assert_allclose(info.weights, counts / counts.sum(), rtol=1e-3)
        terms = {name: float(value) for name, value in seen.best.terms.items()}
        assert set(terms) == {"GoalCost", "QuadraticControlCost", "SpeedLimitCost"}
        assert terms["GoalCost"] == pytest.approx(costs.min(), rel=1e-5)
        before = after


# A robot that does not know where it is

LOST = {
    "all": at(math.nan, math.nan, math.nan, math.nan),
    "x": at(math.nan, 0.0),
    "y": at(0.0, math.nan),
    "infinite": at(math.inf, 0.0),
}
lost = pytest.mark.parametrize("what", list(LOST))


def all_finite(state) -> bool:
    return all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(state))


@lost
@pytest.mark.parametrize("when", [EVERY - 1, EVERY], ids=["between", "due"])
def test_a_lost_robot_keeps_its_target(what: str, when: int, walk) -> None:
    path = places(2 * EVERY + 2)
    path[when] = LOST[what]
    found = run(walk, path)
    for number, (control, state, info) in enumerate(found):
        assert all_finite(state)
        assert np.isfinite(control).all()
        assert (np.abs(control) <= ROBOT.control_max).all()
        assert number == when or bool(info.is_finite)
    wanted = targets(found)
    if when == EVERY:
        np.testing.assert_array_equal(wanted[: 2 * EVERY], np.tile(wanted[0], (2 * EVERY, 1)))
    # Nothing is left of it: the targets are those of a robot that was never lost.
    unharmed = targets(run(walk, places(2 * EVERY + 2)))
    np.testing.assert_array_equal(wanted[2 * EVERY :], unharmed[2 * EVERY :])
    assert not np.array_equal(wanted[2 * EVERY], wanted[0])
    if when != EVERY:
        np.testing.assert_array_equal(wanted, unharmed)


@pytest.mark.parametrize("what", ["all", "infinite", "x", "y"])
def test_a_step_says_that_it_is_lost(what: str, walk) -> None:
    ((_, _, info),) = run(walk, [LOST[what]])
    assert not bool(info.is_finite)
    np.testing.assert_array_equal(info.weights, 0.0)


@lost
def test_a_walk_that_begins_lost_draws_a_target_when_it_knows_where_it_is(what: str, walk) -> None:
    """As the strategies of informative MPPI are: renewed as soon as it knows."""
    path = [LOST[what], *places(EVERY + 1)]
    found = run(walk, path)
    assert all(all_finite(state) and np.isfinite(control).all() for control, state, _ in found)
    for due in (1, 1 + EVERY):
        away = targets(found)[due] - np.asarray(path[due][:2])
        assert np.linalg.norm(away) == pytest.approx(DISTANCE, rel=1e-5)


def test_a_robot_that_knows_only_its_position_still_draws_targets(walk) -> None:
    found = run(walk, [at(1.0, 2.0, math.nan, 0.0), at(1.0, 2.0)])
    away = targets(found)[0] - np.asarray([1.0, 2.0])
    assert np.linalg.norm(away) == pytest.approx(DISTANCE, rel=1e-5)
    assert [bool(info.is_finite) for _, _, info in found] == [False, True]
    assert all(all_finite(state) for _, state, _ in found)


# What changes nothing, and what is refused


def test_another_period_changes_how_many_steps_a_target_lasts(walk) -> None:
    for control_period, every in ((0.1, 2), (0.05, 4), (0.2, 1), (1.0, 1), (0.025, 8)):
        wanted = targets(run(walk.at_period(control_period), places(9)))
        renewed = (np.diff(wanted, axis=0) != 0.0).any(axis=1)
        assert (1 + np.flatnonzero(renewed)).tolist() == list(range(every, 9, every))


def test_another_period_changes_nothing_else(walk) -> None:
    other = walk.at_period(0.02)
    assert float(other.mppi.control_period) == pytest.approx(0.02)
    changes = eqx.tree_at(lambda each: each.mppi.control_period, other, walk.mppi.control_period)
    assert jax.tree.structure(changes) == jax.tree.structure(walk)
    for a, b in zip(jax.tree.leaves(changes), jax.tree.leaves(walk), strict=True):
        np.testing.assert_array_equal(a, b)


def test_numbers_do_not_retrace(walk) -> None:
    first = run(walk, places(2))
    before = len(TRACES)
    found = [
        run(each, places(3), seed=1)
        for each in (
            walk_with(weight=7.0),
            walk_with(distance=0.3),
            walk_with(period=1.0),
            RandomWalk(mppi_with(SAFETY), 3, 1, 1),
            walk.at_period(0.02),
        )
    ]
    assert len(TRACES) == before
    for each in found:
        assert not np.array_equal(each[0][0], first[0][0])


@pytest.mark.parametrize("name", ["weight", "distance", "period"])
@pytest.mark.parametrize(
    ("value", "said"),
    [
        (True, "is True; accepted: a finite number > 0.0"),
        (np.ones(2), r"has shape \(2,\); accepted: one number"),
    ],
)
def test_bad_input_is_named(name: str, value: Any, said: str) -> None:
    with pytest.raises(ValueError, match=rf"^{name} {said}"):
        walk_with(**{name: value})


# The noise of a flight

PARAMETERISATIONS = ["direct", Direct(), Smooth(), Knots(8), Knots(40), Knots(5)]
FACTORS = [1.0, 1.0, 1.0 / (0.05 * math.sqrt(20.0)), math.sqrt(0.2), 1.0, math.sqrt(0.125)]
names = [each if isinstance(each, str) else type(each).__name__ for each in PARAMETERISATIONS]


def noise_of(robot: Dynamics, **numbers: Any) -> np.ndarray:
    proposal = Flight(**numbers).sampling(robot).proposal
    np.testing.assert_array_equal(proposal.mean, 0.0)
    assert proposal.noise_covariance is None
    return np.asarray(proposal.noise_std, float)


@pytest.mark.parametrize(
    ("parameterisation", "factor"), list(zip(PARAMETERISATIONS, FACTORS, strict=True)), ids=names
)
def test_noise_is_a_share_of_the_range_or_as_given(
    parameterisation: Parameterisation | str, factor: float
) -> None:
    """Four times the weight of 1 kg, and 10 rad/s either way."""
    share = np.asarray([0.05 * 4.0 * 9.81, 0.03 * 20.0, 0.03 * 20.0, 0.03 * 20.0])
    np.testing.assert_allclose(share, [2.0, 0.6, 0.6, 0.6], rtol=0.02)
    robot = Quadrotor()
    found = noise_of(robot, parameterisation=parameterisation)
    np.testing.assert_allclose(found, factor * share, rtol=1e-5)
    given = (1.0, 2.0, 0.5, 3.0)
    found = noise_of(robot, noise_std=given, parameterisation=parameterisation)
    np.testing.assert_allclose(found, factor * np.asarray(given), rtol=1e-5)
    if parameterisation == "direct" or isinstance(parameterisation, Direct):
        np.testing.assert_array_equal(found, given)


@pytest.mark.parametrize(("horizon", "dt"), [(40, 0.05), (10, 0.05), (10, 0.2)])
def test_the_factors_are_of_horizon_and_step(horizon: int, dt: float) -> None:
    flight: dict[str, Any] = {"noise_std": [1.0, 1.0], "horizon": horizon, "dt": dt}
    found = noise_of(ROBOT, parameterisation=Smooth(), **flight)
    np.testing.assert_allclose(found, 1.0 / (dt * math.sqrt(horizon / 2.0)), rtol=1e-5)
    found = noise_of(ROBOT, parameterisation=Knots(5), **flight)
    np.testing.assert_allclose(found, math.sqrt(5.0 / horizon), rtol=1e-5)


def test_the_range_is_between_the_bounds_of_the_robot() -> None:
    """Half of it on the ground: of one control and of two, whose ranges are 1.6 and 6, 8 and 4."""
    np.testing.assert_allclose(noise_of(PointMass(1, max_acceleration=0.8)), [0.8], rtol=1e-5)
    mass = PointMass(max_acceleration=[3.0, 2.0])
    np.testing.assert_allclose(noise_of(mass), [3.0, 2.0], rtol=1e-5)
    lopsided = eqx.tree_at(lambda each: each.control_max, mass, jnp.asarray([5.0, 2.0]))
    np.testing.assert_allclose(noise_of(lopsided), [4.0, 2.0], rtol=1e-5)


DRAWS = 20_000
"""The standard deviation of that many is known to 0.5 %."""


@pytest.mark.parametrize(("horizon", "num_knots"), [(40, 8), (40, 4), (40, 40), (12, 3)])
def test_noise_that_is_held_adds_up_to_as_much_as_white_noise(horizon: int, num_knots: int) -> None:
    rng, std = np.random.default_rng(0), 0.7
    found = noise_of(
        PointMass(1), noise_std=[std], horizon=horizon, parameterisation=Knots(num_knots)
    )
    knots = found[0] * rng.normal(size=(DRAWS, num_knots))
    held = np.repeat(knots, horizon // num_knots, axis=1)
    white = std * rng.normal(size=(DRAWS, horizon))
    assert held.shape == white.shape
    assert held.sum(axis=1).std() == pytest.approx(white.sum(axis=1).std(), rel=0.1)
    assert white.sum(axis=1).std() == pytest.approx(std * math.sqrt(horizon), rel=0.03)


def deviations(parameterisation: Parameterisation, horizon: int = 40, dt: float = 0.05):
    """Return how samples of noise of 1 change a control, (T, N), far from any bound."""
    wide = ControlSpace(
        jnp.asarray([-1e6]), jnp.asarray([1e6]), jnp.zeros(1), jnp.asarray(dt), horizon
    )
    std = noise_of(
        PointMass(1), noise_std=[1.0], horizon=horizon, dt=dt, parameterisation=parameterisation
    )
    rows = parameterisation.num_parameters(horizon)
    drawn = std[0] * np.random.default_rng(1).normal(size=(rows, 1, DRAWS))
    nominal = parameterisation.init(jnp.zeros((horizon, 1)), wide)
    controls, _ = parameterisation.decode(nominal, jnp.asarray(drawn, jnp.float32), wide)
    return np.asarray(controls, float)[:, 0]


@pytest.mark.parametrize("interpolation", [None, LinearInterpolation(), ZeroOrderHold()])
def test_knots_add_up_to_as_much_as_white_noise(interpolation) -> None:
    """As they are interpolated: the last one holds for one step only, or for half an interval."""
    knots = Knots(8, interpolation)
    assert interpolation is not None or isinstance(knots.interpolation, CubicSpline)
    assert deviations(knots).sum(axis=0).std() == pytest.approx(math.sqrt(40.0), rel=0.1)


def test_direct_noise_is_white() -> None:
    found = deviations(Direct())
    np.testing.assert_allclose(found.std(axis=1), 1.0, rtol=0.05)
    assert found.sum(axis=0).std() == pytest.approx(math.sqrt(40.0), rel=0.03)


# Baselines


def beside(distance: float) -> Belief:
    """Return a belief in which something is this far away, wherever the robot goes."""
    grid, everywhere = OccupancyGrid(jnp.zeros((2, 2)), 1.0), jnp.full((2, 2), distance)
    nothing, zero = jnp.zeros((2, 2, 2)), jnp.zeros(())
    return Belief(
        grid,
        ScalarField(everywhere, grid.frame, jnp.asarray(distance, jnp.float32)),
        InformationField(nothing[:1], nothing, nothing[0], grid.frame, 2.0 * math.pi, 8),
        GuidanceField(nothing[0], nothing, grid.frame, zero),
        nothing[0],
    )


FLIGHT = Flight(
    horizon=10, num_samples=64, dt=0.1, control_period=0.1, max_speed=1.0, parameterisation=Knots(4)
)


@eqx.filter_jit
def stages(cost, reached, control, belief):
    return {
        name: term.stage(reached, control, jnp.zeros(()), belief) for name, term in cost.terms()
    }


def paid(mppi: MPPI, state, control, distance: float = 100.0) -> dict[str, float]:
    """Return what a step pays by term, of the mean over the horizon."""
    found = stages(mppi.cost, State(state, mppi.dynamics), control, beside(distance))
    return {name: mppi.horizon * float(value) for name, value in found.items()}


def approximately(**terms: float):
    return pytest.approx(terms, rel=1e-4)


SAFE = ("ObstacleCost", "SpeedLimitCost", "QuadraticControlCost")
DRIVEN = DifferentialDrive(max_speed=4.0, radius=0.3)


def test_what_goal_mppi_pays() -> None:
    """By hand. At 2.5 m/s contact is at 30 cm, and 2 cm, and 12.5 cm more: it is not there yet."""
    mppi = goal_mppi(DRIVEN, [3.0, 4.0], FLIGHT)
    assert [name for name, _ in mppi.cost.terms()] == [*SAFE, "GoalCost"]
    fast, slow = (jnp.asarray([0.0, 0.0, 1.0, speed, 0.0]) for speed in (2.5, 1.0))
    control = jnp.asarray([0.5, -2.0])
    assert paid(mppi, fast, control, 0.48) == approximately(
        ObstacleCost=20.0 * 0.2**2,
        SpeedLimitCost=10.0 * (1.5 / 0.1) ** 2,
        QuadraticControlCost=0.01 * (0.25 + 4.0),
        # It stops with half of 1 m/s^2 in 6.25 m, so it would overrun the goal.
        GoalCost=10.0 * (5.0 + 2.0 * (2.5**2 - 5.0)),
    )
    found = paid(mppi, slow, jnp.zeros(2))
    assert [found[name] for name in SAFE] == [0.0, 0.0, 0.0]
    other = FLIGHT._replace(
        horizon=20,
        max_speed=2.0,
        clearance=0.8,
        obstacle_weight=5.0,
        speed_weight=3.0,
        control_weight=0.2,
    )
    assert paid(goal_mppi(DRIVEN, [0.0, 2.0], other), fast, control, 0.48) == approximately(
        ObstacleCost=5.0 * 0.4**2,
        SpeedLimitCost=3.0 * (0.5 / 0.1) ** 2,
        QuadraticControlCost=0.2 * (0.25 + 4.0),
        GoalCost=10.0 * (2.0 + 2.0 * (2.5**2 - 2.0)),
    )


def test_what_a_quadrotor_pays() -> None:
    """It keeps an altitude of 2 m, or as given, whatever the goal's; hovering costs nothing."""
    robot, flight = Quadrotor(), Flight(horizon=4, num_samples=2)
    there, hover = (3.0, 4.0, -1.5), robot.default_control
    found = paid(goal_mppi(robot, there, flight), robot.at_pose(0.0, 0.0, 0.3, -1.5), hover)
    assert set(found) == {*SAFE, "StateCost", "GoalCost"}
    assert [found[name] for name in SAFE] == [0.0, 0.0, 0.0]
    assert found["StateCost"] == pytest.approx(10.0 * 0.25)
    assert found["GoalCost"] == pytest.approx(10.0 * 5.0)
    other = goal_mppi(robot, there, flight._replace(altitude=-3.0, height_weight=2.0))
    found = paid(other, robot.at_pose(3.0, 4.0, 0.3, -2.0), hover)
    assert found["StateCost"] == pytest.approx(2.0 * 1.0)
    assert found["GoalCost"] == pytest.approx(10.0 * 0.5)


def test_a_goal_that_does_not_fit_is_named() -> None:
    with pytest.raises(ValueError, match=r"^goal has shape \(4,\); accepted: \(2,\) or \(3,\)"):
        goal_mppi(DRIVEN, [1.0, 2.0, 3.0, 4.0], FLIGHT)
    with pytest.raises(ValueError, match="DifferentialDrive has no state component 'z'; accepted"):
        goal_mppi(DRIVEN, [1.0, 2.0, 3.0], FLIGHT)


@pytest.mark.parametrize(
    ("numbers", "said"),
    [
        ({"noise_std": [1.0, 1.0, 1.0]}, r"noise_std has shape \(3,\); accepted: \(2,\)"),
        ({"noise_std": [1.0, -2.0]}, r"noise_std is .*-2\..*; accepted: one positive number per"),
        ({"num_samples": 0}, "num_samples is 0; accepted: a whole number >= 1"),
        ({"horizon": -3}, "horizon is -3; accepted: a whole number >= 1"),
        ({"dt": 0.0}, "dt is 0.0; accepted: a finite number > 0.0"),
        ({"temperature": 0.0}, "temperature is 0.0; accepted: a finite number > 0.0"),
        ({"clearance": -1.0}, "clearance is -1.0; accepted: a finite number > 0.0"),
        ({"parameterisation": Knots(9)}, "num_knots is 9; accepted: at most the horizon, 8"),
    ],
)
def test_bad_numbers_of_a_flight_are_named(numbers: dict, said: str) -> None:
    flight = Flight(horizon=8, num_samples=4)._replace(**numbers)
    with pytest.raises(ValueError, match=f"^{said}"):
        goal_mppi(DRIVEN, [1.0, 0.0], flight)
    with pytest.raises(ValueError, match=f"^{said}"):
        random_walk(DRIVEN, flight)


@pytest.mark.parametrize(
    ("numbers", "said"),
    [
        ({"horizon": 0}, "horizon is 0; accepted"),
        ({"horizon": 0, "parameterisation": Knots(4)}, "horizon is 0; accepted"),
        ({"horizon": -3, "parameterisation": Smooth()}, "horizon is -3; accepted"),
        ({"dt": 0.0, "parameterisation": Smooth()}, "dt is 0.0; accepted"),
        ({"noise_std": [1.0, -2.0], "parameterisation": Smooth()}, r"noise_std is .*-2\..*; acc"),
    ],
)
def test_bad_numbers_are_named_before_they_are_used(numbers: dict, said: str) -> None:
    with pytest.raises(ValueError, match=f"^{said}"):
        goal_mppi(DRIVEN, [1.0, 0.0], Flight(horizon=8, num_samples=4)._replace(**numbers))


def drive(mppi: MPPI, state, steps: int) -> np.ndarray:
    """Return the states (N + 1, nx) of a plain loop."""
    memory, states, belief = mppi.init(), [state], beside(100.0)
    for key in keys(11, steps):
        control, memory, info = plan(mppi, memory, states[-1], belief, key)
        assert bool(info.is_finite)
        states.append(mppi.dynamics.step(states[-1], control, mppi.control_period))
    return np.asarray(states, float)


def test_goal_mppi_goes_to_its_goal() -> None:
    """And stays, and goes no faster than it may. With 64 samples chance moves it by up to 0.16 m,
    with 256 by up to 0.04 m (16 flights)."""
    robot, flight = (
        PointMass(max_acceleration=3.0, integrator=Euler()),
        FLIGHT._replace(num_samples=256),
    )
    for goal in ([2.0, 1.0], [-1.5, 0.5]):
        states = drive(goal_mppi(robot, goal, flight), robot.at_pose(0.0, 0.0, 0.0), 60)
        away = np.linalg.norm(states[:, :2] - goal, axis=1)
        assert (away[45:] < 0.1).all()
        speeds = np.linalg.norm(states[:, 2:], axis=1)
        assert 0.9 < speeds.max() < 1.1


@pytest.mark.parametrize("robot", [DRIVEN, Quadrotor()], ids=["ground", "air"])
def test_what_the_baselines_share(robot: Dynamics) -> None:
    flight = FLIGHT._replace(control_period=0.03, temperature=0.4)
    walk, to_goal = random_walk(robot, flight), goal_mppi(robot, [0.0, 0.0], flight)
    for mppi in (walk.mppi, to_goal):
        assert (mppi.horizon, mppi.num_samples) == (10, 64)
        assert (float(mppi.dt), float(mppi.control_period)) == pytest.approx((0.1, 0.03))
        assert float(mppi.weighting.temperature) == pytest.approx(0.4)
        assert isinstance(mppi.parameterisation, Knots)
        assert mppi.parameterisation.num_knots == 4
        expected = flight.sampling(robot).proposal.noise_std
        np.testing.assert_array_equal(mppi.proposal.noise_std, expected)
    state, control = robot.at_pose(3.0, -4.0, 0.7).at[3:5].add(1.2), 0.7 * robot.control_max
    walking, going = (paid(mppi, state, control, 0.4) for mppi in (walk.mppi, to_goal))
    assert min(walking.pop("GoalCost"), going.pop("GoalCost")) > 0.0
    assert walking == pytest.approx(going)
    assert min(walking.values()) > 0.0
    assert (float(walk.distance), float(walk.period)) == (3.0, 2.0)


@pytest.mark.parametrize("horizon", [5, 40])
def test_a_walk_is_pulled_as_a_robot_with_a_goal(horizon: int) -> None:
    """Else it is neither as fast nor as safe: its target outweighs obstacles and speed limit."""
    flight = FLIGHT._replace(horizon=horizon)
    state, control = DRIVEN.at_pose(3.0, -4.0, 0.0), jnp.zeros(2)
    walk, to_goal = random_walk(DRIVEN, flight), goal_mppi(DRIVEN, [0.0, 0.0], flight)
    assert paid(to_goal, state, control)["GoalCost"] == pytest.approx(50.0)
    assert paid(walk.mppi, state, control)["GoalCost"] == pytest.approx(50.0)


def test_without_numbers_they_are_those_of_a_flight() -> None:
    robot, default = Quadrotor(), Flight()
    for mppi in (goal_mppi(robot, [1.0, 2.0]), random_walk(robot).mppi):
        assert (mppi.horizon, mppi.num_samples) == (default.horizon, default.num_samples)
        expected = default.sampling(robot).proposal.noise_std
        np.testing.assert_array_equal(mppi.proposal.noise_std, expected)
