import io
import math
import os
import pickle
import zipfile

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from jaxplore import _files
from jaxplore.maps.ground import Ground
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.maps.resample import CELL_LIMIT
from jaxplore.maps.terrain import TerrainMap

RNG = np.random.default_rng(1)
SHAPE = (6, 9)
ORIGIN = (1.0, -2.0, 0.6)
OCCUPANCY = RNG.random(SHAPE).astype(np.float32)
HEIGHTS = RNG.normal(0.0, 0.1, SHAPE).astype(np.float32)
PASSABLE = RNG.random(SHAPE).astype(np.float32)
TERRAIN = TerrainMap.from_arrays(
    OCCUPANCY, HEIGHTS, 0.25, ORIGIN, max_slope=1.25, max_roughness=0.4, threshold=0.2
)
GIVEN = TerrainMap.from_arrays(OCCUPANCY, HEIGHTS, 0.25, ORIGIN, traversability=PASSABLE)


def entropy(p: np.ndarray) -> np.ndarray:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.nan_to_num(-p * np.log(p)) + np.nan_to_num(-(1 - p) * np.log1p(-p))


def refused(action, *named) -> None:
    with pytest.raises(ValueError, match="accepted") as error:
        action()
    assert "\n" not in str(error.value)
    for text in named:
        assert str(text) in str(error.value)


def test_layers() -> None:
    ground = Ground(HEIGHTS, 0.25, ORIGIN, max_slope=1.25, max_roughness=0.4, threshold=0.2)
    assert np.array_equal(TERRAIN.occupancy, OCCUPANCY)
    assert np.array_equal(TERRAIN.elevation, HEIGHTS)
    for name in ("slope", "roughness", "traversability"):
        assert np.array_equal(getattr(TERRAIN, name), getattr(ground, name))
    np.testing.assert_allclose(TERRAIN.entropy, entropy(OCCUPANCY.astype(float)), atol=1e-6)
    assert TERRAIN.shape == SHAPE
    assert TERRAIN.resolution == 0.25
    np.testing.assert_array_equal(TERRAIN.frame.origin, np.float32(ORIGIN))
    passable = np.asarray(ground.traversability) >= np.float32(0.2)
    assert np.array_equal(TERRAIN.is_drivable, (OCCUPANCY < 0.5) & passable)
    assert TERRAIN.is_drivable.any()
    assert (passable != TERRAIN.is_drivable).any()


@given(st.floats(-3, 5, width=32), st.floats(-5, 3, width=32))
def test_samples(x: float, y: float) -> None:
    dx, dy = x - 1.0, y + 2.0
    c, s = math.cos(0.6), math.sin(0.6)
    row, column = (c * dy - s * dx) / 0.25, (c * dx + s * dy) / 0.25
    if min(abs(row - round(row)), abs(column - round(column))) < 1e-3:
        return
    cell = math.floor(row), math.floor(column)
    sample = TERRAIN.at(jnp.asarray([x, y], jnp.float32))
    if 0 <= row < SHAPE[0] and 0 <= column < SHAPE[1]:
        for name, found in sample._asdict().items():
            assert float(found) == pytest.approx(float(getattr(TERRAIN, name)[cell]), abs=1e-6)
    else:
        assert [float(value) for value in sample] == [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]


def test_nowhere_is_off_the_map() -> None:
    nowhere = jnp.asarray([[math.nan, 0.0], [math.inf, 0.0], [1e30, -1e30]])
    # Cell (0, 0) is free and passable, so that nothing gets by because of its value.
    flat = TerrainMap.from_arrays(np.zeros((2, 2)), np.ones((2, 2)), 1.0, threshold=0.0)
    assert bool(flat.at(jnp.asarray([0.5, 0.5])).is_drivable)
    sample = jax.jit(TerrainMap.at)(flat, nowhere)
    assert (sample.occupancy == 1.0).all()
    assert not any(np.asarray(layer).any() for layer in sample[1:])


