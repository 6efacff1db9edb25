"""The field around a robot against the scans it is made from."""

import math
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import InverseSensorModel, Lidar, OccupancyGrid
from jaxplore.information.gain import IdealSensor
from jaxplore.information.heading_field import HeadingField
from jaxplore.information.local_field import LocalFieldSensor
from jaxplore.information.noise import GaussianNoise, UniformNoise
from jaxplore.information.pose import PoseInformation

pytestmark = pytest.mark.long

SHAPE, RESOLUTION, ORIGIN = (110, 97), 0.1, (1.0, -2.0, 0.7)
QUARTER = Lidar(12, 2.0, math.pi / 2)
SEEDS = PoseInformation(Lidar(12, 10.0, math.pi / 2), InverseSensorModel.from_odds())


class Case(NamedTuple):
    scan: PoseInformation
    spacing: float = 0.5
    num_headings: int = 8

    @property
    def sensor(self) -> LocalFieldSensor:
        return LocalFieldSensor(
            self.scan, RESOLUTION, spacing=self.spacing, num_headings=self.num_headings
        )


CASES = {
    "seeds": Case(SEEDS),
    # Some beams run along diagonals, through the corners of cells.
    "uniform": Case(PoseInformation(QUARTER, noise=UniformNoise(1)), 0.4),
    "gaussian": Case(
        PoseInformation(QUARTER, IdealSensor(), noise=GaussianNoise(0.08), no_return=False)
    ),
    "full circle": Case(PoseInformation(Lidar(18, 2.0), near_weight=False), 0.3, 5),
}
SENSORS = {name: case.sensor for name, case in CASES.items()}


@eqx.filter_jit
def local_field(sensor: LocalFieldSensor, grid: OccupancyGrid, position) -> HeadingField:
    return sensor.field(grid, position)


@eqx.filter_jit
def scan_values(scan: PoseInformation, grid: OccupancyGrid, position, heading) -> jax.Array:
    return scan(grid, position, heading)


def random_map(seed: int = 0) -> OccupancyGrid:
    rng = np.random.default_rng(seed)
    p = rng.choice([0.001, 0.01, 0.1, 0.3, 0.5, 0.9, 0.993], SHAPE).astype(np.float32)
    return OccupancyGrid(p, RESOLUTION, ORIGIN)


MIDDLE = jnp.asarray([1.3, 4.6])
BORDER, OFF_MAP = jnp.asarray([1.0, -1.8]), jnp.asarray([0.6, -2.5])


def test_the_defaults_are_ten_metres_around_the_robot() -> None:
    grid = random_map()
    found = local_field(SENSORS["seeds"], grid, MIDDLE)
    assert found.values.shape == (20, 20, 8)
    assert found.best.values.shape == (20, 20)
    np.testing.assert_array_equal(found.best.values, np.asarray(found.values).max(axis=-1))
    robot = grid.frame.to_cell(MIDDLE)
    np.testing.assert_array_equal(
        grid.frame.to_cell(found.frame.to_world(jnp.full(2, 10.5))), robot
    )
    # The corner: 5 m back along both axes of the map, to the cell.
    back = np.asarray(grid.frame.to_grid(found.origin) - grid.frame.to_grid(MIDDLE))
    assert np.abs(back + 5.0 / RESOLUTION).max() <= 0.5 + 1e-3
    np.testing.assert_allclose(found.frame.cell_centre(jnp.zeros(2, int)), found.origin, rtol=1e-6)
    assert found.frame.resolution == 0.5
    np.testing.assert_allclose(found.headings, ORIGIN[2] + np.arange(8) * math.pi / 4, rtol=1e-6)


