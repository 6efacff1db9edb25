import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore import (
    Camera,
    DifferentialDrive,
    GuidanceCost,
    InverseSensorModel,
    Lidar,
    OccupancyGrid,
    Perception,
    State,
)
from jaxplore.belief.dwell import add_dwell, with_given_up
from jaxplore.maps import Ground
from jaxplore.maps.frame import GridFrame
from jaxplore.parts import IdlenessMap

pytestmark = pytest.mark.long

LIDAR = Lidar(num_beams=72, max_range=1.5, range_noise=0.0)
PERCEPTION = Perception(LIDAR, 0.1, 0.2, num_directions=16)
# Of a type that is said, as all numbers here: another one would be another program.
NOWHERE = jnp.full(3, jnp.nan, jnp.float32)
init = eqx.filter_jit(lambda perception, *arguments: perception.init(*arguments))
observe = eqx.filter_jit(lambda perception, *arguments: perception.observe(*arguments))
update_fields = eqx.filter_jit(lambda perception, *arguments: perception.update_fields(*arguments))
with_map = eqx.filter_jit(lambda perception, *arguments: perception.with_map(*arguments))


@eqx.filter_jit
def scan(sensor, world: OccupancyGrid, pose: jax.Array, ground=None):
    return sensor.scan(world, pose, key=jax.random.key(0), ground=ground)


@eqx.filter_jit
def mapped(sensor, *arguments) -> OccupancyGrid:
    return sensor.update(*arguments)


@eqx.filter_jit
def price_at(cost, robot, poses: jax.Array, belief) -> jax.Array:
    """Return what a robot that rests at each of some poses (N, 3) pays for a step."""

    def one(pose):
        state = State(jnp.concatenate([pose, jnp.zeros(2)]), robot)
        return cost.stage(state, jnp.zeros(2), jnp.zeros(()), belief)

    return jax.vmap(one)(poses)


def room(size: tuple[int, int] = (30, 60)) -> np.ndarray:
    world = np.full(size, 1 / (1 + math.exp(7)), np.float32)
    world[0], world[-1], world[:, 0], world[:, -1] = 0.993, 0.993, 0.993, 0.993
    return world


def fields(world: np.ndarray, pose: tuple[float, float, float], perception=PERCEPTION, times=1):
    belief = init(perception, OccupancyGrid(world, 0.1), jnp.asarray(pose))
    for _ in range(times):
        belief = update_fields(perception, belief, jnp.asarray(pose), jnp.asarray(0.2))
    return belief


def test_at_first_only_the_robot_s_own_place_is_known() -> None:
    frame = OccupancyGrid(room(), 0.1).frame
    belief = init(PERCEPTION, OccupancyGrid.unknown((30, 60), frame), jnp.asarray([3.0, 1.5, 0.0]))
    free = np.argwhere(np.asarray(belief.grid.is_free)) * 0.1 + 0.05
    assert 0 < len(free) < 60
    assert np.hypot(free[:, 0] - 1.5, free[:, 1] - 3.0).max() < 0.45
    assert float(belief.clearance(jnp.asarray([3.0, 1.5]))) >= 0.2


def test_what_is_known_beforehand_stays() -> None:
    belief = init(PERCEPTION, OccupancyGrid(room(), 0.1), jnp.asarray([3.0, 1.5, 0.0]))
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

    places = [(x, 1.0, yaw) for yaw in (0.0, math.pi / 2) for x in (2.6, 2.7, 2.75, 2.8)]
    towards, along = np.split(np.asarray(price_at(cost, robot, jnp.asarray(places), belief)), 2)
    assert float(belief.guidance(jnp.asarray([3.6, 1.0]))) < along[2] - 1.0
    assert (towards > along).all()


