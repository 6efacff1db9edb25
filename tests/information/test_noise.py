"""Range noise against the matrix G in double precision, and FSMI's double sum over it."""

import functools
import math
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import ndtr

from jaxplore import InverseSensorModel
from jaxplore.information.beam import beam_information, cell_information
from jaxplore.information.noise import GaussianNoise, RangeNoise, ToeplitzNoise, UniformNoise

pytestmark = pytest.mark.long

MODEL = InverseSensorModel()
SIZES = pytest.mark.parametrize("n", [1, 7, 200])


@functools.partial(jax.jit, static_argnames=("no_return",))
def total_and_parts(p, noise, edges=None, no_return=True):
    given = {"noise": noise, "edges": edges, "no_return": no_return}
    return beam_information(p, MODEL, **given), cell_information(p, MODEL, **given)


@functools.partial(jax.jit, static_argnames=("cell_size",))
def measured(noise, hit, edges, cell_size=None):
    return noise.apply(hit, edges, cell_size)


def normal_matrix(edges: np.ndarray, std: float, within: float = math.inf) -> np.ndarray:
    """Return G[k, j] = P(reading in k | hit in j), of cells some part of which is `within`."""
    away = edges[:, None] - 0.5 * (edges[1:] + edges[:-1])
    near = (away[:-1] <= within) & (away[1:] >= -within)
    return np.where(near, np.diff(ndtr(away / std), axis=0), 0.0)


def step_matrix(weights: list[float] | np.ndarray, n: int) -> np.ndarray:
    """Return G[k, j] = g(k - j)."""
    half = len(weights) // 2
    return sum(g * np.eye(n, k=half - i) for i, g in enumerate(weights))


def gain(p: np.ndarray, change: float) -> np.ndarray:
    """Return KL(posterior || prior) of an update through the clamp."""
    before = np.clip(np.log(p / (1 - p)), -7, 5)
    q, prior = (1 / (1 + np.exp(-x)) for x in (np.clip(before + change, -7, 5), before))
    return q * np.log(q / prior) + (1 - q) * np.log((1 - q) / (1 - prior))


def double_sum(p: np.ndarray, matrix: np.ndarray, no_return: bool) -> tuple[float, np.ndarray]:
    """Return theory 1's double sum over hits and readings, and what each cell has in it."""
    reach = np.concatenate([[1.0], np.cumprod(1 - p)])
    hit, occupied, free = p * reach[:-1], gain(p, 2.0), gain(p, -2.0)
    # worth[i, k]: what cell i gains from a reading in cell k
    worth = np.diag(occupied) + np.triu(np.repeat(free[:, None], len(p), axis=1), 1)
    parts = worth @ (matrix @ hit)
    potential = occupied + np.cumsum(free) - free
    total = sum(hit[j] * (matrix[:, j] @ potential) for j in range(len(p)))
    return total + no_return * reach[-1] * free.sum(), parts + no_return * reach[-1] * free


def ray_edges(angle: float, start: np.ndarray, n: int) -> np.ndarray:
    """Return the distances at which a ray over a grid of unit cells enters its n cells."""
    steps = np.arange(1, 2 * n + 2)
    lines = [
        (steps - x) / u for x, u in zip(start, (math.cos(angle), math.sin(angle)), strict=True)
    ]
    return np.concatenate([[0.0], np.sort(np.concatenate(lines))[:n]])


