import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore.maps.ground import Ground

RNG = np.random.default_rng(0)
SHAPE = (7, 11)
BUMPS = RNG.normal(0.0, 0.2, SHAPE)


def plane(rise_x: float, rise_y: float, height: float, resolution: float) -> np.ndarray:
    """Return the elevation of a plane at the cells' centres."""
    y, x = (resolution * (np.arange(n) + 0.5) for n in SHAPE)
    return height + rise_x * x[None, :] + rise_y * y[:, None]


def extended(elevation: np.ndarray) -> np.ndarray:
    """Go on in a straight line by one cell on each side."""
    for axis in (0, 1):
        z = np.moveaxis(elevation, axis, 0)
        first, last = (2 * z[0] - z[1], 2 * z[-1] - z[-2]) if len(z) > 1 else (z[0], z[0])
        elevation = np.moveaxis(np.concatenate([first[None], z, last[None]]), 0, axis)
    return elevation


def roughness_by_least_squares(elevation: np.ndarray) -> np.ndarray:
    padded = extended(np.asarray(elevation, np.float64))
    y, x = np.mgrid[-1:2, -1:2]
    design = np.stack([np.ones(9), x.ravel(), y.ravel()], axis=-1)
    rough = np.empty(elevation.shape)
    for row, column in np.ndindex(*elevation.shape):
        z = padded[row : row + 3, column : column + 3].ravel()
        solution = np.linalg.lstsq(design, z, rcond=None)[0]
        rough[row, column] = math.sqrt(np.mean((z - design @ solution) ** 2))
    return rough


@pytest.mark.parametrize("resolution", [0.05, 0.25, 1.0])
@given(st.floats(-2, 2), st.floats(-math.pi, math.pi), st.floats(-10, 10))
def test_a_plane_has_its_slope_and_no_roughness(
    resolution: float, rise: float, direction: float, height: float
) -> None:
    rises = rise * math.cos(direction), rise * math.sin(direction)
    ground = Ground(plane(*rises, height, resolution), resolution)
    # What float32 makes of the elevation, at most 10 + 2 * 11 * 1.5 m, over two cells.
    rounding = 4e-6 * (abs(height) + 20 * abs(rise) * resolution)
    np.testing.assert_allclose(ground.slope, abs(rise), atol=1e-6 + rounding / resolution)
    np.testing.assert_allclose(ground.roughness, 0.0, atol=rounding)


def test_the_slope_of_an_exact_plane_is_exact() -> None:
    ground = Ground(plane(0.75, -1.0, 512.0, 0.25), 0.25)
    assert np.array_equal(ground.slope, np.full(SHAPE, 1.25))
    assert np.array_equal(ground.roughness, np.zeros(SHAPE))


@pytest.mark.parametrize("shape", [SHAPE, (2, 2), (1, 6), (6, 1), (1, 1)])
def test_slope_equals_numpy(shape: tuple[int, int]) -> None:
    elevation = RNG.normal(0.0, 1.0, shape).astype(np.float32)
    rises = [
        np.gradient(elevation.astype(np.float64), 0.25, axis=axis)
        if shape[axis] > 1
        else np.zeros(shape)
        for axis in (0, 1)
    ]
    np.testing.assert_allclose(Ground(elevation, 0.25).slope, np.hypot(*rises), rtol=1e-5)


@pytest.mark.parametrize("resolution", [0.05, 0.25])
def test_the_slope_of_a_cone(resolution: float) -> None:
    # z = s r: central differences are off by (n^2 / 6) d^3 z = s n^2 / (2 r^2) at most, or so.
    n = np.arange(41) - 20.0
    radius = resolution * np.hypot(n[:, None], n[None, :])
    far = radius[1:-1, 1:-1] > 5 * resolution
    slope = np.asarray(Ground(0.4 * radius, resolution).slope)[1:-1, 1:-1]
    np.testing.assert_allclose(slope[far], 0.4, rtol=0.5 / 25 + 1e-4)
    very_far = radius[1:-1, 1:-1] > 18 * resolution
    np.testing.assert_allclose(slope[very_far], 0.4, rtol=0.5 / 18**2 + 1e-4)