@pytest.mark.parametrize("position", [MIDDLE, BORDER, OFF_MAP], ids=["middle", "border", "off"])
@pytest.mark.parametrize("name", CASES)
def test_every_node_and_heading_is_a_scan(
    name: str, position: jax.Array, scan_by_definition: Callable
) -> None:
    case, grid, rng = CASES[name], random_map(), np.random.default_rng(1)
    found = local_field(SENSORS[name], grid, position)
    rows, columns, count = found.values.shape
    assert rows == columns == round(10.0 / case.spacing)
    assert count == case.num_headings
    middle = found.frame.cell_centre(jnp.full(2, rows // 2))
    robot = grid.frame.to_cell(position)
    np.testing.assert_array_equal(grid.frame.to_cell(middle), robot)
    row, column, heading = (rng.integers(0, size, 64) for size in found.values.shape)
    values = np.asarray(found.values)[row, column, heading]
    at = found.frame.cell_centre(jnp.asarray(np.stack([row, column], axis=-1)))
    expected = scan_values(case.scan, grid, at, found.headings[heading])
    np.testing.assert_allclose(values, expected, rtol=2e-4, atol=1e-5)
    scan = case.scan
    rules = (scan.lidar, scan.sensor, scan.noise, scan.no_return, scan.near_weight)
    for node in range(10):
        yaw = float(found.headings[heading[node]])
        by_definition = scan_by_definition(grid, np.asarray(at)[node], yaw, *rules)
        assert values[node] == pytest.approx(by_definition, rel=2e-4, abs=1e-5)
    on_map = np.asarray(grid.contains(grid.frame.to_cell(at)))
    np.testing.assert_array_equal(values[~on_map], 0.0)
    assert (values[on_map] > 0.0).sum() > 2
    if position is not MIDDLE:
        assert not on_map.all()


def test_one_beam_along_the_axes_is_a_scan() -> None:
    scan = PoseInformation(Lidar(1, 2.0))
    grid = OccupancyGrid(np.full((30, 30), 0.2, np.float32), RESOLUTION)
    found = local_field(LocalFieldSensor(scan, RESOLUTION, extent=0.5), grid, jnp.full(2, 1.5))
    position = jnp.broadcast_to(found.origin, (8, 2))
    expected = scan_values(scan, grid, position, found.headings)
    np.testing.assert_allclose(found.values[0, 0], expected, rtol=1e-3)


@pytest.mark.parametrize(
    "position",
    [(math.nan, 0.0), (0.0, math.inf), (1e3, 0.0), (-60.0, 5.0)],
)
def test_a_robot_far_off_the_map_or_nowhere_has_no_information(
    position: tuple[float, float],
) -> None:
    found = local_field(SENSORS["seeds"], random_map(), jnp.asarray(position))
    np.testing.assert_array_equal(found.values, 0.0)
    assert np.isfinite(found.origin).all()


def test_nodes_in_walls_have_no_information() -> None:
    p = np.full(SHAPE, 0.3, np.float32)
    p[::2] = 0.66
    grid = OccupancyGrid(p, RESOLUTION, ORIGIN)
    found = local_field(SENSORS["seeds"], grid, MIDDLE)
    row, column = np.meshgrid(np.arange(20), np.arange(20), indexing="ij")
    nodes = jnp.asarray(np.stack([row, column], axis=-1))
    cells = np.asarray(grid.frame.to_cell(found.frame.cell_centre(nodes)))
    is_wall = (cells[..., 0] % 2 == 0) & np.asarray(grid.contains(jnp.asarray(cells)))
    np.testing.assert_array_equal(np.asarray(found.best.values)[is_wall], 0.0)
    assert 100 < is_wall.sum() < 300
    is_open = (cells[..., 0] % 2 == 1) & np.asarray(grid.contains(jnp.asarray(cells)))
    assert (np.asarray(found.values)[is_open] > 0.0).all()


def test_the_best_heading_is_read_between_nodes_and_ends_with_them() -> None:
    found = local_field(SENSORS["seeds"], random_map(), MIDDLE)
    best, frame = found.best, found.frame
    values = np.asarray(best.values)
    read = jax.jit(jax.vmap(jax.value_and_grad(best)))
    where = [(10.5, 10.5), (0.5, 0.5), (19.5, 19.5), (11.0, 10.5), (11.0, 11.0)]
    outside = [(0.45, 5.0), (5.0, 0.45), (19.55, 5.0), (5.0, 19.55), (-3.0, 5.0), (math.nan, 5.0)]
    points = frame.to_world(jnp.asarray(where + outside))
    value, slope = read(points)
    expected = [
        values[10, 10],
        values[0, 0],
        values[19, 19],
        values[10:12, 10].mean(),
        values[10:12, 10:12].mean(),
    ]
    np.testing.assert_allclose(value[:5], expected, atol=1e-4 * values.max())
    np.testing.assert_array_equal(value[5:], 0.0)
    assert np.isfinite(slope).all()
    np.testing.assert_array_equal(slope[5:], 0.0)
    assert np.abs(slope[3:5]).max() > 0.0


def test_the_spacing_is_whole_cells() -> None:
    for spacing, cells in ((0.5, 5), (0.52, 5), (0.1, 1), (0.04, 1), (0.36, 4)):
        sensor = LocalFieldSensor(CASES["uniform"].scan, RESOLUTION, extent=1.0, spacing=spacing)
        assert sensor.table.stride == cells
        assert sensor.num_nodes == round(2.0 / spacing)
