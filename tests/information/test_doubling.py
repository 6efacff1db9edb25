"""Doubling against the scan of the same beams, and against rays from the nodes."""

import math
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import InverseSensorModel, Lidar, OccupancyGrid
from jaxplore.information import InformationField
from jaxplore.information.beam_table import BeamTable
from jaxplore.information.doubling import Doubling
from jaxplore.information.field_sensor import FieldSensor
from jaxplore.information.gain import CellSensor, IdealSensor
from jaxplore.information.noise import GaussianNoise

pytestmark = pytest.mark.long

RESOLUTION = 0.1
TRACES = []


class Case(NamedTuple):
    """Beams, and how many directions stand for them."""

    num_beams: int
    num_directions: int
    max_range: float
    stride: int = 1
    near_weight: bool = True
    shape: tuple[int, int] = (30, 37)
    sensor: CellSensor = InverseSensorModel()

    @property
    def lidar(self) -> Lidar:
        return Lidar(self.num_beams, self.max_range)

    def field_sensor(self, method: str) -> FieldSensor:
        return FieldSensor(
            self.lidar,
            RESOLUTION,
            self.num_directions,
            self.stride,
            near_weight=self.near_weight,
            method=method,
        )


# Of 90 directions periods have up to 29 cells, of 20 up to 6.
CASES = {
    "shorter than a period": Case(60, 90, 0.3, near_weight=False),
    "a few periods": Case(40, 32, 2.2),
    "near all along": Case(400, 12, 2.2, 2),
    "longer than the map": Case(12, 14, 6.0, 2, sensor=IdealSensor()),
    "a thin map": Case(20, 18, 5.0, 3, shape=(70, 5)),
    "along the axes": Case(20, 9, 2.2),
}


@eqx.filter_jit
def field(sensor: FieldSensor, grid: OccupancyGrid, model: CellSensor) -> InformationField:
    TRACES.append(sensor)
    return sensor.field(grid, model)


def sectors(sensor: FieldSensor, grid: OccupancyGrid, model: CellSensor) -> jax.Array:
    return field(sensor, grid, model).sectors


def open_map(shape: tuple[int, int], seed: int = 0) -> OccupancyGrid:
    """Return a map with few walls, through which long beams come far."""
    rng = np.random.default_rng(seed)
    p = rng.choice([0.001, 0.01, 0.05, 0.5, 0.9], shape, p=[0.5, 0.2, 0.15, 0.1, 0.05])
    return OccupancyGrid(p.astype(np.float32), RESOLUTION, (1.0, -2.0, 0.7))


@pytest.mark.parametrize("name", CASES)
def test_doubling_is_the_scan_of_the_same_beams(name: str, beam_by_definition: Callable) -> None:
    case = CASES[name]
    doubling, scan = case.field_sensor("doubling"), case.field_sensor("scan")
    angles = np.asarray(doubling.angles, float)
    spacing = 2 * np.pi / case.num_beams if case.near_weight else None
    share = case.num_beams / case.num_directions
    table = BeamTable(
        angles, case.max_range / RESOLUTION, case.stride, share=share, spacing=spacing
    )
    scan = eqx.tree_at(lambda sensor: sensor.table, scan, table)
    grid = open_map(case.shape)
    found = sectors(doubling, grid, case.sensor)
    np.testing.assert_allclose(found, sectors(scan, grid, case.sensor), rtol=1e-5, atol=1e-6)
    found = np.asarray(found)

    p = np.asarray(grid.probability, float)
    nodes = np.random.default_rng(1).integers(0, found.shape[1:], (8, 2))
    for node in [*nodes, np.array(found.shape[1:]) - 1]:
        cell = case.stride * node + case.stride // 2
        is_open = (cell < case.shape).all() and p[tuple(cell)] <= 0.65
        rules = (case.max_range, spacing, case.sensor)
        rays = [
            is_open and share * beam_by_definition(p, RESOLUTION, cell + 0.5, angle, *rules)
            for angle in angles
        ]
        np.testing.assert_allclose(found[:, *node], rays, rtol=1e-5, atol=1e-6)


