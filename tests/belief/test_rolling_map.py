"""A map whose window moves, against the map of the whole volume."""

import re

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import jaxplore as jx
from jaxplore.belief.rolling_map import BLOCK, RollingMap, centre_window, shift_array, window_shape
from jaxplore.belief.volume import VolumePerception
from jaxplore.maps.voxel_grid import VoxelGrid
from jaxplore.sensing.inverse_sensor_model import InverseSensorModel
from jaxplore.sensing.volume import DepthCamera
from jaxplore.simulation.loop import copy_tree, initial_loop_state, run_chunk

pytestmark = pytest.mark.long

SIDE, RANGE = 0.2, 2.0
CAMERA = DepthCamera(24, 18, max_range=RANGE, quadratic_noise=0.0)
PARTS = {"max_clearance": 0.8, "min_information": 0.03}
WHOLE = VolumePerception([CAMERA], SIDE, 0.3, **PARTS)
MOVING = VolumePerception([CAMERA], SIDE, 0.3, window=(13.0, 9.6, 2.4), **PARTS)


def hall() -> np.ndarray:
    """Return a long hall with walls across it that have doors, in a block of stone."""
    solid = np.zeros((12, 48, 171), bool)
    solid[[0, -1]] = solid[:, 0] = solid[:, 24:] = solid[:, :, [0, -1]] = True
    for n, x in enumerate(range(15, 160, 17)):
        solid[:, :, x] = True
        solid[:, 4 + 3 * (n % 4) : 10 + 3 * (n % 4), x] = False
    return solid


WORLD = VoxelGrid.solid(hall(), SIDE, (-3.0, 1.0, 0.5))
BLANK = VoxelGrid(np.zeros_like(WORLD.log_odds), SIDE, (-3.0, 1.0, 0.5))


def step(perception: VolumePerception):
    """Return a function that scans, updates, stores and renews the fields."""

    @jax.jit
    def look(belief, at, heading):
        cos, sin = jnp.cos(heading), jnp.sin(heading)
        zero, one = jnp.zeros(()), jnp.ones(())
        turn = jnp.stack(
            [
                jnp.stack([cos, -sin, zero]),
                jnp.stack([sin, cos, zero]),
                jnp.stack([zero, zero, one]),
            ]
        )
        scan = CAMERA.scan(WORLD, at, turn, key=jax.random.key(0))
        belief = perception.update(belief, at, turn, [scan]).store_window()
        return perception.update_fields(belief, at, heading, jnp.asarray(0.1))

    return look


@pytest.fixture(scope="module")
def beliefs():
    """Return beliefs along a flight to the far end and half of the way back: that of the whole
    volume, and that whose window moves."""
    start = jnp.asarray([-1.0, 3.5, 1.7])
    looks = [step(each) for each in (WHOLE, MOVING)]
    now = [eqx.filter_jit(each.init)(BLANK, start) for each in (WHOLE, MOVING)]
    after = []
    for x, heading in [(n, 0.3) for n in np.arange(-1.0, 29.0, 0.7)] + [
        (n, 2.9) for n in np.arange(29.0, 12.0, -0.7)
    ]:
        at = jnp.asarray([x, 3.5, 1.7], jnp.float32)
        now = [f(b, at, jnp.asarray(heading)) for f, b in zip(looks, now, strict=True)]
        after.append(now)
    return after


def test_the_window_moves_and_the_map_of_the_whole_is_the_same(beliefs) -> None:
    offsets = np.array([each.beyond.offset for _, each in beliefs])
    assert len({tuple(each) for each in offsets}) > 4
    # It goes with the robot, there and back.
    assert offsets[:, 2].max() > offsets[-1, 2] > offsets[0, 2]
    whole, moving = beliefs[-1]
    assert moving.grid.shape[2] < whole.grid.shape[2]
    # What was stored is rounded to levels.
    np.testing.assert_allclose(
        moving.whole.log_odds, whole.grid.log_odds, atol=4.0 * float(moving.beyond.unit)
    )
    states = [np.sign(np.asarray(each.log_odds)) for each in (moving.whole, whole.grid)]
    np.testing.assert_array_equal(*states)


