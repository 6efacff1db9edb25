"""Distances and interpolation in a volume against SciPy."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import RegularGridInterpolator
from scipy.ndimage import distance_transform_edt

from jaxplore.maps.volume_clearance import (
    clearance_of_volume,
    squared_distance,
    update_clearance,
)
from jaxplore.maps.volume_field import VolumeField
from jaxplore.maps.voxel_grid import VoxelGrid
from jaxplore.maps.window import Window

REACH = 5
SHAPE = (6, 11, 14)
distances = jax.jit(lambda closed: squared_distance(closed, REACH))


@given(st.integers(0, 2**31), st.floats(0.0, 0.2))
def test_distances_are_those_of_scipy(seed: int, share: float) -> None:
    closed = np.random.default_rng(seed).random(SHAPE) < share
    wanted = np.full(SHAPE, np.inf)
    if closed.any():
        wanted = distance_transform_edt(~closed) ** 2
    wanted = np.where(wanted <= REACH**2, wanted, (REACH + 1) ** 2)
    found = np.asarray(distances(jnp.asarray(closed)))
    # Distances between the reach and one voxel more may be exact or the bound.
    found = np.where(found <= REACH**2, found, (REACH + 1) ** 2)
    np.testing.assert_allclose(found, wanted, atol=1e-3)


def test_interpolation_is_that_of_scipy() -> None:
    rng = np.random.default_rng(0)
    values = rng.normal(size=SHAPE)
    origin, spacing = np.array([-1.0, 2.0, 0.5]), 0.4
    field = VolumeField(
        jnp.asarray(values, jnp.float32), jnp.asarray(origin), spacing, jnp.asarray(-7.0)
    )
    read = eqx.filter_jit(lambda field, points: jax.vmap(field, in_axes=1)(points))
    nodes = tuple(origin[a] + spacing * np.arange(n) for a, n in ((2, 6), (1, 11), (0, 14)))
    plain = RegularGridInterpolator(nodes, values)
    points = rng.uniform(
        [each[0] for each in nodes[::-1]], [each[-1] for each in nodes[::-1]], (500, 3)
    )
    found = np.asarray(read(field, jnp.asarray(points.T, jnp.float32)))
    np.testing.assert_allclose(found, plain(points[:, ::-1]), atol=1e-4)
    # Half a spacing beyond the nodes the edge counts, and beyond that the outside.
    edge = jnp.asarray([[-1.19, -1.21, np.nan], [2.0, 2.0, 2.0], [0.5, 0.5, 0.5]], jnp.float32)
    np.testing.assert_allclose(read(field, edge), [values[0, 0, 0], -7.0, -7.0], atol=1e-5)


def test_a_lattice_of_one_node_is_constant() -> None:
    field = VolumeField(jnp.full((1, 1, 1), 3.0), jnp.zeros(3), 1.0, jnp.zeros(()))
    assert float(field(jnp.asarray([0.3, -0.4, 0.0]))) == pytest.approx(3.0)


def test_an_extruded_plane_has_the_clearance_of_the_plane() -> None:
    closed = np.random.default_rng(4).random((20, 24)) < 0.06
    volume = np.broadcast_to(closed, (9, 20, 24))
    found = np.sqrt(np.asarray(squared_distance(jnp.asarray(volume), 30)))
    planar = distance_transform_edt(~closed)
    np.testing.assert_allclose(found, np.broadcast_to(planar, volume.shape), rtol=1e-6)


@pytest.mark.parametrize("share", [0.0, 0.03])
def test_distances_to_other_voxels_follow_a_change_in_a_window(share: float) -> None:
    rng, shape, reach = np.random.default_rng(6), (12, 15, 18), 2
    grid = VoxelGrid.solid(rng.random(shape) < 0.4, 0.1)
    before = rng.random(shape) < share
    after = before.copy()
    after[5, 6, 7:9] = ~before[5, 6, 7:9]

    @jax.jit
    def update(before, after):
        # Twice the reach around the change.
        window = Window.at(jnp.array([1, 2, 3]), (9, 9, 10), shape)
        former = clearance_of_volume(grid, reach, before).values
        return update_clearance(grid, former, window, reach, after)

    wanted = distance_transform_edt(np.pad(~after, 1))[1:-1, 1:-1, 1:-1] - 0.5
    found = np.minimum(np.asarray(update(before, after)), 0.1 * reach)
    np.testing.assert_allclose(found, np.clip(0.1 * wanted, 0.0, 0.1 * reach), atol=1e-6)
