"""A quadrotor flies to a goal in a volume in the closed loop."""

import itertools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given as given_by
from hypothesis import settings
from hypothesis import strategies as st
from tests.kinds import CAMERA, QUADROTOR, SIDE, room, volume

import jaxplore as jx
from jaxplore.costs import VolumeGoalCost, VolumeGuidanceCost
from jaxplore.maps import MovingObstacle
from jaxplore.parts import MovingObstacles
from jaxplore.planning import GoalApproach
from jaxplore.report.drawing.colours import MOVER
from jaxplore.simulation.run import record_run
from jaxplore.simulation.volume.people import Cylinders, distance_along, floor_plan

pytestmark = pytest.mark.long

GOAL, START = (6.5, 0.9, 1.3), (1.0, 0.9, 1.2, 0.0)
"""On both sides of the half wall, so that the straight line between them is blocked."""
BOX = (2.4, 1.6, 0.0, 3.6, 2.4, 2.4)
"""At the end of the wall, where the shortest way leads."""
BOXES = jx.parts.KeepOutBoxes([BOX])
PEOPLE = MovingObstacles([MovingObstacle(((5.4, 1.0), (5.4, 2.4)), 0.4, 0.25)])
"""Somebody who walks to and fro across the way."""


along = jax.jit(distance_along)


@pytest.fixture(scope="module")
def controller():
    flying = jx.volume_explorer(
        QUADROTOR, horizon=20, num_samples=128, has_goal=True, has_moving_obstacles=True
    )
    return GoalApproach(flying, QUADROTOR)


@pytest.fixture(scope="module")
def run(controller):
    seen = jx.VolumePerception(
        [CAMERA], SIDE, QUADROTOR.radius, goal=GOAL, goal_heading=1.0, parts=[BOXES]
    )
    given = volume(start=START, goal=jx.Goal(GOAL, heading=1.0), perception=seen, truths=[PEOPLE])
    return record_run(controller, given, 600, key=jax.random.key(0), num_trajectories=0)


def test_it_flies_around_the_wall_and_comes_to_rest_at_the_goal(run) -> None:
    metrics, states = run.metrics(), np.asarray(run.records.state)
    assert metrics.is_finished
    assert metrics.collisions == 0
    assert metrics.minimum_clearance > 0.0
    # By hand, in the frame of the model: z down, and a step of 50 ms.
    place = states[:, :3] * [1.0, 1.0, -1.0]
    away = np.linalg.norm(place[-1] - GOAL)
    assert away < 0.15
    assert metrics.goal_distance == pytest.approx(away, abs=1e-5)
    assert np.linalg.norm(place[-1] - place[-2]) / 0.05 <= 0.05
    qw, qx, qy, qz = states[-1, 6:10]
    yaw = math.atan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy**2 + qz**2))
    assert yaw == pytest.approx(1.0, abs=0.1)
    # It ends at once, and knows only a part of the room.
    assert metrics.finished_at == pytest.approx(metrics.duration)
    assert metrics.coverage < 0.95
    # The straight line leads through the wall at x = 3.0 to 3.2 m, y < 1.6 m.
    crossing = place[np.abs(place[:, 0] - 3.1).argmin()]
    assert crossing[1] > 1.6
    # Nor does it enter the box, by the distance of a ball from a box in double precision.
    low, high = np.array(BOX[:3]), np.array(BOX[3:])
    gap = np.maximum(np.maximum(low - place, place - high), 0.0)
    assert np.linalg.norm(gap, axis=1).min() >= 0.3
    assert metrics.untraversable_steps == 0
    assert np.abs(place[:, 0] - 3.0).min() < 0.1


@pytest.mark.parametrize("goal", [(3.6, 0.7, 0.6), (3.7, 0.6, 1.8)])
def test_it_backs_off_to_see_a_goal_that_it_comes_upon_around_a_corner(controller, goal) -> None:
    # From the end of the wall the camera looks over the first goal, and under the second one.
    seen = jx.VolumePerception(
        [CAMERA], SIDE, QUADROTOR.radius, goal=goal, goal_heading=1.0, parts=[BOXES]
    )
    # Nobody walks where the robot backs off to: the camera looks at the goal then.
    far = MovingObstacles([MovingObstacle(((7.4, 1.0), (7.4, 2.4)), 0.4, 0.25)])
    given = volume(start=START, goal=jx.Goal(goal, heading=1.0), perception=seen, truths=[far])
    around = record_run(controller, given, 600, key=jax.random.key(1), num_trajectories=0)
    metrics = around.metrics()
    assert metrics.is_finished
    assert metrics.collisions == 0
    last = np.asarray(around.records.state)[-1, :3] * [1.0, 1.0, -1.0]
    assert np.linalg.norm(last - goal) < 0.15