def test_in_an_alcove_turning_round_pays_at_every_heading() -> None:
    world = np.full((30, 60), 0.993, np.float32)
    world[2:28, 2:30] = 0.001
    world[11:19, 30:45] = 0.001  # 0.8 m wide, a dead end
    world[2:28, 2:8] = 0.5
    belief = fields(world, (4.0, 1.5, 0.0))
    poses = jnp.asarray([(4.0, 1.5, yaw) for yaw in np.linspace(0.1, 3.0, 8)], jnp.float32)
    prices = price_at(GuidanceCost(), DifferentialDrive(), poses, belief)
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
    forgetful = eqx.tree_at(lambda p: p.memory, PERCEPTION, jnp.float32(1.0))
    assert float(fields(world, near, forgetful, times=150).dwell.max()) < 1.5


@pytest.mark.parametrize(
    ("is_localising", "quiet"), [(False, 90.0), (True, 90.0), (True, 30.0), (True, None)]
)
def test_a_robot_that_localises_gives_up_looks_when_it_sees_nothing_new(
    is_localising: bool, quiet: float | None
) -> None:
    """From one place a wall looks thick, from the next one as if there were something behind it."""
    numbers = {"num_directions": 16, "min_information": 5.0}
    perception = Perception(LIDAR, 0.1, 0.2, **numbers, is_localising=is_localising)
    thick, pose = room(), jnp.asarray([4.0, 1.5, 0.0])
    thick[5:25, 1:6] = 0.5  # farther away, and always there
    thin = thick.copy()
    thin[8:22, 50:59] = 0.5
    belief = init(perception, OccupancyGrid(thin, 0.1), pose)

    def leads_ahead(belief) -> bool:
        ahead, behind = (float(belief.guidance(jnp.asarray([x, 1.5]))) for x in (4.4, 3.6))
        return ahead < behind

    def after(belief, world: np.ndarray, elapsed: float):
        belief = with_map(perception, belief, OccupancyGrid(world, 0.1))
        return update_fields(perception, belief, pose, jnp.asarray(elapsed))

    def waited(belief, elapsed: float):
        return update_fields(perception, belief, NOWHERE, jnp.asarray(elapsed))

    assert leads_ahead(belief)
    # What it has seen by now is new; from then on nothing is, for so many seconds.
    belief = after(after(belief, thick, 0.2), thin, 0.2)
    assert leads_ahead(belief)
    if quiet is not None:
        belief = waited(belief, quiet)
    belief = after(after(belief, thick, 0.2), thin, 0.2)
    assert leads_ahead(belief) == (not is_localising or quiet != 90.0)
    # It comes back to it when it has been elsewhere for minutes.
    assert leads_ahead(waited(belief, 300.0))


@given(
    *[st.floats(0.0, 60.0, width=32)] * 2,
    st.floats(0.0, 9.0, width=32),
    st.floats(0.5, 40.0, width=32),
)
def test_a_place_is_given_up_where_looks_take_it_below_the_bound(
    before: float, now: float, dwell: float, least: float
) -> None:
    found = float(given_up(*(jnp.asarray(x, jnp.float32) for x in (dwell, before, now, least))))
    share = math.exp(-dwell / 3.0)
    # Where it is neither clearly above nor clearly below, rounding decides.
    if min(abs(before * share - least), abs(now * share - least)) > 1e-4 * least:
        falls = before * share >= least > now * share
        assert found == pytest.approx(dwell + 6.0 * falls, rel=1e-6)


@jax.jit
def given_up(dwell, before, now, least):
    return with_given_up(dwell, before, now, least, jnp.asarray(3.0))


def test_little_information_comes_last_however_near() -> None:
    world = room()
    world[14, 14] = 0.5  # one cell in front of the robot
    world[:, 52:] = 0.5  # a frontier far away
    belief = fields(world, (2.0, 1.5, 0.0))
    left, right = (float(belief.guidance(jnp.asarray([x, 1.5]))) for x in (1.8, 2.6))
    assert right < left
    eager = eqx.tree_at(lambda p: p.min_information, PERCEPTION, jnp.float32(1e-3))
    belief = fields(world, (2.0, 1.5, 0.0), eager)
    assert float(belief.guidance.values.min()) < 900.0


