"""No path leads through a wall, however it stands: road maps as `Perception` makes them."""

import itertools

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import distance_transform_edt, label

import jaxplore as jx
from jaxplore.belief.car import CarMotion
from jaxplore.belief.volume import VolumePerception
from jaxplore.maps.clearance import clearance_field
from jaxplore.maps.frame import GridFrame

SIZE = 24
LIDAR = jx.Lidar(num_beams=36, max_range=2.0)
BOX = jx.Rectangle(front=0.3, rear=0.1, width=0.2)


def perceive(resolution, radius, margin, spacing, car=None):
    numbers = {"margin": margin, "node_spacing": spacing, "car": car}
    return jx.Perception(LIDAR, resolution, radius, **numbers)


# Side of a cell, radius, margin and node spacing [m]; robots smaller than a cell and larger ones.
ON_THE_GROUND = {
    "below half a cell": (perceive(0.2, 0.05, 0.0, 0.2), 1),
    "a wide margin": (perceive(0.2, 0.05, 0.3, 0.2), 1),
    "as large as a cell": (perceive(0.1, 0.1, 0.05, 0.1), 1),
    "blocks of four": (perceive(0.1, 0.22, 0.1, 0.2), 2),
    "blocks of nine": (perceive(0.1, 0.25, 0.05, 0.3), 2),
    "a small car": (perceive(0.2, 0.05, 0.0, 0.2, CarMotion(0.4, BOX)), 1),
    "a car": (perceive(0.1, 0.15, 0.05, 0.2, CarMotion(0.5, BOX)), 1),
}
CAMERA = jx.DepthCamera(8, 6)
# And the side of a voxel [m].
IN_THE_AIR = {
    "below half a voxel": (VolumePerception([CAMERA], 0.4, 0.1, margin=0.0), 0.4),
    "as large as a voxel": (VolumePerception([CAMERA], 0.2, 0.15, margin=0.05), 0.2),
    "larger nodes": (VolumePerception([CAMERA], 0.1, 0.2, margin=0.1), 0.1),
}


@eqx.filter_jit
def lengths_from(perception, blocked, pose):
    """Return the costs of the paths from a pose to all nodes."""
    clearance = clearance_field(blocked, GridFrame(perception.resolution), 2.0)
    stride = perception.field_sensor.stride
    roads = perception.locomotion.roadmap(clearance, perception.required_clearance, stride)
    return roads.lengths_from(pose)


def draw_line(cells: np.ndarray, begin: np.ndarray, end: np.ndarray) -> None:
    """Block the cells of a line. Its cells share faces or only corners, and it has no hole."""
    for part in np.linspace(0.0, 1.0, int(abs(end - begin).max()) + 1):
        cells[tuple(np.rint(begin + part * (end - begin)).astype(int))] = True


def random_walls(rng: np.random.Generator) -> np.ndarray:
    """Return a room with a closed polygon, or with a wall of straight pieces right across it."""
    blocked = np.zeros((SIZE, SIZE), bool)
    blocked[[0, -1]] = blocked[:, [0, -1]] = True
    corners = rng.integers(1, SIZE - 1, (rng.integers(1, 6), 2))
    if rng.random() < 0.5:
        ends = corners[[-1, *range(len(corners))]]
    else:
        ends = np.concatenate(
            [[[rng.integers(SIZE), 0]], corners, [[rng.integers(SIZE), SIZE - 1]]]
        )
    for begin, end in itertools.pairwise(ends):
        draw_line(blocked, begin, end)
    return blocked | (rng.random(blocked.shape) < rng.choice([0.0, 0.02]))


def random_start(rng: np.random.Generator, room: np.ndarray, required: float) -> tuple | None:
    """Return a cell in which a robot fits."""
    cells = np.argwhere(room >= required - 1e-6)
    return tuple(cells[rng.integers(len(cells))]) if len(cells) else None


