"""The belief of a volume: distances, guidance and information of what was seen."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt
from scipy.spatial.transform import Rotation

from jaxplore.belief.coarse_voxels import coarse_room, coarse_states
from jaxplore.belief.view_field import ViewField
from jaxplore.belief.volume import VolumePerception
from jaxplore.belief.volume_roads import FAR
from jaxplore.maps.volume_clearance import update_clearance
from jaxplore.maps.voxel_grid import VoxelGrid
from jaxplore.maps.window import Window
from jaxplore.sensing.volume import DepthCamera, RingLidar

pytestmark = pytest.mark.long

SIDE, SIZE = 0.2, (8.0, 5.0, 2.4)
LIDAR = RingLidar(20, 144, max_range=3.0, lowest=-0.6, highest=0.6, range_noise=0.0)
AROUND = VolumePerception([LIDAR], SIDE, 0.3, max_clearance=1.0, min_information=0.03)
AT = jnp.asarray([1.5, 2.5, 1.2])


def room() -> np.ndarray:
    """Return a room with a wall across it that has a door."""
    solid = np.zeros((12, 25, 40), bool)
    solid[[0, -1]] = solid[:, [0, -1]] = solid[:, :, [0, -1]] = True
    solid[:, :, 20] = True
    solid[:9, 10:16, 20] = False
    return solid


@pytest.fixture(scope="module")
def seen():
    """Return the belief after one scan, with its fields."""
    world, blank = VoxelGrid.solid(room(), SIDE), VoxelGrid.unknown(SIZE, SIDE)

    @jax.jit
    def look():
        belief = AROUND.init(blank, AT)
        scan = LIDAR.scan(world, AT, jnp.eye(3), key=jax.random.key(0))
        belief = AROUND.update(belief, AT, jnp.eye(3), [scan])
        return AROUND.update_fields(belief, AT, jnp.asarray(0.0), jnp.asarray(0.1))

    return look()


def test_before_the_first_scan_only_the_robot_s_own_place_is_free() -> None:
    belief = AROUND.init(VoxelGrid.unknown(SIZE, SIDE), AT)
    free = np.argwhere(np.asarray(belief.grid.is_free))[:, ::-1]
    distance = np.linalg.norm((free + 0.5) * SIDE - np.asarray(AT), axis=1)
    assert len(free) > 8
    assert distance.max() <= 0.3 + 0.1 + 2.0 * SIDE + 1e-6
    assert float(belief.clearance(AT)) > 0.3


def test_the_clearance_is_the_distance_to_what_is_not_known_to_be_free(seen) -> None:
    closed = np.pad(~np.asarray(seen.grid.is_free), 1, constant_values=True)
    wanted = (distance_transform_edt(~closed)[1:-1, 1:-1, 1:-1] - 0.5) * SIDE
    reach = (AROUND.reach + 0.5) * SIDE
    found = np.asarray(seen.clearance.values)
    np.testing.assert_allclose(
        np.minimum(found, reach - SIDE), np.clip(wanted, 0.0, reach - SIDE), atol=1e-5
    )


def test_the_box_around_the_robot_moves_over_a_map_that_is_larger() -> None:
    # A short sight: the box is smaller than the map, and what it leaves behind stays.
    short = RingLidar(12, 72, max_range=1.0, lowest=-0.6, highest=0.6, range_noise=0.0)
    near = VolumePerception([short], SIDE, 0.3, max_clearance=0.6, min_information=0.03)
    assert near.extent + 4 * near.reach + 4 < 40
    world = VoxelGrid.solid(room(), SIDE)
    update = jax.jit(
        lambda belief, at: near.update(
            belief, at, jnp.eye(3), [short.scan(world, at, jnp.eye(3), key=jax.random.key(0))]
        )
    )
    belief = near.init(VoxelGrid.unknown(SIZE, SIDE), AT)
    for x in (1.5, 2.1, 2.7, 3.3):
        belief = update(belief, jnp.asarray([x, 2.5, 1.2]))
    closed = np.pad(~np.asarray(belief.grid.is_free), 1, constant_values=True)
    wanted = (distance_transform_edt(~closed)[1:-1, 1:-1, 1:-1] - 0.5) * SIDE
    most = (near.reach - 0.5) * SIDE
    found = np.minimum(np.asarray(belief.clearance.values), most)
    np.testing.assert_allclose(found, np.clip(wanted, 0.0, most), atol=1e-5)


def test_guidance_leads_to_what_is_not_known(seen) -> None:
    values, field = np.asarray(seen.guidance.values), seen.guidance
    known = values < FAR / 2
    assert known.any()
    # The wall hides the other half: the cost falls towards the door.
    left, right = (float(field(AT.at[0].set(x))) for x in (1.5, 3.3))
    assert right < left < FAR / 2
    assert float(field(AT.at[0].set(math.nan))) == pytest.approx(FAR)


def test_information_is_behind_the_door_and_fades_with_the_time_spent(seen) -> None:
    door, wall = (
        float(seen.information(jnp.asarray([3.5, 2.6, AT[2]]), jnp.asarray(yaw)))
        for yaw in (0.0, math.pi)
    )
    # The lidar looks around: both headings see the same.
    assert door == pytest.approx(wall, rel=1e-3)
    assert door > 0.06
    again = eqx.filter_jit(AROUND.update_fields)
    waited = again(seen, AT, jnp.asarray(0.0), jnp.asarray(4.0))
    before, after = (float(each.information(AT, jnp.zeros(()))) for each in (seen, waited))
    assert after < 0.7 * before
    # Elsewhere nothing fades.
    far = (jnp.asarray([5.0, 2.6, AT[2]]), jnp.zeros(()))
    assert float(seen.information(*far)) > 0.06
    assert float(waited.information(*far)) == pytest.approx(float(seen.information(*far)), rel=1e-5)


def test_a_camera_sees_what_is_in_its_view_only() -> None:
    camera = DepthCamera(8, 6, max_range=3.0)
    perception = VolumePerception([camera], SIDE, 0.3)
    share = np.asarray(perception.in_view)
    # 80 of 360 degrees, for each of 16 headings.
    np.testing.assert_allclose(share.sum(axis=1), 16 * 80 / 360, rtol=1e-3)
    np.testing.assert_allclose(share[0, [0, -1]], 1.0)
    assert share[0, 8] == 0.0
    np.testing.assert_array_equal(share[1], np.roll(share[0], 1))


def test_headings_between_two_are_interpolated() -> None:
    values = jnp.arange(4.0)[:, None, None, None] * jnp.ones((4, 2, 2, 2))
    field = ViewField(values, jnp.zeros(3), 1.0)
    here = jnp.full(3, 0.5)
    quarter = math.pi / 2.0
    for heading, wanted in (
        (0.0, 0.0),
        (quarter, 1.0),
        (1.5 * quarter, 1.5),
        (-0.5 * quarter, 1.5),
    ):
        assert float(field(here, jnp.asarray(heading))) == pytest.approx(wanted, abs=1e-5)


def test_bad_parts_are_refused() -> None:
    with pytest.raises(ValueError, match="sensors is empty; accepted: one sensor or more"):
        VolumePerception([], 0.1, 0.3)


def test_what_is_renewed_by_windows_is_what_the_whole_map_gives() -> None:
    # Sides that are no multiples of a coarser voxel, a window smaller than the map, a body that
    # tilts, and a jump that no window covers.
    rng = np.random.default_rng(3)
    solid = rng.random((9, 61, 83)) < 0.01
    camera = DepthCamera(24, 18, max_range=1.2, quadratic_noise=0.0)
    parts = [camera, RingLidar(4, 24, max_range=0.8, range_noise=0.0)]
    perception = VolumePerception(parts, 0.1, 0.15, max_clearance=0.3, min_information=1e-4)
    assert perception.pool == 2
    world = VoxelGrid.solid(solid, 0.1)
    blank = VoxelGrid(np.zeros_like(world.log_odds), 0.1)

    @jax.jit
    def look(belief, at, turn):
        keys = jax.random.split(jax.random.key(0))
        scans = [s.scan(world, at, turn, key=k) for s, k in zip(parts, keys, strict=True)]
        return perception.update(belief, at, turn, scans)

    fields = jax.jit(
        lambda belief, at: perception.update_fields(belief, at, jnp.asarray(0.3), jnp.asarray(0.1))
    )
    places = [(1.0, 1.0), (1.4, 1.3), (7.4, 5.5), (8.2, 0.1), (4.0, 3.0), (4.3, 3.1)]
    belief = perception.init(blank, jnp.asarray([1.0, 1.0, 0.45]))
    for index, (x, y) in enumerate(places):
        at = jnp.asarray([x, y, 0.45])
        turn = Rotation.from_euler("zyx", [1.1 * index, 0.3, -0.2]).as_matrix()
        belief = look(belief, at, jnp.asarray(turn, jnp.float32))
        if index % 3 != 1:
            belief = fields(belief, at)
    everything = Window.at(jnp.zeros(3, jnp.int32), solid.shape, solid.shape)
    clearance = update_clearance(belief.grid, jnp.zeros(solid.shape), everything, perception.reach)
    coarse = coarse_states(belief.grid, perception.pool)
    whole = eqx.tree_at(
        lambda each: (each.coarse, each.changed, each.sectors),
        belief,
        (coarse, jnp.ones_like(belief.changed), jnp.zeros_like(belief.sectors)),
    )
    np.testing.assert_array_equal(belief.coarse, coarse)
    np.testing.assert_allclose(belief.clearance.values, clearance, atol=1e-6)
    np.testing.assert_array_equal(
        belief.room, coarse_room(belief.clearance.values, perception.pool)
    )
    np.testing.assert_allclose(belief.sectors, fields(whole, at).sectors, atol=1e-6)
    assert (np.asarray(belief.sectors) > 1e-3).mean() > 0.2
    # The windows are smaller than the map, or this would show nothing.
    assert perception.extent + 4 * perception.reach + 6 < 61