def test_what_follows_from_the_map_is_the_same_inside_the_window(beliefs) -> None:
    for index in (10, 27, 44, 61):
        whole, moving = beliefs[index]
        begin = int(moving.beyond.offset[2])
        # Away from the inner faces, beyond which all is closed.
        reach = MOVING.reach
        inside = slice(reach, moving.grid.shape[2] - reach)
        there = slice(begin + reach, begin + moving.grid.shape[2] - reach)
        np.testing.assert_allclose(
            moving.clearance.values[:, :, inside], whole.clearance.values[:, :, there], atol=1e-6
        )
        nodes, far = moving.sectors.shape[-1], MOVING.table.reach // 2 + 1
        first = begin // 2
        np.testing.assert_allclose(
            moving.sectors[..., far : nodes - far],
            whole.sectors[..., first + far : first + nodes - far],
            atol=2e-3,
        )
        if index < 40:
            # On the way there. What leaves the window is forgotten, and has its time from 0 again.
            np.testing.assert_allclose(
                moving.dwell[..., far : nodes - far],
                whole.dwell[..., first + far : first + nodes - far],
                atol=1e-5,
            )
        origin = np.asarray(WORLD.origin) + np.array([begin * SIDE, 0.0, 0.0])
        np.testing.assert_allclose(moving.grid.origin, origin, atol=1e-5)


def test_what_was_left_outside_is_a_goal_at_the_face_towards_it(beliefs) -> None:
    _, moving = beliefs[-1]
    beyond = moving.beyond
    assert (np.asarray(beyond.left) >= MOVING.min_information).any()
    # In the stone nothing is known, and nobody can look: it is not worth coming back for.
    stone = np.asarray(beyond.left)[:, 2]
    assert np.asarray(moving.sectors).sum(axis=0)[:, 2 * BLOCK :].max() > MOVING.min_information
    assert (stone == 0.0).all()
    # Of two blocks, the nearer one counts unless the other one has much more information.
    left = jnp.zeros_like(beyond.left).at[0, 0, 0].set(1.0)
    alone = eqx.tree_at(lambda each: each.left, beyond, left)
    block = 16
    rest = alone.toward_the_rest(moving.grid, block, jnp.asarray(8.0), jnp.asarray(0.03))
    here = np.asarray([15.0, 3.5, 1.7])
    centre = np.asarray(WORLD.origin) + 0.5 * block * SIDE
    value = float(rest(jnp.asarray(here)))
    # Between the blocks' centres the lattice has 26 directions.
    straight = np.linalg.norm(here - centre)
    assert straight - 0.5 * block * SIDE <= value <= 1.09 * straight + block * SIDE
    more = eqx.tree_at(lambda each: each.left, beyond, 2.0 * left)
    doubled = more.toward_the_rest(moving.grid, block, jnp.asarray(8.0), jnp.asarray(0.03))
    assert float(doubled(jnp.asarray(here))) == pytest.approx(value - 8.0 * np.log(2.0), abs=1e-3)
    none = eqx.tree_at(lambda each: each.left, beyond, jnp.zeros_like(left))
    nothing = none.toward_the_rest(moving.grid, block, jnp.asarray(8.0), jnp.asarray(0.03))
    assert float(nothing(jnp.asarray(here))) > 5e3


@given(st.integers(0, 2**31), st.tuples(*[st.integers(-6, 6)] * 3))
def test_shifts_are_those_of_numpy(seed: int, shift: tuple[int, int, int]) -> None:
    values = np.random.default_rng(seed).random((2, 3, 4, 5)).astype(np.float32)
    wanted = np.zeros_like(values)
    for index in np.ndindex(3, 4, 5):
        source = np.add(index, shift)
        if (source >= 0).all() and (source < (3, 4, 5)).all():
            wanted[(slice(None), *index)] = values[(slice(None), *source)]
    np.testing.assert_array_equal(moved(values, jnp.asarray(shift, jnp.int32)), wanted)


moved = jax.jit(shift_array)


