"""What scans tell about the position, and rollouts that propagate its variance."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxplore as jx
from jaxplore.belief.certainty import LEAST_TURN, CertaintyField
from jaxplore.costs.exploration import CertainInformationCost, UncertaintyCost
from jaxplore.dynamics.base import State
from jaxplore.dynamics.uncertain import VARIANCE, UncertainRobot
from jaxplore.maps.clearance import clearance_field
from jaxplore.maps.field import ScalarField
from jaxplore.planning.strategy.uncertainty_aware import UncertaintyAware

SIDE = 0.1
LIDAR = jx.Lidar(num_beams=360, max_range=4.0)
CERTAINTY = CertaintyField(LIDAR, SIDE, num_directions=64, extent=1.2)
ROBOT = jx.DifferentialDrive()
PERCEPTION = jx.Perception(LIDAR, SIDE, 0.2, num_directions=8)
begin = eqx.filter_jit(PERCEPTION.init)


@eqx.filter_jit
def moved(robot, state, control, dt):
    return robot.step(state, control, dt)


@eqx.filter_jit
def planned(controller, observed, belief, key):
    return controller.step(controller.init(), observed, belief, key=key)[0]


def hall(width: float, height: float, ends: bool = True) -> jx.OccupancyGrid:
    """A hall on a map of 12 x 12 m, with its lower left corner at (1, 1)."""
    world = np.full((120, 120), 0.5, np.float32)
    low, right, top = 10, 10 + round(width / SIDE), 10 + round(height / SIDE)
    world[low:top, low:right] = 0.0
    world[low - 1, low:right] = world[top, low:right] = 1.0
    if ends:
        world[low - 1 : top + 1, low - 1] = world[low - 1 : top + 1, right] = 1.0
    return jx.OccupancyGrid(world, SIDE)


@jax.jit
def information(grid, position):
    clearance = clearance_field(~(grid.probability < 0.25), grid.frame, 1.0)
    return CERTAINTY.at(grid, clearance, position), CERTAINTY(grid, clearance, position)


def by_hand(width: float, height: float, x: float, y: float, ends: bool) -> float:
    """The least eigenvalue in double precision, by rays that meet the planes of the walls."""
    total = np.zeros((3, 3))
    for angle in 2.0 * np.pi * np.arange(64) / 64:
        ux, uy = np.cos(angle), np.sin(angle)
        hits = []
        for wall, u, normal in ((1.0, ux, (1, 0)), (1.0 + width, ux, (-1, 0))):
            if ends and abs(u) > 1e-9 and (wall - x) / u > 0:
                hits.append(((wall - x) / u, normal))
        for wall, u, normal in ((1.0, uy, (0, 1)), (1.0 + height, uy, (0, -1))):
            if abs(u) > 1e-9 and (wall - y) / u > 0:
                hits.append(((wall - y) / u, normal))
        if not hits:
            continue
        reach, (nx, ny) = min(hits)
        if reach < 4.0:
            row = np.array([nx, ny, reach * (ux * ny - uy * nx)])
            total += np.outer(row, row) * 360 / 64 / 0.05**2
    across = total[:2, 2]
    left = total[:2, :2] - np.outer(across, across) / (total[2, 2] + LEAST_TURN)
    return float(np.linalg.eigvalsh(left)[0])


@pytest.mark.parametrize(
    ("width", "height", "x", "y"),
    [(4.0, 3.0, 3.0, 2.5), (5.0, 2.0, 2.2, 1.7), (3.0, 5.0, 2.5, 4.9)],
)
def test_the_information_is_that_of_rays_that_meet_planes(
    width: float, height: float, x: float, y: float
) -> None:
    found, _ = information(hall(width, height), jnp.array([x, y]))
    expected = by_hand(width, height, x, y, ends=True)
    # Rays end in cells, and near the corners gradients of the clearance are oblique.
    assert float(found) == pytest.approx(expected, rel=0.25)
    assert expected > 5_000


def test_a_corridor_without_ends_tells_nothing_of_the_way_along_it() -> None:
    middle, _ = information(hall(10.0, 2.0, ends=False), jnp.array([6.0, 2.0]))
    assert by_hand(10.0, 2.0, 6.0, 2.0, ends=False) == pytest.approx(0.0, abs=1e-6)
    room, _ = information(hall(4.0, 2.0), jnp.array([3.0, 2.0]))
    assert float(middle) < 0.02 * float(room)
    unknown, _ = information(
        jx.OccupancyGrid(np.full((120, 120), 0.5, np.float32), SIDE), jnp.array([6.0, 6.0])
    )
    assert float(unknown) == 0.0


def test_the_field_holds_the_information_of_its_nodes() -> None:
    grid = hall(4.0, 3.0)
    _, field = information(grid, jnp.array([3.03, 2.41]))
    assert field.values.shape == CERTAINTY.blank().values.shape == (7, 7)
    node = jnp.array([2.8, 2.4])
    np.testing.assert_allclose(field(node), information(grid, node)[0], rtol=1e-4)
    # Off the field the value is that of its edge.
    np.testing.assert_allclose(field(jnp.array([3.2, 99.0])), field(jnp.array([3.2, 3.6])))


def constant(value: float) -> ScalarField:
    blank = CERTAINTY.blank()
    return ScalarField(jnp.full_like(blank.values, value), blank.frame, blank.outside, blank.margin)


@pytest.mark.parametrize("told", [0.0, 40.0])
def test_the_variance_is_that_of_a_kalman_filter(told: float) -> None:
    robot = UncertainRobot(ROBOT, constant(told), added=4e-4, rate=10.0)
    state = jnp.append(ROBOT.at_pose(0.0, 0.0, 0.3), 0.01).at[3].set(0.8)
    control, dt = jnp.array([0.5, 0.2]), jnp.asarray(0.05)
    variance, before = 0.01, np.asarray(state, float)
    for _ in range(40):
        state = moved(robot, state, control, dt)
        after = np.asarray(state, float)
        variance += 4e-4 * np.hypot(*(after - before)[:2])
        # A scan with the information told * rate * dt: the product of two Gaussians.
        variance = 1.0 / (1.0 / variance + told * 10.0 * 0.05)
        before = after
    assert float(state[-1]) == pytest.approx(variance, rel=1e-4)
    assert robot.state_names[-1] == VARIANCE
    inner = moved(ROBOT, state[:-1], control, dt)
    np.testing.assert_array_equal(moved(robot, state, control, dt)[:-1], inner)


def test_costs_of_the_variance() -> None:
    robot = UncertainRobot(ROBOT, constant(0.0))
    state = State(jnp.append(ROBOT.at_pose(3.0, 2.5, 0.0), 0.04), robot)
    zero = jnp.zeros(())
    paid = UncertaintyCost().stage(state, jnp.zeros(2), zero, jx.belief.Belief())
    assert float(paid) == pytest.approx(0.2)
    belief = begin(hall(4.0, 3.0), np.array([3.0, 2.5, 0.0], np.float32))
    plain = jx.costs.InformationCost().stage(state, jnp.zeros(2), zero, belief)
    half = CertainInformationCost(0.2).stage(state, jnp.zeros(2), zero, belief)
    assert float(plain) < 0.0
    assert float(half) == pytest.approx(0.5 * float(plain), rel=1e-5)


def test_a_robot_that_knows_its_place_plans_as_without_it() -> None:
    """With no variance and no weight, the controller is that without the variance."""
    here = jnp.array([2.0, 2.0, 0.4])
    grid = hall(4.0, 3.0)
    belief = begin(grid, here)
    numbers = {"num_samples": 64, "horizon": 12}
    plain = jx.explorer(ROBOT, **numbers)
    uncertain = UncertainRobot(ROBOT, CERTAINTY.blank(), added=0.0)
    aware = UncertaintyAware(jx.explorer(ROBOT, uncertain=uncertain, **numbers))
    known = jx.belief.Belief(
        **{
            **{name: getattr(belief, name) for name in ("grid", "clearance", "information")},
            **{name: getattr(belief, name) for name in ("guidance", "dwell", "pose")},
            "certainty": information(grid, here[:2])[1],
            "position_variance": jnp.zeros(()),
        }
    )
    observed, key = ROBOT.at_pose(2.0, 2.0, 0.4), jax.random.key(0)
    first, second = planned(plain, observed, belief, key), planned(aware, observed, known, key)
    np.testing.assert_allclose(first, second, atol=1e-5)
    plan = eqx.filter_jit(aware.inspect)(aware.init(), observed, known, key=key, num_trajectories=2)
    assert plan.nominal.states.shape == (13, ROBOT.state_size + 1)
    assert aware.at_period(0.02).dynamics is not None
    with pytest.raises(ValueError, match=r"belief has no certainty; accepted: the belief of a sce"):
        aware.step(aware.init(), observed, belief, key=key)


def test_a_robot_with_a_variance_gets_no_second_one() -> None:
    robot = UncertainRobot(ROBOT, constant(0.0))
    with pytest.raises(
        ValueError,
        match="state_names of PositionVariance has 'position_variance', which UncertainRobot",
    ):
        UncertainRobot(robot, constant(0.0))
