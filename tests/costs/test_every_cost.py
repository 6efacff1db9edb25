"""What holds for every cost, of those that read a belief for the ones of ground vehicles."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import (
    MPPI,
    ControlCost,
    ControlRateCost,
    Cost,
    DifferentialDrive,
    DiscObstacleCost,
    GoalCost,
    MovingObstacleCost,
    OccupancyGrid,
    State,
    StateCost,
    WaypointCost,
)
from jaxplore.belief import Obstacles
from jaxplore.belief.belief import Belief
from jaxplore.belief.guidance import GuidanceField
from jaxplore.belief.tracks import ObstacleTracker
from jaxplore.costs import (
    CollisionCost,
    ControlJerkCost,
    OcclusionCost,
    PathCost,
    QuadraticControlCost,
    ReferenceCost,
    RegionCost,
    StabilityCost,
    StateBoundsCost,
    TerrainCost,
    ToGoalCost,
    TraversabilityCost,
)
from jaxplore.geometry import Chassis, Outlines
from jaxplore.information import InformationField
from jaxplore.maps import Ground
from jaxplore.maps.field import ScalarField
from jaxplore.maps.frame import GridFrame
from jaxplore.sensing.clusters import Edges

pytestmark = pytest.mark.long

RNG = np.random.default_rng(0)
# All goals, obstacles and paths lead through (0, 0): that is where gradients are delicate.
HERE = np.zeros(2)
PATH = np.array([[-1.0, 0.0], [0.0, 0.0], [0.0, 0.0], [1.0, 2.0]])


def obstacles_at(place: np.ndarray, size: float = 1.0) -> Obstacles:
    """Return a disc and a triangle with a corner at a place, of which all is uncertain."""
    triangle = place + size * np.array([[0.0, 0.0], [1.5, 0.5], [0.25, 2.0]])
    return Obstacles(
        Outlines.discs([place], size) + Outlines.polygons([triangle], 0.25 * size),
        size * np.array([[0.5, 0.25], [0.0, 0.0]]) + size - 1.0,
        [0.1 * size, 0.2 * size],
        centres=place + np.array([[0.0, 0.0], [0.75, 0.75]]),
        covariance=size * np.array([[3.0, 1.0], [1.0, 4.0]]),
        growth=size,
        turn_growth=0.1 * size,
        age=0.5 * size,
        memory=size,
    )


def discs_at(place: np.ndarray, size: float = 1.0) -> Obstacles:
    """Return two discs at a place, of which all is uncertain."""
    return Obstacles(
        Outlines.discs([place, place], size),
        size * np.array([[0.5, 0.25], [1.0, 0.5]]),
        [0.1 * size, 0.2 * size],
        centres=place + size * np.array([[0.25, 0.0], [0.0, 0.5]]),
        covariance=size * np.array([[3.0, 1.0], [1.0, 4.0]]),
        growth=size,
        turn_growth=0.1 * size,
        age=0.5 * size,
        memory=size,
    )


ALL = {"clearance": 0.4, "margin": 0.02, "caution": 1.0}
OTHER = {"margin": 4.0, "reaction_time": 5.0}
ALL_OTHER = {"clearance": 2.0, "collision": 3.0, "caution": 6.0, **OTHER}

# Two of each kind in which every number differs.
PAIRS = {
    "goal": [GoalCost(HERE), GoalCost([1.0, 2.0], None, 2.0)],
    "saturated goal": [GoalCost(HERE, 2.0), GoalCost([1.0, 2.0], 3.0, 2.0)],
    "goal in space": [GoalCost([0.0, 0.0, 0.0]), GoalCost([1.0, 2.0, 3.0], None, 2.0)],
    "waypoint": [WaypointCost(HERE, 0.0), WaypointCost([1.0, 2.0], 3.0, 4.0, 5.0, 6.0)],
    "reference": [ReferenceCost(PATH, 0.1), ReferenceCost(PATH + 1.0, 0.2)],
    "path": [PathCost(PATH, 1.0, 1.0), PathCost(PATH + 1.0, 2.0, 3.0, 4.0)],
    "state": [
        StateCost({"yaw": 1.0, "x": 2.0}, angles=["yaw"]),
        StateCost({"x": 3.0, "yaw": 4.0}, {"x": 5.0, "yaw": 6.0}, ["yaw"], 7.0),
    ],
    "bounds": [
        StateBoundsCost({"x": 0.0}, {"x": 0.0, "z": -1.0}),
        StateBoundsCost({"x": -2.0}, {"z": 1.0, "x": 3.0}, {"x": 4.0, "z": 5.0}),
    ],
    "discs": [
        DiscObstacleCost([HERE, HERE], 0.5),
        DiscObstacleCost(np.ones((2, 2)), [1.0, 2.0], 3.0, 4.0, 5.0, 6.0),
    ],
    "moving": [
        MovingObstacleCost(discs_at(HERE), collision=None),
        MovingObstacleCost(discs_at(np.ones(2), 2.0), nearness=2.0, collision=None, **OTHER),
    ],
    "outlined": [
        MovingObstacleCost(obstacles_at(HERE), nearness=None, **ALL, nearest_only=True),
        MovingObstacleCost(
            obstacles_at(np.ones(2), 2.0), nearness=None, **ALL_OTHER, nearest_only=True
        ),
    ],
    "moving, all terms": [
        MovingObstacleCost(obstacles_at(HERE), **ALL),
        MovingObstacleCost(obstacles_at(np.ones(2), 2.0), nearness=2.0, **ALL_OTHER),
    ],
    "effort": [ControlCost(), ControlCost()],
    "quadratic effort": [
        QuadraticControlCost([1.0, 1.0, 1.0], [0.0, 0.0, 0.0]),
        QuadraticControlCost([2.0, 3.0, 4.0], [1.0, 2.0, 3.0]),
    ],
    "rate": [ControlRateCost(1.0), ControlRateCost(2.0)],
    "jerk": [ControlJerkCost(1.0), ControlJerkCost(2.0)],
    "collision": [CollisionCost(1.0, 1.0, 1.0, 1.0), CollisionCost(2.0, 3.0, 4.0, 5.0)],
    "tracked": [MovingObstacleCost(), MovingObstacleCost(nearness=2.0, collision=3.0, **OTHER)],
    "occlusion": [OcclusionCost(), OcclusionCost(1.0, 2.0, 0.1, 0.2)],
    "terrain": [TerrainCost(), TerrainCost(1.0, 2.0)],
    "traversability": [TraversabilityCost(), TraversabilityCost(1.0, 0.9)],
    "stability": [
        StabilityCost(Chassis(1.0, 1.0, 1.0, 0.1), 0.0),
        StabilityCost(Chassis(1.5, 0.9, 2.0, 0.2, 0.5), 0.5),
    ],
    "to goal": [ToGoalCost(), ToGoalCost(2.0)],
    "region": [RegionCost(), RegionCost(2.0)],
    "sum": [
        2.0 * GoalCost(HERE).with_name("a") + ControlCost(),
        3.0 * GoalCost([1.0, 2.0], None, 2.0).with_name("a") + ControlCost(),
    ],
}
READERS = (
    *("collision", "tracked", "occlusion", "terrain", "traversability", "stability", "to goal"),
    "region",
)


def small_belief(seed: int = 0) -> Belief:
    """Return 6 x 6 cells around the origin in which every field is uneven; the robot is on it."""
    rng = np.random.default_rng(seed)
    origin = (-3.0, -3.0, 0.0)
    frame, ways = GridFrame(1.0, origin), rng.uniform(-0.7, 0.7, (2, 6, 6))

    def field() -> jax.Array:
        return jnp.asarray(rng.uniform(0.0, 1.0, (6, 6)), jnp.float32)

    guidance = GuidanceField(field(), jnp.asarray(ways, jnp.float32), frame, jnp.asarray(1e4))
    discs = Obstacles.unseen([0.3, 0.4, 0.5])
    places = jnp.asarray([HERE, [1.0, -1.0], [np.nan, 0.0]], jnp.float32)
    known = jnp.asarray([True, True, False])
    discs = eqx.tree_at(
        lambda some: (some.outlines.corners, some.centres, some.is_known),
        discs,
        (places[:, None], places, known),
    )
    corners = jnp.asarray([HERE, [1.0, 0.5], [0.0, 0.1]], jnp.float32)
    edges = Edges(corners, jnp.asarray([True, True, False]))
    return Belief(
        grid=OccupancyGrid(np.zeros((6, 6)), 1.0, origin),
        clearance=ScalarField(field(), frame, jnp.zeros(())),
        information=no_information(frame),
        guidance=guidance,
        dwell=jnp.zeros((6, 6)),
        ground=Ground(rng.uniform(0.0, 0.5, (6, 6)), 1.0, origin),
        to_goal=guidance,
        obstacles=discs,
        tracks=ObstacleTracker(2).init()._replace(edges=edges),
    )


def no_information(frame: GridFrame) -> InformationField:
    return InformationField(
        sectors=jnp.zeros((4, 6, 6)),
        cumulative=jnp.zeros((5, 6, 6)),
        source=jnp.zeros((6, 6)),
        frame=frame,
        field_of_view=2.0 * np.pi,
        num_beams=8,
    )


# A cost that is not to read its belief gets none.
KNOWN = {name: small_belief() if name in READERS else None for name in PAIRS}
every_cost = pytest.mark.parametrize("name", PAIRS)


def total(cost: Cost, state: State, control, t, controls, known: Belief | None):
    """Return everything a cost may ask for."""
    return (
        cost.stage(state, control, t, known)
        + cost.terminal(state, known)
        + cost.sequence(controls, controls[0], jnp.asarray(0.1), state.dynamics)
    )


def totals(costs: dict[str, Cost], state: State, controls, t):
    """Return everything that each of the costs may ask for."""
    return {
        name: total(cost, state, controls[1], t, controls, KNOWN[name])
        for name, cost in costs.items()
    }


CONTROLS = jnp.asarray(RNG.normal(size=(4, 3)), jnp.float32)
FIRST, SECOND = ({name: pair[which] for name, pair in PAIRS.items()} for which in (0, 1))


class Programs:
    """All costs in one program, of which there are few: that is what tests cost."""

    def __init__(self, robot) -> None:
        self.traced = 0

        @jax.jit
        def price(costs, state, controls, t):
            self.traced += 1
            return totals(costs, state, controls, t)

        @jax.jit
        def slopes(values, costs):
            def paid(values, cost, name):
                state = State(values, robot)
                return total(cost, state, CONTROLS[1], jnp.asarray(0.1), CONTROLS, KNOWN[name])

            both = jax.grad(paid, (0, 1))
            return {name: both(values, cost, name) for name, cost in costs.items()}

        self.price, self.slopes = price, slopes


@pytest.fixture(scope="module")
def programs(drone):
    """Return the programs of a drone."""
    return Programs(drone().dynamics)


@pytest.fixture(scope="module")
def prices(programs, drone):
    """Return what the first and the second of each kind cost in one place."""
    state = drone(x=0.7, y=-0.3, z=2.0, yaw=1.0, v=0.5)
    found = [programs.price(each, state, CONTROLS, jnp.ones(())) for each in (FIRST, SECOND)]
    assert programs.traced == 1
    return found


@every_cost
def test_numbers_are_leaves_and_another_number_does_not_recompile(name, prices) -> None:
    first, second = PAIRS[name]
    assert jax.tree.structure(first) == jax.tree.structure(second)
    for one, other in zip(jax.tree.leaves(first), jax.tree.leaves(second), strict=True):
        assert isinstance(one, jax.Array)
        assert one.dtype == other.dtype == jnp.float32
        assert one.shape == other.shape
        assert not np.array_equal(one, other)
    assert len(jax.tree.leaves(first)) == 0 or prices[0][name] != prices[1][name]


@pytest.fixture(scope="module")
def sampled(programs, drone):
    """Return what six samples cost at once and one by one."""
    robot = drone().dynamics
    states = RNG.normal(size=(5, 6)).astype(np.float32) * 2.0
    controls = RNG.normal(size=(4, 3, 6)).astype(np.float32)
    t = jnp.asarray(0.3)

    def one(values, controls):
        return programs.price(SECOND, State(values, robot), controls, t)

    together = jax.jit(jax.vmap(one, in_axes=-1))(states, controls)
    alone = [one(jnp.asarray(states[:, k]), jnp.asarray(controls[:, :, k])) for k in range(6)]
    return together, alone


@every_cost
def test_samples_on_the_last_axis_are_priced_one_by_one(name, sampled) -> None:
    together, alone = sampled
    one_by_one = [float(each[name]) for each in alone]
    np.testing.assert_allclose(together[name], one_by_one, rtol=1e-5, atol=1e-6)


DELICATE = (
    {},
    {"x": 1e-20},
    {"x": 1e-6, "y": 1e-6},
    {"yaw": np.pi},
    *({"x": s * 1e6, "y": -1e6, "z": 1e6, "yaw": 1e4, "v": 1e3} for s in (1.0, -1.0)),
)


@pytest.fixture(scope="module")
def gradients(programs, drone):
    """Return the gradients of the first of each kind by state and numbers, where they may fail."""
    costs = {name: FIRST[name] for name in DERIVED}
    return [programs.slopes(drone(**where).values, costs) for where in DELICATE]


# All terms of moving obstacles are those of two others, whose derivatives are compiled already.
DERIVED = [name for name in PAIRS if name != "moving, all terms"]


@pytest.mark.parametrize("name", DERIVED)
def test_gradients_are_finite_everywhere(name, gradients) -> None:
    for where, found in zip(DELICATE, gradients, strict=True):
        for leaf in jax.tree.leaves(found[name]):
            assert np.isfinite(leaf).all(), where


@pytest.fixture(scope="module")
def elsewhere(programs, shuffled):
    """Return what both of each kind cost in the same place with another model."""
    state = shuffled(x=0.7, y=-0.3, z=2.0, yaw=1.0, v=0.5)
    return [programs.price(each, state, CONTROLS, jnp.ones(())) for each in (FIRST, SECOND)]


@every_cost
def test_the_same_cost_serves_another_model(name, prices, elsewhere) -> None:
    for here, there in zip(prices, elsewhere, strict=True):
        assert float(here[name]) == pytest.approx(float(there[name]), rel=1e-6)


NOBODY = Obstacles(Outlines.discs(np.zeros((0, 2)), []), np.zeros((0, 2)), covariance=np.eye(2))


@pytest.mark.parametrize(
    "cost",
    [
        DiscObstacleCost([], 0.3),
        DiscObstacleCost(np.zeros((0, 3)), []),
        MovingObstacleCost(Obstacles(Outlines.discs([], 0.3), [])),
        MovingObstacleCost(NOBODY, **ALL),
        MovingObstacleCost(NOBODY, nearness=None, **ALL, nearest_only=True),
    ],
)
def test_no_obstacles_cost_nothing(cost) -> None:
    model = DifferentialDrive()

    def paid(values):
        here = State(values, model)
        return cost.stage(here, jnp.zeros(2), jnp.asarray(0.5), None) + cost.terminal(here, None)

    values = jnp.asarray([1.0, 2.0, 0.3, 0.5, 0.1])
    price, slope = jax.jit(jax.value_and_grad(paid))(values)
    assert price == 0.0
    np.testing.assert_array_equal(slope, 0.0)


def test_some_moving_obstacles_need_as_many_velocities() -> None:
    with pytest.raises(ValueError, match=r"velocities has shape \(0,\); accepted: \(1, 2\)"):
        Obstacles(Outlines.discs([[1.0, 2.0]], 0.3), [])


@pytest.mark.parametrize(
    ("name", "missing", "lacking"),
    [
        ("collision", "clearance", "the belief of a Perception"),
        ("tracked", "obstacles", r"Belief\(obstacles=\.\.\.\), or obstacles given to the cost"),
        ("to goal", "to_goal", "the belief of a Perception with a goal apart"),
    ],
)
def test_a_part_that_the_belief_lacks_is_named(name, missing, lacking, drone) -> None:
    without = eqx.tree_at(
        lambda known: getattr(known, missing), small_belief(), None, is_leaf=lambda x: x is None
    )
    for known in (without, Belief()):
        with pytest.raises(ValueError, match=f"^belief has no {missing}; accepted: {lacking}$"):
            total(PAIRS[name][0], drone(), CONTROLS[0], jnp.zeros(()), CONTROLS, known)


def test_a_controller_says_so_too() -> None:
    robot = DifferentialDrive()
    given = {"horizon": 3, "num_samples": 4, "noise_std": [1.0, 1.0], "dt": 0.1}
    mppi = MPPI(robot, MovingObstacleCost(), **given, temperature=1.0)
    for known, said in ((None, "is None, and a cost reads its"), (Belief(), "has no")):
        with pytest.raises(ValueError, match=f"^belief {said} obstacles; accepted"):
            mppi.step(mppi.init(), jnp.zeros(5), known, key=jax.random.key(0))
