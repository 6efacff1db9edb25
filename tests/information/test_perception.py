import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import (
    DifferentialDrive,
    GuidanceCost,
    InverseSensorModel,
    Lidar,
    OccupancyGrid,
    Perception,
    State,
)

LIDAR = Lidar(num_beams=72, max_range=1.5, range_noise=0.0)
PERCEPTION = Perception(LIDAR, 0.1, 0.2, num_directions=16)
observe = eqx.filter_jit(lambda perception, *arguments: perception.observe(*arguments))
update_fields = eqx.filter_jit(lambda perception, *arguments: perception.update_fields(*arguments))


def room(size: tuple[int, int] = (30, 60)) -> np.ndarray:
    world = np.full(size, 1 / (1 + math.exp(7)), np.float32)
    world[0], world[-1], world[:, 0], world[:, -1] = 0.993, 0.993, 0.993, 0.993
    return world


def fields(world: np.ndarray, pose: tuple[float, float, float], perception=PERCEPTION, times=1):
    belief = perception.init(OccupancyGrid(world, 0.1), jnp.asarray(pose))
    for _ in range(times):
        belief = update_fields(perception, belief, jnp.asarray(pose), jnp.asarray(0.2))
    return belief


def test_at_first_only_the_robot_s_own_place_is_known() -> None:
    frame = OccupancyGrid(room(), 0.1).frame
    belief = PERCEPTION.init(OccupancyGrid.unknown((30, 60), frame), jnp.asarray([3.0, 1.5, 0.0]))
    free = np.argwhere(np.asarray(belief.grid.is_free)) * 0.1 + 0.05
    assert 0 < len(free) < 60
    assert np.hypot(free[:, 0] - 1.5, free[:, 1] - 3.0).max() < 0.45
    assert float(belief.clearance(jnp.asarray([3.0, 1.5]))) >= 0.2


def test_what_is_known_beforehand_stays() -> None:
    belief = PERCEPTION.init(OccupancyGrid(room(), 0.1), jnp.asarray([3.0, 1.5, 0.0]))
    np.testing.assert_allclose(belief.grid.probability, room(), atol=1e-5)


def test_guidance_falls_towards_what_is_unknown() -> None:
    world = room()
    world[:, 45:] = 0.5
    belief = fields(world, (1.0, 1.5, 0.0))
    along = [float(belief.guidance(jnp.asarray([x, 1.5]))) for x in np.arange(0.6, 3.0, 0.2)]
    assert (np.diff(along) < 0).all()
    # A metre nearer is a metre less where there is room.
    assert along[0] - along[5] == pytest.approx(1.0, abs=0.1)


def test_guidance_does_not_lead_through_a_wall() -> None:
    world = room()
    world[:, 45:] = 0.5
    world[1:20, 30] = 0.993  # the way round is at the top
    belief = fields(world, (1.0, 0.5, 0.0))
    below, above = (float(belief.guidance(jnp.asarray([2.5, y]))) for y in (0.5, 2.4))
    assert below > above + 1.0
    into_wall = [float(belief.guidance(jnp.asarray([x, 0.55]))) for x in (2.65, 2.75, 2.85)]
    assert np.isfinite(into_wall).all()
    assert into_wall[0] < into_wall[1] < into_wall[2]


@pytest.mark.parametrize("thickness", [1, 2, 3])
def test_facing_a_wall_never_pays_for_what_is_behind_it(thickness: int) -> None:
    """The other side is metres closer to what is unknown; the way there leads round the wall."""
    world = room((30, 60))
    world[1:24, 30 : 30 + thickness] = 0.993
    world[1:12, 30 + thickness : 45] = 0.5
    belief = fields(world, (2.0, 0.5, 0.0))
    robot = DifferentialDrive(radius=0.2)
    cost = GuidanceCost(turning=0.5)

    def price(x: float, yaw: float) -> float:
        state = State(robot.at_pose(x, 1.0, yaw), robot)
        return float(cost.stage(state, jnp.zeros(2), jnp.zeros(()), belief))

    assert float(belief.guidance(jnp.asarray([3.6, 1.0]))) < price(2.75, math.pi / 2) - 1.0
    for x in (2.6, 2.7, 2.75, 2.8):
        assert price(x, 0.0) > price(x, math.pi / 2)