def test_scans_change_the_occupancy_and_not_the_ground() -> None:
    traces = []

    @jax.jit
    def scanned(terrain: TerrainMap, probability: jax.Array) -> TerrainMap:
        traces.append(terrain)
        return terrain.with_grid(
            OccupancyGrid(probability, terrain.resolution, terrain.frame.origin)
        )

    for terrain in (TERRAIN, scanned(TERRAIN, jnp.full(SHAPE, 0.25))):
        after = scanned(terrain, jnp.full(SHAPE, 0.5))
        np.testing.assert_allclose(after.entropy, math.log(2), rtol=1e-6)
        assert not after.is_drivable.any()
        for new, old in zip(
            jax.tree.leaves(after.ground), jax.tree.leaves(TERRAIN.ground), strict=True
        ):
            assert np.array_equal(new, old)
    assert len(traces) == 1


@pytest.mark.parametrize(
    ("grid", "named"),
    [
        (OccupancyGrid(np.zeros((9, 6)), 0.25, ORIGIN), "shape (6, 9); accepted: the grid's, (9"),
        (OccupancyGrid(OCCUPANCY, 0.5, ORIGIN), "resolution 0.25; accepted: the grid's, 0.5"),
        (OccupancyGrid(OCCUPANCY, 0.25), "origin (1.0, -2.0, 0.6"),
    ],
)
def test_grids_that_do_not_fit_are_refused(grid: OccupancyGrid, named: str) -> None:
    refused(lambda: TerrainMap(grid, TERRAIN.ground), named)
    refused(lambda: TERRAIN.with_grid(grid), named)


def test_bad_arrays_are_named() -> None:
    refused(lambda: TerrainMap.from_arrays(OCCUPANCY, HEIGHTS.T, 0.25), "shape")
    refused(lambda: TerrainMap.from_arrays(OCCUPANCY, HEIGHTS + np.nan, 0.25), "elevation")
    refused(lambda: TerrainMap.from_arrays(OCCUPANCY + 1, HEIGHTS, 0.25), "probability")
    refused(lambda: TerrainMap.from_arrays(OCCUPANCY, HEIGHTS, 0.25, max_slope=0.0), "max_slope")


# --- images ---------------------------------------------------------------------------------------

GREYS = np.array([[0, 51, 102], [153, 204, 255]], np.uint8)


def picture(path, pixels):
    Image.fromarray(pixels).save(path)
    return path


@pytest.mark.parametrize(
    ("name", "levels", "full"),
    [
        ("h.png", GREYS, 255),
        ("h.pgm", GREYS, 255),
        ("h.png", GREYS.astype(np.uint16) * np.uint16(256), 65535),
        ("h.pgm", GREYS.astype(np.uint16) * np.uint16(256), 65535),
    ],
)
def test_from_images(tmp_path, name: str, levels: np.ndarray, full: int) -> None:
    occupancy = picture(tmp_path / "o.png", GREYS.T.copy().reshape(2, 3))
    heights = picture(tmp_path / name, levels)
    terrain = TerrainMap.from_images(
        occupancy, str(heights), 0.5, (1.0, 2.0, 0.25), elevation_scale=2.0, threshold=0.5
    )
    expected = np.float64(GREYS.T.copy().reshape(2, 3)[::-1]) / 255
    np.testing.assert_allclose(terrain.occupancy, expected, rtol=1e-6)
    np.testing.assert_allclose(terrain.elevation, 2.0 * levels[::-1] / full, rtol=1e-6)
    assert terrain.resolution == 0.5
    assert np.array_equal(terrain.frame.origin, [1.0, 2.0, 0.25])
    assert float(terrain.ground.threshold) == 0.5


def test_defaults_and_transparent_pixels_of_images(tmp_path) -> None:
    heights = picture(tmp_path / "h.png", np.array([[0, 255]], np.uint8))
    clear = picture(tmp_path / "o.png", np.array([[[0, 255], [255, 0]]], np.uint8))
    terrain = TerrainMap.from_images(clear, heights)
    assert np.array_equal(terrain.occupancy, [[0.0, 0.5]])
    assert np.array_equal(terrain.elevation, [[0.0, 5.0]])
    assert terrain.resolution == 0.1
    refused(lambda: TerrainMap.from_images(heights, clear), clear, "transparent")


def test_images_refused(tmp_path) -> None:
    occupancy = picture(tmp_path / "o.png", GREYS)
    heights = picture(tmp_path / "h.png", GREYS.T.copy())
    refused(lambda: TerrainMap.from_images(occupancy, heights), heights, "2 x 3", "3 x 2")
    absent = tmp_path / "absent.png"
    refused(lambda: TerrainMap.from_images(occupancy, absent), absent)
    refused(lambda: TerrainMap.from_images(absent, heights), absent)
    for scale in (0.0, math.nan, 1e9):
        refused(
            lambda s=scale: TerrainMap.from_images(occupancy, occupancy, elevation_scale=s),
            f"elevation_scale is {scale}",
        )