def test_a_dark_hall_is_worth_more_than_a_slit() -> None:
    """Beams that take what is not known for mostly free see how much of it there is."""
    world = room()
    world[1:15, 40:55] = 0.5  # 1.5 m deep
    world[15:29, 40:43] = 0.5  # 0.3 m deep
    world[15:29, 43] = 0.993
    even, free = (
        Perception(LIDAR, 0.1, 0.2, num_directions=16, occupancy_prior=prior)
        for prior in (0.5, 0.1)
    )
    ratios = []
    for perception in (even, free):
        total = fields(world, (1.0, 1.5, 0.0), perception).information.total
        ratios.append(float(total[3, 19] / total[10, 19]))
    assert 0.9 < ratios[0] < 1.2
    assert ratios[1] > 1.8


def test_the_prior_is_for_what_was_never_measured_and_for_information_alone() -> None:
    world = room()
    world[:, 40:50], world[5, 30] = 0.5, 0.7
    belief = fields(world, (1.0, 1.5, 0.0))
    expected = np.where(world == 0.5, np.float32(0.1), world)
    np.testing.assert_array_equal(belief.grid.probability, world)
    field = eqx.filter_jit(PERCEPTION.field_sensor.field)(
        OccupancyGrid(expected, 0.1), PERCEPTION.sensor_model
    )
    np.testing.assert_allclose(belief.information.total, field.total, rtol=1e-6)


def test_when_everything_is_known_guidance_is_flat() -> None:
    belief = fields(room(), (2.0, 1.5, 0.0))
    np.testing.assert_array_equal(belief.guidance.values, 0.0)


def test_observe_updates_map_and_clearance_but_not_the_fields() -> None:
    world, pose = OccupancyGrid(room(), 0.1), jnp.asarray([3.0, 1.5, 0.0])
    before = init(PERCEPTION, OccupancyGrid.unknown((30, 60), world.frame), pose)
    after = observe(PERCEPTION, before, scan(LIDAR, world, pose), pose)
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


@given(st.floats(2.5, 9.5), st.floats(-0.5, 9.5))
def test_dwell_is_the_time_within_half_a_metre(x: float, y: float) -> None:
    before = np.linspace(0.0, 9.0, 60 * 90, dtype=np.float32).reshape(60, 90)
    pose = jnp.asarray([x, y, 0.3], jnp.float32)
    found = stayed(before, pose)
    rows, columns = np.mgrid[:60, :90]
    # The nodes are 0.1 m apart, in a lattice that is turned by a quarter.
    nodes = np.stack([9.0 - 0.1 * (rows + 0.5), 0.1 * (columns + 0.5)], axis=-1)
    away = np.linalg.norm(nodes - np.asarray(pose, float)[:2], axis=-1)
    expected = before * math.exp(-0.2 / 60.0) + 0.2 * np.exp(-0.5 * (away / 0.5) ** 2)
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-5)


@jax.jit
def stayed(before, pose):
    frame = GridFrame(0.1, (9.0, 0.0, math.pi / 2))
    return add_dwell(before, frame, pose, jnp.asarray(0.2), jnp.asarray(60.0))


def test_a_place_with_little_to_see_has_the_same_area_for_all_cells() -> None:
    least = {cell: float(Perception(LIDAR, cell, 0.3).min_information) for cell in (0.05, 0.1, 0.2)}
    assert least == pytest.approx({0.05: 40.0, 0.1: 10.0, 0.2: 2.5})


GOAL = np.array([5.0, 1.5])
HOMING = Perception(LIDAR, 0.1, 0.2, num_directions=16, goal=GOAL, max_unknown=0.05)


def beginning(world: np.ndarray, pose: tuple[float, float, float], perception=HOMING):
    return init(perception, OccupancyGrid(world, 0.1), jnp.asarray(pose))


@eqx.filter_jit
def read(guidance, points: jax.Array) -> jax.Array:
    """Return the way to go (x, y) and the cost to go at places."""
    return jax.vmap(lambda place: jnp.append(guidance.direction(place), guidance(place)))(points)


def at_places(belief, *places: tuple[float, float]) -> np.ndarray:
    """Return (direction x, direction y, cost) at each; always as many, to compile once."""
    padded = np.zeros((24, 2), np.float32)
    padded[: len(places)] = places
    return np.asarray(read(belief.guidance, jnp.asarray(padded)))[: len(places)]