def test_it_avoids_somebody_whom_it_sees_and_does_not_map(run) -> None:
    # The clearance that is recorded, by hand: that of the walls, and of the person then.
    states = np.asarray(run.records.state, np.float64)
    movers = np.stack([frame.movers for frame in run.frames]).astype(np.float64)
    steps = [frame.step for frame in run.frames]
    for step, (x, y, radius) in zip(steps[1:], movers[1:, 0], strict=True):
        gap = np.hypot(states[step - 1, 0] - x, states[step - 1, 1] - y) - radius - 0.3
        assert run.records.clearance[step - 1] <= gap + 1e-4
    # Somebody stands 1 m above the floor in every voxel of the walk: nothing of it is in the map.
    walk = np.zeros(run.world.shape, bool)
    walk[3:8, 5:12, 26:28] = True
    assert not run.world[walk].any()
    assert (run.belief[walk] == 2).sum() == 0
    assert (run.belief[walk] == 1).mean() > 0.5
    picture = np.asarray(run.frame_image(run.frames[-1]).convert("RGB"))
    assert (picture == np.array(MOVER)).all(axis=-1).sum() > 20


@settings(max_examples=25)
@given_by(st.integers(0, 2**31))
def test_rays_end_at_upright_cylinders(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ways = rng.normal(size=(3, 40))
    ways /= np.linalg.norm(ways, axis=0)
    ways[:, 0], ways[:, 1] = (0.0, 0.0, -1.0), (1.0, 0.0, 0.0)
    start, middle = rng.uniform(-2.0, 2.0, 3), rng.uniform(-1.0, 1.0, 2)
    radius, top = rng.uniform(0.1, 0.8), rng.uniform(-1.0, 1.0)
    given = [np.asarray(each, np.float32) for each in (start, ways, middle, radius, top)]
    found = np.asarray(along(*given))
    # Step by step along each ray, in double precision.
    steps = np.arange(0.0, 6.0, 2e-3)
    points = start[:, None, None] + steps * ways[:, :, None]
    away = np.hypot(points[0] - middle[0], points[1] - middle[1])
    inside = (away <= radius) & (points[2] <= top)
    wanted = np.where(inside.any(axis=1), steps[inside.argmax(axis=1)], np.inf)
    # A ray that only grazes is inside for less than a step.
    near = (away <= radius + 5e-3) & (points[2] <= top + 5e-3)
    is_plain = (inside.sum(axis=1) > 20) | ~near.any(axis=1)
    within = np.where(found < 5.9, found, np.inf)
    wanted = np.where(wanted < 5.9, wanted, np.inf)
    both = is_plain & np.isfinite(wanted) & np.isfinite(within)
    np.testing.assert_array_equal(np.isfinite(wanted)[is_plain], np.isfinite(within)[is_plain])
    np.testing.assert_allclose(found[both], wanted[both], atol=4e-3)


def test_people_touch_what_is_lower_than_their_heads() -> None:
    here = jnp.zeros(2)
    people = Cylinders(here[None], here[None], jnp.array([0.3]), jnp.zeros(()), jnp.float32(1.8))
    for place, wanted in (
        ((1.0, 0.0, 1.0), 0.7),
        ((0.1, 0.0, 1.0), 0.0),
        ((0.0, 0.0, 2.3), 0.5),
        ((0.6, 0.8, 2.2), np.hypot(0.7, 0.4)),
    ):
        assert float(people.gap(jnp.asarray(place))) == pytest.approx(wanted, abs=1e-5)


def test_a_robot_is_told_of_whom_it_sees() -> None:
    # One person before the camera, one behind it, one behind the half wall, and one at the edge of
    # the view, which is 40 degrees beside the heading: the middle is 42 degrees beside it.
    places = ((2.2, 2.0), (0.3, 2.0), (4.2, 0.8), (2.115, 3.004))
    people = MovingObstacles([MovingObstacle((place,), 0.0, 0.2) for place in places])
    given = volume(start=(1.0, 2.0, 1.2, 0.0), truths=[people], tracking_noise=(0.0, 0.0))
    world, at = given.world, jnp.array([1.0, 2.0, 1.2])
    there = Cylinders.of(people.at(jnp.zeros(())), world)
    told = there.tell(given.sensors, world, at, jnp.eye(3), jnp.zeros(2), jax.random.key(0))
    np.testing.assert_array_equal(told.is_seen, [True, False, False, True])
    np.testing.assert_allclose(told.positions, places, atol=1e-6)
    # Rays that end at somebody are shorter, and no returns.
    scan = CAMERA.scan(world, at, jnp.eye(3), key=jax.random.key(0))
    blocked = there.block(scan, CAMERA, at, jnp.eye(3))
    is_shorter = np.asarray(blocked.ranges < scan.ranges)
    assert is_shorter.any()
    assert not np.asarray(blocked.is_return)[is_shorter].any()
    # The nearest of them is straight ahead, at the front of the first one.
    assert float(blocked.ranges.min()) == pytest.approx(1.0, abs=0.01)


def test_people_walk_where_nothing_stands_between_their_feet_and_heads() -> None:
    solid = np.zeros((12, 20, 40), bool)
    solid[0] = True
    solid[10:, 5:8] = True  # Above their heads.
    solid[4, 10, 10] = True
    plan = floor_plan(jx.VoxelGrid.solid(solid, SIDE, (3.0, -1.0, 2.0)))
    wanted = np.zeros((20, 40), bool)
    wanted[10, 10] = True
    np.testing.assert_array_equal(np.asarray(plan.is_occupied), wanted)
    np.testing.assert_allclose(plan.frame.origin, [3.0, -1.0, 0.0])


def test_the_goal_is_in_the_pictures_and_arrays(run, tmp_path) -> None:
    recording = run
    picture = np.asarray(recording.frame_image(recording.frames[-1]).convert("RGB"))
    assert (picture == [233, 162, 59]).all(axis=-1).sum() > 20
    figure = recording.figures()["volume"]()
    (axes,) = figure.axes
    assert "goal" in [each.get_text() for each in axes.get_legend().get_texts()]
    np.testing.assert_allclose(recording.arrays()["goal"], GOAL, atol=1e-6)
    assert dict(recording.metrics().rows())["goal"].endswith("m away")


def test_the_cost_of_the_way_is_what_it_says() -> None:
    given = volume(start=START, goal=GOAL)
    _, belief = given.init(None)
    rising = jnp.arange(belief.guidance.values.shape[2], dtype=jnp.float32) * jnp.ones(
        belief.guidance.values.shape
    )
    belief = eqx.tree_at(
        lambda each: (each.guidance.values, each.goal.way), belief, (rising, jnp.array([0.6, 0.0]))
    )
    # 2 m/s ahead, with the nose turned by 0.4 rad from the way.
    values = QUADROTOR.at_pose(4.0, 2.0, 0.4, -1.2).at[3].set(2.0)
    state = jx.State(values, QUADROTOR)
    nothing = jnp.zeros(4), jnp.zeros(()), belief
    way = float(VolumeGuidanceCost(50.0).stage(state, *nothing))
    braking = 2.0 * max(0.0, 4.0 / (2.0 * 0.25 * 9.81) / 0.5 - way)
    found = float(VolumeGoalCost(0.5, 50.0).stage(state, *nothing))
    assert found == pytest.approx(way + braking + 0.5 * 0.6 * (1.0 - math.cos(0.4)), abs=1e-4)


def test_flying_where_the_camera_does_not_look_costs_fourfold_among_people() -> None:
    given = volume(start=START, goal=GOAL, truths=[PEOPLE])
    _, belief = given.init(None)
    # 1 m/s to the left and 2 m/s backwards; nobody has been seen yet.
    values = QUADROTOR.at_pose(4.0, 2.0, 0.0, -1.2).at[3:5].set(jnp.array([-2.0, 1.0]))
    state = jx.State(values, QUADROTOR)
    costs = []
    for has_people in (True, False):
        flying = jx.volume_explorer(
            QUADROTOR, horizon=20, has_goal=True, has_moving_obstacles=has_people, blind_weight=0.5
        )
        costs.append(float(flying.cost.stage(state, jnp.zeros(4), jnp.zeros(()), belief)))
    assert 20 * (costs[0] - costs[1]) == pytest.approx(3 * 0.5 * (2.0**2 + 0.6 * 1.0**2), rel=1e-4)


def _with_box(place) -> jx.VolumePerception:
    x, y, z = place[:3]
    box = (x - 0.1, y - 0.1, z - 0.1, x + 0.1, y + 0.1, z + 0.1)
    return jx.VolumePerception([CAMERA], SIDE, 0.3, parts=[jx.parts.KeepOutBoxes([box])])


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (
            {"goal": (3.1, 0.9, 1.2)},
            "cannot reach from its start: .* accepted: a goal within 0.135",
        ),
        ({"goal": (99.0, 0.9, 1.2)}, "goal is .*99, .*cannot reach from its start"),
        (
            {"goal": GOAL, "truths": [jx.parts.Targets([GOAL])]},
            "beside targets; accepted: one of them",
        ),
        ({"goal": GOAL, "perception": _with_box(START)}, r"start is \(1, 0.9, 1.2\), in a keep-"),
        ({"goal": GOAL, "perception": _with_box(GOAL)}, r"goal is \(6.5, 0.9, 1.3\), in a keep-"),
        (
            {"truths": [jx.parts.Targets([GOAL])], "perception": _with_box(GOAL)},
            "targets are 1, all in keep-out b",
        ),
        ({"goal": (1.0, 2.0)}, "goal is .* accepted: 3 finite numbers"),
        ({"goal": jx.Goal(GOAL, 0.0)}, "goal_radius is 0.0; accepted"),
        ({"goal": jx.Goal(GOAL, max_unknown=0.2)}, "max_unknown of goal is 0.2; accepted"),
        (
            {
                "goal": GOAL,
                "perception": jx.VolumePerception([CAMERA], SIDE, 0.3, goal=GOAL, goal_radius=0.3),
            },
            r"perception has the goal_radius 0.30.*; accepted: the scenario's, 0.15",
        ),
        (
            {"goal": GOAL, "perception": jx.VolumePerception([CAMERA], SIDE, 0.3)},
            "perception has the goal None; accepted: the scenario's",
        ),
    ],
)
def test_goals_that_are_not_possible_are_refused(given, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        volume(start=START, **given)


def test_a_goal_that_is_accepted_has_room_within_its_radius() -> None:
    # In voxels of 0.2 m a robot of 0.25 m fits at the middles of the second ones from a wall.
    robot, given = jx.Quadrotor(radius=0.25), room()
    solid = np.argwhere(np.asarray(given.is_occupied))[:, ::-1] * SIDE
    rng = np.random.default_rng(0)
    ball = rng.normal(size=(3000, 3))
    ball *= rng.random((3000, 1)) ** (1 / 3) / np.linalg.norm(ball, axis=1, keepdims=True)

    def room_at(points: np.ndarray) -> np.ndarray:
        """Return the distance to the nearest solid voxel, a cube, by brute force."""
        gap = np.maximum(np.maximum(solid - points[:, None], points[:, None] - solid - SIDE), 0.0)
        return np.linalg.norm(gap, axis=-1).min(axis=1)

    refused = 0
    for radius, place in itertools.product(
        (0.05, 0.15), rng.uniform((5, 0.2, 0.2), (7, 0.7, 0.7), (12, 3))
    ):
        goal = [round(each, 3) for each in place]
        most = room_at(goal + radius * ball).max()
        try:
            jx.VolumeScenario(given, robot, CAMERA, START, goal=jx.Goal(goal, radius=radius))
        except ValueError:
            refused += 1
            # Of the radius, a tenth is for control, and clearance is up to half a voxel short.
            assert most < 0.25 + 0.1 * radius + 0.5 * SIDE
        else:
            assert most >= 0.25 - 1e-3
    assert 4 < refused < 20


def test_a_goal_needs_the_whole_map_and_a_controller_that_knows_it() -> None:
    with pytest.raises(ValueError, match=r"window is .* beside a goal.*accepted: one of them"):
        jx.VolumePerception([CAMERA], SIDE, 0.3, goal=GOAL, window=(20.0, 20.0, 3.0))
    with pytest.raises(ValueError, match="goal_heading is given without a goal"):
        jx.VolumePerception([CAMERA], SIDE, 0.3, goal_heading=0.0)
    # A controller that flies to a goal says what is missing where there is none.
    flying = jx.volume_explorer(QUADROTOR, horizon=20, num_samples=128, has_goal=True)
    given = jx.VolumeScenario(room(), QUADROTOR, CAMERA, START)
    _, belief = given.init(None)
    with pytest.raises(ValueError, match="belief has no goal; accepted: the belief of a perc"):
        flying.step(flying.init(), given.start, belief, key=jax.random.key(0))


def test_what_is_in_a_box_does_not_count() -> None:
    plain = volume(start=START)
    barred = volume(start=START, perception=jx.VolumePerception([CAMERA], SIDE, 0.3, parts=[BOXES]))
    gone = np.asarray(plain.observable) & ~np.asarray(barred.observable)
    # 0.6 m by 0.8 m by 2 m of it are beside the wall, and the rest is free.
    box = np.zeros(gone.shape, bool)
    box[:, 8:12, 12:18] = True
    np.testing.assert_array_equal(gone, box & np.asarray(plain.observable))
    assert float(barred.num_observable) == np.asarray(barred.observable).sum()