def test_from_ros(tmp_path) -> None:
    probability = np.array([[0.0, 0.5, 1.0], [1.0, 0.0, 0.0]], np.float32)
    OccupancyGrid(probability, 0.05, ORIGIN).to_ros(tmp_path / "map.yaml")
    heights = picture(tmp_path / "h.png", GREYS)
    terrain = TerrainMap.from_ros(
        tmp_path / "map.yaml", heights, elevation_scale=1.0, max_slope=9.0
    )
    assert np.array_equal(terrain.occupancy, probability)
    np.testing.assert_allclose(terrain.elevation, GREYS[::-1] / 255, rtol=1e-6)
    np.testing.assert_array_equal(terrain.frame.origin, np.float32(ORIGIN))
    assert terrain.resolution == 0.05
    assert float(terrain.ground.max_slope) == 9.0
    tall = picture(tmp_path / "tall.png", GREYS.T.copy())
    refused(lambda: TerrainMap.from_ros(tmp_path / "map.yaml", tall), tall, "2 x 3", "3 x 2")
    refused(lambda: TerrainMap.from_ros(tmp_path / "no.yaml", heights), tmp_path / "no.yaml")


# --- other resolutions ----------------------------------------------------------------------------


@pytest.mark.parametrize("resolution", [0.05, 0.1, 0.125, 0.25, 0.3, 0.5, 0.6])
def test_a_plane_stays_one(resolution: float) -> None:
    y, x = (0.25 * (np.arange(n) + 0.5) for n in (12, 24))
    fine = TerrainMap.from_arrays(np.zeros((12, 24)), 0.3 * y[:, None] - 0.2 * x[None], 0.25)
    other = fine.resample(resolution)
    assert other.resolution == resolution
    assert other.shape == (round(3 / resolution), round(6 / resolution))
    new_y, new_x = (resolution * (np.arange(n) + 0.5) for n in other.shape)
    np.testing.assert_allclose(other.elevation, 0.3 * new_y[:, None] - 0.2 * new_x[None], atol=1e-6)
    np.testing.assert_allclose(other.slope, math.hypot(0.3, 0.2), atol=1e-4)
    np.testing.assert_allclose(other.roughness, 0.0, atol=1e-6)


def test_the_same_resolution_is_the_same_map() -> None:
    for terrain in (TERRAIN, GIVEN):
        same = terrain.resample(0.25)
        leaves = zip(jax.tree.leaves(same), jax.tree.leaves(terrain), strict=True)
        assert all(np.array_equal(new, old) for new, old in leaves)