def along_x(belief, places: np.ndarray) -> np.ndarray:
    return at_places(belief, *((x, 1.5) for x in places))[:, 2]


def test_worthwhile_information_comes_before_the_goal() -> None:
    world, pose = room(), (3.5, 1.5, 0.0)
    world[:, :20] = 0.5
    belief = beginning(world, pose)
    assert not bool(belief.is_explored)
    assert at_places(belief, pose[:2])[0, 0] < -0.9
    # Uphill all the way to the goal, which is nearer than what is unknown.
    assert (np.diff(along_x(belief, np.arange(2.6, 5.1, 0.2))) > 0.0).all()
    # And no different from a robot that has no goal.
    aimless = beginning(world, pose, PERCEPTION)
    np.testing.assert_array_equal(belief.guidance.values, aimless.guidance.values)


def test_with_all_explored_guidance_falls_to_the_goal_and_ends_there() -> None:
    for start in ((0.6, 1.5, 0.0), (3.0, 0.7, 2.0)):
        belief = beginning(room(), start)
        assert bool(belief.is_explored)
    values = along_x(belief, np.arange(0.6, 4.9, 0.2))
    assert (np.diff(values) < 0.0).all()
    # A metre nearer is a metre less where there is room.
    assert values[0] - values[15] == pytest.approx(3.0, abs=0.1)
    assert (np.diff(along_x(belief, np.arange(5.2, 5.7, 0.1))) > 0.0).all()
    places = np.array([(1.0, 1.5), (4.0, 0.7), (5.6, 2.4)])
    ways, offsets = at_places(belief, *places)[:, :2], GOAL - places
    assert ((ways * offsets).sum(axis=1) > 0.7 * np.linalg.norm(offsets, axis=1)).all()


def test_the_way_to_the_goal_leads_round_walls() -> None:
    world = room()
    world[1:20, 30] = 0.993
    belief = beginning(world, (1.0, 0.5, 0.0))
    below, above, behind = at_places(belief, (2.5, 0.5), (2.5, 2.4), (3.6, 0.5))[:, 2]
    assert below > above + 1.0 > behind + 1.0


def test_a_goal_where_the_robot_does_not_fit_is_approached() -> None:
    corner = eqx.tree_at(lambda p: p.goal, HOMING, jnp.asarray([5.85, 2.85]))
    guidance = beginning(room(), (1.0, 1.5, 0.0), corner).guidance
    row, column = np.unravel_index(int(jnp.argmin(guidance.values)), guidance.values.shape)
    found = np.asarray(guidance.frame.cell_centre(jnp.asarray([row, column], jnp.int32)))
    assert np.hypot(*(found - (5.85, 2.85))) < 0.6


def test_the_map_counts_as_explored_right_below_the_share_given() -> None:
    world, pose = room(), (4.0, 1.5, 0.0)
    world[:, :12] = 0.5
    world[1:10, 40] = [0.14, 0.15, 0.2, 0.8, 0.85, 0.86, 0.14, 0.86, 0.14]  # four are unknown
    share = (12 * 30 + 4) / (30 * 60)
    for most, expected in ((share + 1e-4, True), (share - 1e-4, False)):
        perception = eqx.tree_at(lambda p: p.max_unknown, HOMING, jnp.float32(most))
        belief = beginning(world, pose, perception)
        assert bool(belief.is_explored) is expected
        # Then the goal alone counts, however much is unknown.
        assert (at_places(belief, (3.0, 2.0))[0, 0] > 0.0) == expected


def test_nothing_worthwhile_within_reach_is_explored_too() -> None:
    world = room()
    world[:, :20], world[:, 20] = 0.5, 0.993  # walled off
    sealed = beginning(world, (3.5, 1.5, 0.0))
    assert bool(sealed.is_explored)
    assert (np.diff(along_x(sealed, np.arange(2.6, 4.9, 0.2))) < 0.0).all()


