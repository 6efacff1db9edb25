"""Padded maps: the same numbers as without padding, in arrays of one of a few shapes."""

import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore import InverseSensorModel, Lidar, OccupancyGrid, Perception
from jaxplore.belief import unknown_fraction
from jaxplore.information.field_sensor import FieldSensor
from jaxplore.maps.clearance import clearance_field
from jaxplore.maps.ground import Ground
from jaxplore.maps.padding import choose_padded_shape, common_shapes
from jaxplore.sensing.base import update_grid
from jaxplore.sensing.beams import Scan

pytestmark = pytest.mark.long

SIDES = st.integers(1, 3000)
LIDAR = Lidar(num_beams=24, max_range=1.2, range_noise=0.0)
MODEL = InverseSensorModel()


def grid_of(rows: int = 21, columns: int = 34, seed: int = 0) -> OccupancyGrid:
    values = np.random.default_rng(seed).choice(
        [0.01, 0.5, 0.97], (rows, columns), p=[0.6, 0.3, 0.1]
    )
    return OccupancyGrid(values, 0.1, (-1.0, 0.5, 0.3))


GRID = grid_of()
PADDED = GRID.pad((40, 60))


@given(SIDES, SIDES)
def test_a_side_grows_by_less_than_a_quarter_or_32_and_only_once(rows, columns) -> None:
    padded = choose_padded_shape((rows, columns))
    for side, more in zip((rows, columns), padded, strict=True):
        assert side <= more < max(1.25 * side, side + 32)
    assert choose_padded_shape(padded) == padded


def test_there_are_four_sizes_between_powers_of_two() -> None:
    sizes = {choose_padded_shape((side, side))[0] for side in range(129, 1025)}
    assert sizes == {160, 192, 224, 256, 320, 384, 448, 512, 640, 768, 896, 1024}


@given(st.lists(st.tuples(SIDES, SIDES), min_size=1, max_size=12), st.integers(1, 4))
def test_common_shapes_are_few_and_hold_every_map(shapes, most) -> None:
    named = {str(index): shape for index, shape in enumerate(shapes)}
    chosen = common_shapes(named, most)
    assert set(chosen) == set(named)
    assert len(set(chosen.values())) <= most
    for name, (rows, columns) in named.items():
        assert chosen[name][0] >= rows
        assert chosen[name][1] >= columns


def test_two_of_three_maps_share_the_shape_that_needs_the_fewest_cells() -> None:
    maps = {"small": (100, 100), "wide": (100, 300), "long": (310, 100)}
    chosen = common_shapes(maps, 2)
    # Brute force: all ways to give two of them one shape.
    sides = {name: choose_padded_shape(shape) for name, shape in maps.items()}

    def cells(pair: tuple[str, str]) -> int:
        rows, columns = np.max([sides[name] for name in pair], axis=0)
        alone = [size for name, size in sides.items() if name not in pair]
        return 2 * int(rows * columns) + sum(rows * columns for rows, columns in alone)

    best = min(itertools.combinations(maps, 2), key=cells)
    assert chosen[best[0]] == chosen[best[1]]
    assert len(set(chosen.values())) == 2


def test_cells_are_the_same_on_the_map_and_off_it() -> None:
    cells = jnp.asarray(list(itertools.product(range(-3, 45), range(-3, 65))))
    np.testing.assert_array_equal(PADDED.at_cell(cells), GRID.at_cell(cells))
    np.testing.assert_array_equal(PADDED.contains(cells), GRID.contains(cells))
    assert PADDED.shape == (40, 60)
    assert repr(PADDED) == repr(GRID)


def test_padding_can_be_undone_and_is_not_repeated() -> None:
    np.testing.assert_array_equal(PADDED.unpad().probability, GRID.probability)
    assert PADDED.unpad().map_shape is None
    assert PADDED.pad() is PADDED
    assert GRID.pad().shape == (32, 64)
    np.testing.assert_array_equal(PADDED.pad((50, 60)).unpad().probability, GRID.probability)
    with pytest.raises(ValueError, match=r"shape is \(20, 60\); accepted: at least \(21, 34\)"):
        PADDED.pad((20, 60))


def test_files_and_other_resolutions_have_the_map_alone(tmp_path) -> None:
    for name, grid in (("alone", GRID), ("padded", PADDED)):
        grid.to_ros(tmp_path / f"{name}.yaml")
    assert (tmp_path / "alone.pgm").read_bytes() == (tmp_path / "padded.pgm").read_bytes()
    coarse = PADDED.resample(0.2).probability
    np.testing.assert_array_equal(coarse, GRID.resample(0.2).probability)