def test_coarser_by_a_whole_number_is_the_mean() -> None:
    coarse = TERRAIN.resample(0.75)
    expected = HEIGHTS.astype(float).reshape(2, 3, 3, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(coarse.elevation, expected, atol=1e-6)
    assert np.array_equal(coarse.occupancy, TERRAIN.grid.resample(0.75).probability)
    again = Ground(expected, 0.75, max_slope=1.25, max_roughness=0.4)
    np.testing.assert_allclose(coarse.traversability, again.traversability, atol=1e-5)
    assert float(coarse.ground.threshold) == np.float32(0.2)
    np.testing.assert_array_equal(coarse.frame.origin, TERRAIN.frame.origin)


@pytest.mark.parametrize("resolution", [0.1, 0.25, 0.4, 0.5, 0.6, 1.0, 100.0])
def test_a_traversability_that_was_given_becomes_the_least(resolution: float) -> None:
    coarse = GIVEN.resample(resolution)
    assert coarse.ground.is_given
    for cell in np.ndindex(*coarse.shape):
        low = [round(n * resolution / 0.25, 9) for n in cell]
        high = [round((n + 1) * resolution / 0.25, 9) for n in cell]
        rows, columns = (slice(math.floor(a), math.ceil(b)) for a, b in zip(low, high, strict=True))
        assert coarse.traversability[cell] == PASSABLE[rows, columns].min()


@pytest.mark.parametrize("resolution", [0.07, 0.4, 1.0, 5.0, 1e30])
def test_no_elevation_is_invented(resolution: float) -> None:
    other = TERRAIN.resample(resolution)
    # Half a cell at the edge is extrapolated, by at most half the greatest step each way.
    spread = HEIGHTS.max() - HEIGHTS.min()
    assert np.max(np.asarray(other.elevation)) <= HEIGHTS.max() + 1.5 * spread
    assert np.min(np.asarray(other.elevation)) >= HEIGHTS.min() - 1.5 * spread
    if other.shape == (1, 1):
        assert float(other.elevation[0, 0]) == pytest.approx(HEIGHTS.mean(), abs=1e-6)


def test_resampling_maps_one_cell_wide() -> None:
    line = TerrainMap.from_arrays(np.zeros((1, 4)), np.array([[0.0, 1.0, 2.0, 3.0]]), 0.5)
    np.testing.assert_allclose(
        line.resample(0.25).elevation, np.tile(np.arange(8) / 2 - 0.25, (2, 1)), atol=1e-6
    )
    np.testing.assert_allclose(line.resample(1.0).elevation, [[0.5, 2.5]], atol=1e-6)


def test_resolutions_refused() -> None:
    for resolution in (0.0, -1.0, math.nan, 1e-9):
        refused(lambda r=resolution: TERRAIN.resample(r), "resolution is")


# --- files ----------------------------------------------------------------------------------------


def test_a_saved_map_comes_back_to_the_bit(tmp_path) -> None:
    bare = TerrainMap.from_arrays(OCCUPANCY, HEIGHTS, 0.1)
    compiled = jax.jit(lambda h: TerrainMap.from_arrays(OCCUPANCY, h, 0.1))(jnp.asarray(HEIGHTS))
    zero = np.full((1, 1), -0.0)
    minus = TerrainMap.from_arrays(zero, zero, 0.3, (-0.0, 0.0, 0.0), traversability=zero)
    for terrain in (TERRAIN, GIVEN, bare, compiled, minus):
        terrain.save(tmp_path / "a map.npz")
        back = TerrainMap.load(str(tmp_path / "a map.npz"))
        assert jax.tree.structure(back) == jax.tree.structure(terrain)
        assert back.resolution == terrain.resolution
        for new, old in zip(jax.tree.leaves(back), jax.tree.leaves(terrain), strict=True):
            assert new.dtype == old.dtype
            assert np.asarray(new).tobytes() == np.asarray(old).tobytes()
    assert os.listdir(tmp_path) == ["a map.npz"]


def test_a_failed_write_leaves_what_was_there(tmp_path, monkeypatch) -> None:
    TERRAIN.save(tmp_path / "map.npz")
    before = (tmp_path / "map.npz").read_bytes()

    def denied(*args):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(_files.os, "replace", denied)
    with pytest.raises(PermissionError):
        GIVEN.save(tmp_path / "map.npz")
    assert os.listdir(tmp_path) == ["map.npz"]
    assert (tmp_path / "map.npz").read_bytes() == before


def test_what_could_not_be_read_back_is_not_written(tmp_path) -> None:
    bad = jax.jit(lambda p: TerrainMap.from_arrays(p, HEIGHTS, 0.1))(jnp.full(SHAPE, jnp.nan))
    refused(lambda: bad.save(tmp_path / "map.npz"), tmp_path / "map.npz", "probability")
    refused(lambda: TERRAIN.save(tmp_path / "map.npy"), "map.npy", "ends in .npz")
    assert not os.listdir(tmp_path)


@pytest.fixture(scope="module")
def saved(tmp_path_factory) -> bytes:
    path = tmp_path_factory.mktemp("terrain") / "map.npz"
    TERRAIN.save(path)
    return path.read_bytes()


def packed(saved: bytes, /, drop=(), **changes) -> bytes:
    with np.load(io.BytesIO(saved)) as file:
        arrays = {name: value for name, value in file.items() if name not in drop}
    stream = io.BytesIO()
    np.savez(stream, **{**arrays, **changes})
    return stream.getvalue()


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"drop": ["elevation"]}, "lacks elevation"),
        ({"more": np.zeros(3)}, "holds more"),
        ({"elevation": HEIGHTS.astype(np.float64)}, "elevation has shape (6, 9) and type float64"),
        ({"elevation": HEIGHTS[0]}, "elevation has shape (9,)"),
        ({"elevation": HEIGHTS[:0]}, "elevation has shape (0, 9)"),
        ({"elevation": HEIGHTS[:2]}, "layers have the shapes"),
        ({"elevation": HEIGHTS * np.float32(np.nan)}, "elevation spans"),
        ({"elevation": np.array([[{}, 1.0]])}, "elevation has shape"),
        ({"probability": OCCUPANCY + np.float32(1)}, "probability spans"),
        ({"slope": HEIGHTS}, "slope has values that are negative"),
        ({"roughness": np.full(SHAPE, np.float32(np.inf))}, "roughness has values"),
        ({"traversability": HEIGHTS * np.float32(9)}, "traversability spans"),
        ({"origin": np.zeros(4, np.float32)}, "origin is"),
        ({"origin": np.full(3, np.nan, np.float32)}, "origin is"),
        ({"resolution": np.float64(0)}, "resolution is 0.0"),
        ({"resolution": np.float64(np.nan)}, "resolution is nan"),
        ({"threshold": np.float32(2)}, "threshold is 2.0"),
        ({"max_slope": np.float32(0)}, "max_slope is 0.0"),
        ({"max_roughness": np.float32(-1)}, "max_roughness is -1.0"),
        ({"is_given": np.float32(1)}, "is_given has shape"),
    ],
)
def test_contents_refused(tmp_path, saved, changes, named: str) -> None:
    path = tmp_path / "map.npz"
    path.write_bytes(packed(saved, **changes))
    refused(lambda: TerrainMap.load(path), path, named)