def test_the_goal_comes_before_what_is_hardly_worth_it() -> None:
    world, pose = room(), (3.6, 1.5, 0.0)
    world[14, 14] = 0.5  # one cell
    never = eqx.tree_at(lambda p: p.max_unknown, HOMING, jnp.float32(0.0))
    belief = beginning(world, pose, never)
    worth = float(belief.information.total.max())
    assert 0.1 * 3.0 < worth < 3.0  # left for last, not given up
    assert bool(belief.is_explored)
    assert at_places(belief, pose[:2])[0, 0] > 0.5
    eager = eqx.tree_at(lambda p: p.min_information, never, jnp.float32(0.5 * worth))
    belief = beginning(world, pose, eager)
    assert not bool(belief.is_explored)
    assert at_places(belief, pose[:2])[0, 0] < -0.5


def test_without_a_goal_nothing_is_ever_explored() -> None:
    for world in (room(), np.full((30, 60), 0.5, np.float32)):
        assert not bool(beginning(world, (2.0, 1.5, 0.0), PERCEPTION).is_explored)
        assert not bool(fields(world, (2.0, 1.5, 0.0)).is_explored)


@pytest.fixture(scope="module")
def lost():
    """A belief with something to see, before and after an update without a known pose."""
    world = room()
    world[:, :20] = 0.5
    pose, nowhere = jnp.asarray([3.5, 1.5, 0.0]), NOWHERE
    before = beginning(world, (3.5, 1.5, 0.0))
    before = update_fields(HOMING, before, pose, jnp.asarray(0.2))
    return before, update_fields(HOMING, before, nowhere, jnp.asarray(0.2))


def test_a_pose_that_is_not_known_poisons_nothing(lost) -> None:
    before, after = lost
    for leaf in jax.tree.leaves(after):
        assert np.isfinite(leaf).all()
    assert float(before.dwell.max()) > 0.1
    decayed = np.asarray(before.dwell, np.float64) * math.exp(-0.2 / 60.0)
    np.testing.assert_allclose(after.dwell, decayed, rtol=1e-5)
    np.testing.assert_array_equal(after.information.total, before.information.total)


def test_a_robot_that_is_lost_has_not_explored(lost) -> None:
    before, after = lost
    assert not bool(before.is_explored)
    assert not bool(after.is_explored)


@pytest.mark.parametrize("goal", [(1.0,), (1.0, 2.0, 3.0)])
def test_a_bad_end_is_named(goal) -> None:
    with pytest.raises(ValueError, match=r"goal is .*accepted"):
        Perception(LIDAR, 0.1, 0.2, goal=goal)


# Several sensors, watch and ground

CAMERA = Camera(33, 2.5, math.radians(60.0), math.radians(90.0), height=0.4, tilt=0.0)
POSE = jnp.asarray([2.5, 1.5, 0.0])
FLAT = Ground(np.zeros((30, 60)), 0.1)


def two(watch: IdlenessMap | None = None, ground: Ground | None = FLAT) -> Perception:
    return Perception(
        [CAMERA, LIDAR],
        0.1,
        0.2,
        num_directions=8,
        node_spacing=0.2,
        parts=[] if watch is None else [watch],
        ground=ground,
    )


def unknown() -> OccupancyGrid:
    return OccupancyGrid.unknown((30, 60), OccupancyGrid(room(), 0.1).frame)


@pytest.fixture(scope="module")
def looked():
    """Return the belief before and after one look with both sensors, and what each measured."""
    perception, world = two(IdlenessMap(10.0)), OccupancyGrid(room(), 0.1)
    before = init(perception, unknown(), POSE)
    scans = tuple(scan(sensor, world, POSE, FLAT) for sensor in (CAMERA, LIDAR))
    return before, scans, observe(perception, before, scans, POSE, jnp.float32(0.25))


def test_both_sensors_make_the_map(looked) -> None:
    before, _, after = looked
    is_free = np.asarray(after.grid.is_free)
    rows, columns = np.mgrid[:30, :60]
    x, y = 0.1 * columns + 0.05 - 2.5, 0.1 * rows + 0.05 - 1.5
    away, bearing = np.hypot(x, y), np.abs(np.arctan2(y, x))
    inside = (rows > 0) & (rows < 29)
    # Within the lidar's 1.5 m all around; of what is farther only what the camera looks at.
    assert is_free[inside & (away < 1.0)].all()  # where a cell is wider than a beam
    ahead = inside & (bearing < math.radians(28.0)) & (away > 1.65) & (away < 2.35)
    assert ahead.sum() > 100
    assert is_free[ahead].all()
    np.testing.assert_array_equal(after.grid.probability[(away > 1.65) & (bearing > 0.6)], 0.5)
    assert float(after.clearance(POSE[:2])) > float(before.clearance(POSE[:2]))