@pytest.mark.parametrize("name", ON_THE_GROUND)
@given(seed=st.integers(0, 2**32 - 1))
def test_no_path_leads_through_a_wall(name: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    perception, _ = ON_THE_GROUND[name]
    side, stride = perception.resolution, perception.field_sensor.stride
    blocked = random_walls(rng)
    room = (distance_transform_edt(~blocked) - 0.5) * side
    start = random_start(rng, room, float(perception.required_clearance))
    if start is None:
        return
    pose = np.array([(start[1] + 0.5) * side, (start[0] + 0.5) * side, rng.uniform(-3, 3)])
    found = lengths_from(perception, jnp.asarray(blocked), jnp.asarray(pose, jnp.float32))
    # Cells on this side of the walls: steps over faces lead there from the start.
    sides, _ = label(~blocked)
    padding = -SIZE % stride
    is_here = np.pad(sides == sides[start], (0, padding))
    nodes = is_here.reshape(found.shape[0], stride, found.shape[1], stride).any(axis=(1, 3))
    assert not (np.isfinite(found) & ~nodes).any()


@pytest.mark.parametrize("name", ON_THE_GROUND)
def test_paths_lead_around_the_end_of_a_wall(name: str) -> None:
    """And the strides are those that the cases are meant for."""
    perception, stride = ON_THE_GROUND[name]
    assert perception.field_sensor.stride == stride
    blocked = np.zeros((SIZE, SIZE), bool)
    blocked[[0, -1]] = blocked[:, [0, -1]] = True
    blocked[:12, 12] = True
    x, y = np.array([6.5, 5.5]) * perception.resolution
    found = lengths_from(perception, jnp.asarray(blocked), jnp.asarray([x, y, 1.5], jnp.float32))
    node = found[6 // stride, 18 // stride]
    # Around it, with prices of at most twice the length.
    assert 14.0 * perception.resolution < node < 56.0 * perception.resolution


@eqx.filter_jit
def lengths_in_volume(perception, grid, position):
    """Return the costs of the paths from a position to all nodes, and the first node."""
    roads = perception.roads(perception.init(grid, position))
    return roads.lengths_from(position), roads.origin


@pytest.mark.parametrize("name", IN_THE_AIR)
@given(seed=st.integers(0, 2**32 - 1))
def test_no_path_leads_through_a_wall_in_a_volume(name: str, seed: int) -> None:
    """A plane of voxels that share faces, edges or only corners."""
    rng = np.random.default_rng(seed)
    perception, side = IN_THE_AIR[name]
    pool, size = perception.pool, 16
    normal = rng.normal(size=3) if rng.random() < 0.6 else rng.choice([-1.0, 0.0, 1.0], 3)
    normal = np.array([0.0, 0.6, 0.8]) if not normal.any() else normal / np.linalg.norm(normal)
    places = np.mgrid[:size, :size, :size] + 0.5 - size / 2
    away = np.tensordot(normal, places, 1) - rng.uniform(-3, 3)
    solid = abs(away) <= 0.5 * rng.choice([abs(normal).max(), abs(normal).sum()])
    room = (distance_transform_edt(np.pad(~solid, 1))[1:-1, 1:-1, 1:-1] - 0.5) * side
    # The whole node is open in which the robot is.
    blocks = room.reshape(size // pool, pool, size // pool, pool, size // pool, pool)
    open_blocks = blocks.min(axis=(1, 3, 5)).repeat(pool, 0).repeat(pool, 1).repeat(pool, 2)
    start = random_start(rng, open_blocks, max(float(perception.required), 0.51 * side))
    if start is None:
        return
    position = (np.array(start[::-1]) + 0.5) * side
    grid = jx.VoxelGrid.solid(solid, side)
    found, origin = lengths_in_volume(perception, grid, jnp.asarray(position, jnp.float32))
    sides, _ = label(~solid)
    is_here = sides == sides[start]
    for node in np.argwhere(np.isfinite(found)):
        first = np.rint((np.asarray(origin)[::-1] / side - 0.5 * pool) + 2 * pool * node).astype(
            int
        )
        assert is_here[tuple(slice(each, each + pool) for each in first)].any()