def random_line(seed: int, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return probabilities, some low so that the beam goes far, and a ray's edges."""
    rng = np.random.default_rng(seed)
    p = rng.uniform(0.01, 0.99, n) if seed % 2 else rng.choice([0.002, 0.02, 0.1, 0.5, 0.9], n)
    edges = ray_edges(rng.uniform(0.05, math.pi / 2 - 0.05), rng.uniform(0, 1, 2), n)
    return p.astype(np.float32), edges.astype(np.float32)


def check(p: np.ndarray, noise: RangeNoise, matrix: np.ndarray, edges=None, no_return=True) -> None:
    edges = None if edges is None else jnp.asarray(edges)
    found, found_parts = total_and_parts(jnp.asarray(p), noise, edges, no_return=no_return)
    total, parts = double_sum(p.astype(float), matrix, no_return)
    assert total == pytest.approx(parts.sum(), rel=1e-12)
    assert float(found) == pytest.approx(total, rel=2e-5)
    np.testing.assert_allclose(found_parts, parts, rtol=1e-4, atol=1e-7)
    assert float(found_parts.sum()) == pytest.approx(float(found), rel=1e-5)
    assert float(found_parts.min()) >= 0.0


@SIZES
@pytest.mark.parametrize("truncation", [None, 1.5, 4.0])
def test_gaussian_noise_is_the_double_sum(n: int, truncation: float | None) -> None:
    std = 0.75
    noise = GaussianNoise(std, truncation)
    within = math.inf if truncation is None else truncation * std
    for seed in range(3):
        p, edges = random_line(seed, n)
        check(p, noise, normal_matrix(np.arange(n + 1.0), std, within))
        check(p, noise, normal_matrix(edges.astype(float), std, within), edges)


@SIZES
def test_toeplitz_noise_is_the_double_sum(n: int) -> None:
    lopsided = [0.05, 0.1, 0.5, 0.3, 0.0, 0.02, 0.01]
    for seed in range(3):
        p, _ = random_line(seed, n)
        check(p, ToeplitzNoise(lopsided), step_matrix(lopsided, n), no_return=seed > 0)


@SIZES
@pytest.mark.parametrize("half_width", [0, 5])
def test_uniform_noise_is_the_double_sum(n: int, half_width: int) -> None:
    weights = np.full(2 * half_width + 1, 1 / (2 * half_width + 1))
    for seed in range(3):
        p, _ = random_line(seed, n)
        check(p, UniformNoise(half_width), step_matrix(weights, n))


def test_noise_spreads_any_hits() -> None:
    """`apply` itself is linear: not only distributions of a first hit."""
    hit, edges = np.random.default_rng(1).uniform(0, 1, 50).astype(np.float32), np.arange(51.0)
    for noise, matrix in (
        (GaussianNoise(2.0), normal_matrix(edges, 2.0)),
        (ToeplitzNoise([0.1, 0.6, 0.3]), step_matrix([0.1, 0.6, 0.3], 50)),
        (UniformNoise(60), np.full((50, 50), 1 / 121)),
    ):
        found = measured(noise, jnp.asarray(hit), jnp.asarray(edges, jnp.float32))
        np.testing.assert_allclose(found, matrix @ hit, rtol=2e-5)


@given(st.floats(0.0, math.pi / 2), st.integers(0, 2**16))
def test_a_grids_cell_size_narrows_the_band_without_losing_a_pair(angle: float, seed: int) -> None:
    """The static band must hold every cell in reach, whatever the ray's direction."""
    rng = np.random.default_rng(seed)
    angle = min(max(angle, 1e-3), math.pi / 2 - 1e-3)
    size = 0.1
    edges = (size * ray_edges(angle, rng.uniform(0.01, 0.99, 2), 50)).astype(np.float32)
    hit = jnp.asarray(rng.uniform(0, 1, 50), jnp.float32)
    for noise in (GaussianNoise(0.021, 2.0), GaussianNoise(0.13, 3.0), GaussianNoise(0.31, 4.0)):
        narrow = measured(noise, hit, jnp.asarray(edges), cell_size=size)
        whole = measured(noise, hit, jnp.asarray(edges))
        np.testing.assert_allclose(narrow, whole, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize(
    ("std", "truncation"),
    [
        *((std, 4.0) for std in (0.05, 0.13, 0.24, 0.7, 3.0)),
        *((std, 2.0) for std in (0.13, 0.7, 3.0)),
        *((std, 1.0) for std in (0.49, 1.1)),
    ],
)
def test_truncation_loses_less_than_the_tail(std: float, truncation: float) -> None:
    """Whole cells are kept, so what is lost begins behind the last one that begins in reach."""
    hit, edges, bound = jnp.zeros(60).at[30].set(1.0), jnp.arange(61.0), 2 * ndtr(-truncation)
    kept = math.floor(truncation * std + 0.5) + 0.5
    for noise in (GaussianNoise(std, truncation), ToeplitzNoise.gaussian(std, 1.0, truncation)):
        lost = 1.0 - float(measured(noise, hit, edges, cell_size=1.0).sum())
        assert lost < bound
        assert lost == pytest.approx(2 * ndtr(-kept / std), rel=1e-3, abs=1e-6)
    for angle in (0.1, 0.6, math.pi / 4, 1.3):
        edges = ray_edges(angle, np.asarray([0.3, 0.55]), 60).astype(np.float32)
        noise = GaussianNoise(std, truncation)
        lost = 1.0 - float(measured(noise, hit, jnp.asarray(edges), cell_size=1.0).sum())
        assert -1e-5 < lost < bound


def test_toeplitz_gaussian_scales_with_the_cell() -> None:
    one, other = ToeplitzNoise.gaussian(0.6), ToeplitzNoise.gaussian(0.03, cell_size=0.05)
    np.testing.assert_allclose(one.weights, other.weights, rtol=1e-5)
    tails = ndtr((np.arange(-2, 4) - 0.5) / 0.6)
    np.testing.assert_allclose(one.weights, np.diff(tails), rtol=1e-5)
    assert ToeplitzNoise.gaussian(0.3, 0.1, 2.0).weights.shape == (13,)


@given(st.floats(0.02, 3.0), st.integers(0, 2**16))
@settings(max_examples=30)
def test_readings_are_at_most_as_many_as_hits(std: float, seed: int) -> None:
    _, edges = random_line(seed, 50)
    hit = jnp.zeros(50).at[seed % 50].set(1.0)
    readings = np.asarray(measured(GaussianNoise(std), hit, jnp.asarray(edges)))
    assert readings.sum() <= 1.0 + 1e-5
    assert readings.min() >= -2e-7


def test_readings_in_very_short_cells_are_not_negative() -> None:
    spacing = np.spacing(np.float32(1.41))
    edges = np.append(np.float32(-1.4140625) + 2 * spacing * np.arange(200), [-1.0, 1.0])
    hit = jnp.zeros(201).at[200].set(1.0)
    readings = measured(GaussianNoise(1.0), hit, jnp.asarray(edges, jnp.float32))
    assert float(readings.min()) >= 0.0


def test_a_batch_of_beams_is_each_beam() -> None:
    lines = [random_line(seed, 7) for seed in range(6)]
    p, edges = (jnp.stack([jnp.asarray(line[i]) for line in lines]) for i in (0, 1))
    for noise in (GaussianNoise(0.75, 1.5), UniformNoise(1)):
        batch = jax.jit(jax.vmap(lambda p, edges, noise=noise: total_and_parts(p, noise, edges)[1]))
        found = batch(p, edges)
        for row, beam in enumerate(zip(p, edges, strict=True)):
            expected = total_and_parts(beam[0], noise, beam[1])[1]
            np.testing.assert_allclose(found[row], expected, rtol=1e-5, atol=1e-7)


def test_a_batch_of_deviations_is_each_deviation() -> None:
    """A standard deviation may be traced, so noise can be fitted or swept."""
    p, stds = jnp.full(7, 0.2), jnp.asarray([0.2, 0.4, 0.5, 0.8, 1.0])

    def value(std):
        return total_and_parts(p, GaussianNoise(std))[0]

    found, slopes = jax.jit(jax.vmap(jax.value_and_grad(value)))(stds)
    alone = jax.jit(value)
    expected = [alone(std) for std in np.asarray(stds)]
    np.testing.assert_allclose(found, expected, rtol=1e-5)
    slope = slopes[2]
    below, above = (
        double_sum(np.full(7, 0.2), normal_matrix(np.arange(8.0), std), True)[0]
        for std in (0.4999, 0.5001)
    )
    assert float(slope) == pytest.approx((above - below) / 2e-4, rel=1e-3)


def test_other_numbers_do_not_retrace() -> None:
    traces = []

    @jax.jit
    def value(p: jax.Array, sensor: InverseSensorModel, noise: RangeNoise | None) -> jax.Array:
        traces.append(noise)
        return beam_information(p, sensor, noise=noise)

    sensors = (
        MODEL,
        InverseSensorModel.from_odds(),
        InverseSensorModel.from_odds(3.0, 0.2, clamp=(-4, 4)),
    )
    banded = GaussianNoise(0.5, 4.0)
    for noises in (
        (None,),
        (GaussianNoise(0.3), GaussianNoise(jnp.float32(0.8)), GaussianNoise(1)),
        (ToeplitzNoise.gaussian(0.6), ToeplitzNoise([0.0, 0.2, 0.5, 0.2, 0.0])),
        # The width of a band is static, the deviation within it is not.
        (banded, eqx.tree_at(lambda noise: noise.std, banded, jnp.float32(0.4))),
    ):
        before = len(traces)
        values = {
            float(value(jnp.full(7, 0.3), sensor, noise)) for noise in noises for sensor in sensors
        }
        assert len(traces) == before + 1
        assert len(values) == len(sensors) * len(noises)


@pytest.mark.parametrize(
    "build", [lambda: GaussianNoise(0.3, 4.0), lambda: ToeplitzNoise([0.1, 0.8, 0.1])]
)
def test_noise_can_be_built_inside_a_trace(build: Callable[[], RangeNoise]) -> None:
    p = jnp.full(7, 0.3)
    found = jax.jit(lambda p: beam_information(p, noise=build()))(p)
    assert float(found) == pytest.approx(float(eqx.filter_jit(beam_information)(p, noise=build())))


@pytest.fixture
def package_checks_only(monkeypatch: pytest.MonkeyPatch) -> None:
    """Switch off the type checks of the test run, which refuse wrong types with another error."""
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)


@pytest.mark.usefixtures("package_checks_only")
@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: ToeplitzNoise([]), r"weights has shape \(0,\); accepted: an odd number"),
        (lambda: ToeplitzNoise([0.5, 0.5]), r"weights has shape \(2,\); accepted: an odd number"),
        (lambda: ToeplitzNoise([[1.0]]), r"weights has shape \(1, 1\); accepted: an odd number"),
        (lambda: ToeplitzNoise([0.5, 0.6, 0.1]), r"weights is \[0.5, 0.6, 0.1\]; .* sum <= 1"),
        (lambda: ToeplitzNoise.gaussian(0.0), "std is 0.0; accepted"),
        (lambda: ToeplitzNoise.gaussian(1.0, cell_size=-1.0), "cell_size is -1.0; accepted"),
        (lambda: ToeplitzNoise.gaussian(1.0, truncation=0.0), "truncation is 0.0; accepted"),
    ],
)
def test_bad_noise(build: Callable[[], RangeNoise], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        build()


def test_a_traced_deviation_has_no_band() -> None:
    with pytest.raises(ValueError, match="std is traced; accepted with a truncation: a number"):
        jax.jit(lambda std: GaussianNoise(std, 4.0).std)(0.5)