def test_the_map_is_that_of_one_sensor_after_the_other(looked) -> None:
    before, scans, after = looked
    grid = before.grid
    for sensor, seen in zip((CAMERA, LIDAR), scans, strict=True):
        grid = mapped(sensor, grid, seen, POSE, InverseSensorModel(), FLAT)
    np.testing.assert_allclose(after.grid.probability, grid.probability, rtol=1e-6)


def test_only_the_first_sensor_keeps_watch(looked) -> None:
    before, _, after = looked
    assert np.isinf(before.parts["watch"]).all()
    idleness = np.asarray(after.parts["watch"])
    rows, columns = np.mgrid[:30, :60]
    x, y = 0.1 * columns + 0.05 - 2.5, 0.1 * rows + 0.05 - 1.5
    away, bearing = np.hypot(x, y), np.abs(np.arctan2(y, x))
    # The camera is 0.4 m high and looks 45 degrees down: it sees the ground from 0.4 m on.
    seen = (bearing < math.radians(28.0)) & (away > 0.6) & (away < 2.35)
    np.testing.assert_array_equal(idleness[seen], 0.0)
    aside = (bearing > 1.3) | ((bearing > 0.75) & (away > 0.5))
    assert np.isinf(idleness[aside | (away > 2.65) | (away < 0.3)]).all()


def test_what_is_not_seen_again_grows_older_by_the_time_given(looked) -> None:
    _, scans, after = looked
    perception = two(IdlenessMap(10.0))
    away = jnp.asarray([2.5, 1.5, math.pi])
    later = np.asarray(observe(perception, after, scans, away, jnp.float32(0.75)).parts["watch"])
    seen = np.asarray(after.parts["watch"]) == 0.0
    rows, columns = np.nonzero(seen & (np.mgrid[:30, :60][1] > 26))
    assert len(rows) > 100
    np.testing.assert_allclose(later[rows, columns], 0.75)


def test_what_a_look_is_worth_again_draws_the_robot() -> None:
    """All is known; one end was not seen for a long time, the rest just now."""
    perception, plain = two(IdlenessMap(10.0)), two()
    belief = init(perception, OccupancyGrid(room(), 0.1), POSE)
    idleness = jnp.zeros((30, 60)).at[:, 45:].set(100.0)
    for one, drawn in ((idleness, True), (idleness[:, ::-1], False)):
        belief = eqx.tree_at(lambda some: some.parts["watch"], belief, one)
        after = update_fields(perception, belief, POSE, jnp.asarray(0.2))
        left, right = (float(after.guidance(jnp.asarray([x, 1.5]))) for x in (2.0, 3.0))
        assert (right < left) == drawn
        assert float(after.information.total.max()) > 3.0
        np.testing.assert_array_equal(after.parts["watch"], one)
    calm = eqx.tree_at(lambda some: some.parts["watch"], belief, jnp.zeros((30, 60)))
    after = update_fields(perception, calm, POSE, jnp.asarray(0.2))
    alone = init(plain, OccupancyGrid(room(), 0.1), POSE)
    assert not alone.parts
    np.testing.assert_allclose(after.information.total, alone.information.total, atol=1e-5)