@pytest.mark.parametrize("shape", [SHAPE, (2, 2), (1, 6), (6, 1), (1, 1)])
def test_roughness_equals_least_squares(shape: tuple[int, int]) -> None:
    elevation = RNG.normal(0.0, 0.3, shape).astype(np.float32)
    expected = roughness_by_least_squares(elevation)
    np.testing.assert_allclose(Ground(elevation, 0.1).roughness, expected, rtol=1e-4, atol=1e-7)


def test_roughness_of_a_spike_on_a_high_slope() -> None:
    spike = plane(0.5, -0.25, 1024.0, 0.25)
    spike[3, 5] += 0.5
    found = Ground(spike, 0.25).roughness
    np.testing.assert_allclose(found, roughness_by_least_squares(spike), atol=1e-6)
    # In its middle the plane takes a ninth of the spike: 8 of 1/9 and one of 8/9.
    assert float(found[3, 5]) == pytest.approx(0.5 * math.sqrt(8) / 9)


@pytest.mark.parametrize("step", [(-1, 1), (1, -1), (-1, -1)])
def test_turning_the_map_turns_the_layers(step: tuple[int, int]) -> None:
    def turned(layer: np.ndarray) -> np.ndarray:
        return layer[:: step[0], :: step[1]]

    ground = Ground(BUMPS, 0.25, max_slope=4.0)
    other = Ground(turned(BUMPS), 0.25, max_slope=4.0)
    for name in ("slope", "roughness", "traversability"):
        np.testing.assert_allclose(
            getattr(other, name), turned(np.asarray(getattr(ground, name))), rtol=1e-4, atol=1e-6
        )


def test_traversability() -> None:
    ground = Ground(BUMPS, 0.25, max_slope=1.5, max_roughness=0.3)
    slope, rough = np.asarray(ground.slope, float), np.asarray(ground.roughness, float)
    expected = np.clip(1 - slope / 1.5, 0, 1) * np.clip(1 - rough / 0.3, 0, 1)
    assert (expected == 0).any()
    assert (expected > 0.3).any()
    np.testing.assert_allclose(ground.traversability, expected, atol=1e-6)
    assert np.array_equal(ground.is_traversable, np.asarray(ground.traversability) >= 0.3)
    smooth = Ground(BUMPS, 0.25, max_slope=1.5)
    np.testing.assert_allclose(smooth.traversability, np.clip(1 - slope / 1.5, 0, 1), atol=1e-6)


def test_a_traversability_that_is_given_holds() -> None:
    given_layer = RNG.random(SHAPE).astype(np.float32)
    ground = Ground(BUMPS, 0.25, traversability=given_layer, max_roughness=0.1, threshold=0.6)
    assert np.array_equal(ground.traversability, given_layer)
    assert np.array_equal(ground.is_traversable, given_layer >= np.float32(0.6))
    assert ground.is_given
    assert not Ground(BUMPS, 0.25).is_given


GROUND = Ground(BUMPS, 0.25, (1.0, -2.0, 0.6), max_slope=3.0)
LAYERS = ("elevation", "slope", "roughness", "traversability")


@given(st.floats(-4, 6, width=32), st.floats(-6, 4, width=32))
def test_look_up_in_a_rotated_map(x: float, y: float) -> None:
    dx, dy = x - 1.0, y + 2.0
    c, s = math.cos(0.6), math.sin(0.6)
    row, column = (c * dy - s * dx) / 0.25, (c * dx + s * dy) / 0.25
    if min(abs(row - round(row)), abs(column - round(column))) < 1e-3:
        return
    cell = math.floor(row), math.floor(column)
    inside = 0 <= row < SHAPE[0] and 0 <= column < SHAPE[1]
    sample = GROUND.at(jnp.asarray([x, y], jnp.float32))
    for name in LAYERS:
        expected = float(getattr(GROUND, name)[cell]) if inside else 0.0
        assert float(getattr(sample, name)) == expected
    assert bool(GROUND.contains(jnp.asarray(cell))) == inside
    assert float(GROUND.elevation_at_cell(jnp.asarray(cell))) == float(sample.elevation)


