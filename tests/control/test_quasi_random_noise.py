import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

from jaxplore import HaltonNoise
from jaxplore.control import AntitheticNoise, SobolNoise
from jaxplore.control import noise as noises

BITS = 24
SOURCES = [
    pytest.param(SobolNoise(), scipy.stats.qmc.Sobol, id="Sobol"),
    pytest.param(HaltonNoise(), scipy.stats.qmc.Halton, id="Halton"),
]
sources = pytest.mark.parametrize(("noise", "sequence"), SOURCES)


@eqx.filter_jit
def draw(noise, shape, key):
    return noise.draw(shape, key=key)


@eqx.filter_jit
def draw_points(noise, shape, key):
    """As `draw`, compiled apart: for the fixture below only."""
    return noise.draw(shape, key=key)


@pytest.fixture
def as_points(monkeypatch):
    """Make draws whole numbers below 2^24 instead of their normal quantiles."""
    monkeypatch.setattr(noises, "_normal", lambda points: jnp.asarray(points, jnp.float32))

    def points(noise, shape, seed: int = 0) -> np.ndarray:
        drawn = np.asarray(draw_points(noise, shape, jax.random.key(seed)), np.int64)
        assert drawn.shape == shape
        assert ((drawn >= 0) & (drawn < 2**BITS)).all()
        return drawn

    return points


def known(sequence, dimensions: int, samples: int) -> np.ndarray:
    """SciPy's points (dimensions, samples) as whole numbers."""
    points = sequence(dimensions, scramble=True, rng=np.random.default_rng(0)).random(samples)
    return np.minimum(points.T * 2**BITS, 2**BITS - 1).astype(np.int64)


@sources
@pytest.mark.parametrize("samples", [1, 256])
def test_are_the_points_of_scipy_up_to_a_shift(noise, sequence, samples: int, as_points) -> None:
    drawn = as_points(noise, (5, 3, samples)).reshape(15, samples)
    expected = known(sequence, 15, samples)
    if sequence is scipy.stats.qmc.Sobol:
        shift = drawn ^ expected
    else:
        shift = (drawn - expected) % 2**BITS
    np.testing.assert_array_equal(shift, np.broadcast_to(shift[:, :1], shift.shape))
    assert len(set(shift[:, 0])) == 15


@sources
@pytest.mark.parametrize("samples", [100, 129])
def test_any_number_of_samples_is_the_start_of_a_longer_one(
    noise, sequence, samples: int, as_points
) -> None:
    longer = as_points(noise, (5, 3, 256))
    np.testing.assert_array_equal(as_points(noise, (5, 3, samples)), longer[:, :, :samples])


@pytest.mark.parametrize("digits", [1, 8])
def test_sobol_points_lie_one_in_each_interval(digits: int, as_points) -> None:
    count = 2**digits
    intervals = as_points(SobolNoise(), (5, 3, count), seed=3) >> (BITS - digits)
    expected = np.broadcast_to(np.arange(count), intervals.shape)
    np.testing.assert_array_equal(np.sort(intervals, axis=-1), expected)


def test_sobol_points_lie_one_in_each_box(as_points) -> None:
    """The first two dimensions make a (0, m, 2) net in base 2."""
    first, second = as_points(SobolNoise(), (5, 3, 256), seed=4)[0, :2]
    for wide in range(9):
        boxes = (first >> (BITS - wide)) * 2 ** (8 - wide) + (second >> (BITS - 8 + wide))
        np.testing.assert_array_equal(np.sort(boxes), np.arange(256))


@sources
@pytest.mark.parametrize("seed", range(3))
def test_are_more_even_than_random_points(noise, sequence, seed: int, as_points) -> None:
    points = as_points(noise, (3, 1, 128), seed).reshape(3, 128).T / 2**BITS
    rng = np.random.default_rng(seed)
    random = [scipy.stats.qmc.discrepancy(rng.uniform(size=(128, 3))) for _ in range(20)]
    assert scipy.stats.qmc.discrepancy(points) < 0.5 * min(random)


@sources
def test_every_point_is_uniform_over_the_keys(noise, sequence) -> None:
    draws = jax.jit(jax.vmap(lambda key: noise.draw((2, 2, 8), key=key)))
    values = np.asarray(draws(jax.random.split(jax.random.key(0), 1000)), np.float64)
    for row in values.reshape(1000, 32).T:
        assert scipy.stats.kstest(row, "norm").pvalue > 1e-5
    # Shifts of different dimensions have nothing to do with each other.
    between = np.corrcoef(values[:, :, :, 0].reshape(1000, 4).T) - np.eye(4)
    np.testing.assert_allclose(between, 0.0, atol=5 / np.sqrt(1000))


@sources
def test_has_mean_0_and_variance_1(noise, sequence) -> None:
    values = np.asarray(draw(noise, (4, 2, 1024), jax.random.key(0)), np.float64)
    np.testing.assert_allclose(values.mean(axis=-1), 0.0, atol=0.01)
    np.testing.assert_allclose(values.var(axis=-1), 1.0, atol=0.03)


@sources
def test_steps_differ(noise, sequence) -> None:
    one = np.asarray(draw(noise, (2, 2, 16), jax.random.key(0)))
    other = np.asarray(draw(noise, (2, 2, 16), jax.random.key(1)))
    assert (one != other).mean() > 0.99


def test_goes_with_mirroring() -> None:
    values = draw(AntitheticNoise(SobolNoise()), (2, 1, 64), jax.random.key(0))
    np.testing.assert_array_equal(values[:, :, 32:], -values[:, :, :32])


def test_quantiles_are_those_of_the_normal_distribution() -> None:
    edges = np.concatenate([np.arange(5000), 2**23 + np.arange(-5000, 5000)])
    inside = np.random.default_rng(0).integers(0, 2**BITS, 20_000)
    points = np.concatenate([edges, 2**BITS - 1 - np.arange(5000), inside]).astype(np.uint32)
    values = np.asarray(noises._normal(jnp.asarray(points)[None]), np.float64)[0]
    assert np.isfinite(values).all()
    probability = (points + 0.5) / 2**BITS
    expected = scipy.stats.norm.ppf(probability)
    central = np.abs(expected) < 4.0
    np.testing.assert_allclose(values[central], expected[central], rtol=2e-6, atol=5e-3)
    calm = np.abs(expected) < 2.0
    np.testing.assert_allclose(values[calm], expected[calm], rtol=2e-6, atol=2e-6)
    # In the tails a float32 cannot tell neighbouring cells apart.
    np.testing.assert_allclose(scipy.stats.norm.cdf(values), probability, atol=1.5 * 2.0**-BITS)
    assert values.max() == pytest.approx(-values.min(), rel=1e-6)
    assert values.max() == pytest.approx(scipy.stats.norm.ppf(1 - 2.0 ** -(BITS + 1)), rel=1e-3)


@sources
def test_rows_are_uncorrelated(noise, sequence) -> None:
    sequence = jnp.asarray([[1.0, -2.0], [3.0, 0.5]])
    np.testing.assert_array_equal(noise.precision(sequence), sequence)


def test_there_are_only_so_many_directions() -> None:
    SobolNoise().check((21201, 1, 4))
    with pytest.raises(ValueError, match=r"is 21202 x 1; accepted: at most 21201 numbers"):
        SobolNoise().check((21202, 1, 4))
    with pytest.raises(ValueError, match=r"is 10601 x 2; accepted"):
        AntitheticNoise(SobolNoise()).check((10601, 2, 4))
    HaltonNoise().check((30_000, 1, 4))