def test_ground_that_may_not_be_entered_is_closed() -> None:
    passable = np.ones((30, 60))
    passable[1:20, 20] = 0.2  # the way round is in the north
    ground = Ground(np.zeros((30, 60)), 0.1, traversability=passable, threshold=0.3)
    start = jnp.asarray([1.0, 0.5, 0.0])
    world = room()
    world[:, 48:] = 0.5  # too far to be seen across
    belief = init(two(None, ground), OccupancyGrid(world, 0.1), start)
    assert float(belief.clearance(jnp.asarray([2.05, 1.05]))) == 0.0
    assert float(belief.clearance(jnp.asarray([1.65, 1.05]))) == pytest.approx(0.35, abs=1e-4)
    below, above = (float(belief.guidance(jnp.asarray([1.5, y]))) for y in (0.5, 2.4))
    assert below > above + 1.0
    # Nothing is known to stand there.
    assert np.asarray(belief.grid.is_free)[1:20, 20].all()
    walled = world.copy()
    walled[1:20, 20] = 0.993
    expected = init(two(), OccupancyGrid(walled, 0.1), start)
    np.testing.assert_array_equal(belief.clearance.values, expected.clearance.values)
    level = init(two(), OccupancyGrid(world, 0.1), start)
    below, above = (float(level.guidance(jnp.asarray([1.5, y]))) for y in (0.5, 2.4))
    assert below < above + 0.5


# A goal apart

APART = Perception(LIDAR, 0.1, 0.2, num_directions=16, goal=GOAL, is_goal_apart=True)


def test_a_goal_apart_has_a_field_of_its_own_and_guidance_ignores_it() -> None:
    for world in (room(), np.full((30, 60), 0.5, np.float32)):
        belief, aimless = (beginning(world, (2.0, 1.5, 0.0), each) for each in (APART, PERCEPTION))
        assert aimless.to_goal is None
        np.testing.assert_array_equal(belief.guidance.values, aimless.guidance.values)
        np.testing.assert_array_equal(belief.guidance.descent, aimless.guidance.descent)
        costs = [float(belief.to_goal(jnp.asarray([x, 1.5]))) for x in np.arange(0.7, 4.9, 0.2)]
        assert (np.diff(costs) < 0.0).all()
    assert beginning(room(), (2.0, 1.5, 0.0), HOMING).to_goal is None


def test_the_way_to_a_goal_apart_is_kept_up_to_date() -> None:
    start, pose = (2.0, 1.5, 0.0), jnp.asarray([2.0, 1.5, 0.0])
    belief = beginning(np.full((30, 60), 0.5, np.float32), start, APART)
    world = room()
    world[1:20, 35] = 0.993
    before = float(belief.to_goal(pose[:2]))
    found = eqx.tree_at(lambda some: some.grid, belief, OccupancyGrid(world, 0.1))
    after = update_fields(APART, found, pose, jnp.asarray(0.2))
    # Through the unknown 3 m counted half as much again; now they are free, but for a wall.
    assert before == pytest.approx(4.5, abs=0.4)
    x, y = np.array([2.0, 3.5, 5.0]), np.array([1.5, 2.2, 1.5])
    around = np.hypot(np.diff(x), np.diff(y)).sum()
    assert around < float(after.to_goal(pose[:2])) < 2.0 * around
    # Beside the wall, where there is room, the way is up to its end.
    assert float(after.to_goal.direction(jnp.asarray([2.9, 1.5]))[1]) > 0.5
    assert float(belief.to_goal.direction(jnp.asarray([2.9, 1.5]))[1]) < 0.2


def test_a_goal_apart_counts_as_explored_by_what_is_unknown_alone() -> None:
    assert bool(beginning(room(), (2.0, 1.5, 0.0), APART).is_explored)
    world = room()
    world[:, :20], world[:, 20] = 0.5, 0.993  # walled off
    assert not bool(beginning(world, (3.5, 1.5, 0.0), APART).is_explored)


def test_a_goal_apart_must_be_given() -> None:
    with pytest.raises(ValueError, match="goal is None; accepted: a position, for a goal apart"):
        Perception(LIDAR, 0.1, 0.2, is_goal_apart=True)


def test_bad_sensors_are_named() -> None:
    with pytest.raises(ValueError, match="sensors is empty; accepted: a Sensor, or a list of them"):
        Perception((), 0.1, 0.2)


def test_as_many_scans_as_sensors(looked) -> None:
    before, scans, _ = looked
    with pytest.raises(ValueError, match=r"scans has \d scans; accepted: 2, one per sensor"):
        observe(two(IdlenessMap(10.0)), before, scans[:1], POSE, 0.25)