@given(st.floats(-5.0, 100.0), st.integers(20, 90), st.integers(1, 9))
def test_a_window_lies_in_the_volume_and_begins_with_a_whole_block(
    here: float, most: int, block: int
) -> None:
    whole = (most, most + 3, 10)
    shape = window_shape(whole, (1.0, 1.5, 2.0), 0.1, block)
    assert shape[2] == 10
    assert all(size >= wanted for size, wanted in zip(shape, (20, 15, 10), strict=True))
    first = np.asarray(
        centre_window(jnp.asarray([here, here, here], jnp.float32), shape, whole, block)
    )
    assert (first % block == 0).all()
    assert (first >= 0).all()
    assert (first + shape <= whole).all()
    # The place lies in the window if it lies in the volume.
    if 0 <= here < most and min(shape[:2]) > 2 * block:
        assert ((first[:2] <= here) & (here < first[:2] + shape[:2])).all()


def test_a_place_that_is_not_finite_moves_no_window() -> None:
    grid = VoxelGrid(np.zeros((4, 8, 40)), 0.5)
    rolling, window = RollingMap.around(
        grid, jnp.asarray([10.0, 2.0, 1.0]), (4, 8, 24), 4, InverseSensorModel()
    )
    for place in ([np.nan, 2.0, 1.0], [19.9, np.nan, 1.0]):
        due, _ = rolling.next_offset(window, jnp.asarray(place), 2.0, 4)
        assert not bool(due)
    due, _ = rolling.next_offset(window, jnp.asarray([19.9, 2.0, 1.0]), 2.0, 4)
    assert bool(due)


def test_an_explorer_comes_back_for_what_left_its_window() -> None:
    # It begins in the middle: whichever side it takes, the other one leaves the window.
    robot = jx.Quadrotor()
    solid = hall()[:, :25, :121]
    solid[:, :, -1] = True
    perception = VolumePerception(
        [CAMERA], SIDE, robot.radius, window=(13.0, 5.0, 2.4), min_information=0.03
    )
    scenario = jx.VolumeScenario(
        VoxelGrid.solid(solid, SIDE),
        robot,
        CAMERA,
        (12.2, 2.4, 1.2, 0.0),
        perception=perception,
        target_coverage=0.8,
    )
    run = jx.simulate(
        jx.volume_explorer(robot, horizon=15, num_samples=64),
        scenario,
        1200,
        key=jax.random.key(1),
        num_trajectories=0,
    )
    assert run.metrics.coverage >= 0.8
    assert run.metrics.collisions == 0
    x = np.asarray(run.recording.records.state)[:, 0]
    assert x.min() < 12.2 - 7.0
    assert x.max() > 12.2 + 7.0


def test_a_step_copies_no_map() -> None:
    # A branch whose condition is seldom true must not copy what it may change: on a large map that
    # takes longer than the step.
    robot = jx.Quadrotor()
    scenario = jx.VolumeScenario(
        WORLD,
        robot,
        CAMERA,
        (-1.0, 3.5, 1.7, 0.0),
        perception=VolumePerception([CAMERA], SIDE, 0.3),
    )
    controller = jx.volume_explorer(robot, horizon=2, num_samples=4)
    key = jax.random.key(0)
    state = copy_tree(initial_loop_state(controller, scenario, key))
    given = controller, scenario, key, jnp.asarray(1, jnp.int32)
    text = run_chunk.lower(given, state, 1).compile().compiled.as_text()
    shape = ",".join(map(str, WORLD.shape))
    assert f"f32[{shape}]" in text
    assert not re.findall(rf"f32\[{shape}\]\S* copy\(", text)


def test_windows_that_are_too_small_are_refused() -> None:
    with pytest.raises(ValueError, match=r"window is \[0.0, 1.0, 1.0\]; accepted: three lengths"):
        VolumePerception([CAMERA], SIDE, 0.3, window=(0.0, 1.0, 1.0))
    small = VolumePerception([CAMERA], SIDE, 0.3, window=(8.0, 9.6, 2.4))
    with pytest.raises(
        ValueError, match=r"window is \[8.0, 9.6, 2.4\] for a volume of .* accepted"
    ):
        jx.VolumeScenario(WORLD, jx.Quadrotor(), CAMERA, (-1.0, 3.5, 1.7, 0.0), perception=small)