def test_values_are_not_negative_and_zero_in_walls() -> None:
    case = CASES["a few periods"]
    grid = open_map(case.shape, seed=2)
    found = np.asarray(sectors(case.field_sensor("doubling"), grid, case.sensor))
    assert found.min() >= 0.0
    is_wall = np.asarray(grid.is_occupied)
    np.testing.assert_array_equal(found[:, is_wall], 0.0)
    assert (found.sum(axis=0)[~is_wall] > 0.0).mean() > 0.9


@pytest.mark.parametrize("count", [4, 6, 8, 32, 33, 64, 90, 256])
def test_directions_repeat_and_lie_within_their_sectors(count: int) -> None:
    middles = (np.arange(count) + 0.5) * 2 * np.pi / count
    doubling = Doubling(middles, 2.0, 1)
    period = np.asarray(doubling.period) * np.asarray(doubling.sign)
    np.testing.assert_array_equal(np.gcd(*np.abs(period).T), 1)
    angles = np.arctan2(period[:, 0], period[:, 1])
    np.testing.assert_allclose(doubling.angles, np.mod(angles, 2 * np.pi), rtol=1e-6)
    off = np.angle(np.exp(1j * (angles - middles)))
    assert np.abs(off).max() <= 0.5 * np.pi / count + 1e-6
    # No shorter vector would do: all of them, one by one.
    for middle, length in zip(middles, np.abs(period).sum(axis=1), strict=True):
        side = np.arange(-length, length + 1)
        rows, columns = (part.reshape(-1) for part in np.meshgrid(side, side))
        size = np.abs(rows) + np.abs(columns)
        is_shorter = (size > 0) & (size < length)
        shorter = np.arctan2(rows[is_shorter], columns[is_shorter])
        nearest = np.abs(np.angle(np.exp(1j * (shorter - middle)))).min(initial=np.pi)
        assert nearest > 0.5 * np.pi / count - 1e-6


def test_it_is_chosen_where_it_is_faster() -> None:
    long, short = Lidar(90, 30.0), Lidar(90, 5.0)
    assert FieldSensor(long, 0.1, 16).doubling is not None
    assert FieldSensor(long, 0.1, 16).num_beams == 90
    for slower in (
        FieldSensor(short, 0.1, 16),
        FieldSensor(long, 0.1, 16, 2),
        FieldSensor(long, 0.5, 16),
        FieldSensor(long, 0.1, 8, method="scan"),
        FieldSensor(long, 0.1, 8, no_return=False),
        FieldSensor(long, 0.3, 8, noise=GaussianNoise(0.1)),
    ):
        assert slower.doubling is None


def test_an_update_is_the_new_maps_field() -> None:
    case = CASES["a few periods"]
    sensor = case.field_sensor("doubling")
    old, new = open_map(case.shape, seed=3), open_map(case.shape, seed=4)
    found = field(sensor, old, case.sensor)
    found = eqx.filter_jit(sensor.update)(found, new, case.sensor)
    np.testing.assert_array_equal(found.sectors, sectors(sensor, new, case.sensor))
    sums = np.cumsum(np.asarray(found.sectors, float), axis=0)
    np.testing.assert_allclose(found.cumulative[1:], sums, rtol=1e-5)
    np.testing.assert_array_equal(found.cumulative[0], 0.0)
    np.testing.assert_array_equal(found.source, new.probability)
    node = found.frame.cell_centre(jnp.asarray([7, 9]))
    np.testing.assert_allclose(node, new.frame.cell_centre(jnp.asarray([7, 9])), rtol=1e-5)
    total = float(found(node, jnp.float32(0.3), 2 * math.pi))
    assert total == pytest.approx(float(found.total[7, 9]), rel=1e-4)


def test_other_maps_and_odds_do_not_retrace() -> None:
    case = CASES["a few periods"]
    sensor = case.field_sensor("doubling")
    sectors(sensor, open_map(case.shape), case.sensor)
    before = len(TRACES)
    other = InverseSensorModel.from_odds(3.0, 0.3)
    sums = {float(sectors(sensor, open_map(case.shape, seed), other).sum()) for seed in (5, 6)}
    assert len(TRACES) == before
    assert len(sums) == 2