def test_in_an_alcove_turning_round_pays_at_every_heading() -> None:
    world = np.full((40, 60), 0.993, np.float32)
    world[2:38, 2:30] = 0.001
    world[14:22, 30:45] = 0.001  # 0.8 m wide, a dead end
    world[2:38, 2:8] = 0.5
    belief = fields(world, (4.0, 1.8, 0.0))
    robot = DifferentialDrive()

    def price(yaw: float) -> float:
        state = State(robot.at_pose(4.0, 1.8, yaw), robot)
        return float(GuidanceCost().stage(state, jnp.zeros(2), jnp.zeros(()), belief))

    prices = [price(yaw) for yaw in np.linspace(0.1, 3.0, 12).tolist()]
    assert (np.diff(prices) < 0).all()


def test_a_place_watched_in_vain_loses_its_pull_and_regains_it() -> None:
    world = room()
    world[14:16, 50:] = 0.5
    world[14:16, 2:4] = 0.5
    near = (5.0, 1.5, 0.0)
    fresh = fields(world, near)
    tired = fields(world, near, times=150)
    ahead, behind = jnp.asarray([4.6, 1.5]), jnp.asarray([3.4, 1.5])
    assert float(fresh.guidance(ahead)) < float(fresh.guidance(behind))
    assert float(tired.guidance(ahead)) > float(tired.guidance(behind))
    assert float(tired.dwell.max()) == pytest.approx(60 * (1 - math.exp(-0.5)), rel=0.05)
    forgetful = eqx.tree_at(lambda p: p.memory, PERCEPTION, jnp.asarray(1.0))
    assert float(fields(world, near, forgetful, times=150).dwell.max()) < 1.5


def test_little_information_comes_last_however_near() -> None:
    world = room()
    world[14, 14] = 0.5  # one cell in front of the robot
    world[:, 52:] = 0.5  # a frontier far away
    belief = fields(world, (2.0, 1.5, 0.0))
    left, right = (float(belief.guidance(jnp.asarray([x, 1.5]))) for x in (1.8, 2.6))
    assert right < left
    eager = eqx.tree_at(lambda p: p.min_information, PERCEPTION, jnp.asarray(1e-3))
    belief = fields(world, (2.0, 1.5, 0.0), eager)
    assert float(belief.guidance.values.min()) < 900.0


def test_when_everything_is_known_guidance_is_flat() -> None:
    belief = fields(room(), (2.0, 1.5, 0.0))
    np.testing.assert_array_equal(belief.guidance.values, 0.0)


def test_observe_updates_map_and_clearance_but_not_the_fields() -> None:
    world, pose = OccupancyGrid(room(), 0.1), jnp.asarray([3.0, 1.5, 0.0])
    before = PERCEPTION.init(OccupancyGrid.unknown((30, 60), world.frame), pose)
    after = observe(PERCEPTION, before, LIDAR.scan(world, pose, key=jax.random.key(0)), pose)
    assert float(after.clearance(pose[:2])) > float(before.clearance(pose[:2]))
    np.testing.assert_array_equal(after.guidance.values, before.guidance.values)
    np.testing.assert_array_equal(after.information.total, before.information.total)


def test_numbers_are_leaves_and_do_not_recompile() -> None:
    update_fields(PERCEPTION, fields(room(), (2.0, 1.5, 0.0)), jnp.zeros(3), jnp.asarray(0.2))
    before = update_fields._cached._cache_size()
    for perception in (
        Perception(LIDAR, 0.1, 0.2, num_directions=16, decay_length=1.0, patience=9.0),
        Perception(LIDAR, 0.1, 0.25, num_directions=16, margin=0.05, memory=5.0),
        Perception(LIDAR, 0.1, 0.2, num_directions=16, sensor_model=InverseSensorModel(0.85, -0.4)),
    ):
        fields(room(), (2.0, 1.5, 0.0), perception)
    assert update_fields._cached._cache_size() == before


@pytest.mark.parametrize(
    ("argument", "value"),
    [
        ("robot_radius", 0.0),
        ("num_directions", 3),
        ("node_spacing", 0.0),
        ("max_clearance", -1.0),
        ("margin", -0.1),
        ("decay_length", 0.0),
        ("min_information", math.nan),
        ("patience", 0.0),
        ("memory", -2.0),
    ],
)
def test_bad_input_is_named(argument: str, value: float) -> None:
    arguments = {"lidar": LIDAR, "resolution": 0.1, "robot_radius": 0.2, argument: value}
    with pytest.raises(ValueError, match=f"{argument} is .*accepted"):
        Perception(**arguments)
