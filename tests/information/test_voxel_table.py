"""Information in a volume against explicit rays in float64."""

import itertools
import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore.geometry.rays import direction_offsets, ray_offsets
from jaxplore.information.gain import IdealSensor, expected_gain
from jaxplore.information.voxel_table import VoxelTable, band
from jaxplore.sensing.inverse_sensor_model import InverseSensorModel

SHAPE = (9, 16, 20)
SECTORS, ELEVATIONS, EDGES, LENGTH = 6, 3, (-0.6, 0.5), 6.5
found_in = eqx.filter_jit(
    lambda table, volume, first, shape, sensor: table.information(volume, first, shape, sensor)
)


def explicit(volume: np.ndarray, gain: np.ndarray, start: np.ndarray, way: np.ndarray) -> float:
    """Return the information of a ray from a voxel's centre, per unit of solid angle."""
    crossings = [0.0]
    for axis in range(3):
        if abs(way[axis]) > 1e-12:
            planes = np.arange(-40, 40) + 0.5
            crossings += list(planes / way[axis])
    crossings = sorted(each for each in crossings if 0.0 <= each <= LENGTH)
    total, reached = 0.0, 1.0
    for enters, leaves in itertools.pairwise(crossings):
        voxel = tuple(np.floor(start + 0.5 + 0.5 * (enters + leaves) * way).astype(int))
        if any(not 0 <= v < n for v, n in zip(voxel, volume.shape, strict=True)):
            return total
        total += reached * gain[voxel] * (leaves**3 - enters**3) / 3.0
        reached *= 1.0 - volume[voxel]
    return total


@pytest.mark.parametrize("stride", [1, 2, 3])
@pytest.mark.parametrize("sensor", [IdealSensor(), InverseSensorModel()], ids=["ideal", "model"])
def test_each_viewpoint_has_the_information_of_its_rays(stride: int, sensor) -> None:
    rng = np.random.default_rng(stride)
    volume = rng.choice([0.02, 0.5, 0.98], SHAPE, p=[0.5, 0.4, 0.1]).astype(np.float32)
    table = VoxelTable(SECTORS, ELEVATIONS, *EDGES, LENGTH, stride)
    first, shape = (1, 2, 0), (2, 4, 5)
    found = np.asarray(found_in(table, jnp.asarray(volume), first, shape, sensor))
    assert found.shape == (SECTORS, *shape)
    gain = np.asarray(expected_gain(jnp.asarray(volume), sensor), np.float64)
    ways, size = band(SECTORS, ELEVATIONS, *EDGES)
    for node in [(0, 0, 0), (1, 3, 4), (1, 1, 2), (0, 2, 3)]:
        start = np.array(first) + stride * np.array(node)
        for sector in range(SECTORS):
            rays = ways[::-1].reshape(3, SECTORS, ELEVATIONS)[:, sector].T
            wanted = size * sum(explicit(volume.astype(float), gain, start, ray) for ray in rays)
            assert found[(sector, *node)] == pytest.approx(wanted, rel=2e-3, abs=1e-4)


def test_each_sector_is_around_its_azimuth() -> None:
    ways, size = band(SECTORS, ELEVATIONS, *EDGES)
    np.testing.assert_allclose(np.linalg.norm(ways, axis=0), 1.0)
    x, y, z = ways.reshape(3, SECTORS, ELEVATIONS)
    # The turn from a sector's middle, (a + 1/2) 2 pi / A.
    middle = 2.0 * math.pi * (np.arange(SECTORS)[:, None] + 0.5) / SECTORS
    np.testing.assert_allclose(x * np.cos(middle) + y * np.sin(middle), np.hypot(x, y))
    low, high = np.sin(EDGES)
    np.testing.assert_allclose(z, np.tile(low + (high - low) * np.array([1, 3, 5]) / 6, (6, 1)))
    assert size == pytest.approx(2.0 * math.pi * (high - low) / (SECTORS * ELEVATIONS))


def test_what_is_unknown_on_one_side_informs_the_sector_of_that_side() -> None:
    """Four sectors are the four quadrants around the viewpoint, counter-clockwise from x and y."""
    table = VoxelTable(4, 3, -0.3, 0.3, LENGTH, 1)
    west, east, south, north = slice(10), slice(11, None), slice(8), slice(9, None)
    for sector, (x, y) in enumerate([(east, north), (west, north), (west, south), (east, south)]):
        volume = np.zeros(SHAPE, np.float32)
        volume[:, y, x] = 0.5
        found = np.asarray(
            found_in(table, jnp.asarray(volume), (4, 8, 10), (1, 1, 1), InverseSensorModel())
        ).ravel()
        assert found[sector] > 1.0
        np.testing.assert_allclose(np.delete(found, sector), 0.0, atol=1e-5)


def test_in_free_space_the_weights_add_up_to_the_volume() -> None:
    # All voxels are unknown, and none stops a ray: the information is the volume in sight.
    table = VoxelTable(16, 8, -0.5, 0.5, 12.0, 1)
    volume = 2.0 * math.pi * 2.0 * math.sin(0.5) * 12.0**3 / 3.0
    # Rays end at the last plane that they cross within their length.
    assert float(table.weight.sum()) == pytest.approx(volume, rel=0.15)
    assert float(table.weight.sum()) < volume


def test_a_wall_hides_what_is_behind_it() -> None:
    volume = np.full(SHAPE, 0.5, np.float32)
    volume[:, :, 7] = 1.0
    volume[:, :, :7] = 0.0
    table = VoxelTable(4, 3, -0.3, 0.3, LENGTH, 1)
    found = np.asarray(
        found_in(table, jnp.asarray(volume), (4, 8, 3), (1, 1, 1), InverseSensorModel())
    )
    np.testing.assert_allclose(found, 0.0, atol=1e-4)


def test_offsets_in_the_plane_are_those_of_level_rays_in_space() -> None:
    angles = np.linspace(0.1, 6.0, 9)
    plane = ray_offsets(angles, 9.0)
    ways = np.stack([np.zeros(9), np.sin(angles), np.cos(angles)])
    space = direction_offsets(ways, 9.0)
    np.testing.assert_array_equal(space.offset[..., 1:], plane.offset)
    np.testing.assert_array_equal(space.offset[..., 0], 0)
    np.testing.assert_allclose(space.exit, plane.exit)