@pytest.mark.parametrize(
    "point", [(math.nan, 0.0), (1.1, math.nan), (math.inf, 0.0), (1.0, -math.inf), (1e30, 1e30)]
)
def test_nowhere_is_off_the_map(point: tuple[float, float]) -> None:
    sample = GROUND.at(jnp.asarray([point, (1e30, -1e30)]))
    assert all((np.asarray(layer) == 0.0).all() for layer in sample)
    assert float(GROUND.traversability_field(jnp.asarray(point))) == 0.0


def test_fields_are_the_layers_at_the_cells_centres() -> None:
    cells = jnp.stack(jnp.mgrid[: SHAPE[0], : SHAPE[1]], axis=-1).reshape(-1, 2)
    points = GROUND.frame.cell_centre(cells)
    outside = jnp.asarray([-50.0, 3.0])
    for name in LAYERS:
        field = getattr(GROUND, f"{name}_field")
        found = jax.vmap(field)(points)
        np.testing.assert_allclose(found, np.ravel(getattr(GROUND, name)), atol=1e-5)
        assert float(field(outside)) == 0.0


def test_another_ground_does_not_compile_again() -> None:
    traces = []

    @jax.jit
    def elevation_below(ground: Ground) -> jax.Array:
        traces.append(ground)
        return ground.at(jnp.asarray([0.1, 0.1])).elevation

    for height in (1.0, 2.0):
        ground = Ground(BUMPS + height, 0.25, threshold=0.1 * height, max_slope=height)
        assert float(elevation_below(ground)) == float(ground.elevation[0, 0])
    assert len(traces) == 1


def test_made_in_a_trace_it_is_the_same_and_contains_what_is_no_number() -> None:
    @jax.jit
    def make(elevation: jax.Array, traversability: jax.Array) -> tuple[Ground, Ground]:
        made = Ground(elevation, 0.25, max_slope=elevation[0, 0] + 3.0, max_roughness=0.5)
        return made, Ground(elevation, 0.25, traversability=traversability)

    elevation = jnp.asarray(BUMPS, jnp.float32).at[0, 0].set(0.0)
    made, _ = make(elevation, elevation)
    expected = Ground(elevation, 0.25, max_slope=3.0, max_roughness=0.5)
    for name in LAYERS:
        np.testing.assert_allclose(getattr(made, name), getattr(expected, name), atol=1e-5)

    for odd in (jnp.nan, jnp.inf, -1e30):
        for ground in make(elevation.at[2, 3].set(odd), elevation.at[4, 4].set(odd)):
            for name in LAYERS:
                assert np.isfinite(getattr(ground, name)).all()
            assert float(ground.traversability[2, 3]) == 0.0
            assert ((ground.traversability >= 0.0) & (ground.traversability <= 1.0)).all()


def test_derivatives_by_the_elevation_are_finite_on_the_level() -> None:
    def total(elevation: jax.Array) -> jax.Array:
        ground = Ground(elevation, 0.25)
        return jnp.sum(ground.slope) + jnp.sum(ground.roughness)

    assert np.isfinite(jax.grad(total)(jnp.ones(SHAPE))).all()
    assert np.isfinite(jax.grad(total)(jnp.asarray(BUMPS, jnp.float32))).all()


LEVEL = np.zeros((2, 3))


@pytest.mark.parametrize(
    ("elevation", "options", "culprit"),
    [
        (np.zeros((0, 3)), {}, r"elevation has shape \(0, 3\)"),
        (np.zeros(3), {}, r"elevation has shape \(3,\)"),
        (LEVEL, {"traversability": np.zeros((3, 2))}, r"traversability has shape \(3, 2\)"),
        (LEVEL, {"traversability": np.full((2, 3), 1.5)}, "traversability spans 1.5"),
        (LEVEL, {"traversability": np.full((2, 3), math.nan)}, "traversability spans nan"),
    ],
)
def test_bad_input_is_named(elevation, options, culprit: str) -> None:
    with pytest.raises(ValueError, match=culprit) as error:
        Ground(elevation, **{"resolution": 0.1, **options})
    assert "accepted" in str(error.value)