@pytest.mark.parametrize("reach", [0.25, 0.8])
def test_clearance_is_the_same_to_the_bit(reach) -> None:
    alone = clearance_field(~GRID.is_free, GRID.frame, reach).values
    padded = clearance_field(~PADDED.is_free, PADDED.frame, reach).values
    np.testing.assert_array_equal(padded[:21, :34], alone)
    assert not padded[21:].any()


@pytest.mark.parametrize("method", ["scan", "doubling"])
@pytest.mark.parametrize("interest", [None, 0.3])
def test_information_is_the_same_to_the_bit(method, interest) -> None:
    sensor = FieldSensor(LIDAR, 0.1, 12, 2, method=method)

    @jax.jit
    def total(grid):
        more = None if interest is None else jnp.full(grid.shape, interest)
        return sensor.field(grid, MODEL, more).sectors

    alone, padded = total(GRID), total(PADDED)
    rows, columns = alone.shape[1:]
    np.testing.assert_array_equal(padded[:, :rows, :columns], alone)
    assert not padded[:, rows:].any()
    assert not padded[:, :, columns:].any()


def test_a_window_at_the_edge_is_the_same_to_the_bit() -> None:
    sensor = FieldSensor(LIDAR, 0.1, 8, 2, method="scan")
    window = jax.jit(lambda grid, at: sensor.window(grid, MODEL, at, (6, 6)).sectors)
    for cell in ([20, 33], [0, 33], [10, 10]):
        at = GRID.frame.cell_centre(jnp.asarray(cell))
        np.testing.assert_array_equal(window(PADDED, at), window(GRID, at))


def test_a_scan_beyond_the_edge_changes_no_cell_off_the_map() -> None:
    pose = jnp.append(GRID.frame.cell_centre(jnp.asarray([19, 32])), 0.2)
    scan = Scan(jnp.full(24, 0.6), jnp.ones(24, bool))

    @jax.jit
    def updated(grid):
        return update_grid(grid, LIDAR.sight(grid, scan, pose), MODEL)

    alone, padded = updated(GRID), updated(PADDED)
    np.testing.assert_array_equal(padded.unpad().probability, alone.probability)
    assert (np.asarray(padded.probability)[21:] == 1.0).all()
    assert not np.array_equal(alone.probability, GRID.probability)


def test_the_unknown_share_is_that_of_the_map() -> None:
    share = float(unknown_fraction(GRID))
    assert float(unknown_fraction(PADDED)) == pytest.approx(share, rel=1e-6)
    assert share == pytest.approx((np.asarray(GRID.probability) == 0.5).mean())


def test_ground_is_0_off_the_map_and_can_be_cut_back() -> None:
    height = np.random.default_rng(1).uniform(0.0, 0.1, (21, 34))
    ground = Ground(height, 0.1)
    padded = ground.pad((40, 60))
    assert not np.asarray(padded.is_traversable)[21:].any()
    cut = padded.crop((21, 34))
    for one, other in zip(jax.tree.leaves(cut), jax.tree.leaves(ground), strict=True):
        np.testing.assert_array_equal(one, other)
    with pytest.raises(ValueError, match="accepted: at least"):
        ground.pad((10, 60))


@pytest.mark.parametrize(
    "drawn",
    [
        lambda belief: belief.grid.plot(),
        lambda belief: belief.clearance.plot(),
        lambda belief: belief.guidance.plot(),
        lambda belief: belief.information.plot(),
        lambda belief: belief.information.plot(0.7),
        lambda belief: belief.information.at_headings(4, 1.0).plot(),
    ],
    ids=["map", "clearance", "guidance", "full circle", "one heading", "best heading"],
)
def test_figures_of_a_padded_belief_end_where_the_map_ends(drawn, beliefs) -> None:
    alone, padded = (drawn(belief).axes[0] for belief in beliefs)
    np.testing.assert_allclose(padded.images[0].get_array(), alone.images[0].get_array(), rtol=1e-4)
    assert padded.images[0].get_clim() == pytest.approx(alone.images[0].get_clim())
    assert (padded.get_xlim(), padded.get_ylim()) == (alone.get_xlim(), alone.get_ylim())


@pytest.fixture(scope="module")
def beliefs():
    """Return a belief of the map alone, and one of the padded map."""
    perception = Perception(LIDAR, 0.1, 0.15, num_directions=8)
    pose = jnp.append(GRID.frame.cell_centre(jnp.asarray([10, 12])), 0.0)
    init = eqx.filter_jit(perception.init)
    return init(GRID, pose), init(PADDED, pose)


def test_the_frame_of_a_window_is_that_of_no_map() -> None:
    coarse = PADDED.frame.coarsen(2, 1.0)
    assert np.asarray(coarse.map_shape).tolist() == [11, 17]
    assert PADDED.frame.coarsen(2, 1.0, jnp.array([3, 4])).map_shape is None
    assert GRID.frame.coarsen(2, 1.0).map_shape is None