def test_a_layer_by_columns_is_read_as_what_it_is(tmp_path, saved) -> None:
    path = tmp_path / "map.npz"
    path.write_bytes(packed(saved, elevation=np.asfortranarray(HEIGHTS)))
    np.testing.assert_array_equal(TerrainMap.load(path).elevation, HEIGHTS)


def header(shape: tuple[int, ...]) -> bytes:
    stream = io.BytesIO()
    description = {"descr": "<f4", "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(stream, description)
    return stream.getvalue()


@pytest.mark.parametrize(
    ("elevation", "named"),
    [
        (header((10**6, 10**6)), "elevation has shape (1000000, 1000000)"),
        (header((8001, 8001)), f"not 1 to {CELL_LIMIT} cells"),
        (header((-6, -9)) + bytes(216), "not a terrain map"),
        (header((6, 9)) + bytes(215), "more or fewer values"),
        (header((6, 9)) + bytes(10**7), "more or fewer values"),
        (header((6, 9))[:20], "not a terrain map"),
        (b"\x93NUMPY\x03\x00" + bytes(300), "another version"),
        (b"", "not a terrain map"),
        (pickle.dumps([1.0]), "not a terrain map"),
    ],
)
def test_arrays_that_are_malformed_or_too_large_are_refused(tmp_path, saved, elevation, named):
    path = tmp_path / "map.npz"
    with (
        zipfile.ZipFile(io.BytesIO(saved)) as before,
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as after,
    ):
        for name in before.namelist():
            after.writestr(name, elevation if name == "elevation.npy" else before.read(name))
    refused(lambda: TerrainMap.load(path), path, named)


def test_files_refused(tmp_path, saved) -> None:
    path = tmp_path / "map.npz"
    flipped = bytearray(saved)
    flipped[len(saved) // 2] ^= 0xFF
    twice = io.BytesIO(saved)
    with zipfile.ZipFile(twice, "a") as archive, pytest.warns(UserWarning, match="Duplicate"):
        archive.writestr("origin.npy", b"")
    squeezed = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(saved)) as a, zipfile.ZipFile(squeezed, "w", 14) as b:
        for name in a.namelist():
            b.writestr(name, a.read(name))
    for data in (
        b"",
        b"PK\x03\x04",
        saved[:-30],
        saved[30:],
        bytes(flipped),
        twice.getvalue(),
        squeezed.getvalue(),
        pickle.dumps({"elevation": 1}),
        b"\x80\x04." * 100,
    ):
        path.write_bytes(data)
        refused(lambda: TerrainMap.load(path), path, "not a terrain map")
    os.mkfifo(tmp_path / "pipe.npz")
    for name in ("absent.npz", "pipe.npz", "."):
        refused(lambda n=name: TerrainMap.load(tmp_path / n), "not there or not a file")
