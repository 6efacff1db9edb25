import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal
import scipy.stats

from jaxplore import ColouredNoise
from jaxplore.control import AntitheticNoise, LogNormalNoise, NoiseBank, WhiteNoise
from jaxplore.control.noise import LARGE, Noise

pytestmark = pytest.mark.long

ROWS, SIZE, SAMPLES = SHAPE = (4, 2, 4000)
SOURCES = {
    "white": WhiteNoise(),
    "antithetic": AntitheticNoise(),
    "log-normal": LogNormalNoise(0.3),
    "coloured": ColouredNoise(1.0),
    "coloured antithetic": ColouredNoise(0.5, AntitheticNoise()),
    "bank": NoiseBank(key=jax.random.key(11)),
    "coloured bank": ColouredNoise(1.0, NoiseBank(key=jax.random.key(12))),
}
sources = pytest.mark.parametrize("noise", SOURCES.values(), ids=SOURCES.keys())


@eqx.filter_jit
def draw(noise, shape, key):
    return noise.draw(shape, key=key)


@eqx.filter_jit
def covariance_of(noise, rows):
    return noise.covariance(rows)


@eqx.filter_jit
def precision_of(noise, sequence):
    return noise.precision(sequence)


def drawn(noise, shape=SHAPE, seed=0) -> np.ndarray:
    return np.asarray(draw(noise, shape, jax.random.key(seed)), np.float64)


def correlations(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Of each row of `a` with each row of `b`, over the last axis."""
    a, b = (x.reshape(-1, x.shape[-1]) for x in (a, b))
    a, b = (x - x.mean(axis=1, keepdims=True) for x in (a, b))
    lengths = np.sqrt((a**2).sum(axis=1)[:, None] * (b**2).sum(axis=1))
    return (a @ b.T) / lengths


@sources
def test_has_mean_0_and_variance_1(noise) -> None:
    values = drawn(noise)
    assert values.shape == SHAPE
    np.testing.assert_allclose(values.mean(axis=-1), 0.0, atol=5 / math.sqrt(SAMPLES))
    # The variance of a squared draw is the kurtosis less 1: 2 for normal draws, 3.3 for these.
    np.testing.assert_allclose((values**2).mean(axis=-1), 1.0, atol=5 * math.sqrt(4 / SAMPLES))


@pytest.mark.parametrize("name", ["white", "coloured", "bank"])
@pytest.mark.parametrize("seed", [0, 1])
def test_is_normal(name: str, seed: int) -> None:
    for row in drawn(SOURCES[name], seed=seed).reshape(-1, SAMPLES):
        assert scipy.stats.kstest(row, "norm").pvalue > 1e-4


def test_antithetic_halves_are_normal() -> None:
    for row in drawn(SOURCES["antithetic"]).reshape(-1, SAMPLES):
        assert scipy.stats.kstest(row[: SAMPLES // 2], "norm").pvalue > 1e-4


@pytest.mark.parametrize("name", ["white", "antithetic", "log-normal", "bank"])
def test_rows_and_controls_are_uncorrelated(name: str) -> None:
    values = drawn(SOURCES[name])
    between = correlations(values, values) - np.eye(ROWS * SIZE)
    np.testing.assert_allclose(between, 0.0, atol=5 * math.sqrt(2 / SAMPLES))


def test_coloured_controls_are_uncorrelated() -> None:
    values = drawn(SOURCES["coloured"])
    between = correlations(values[:, 0], values[:, 1])
    np.testing.assert_allclose(between, 0.0, atol=5 / math.sqrt(SAMPLES))


@sources
def test_samples_are_independent(noise) -> None:
    values = drawn(noise)
    half = values[:, :, : SAMPLES // 2]  # The other half may mirror it.
    for lag in (1, 2, 7):
        between = np.diag(correlations(half[:, :, lag:], half[:, :, :-lag]))
        np.testing.assert_allclose(between, 0.0, atol=5 / math.sqrt(SAMPLES // 2))


@pytest.mark.parametrize("name", [name for name in SOURCES if name != "bank"])
def test_streams_of_different_keys_are_uncorrelated(name: str) -> None:
    """Also those of one seed, however it was split on the way."""
    root = jax.random.key(7)
    left, right = jax.random.split(root)
    keys = [root, left, right, *jax.random.split(left), *jax.random.split(right), jax.random.key(8)]
    streams = [np.asarray(draw(SOURCES[name], SHAPE, key), np.float64) for key in keys]
    for index, one in enumerate(streams):
        for other in streams[:index]:
            between = correlations(one, other)
            np.testing.assert_allclose(between, 0.0, atol=5.5 * math.sqrt(2 / SAMPLES))


@pytest.mark.parametrize(
    ("noise", "samples"),
    [(WhiteNoise(), 8), (WhiteNoise(), 7), (WhiteNoise(), 1), (ColouredNoise(1.0), 8)],
)
def test_antithetic_noise_mirrors_its_first_half_exactly(noise, samples: int) -> None:
    key, half = jax.random.key(3), (samples + 1) // 2
    values = np.asarray(draw(AntitheticNoise(noise), (3, 2, samples), key))
    assert values.shape == (3, 2, samples)
    np.testing.assert_array_equal(values[:, :, :half], draw(noise, (3, 2, half), key))
    np.testing.assert_array_equal(values[:, :, half:], -values[:, :, : samples // 2])
    if samples % 2 == 0:
        np.testing.assert_array_equal(values.astype(np.float64).sum(axis=-1), 0.0)


@pytest.mark.parametrize("spread", [0.0, 0.2, 0.3])
def test_log_normal_noise_has_its_kurtosis(spread: float) -> None:
    values = drawn(LogNormalNoise(spread), (1, 1, 800_000))
    deviation = math.sqrt(105 * math.exp(24 * spread**2) - 9 * math.exp(8 * spread**2))
    kurtosis = (values**4).mean() / (values**2).mean() ** 2
    assert (values**2).mean() == pytest.approx(1.0, abs=0.02)
    assert kurtosis == pytest.approx(
        3 * math.exp(4 * spread**2), abs=5 * deviation / 800**0.5 / 1000**0.5
    )


def test_white_noise_that_is_drawn_row_by_row_is_white() -> None:
    rows, samples = 33, 16384
    assert rows * 2 * samples > LARGE >= 32 * 2 * samples
    values = drawn(WhiteNoise(), (rows, 2, samples))
    assert values.shape == (rows, 2, samples)
    np.testing.assert_allclose(values.mean(axis=-1), 0.0, atol=5 / math.sqrt(samples))
    np.testing.assert_allclose(values.var(axis=-1), 1.0, atol=5 * math.sqrt(2 / samples))
    between = correlations(values, values) - np.eye(2 * rows)
    np.testing.assert_allclose(between, 0.0, atol=5.5 / math.sqrt(samples))
    for row in (0, rows - 1):
        assert scipy.stats.kstest(values[row, 0], "norm").pvalue > 1e-4
    other = drawn(WhiteNoise(), (rows, 2, samples), seed=1)
    np.testing.assert_allclose(correlations(values, other), 0.0, atol=5.5 / math.sqrt(samples))


class TestNoiseBank:
    shape = (3, 2, 5)
    bank = NoiseBank(60, key=jax.random.key(0))

    def test_rows_are_stretches_of_the_ring_up_to_sign(self) -> None:
        ring, offsets, signs = np.asarray(self.bank.ring), set(), []
        stretches = {
            tuple(sign * np.resize(np.roll(ring, -at), 5)): (at, sign)
            for at in range(60)
            for sign in (1, -1)
        }
        for seed in range(40):
            values = np.asarray(draw(self.bank, self.shape, jax.random.key(seed)))
            found = [stretches[tuple(row)] for row in values.reshape(6, 5)]
            places = [at for at, _ in found]
            # Each row has a part of the ring of its own to begin in.
            assert sorted(at // 10 for at in places) == list(range(6))
            offsets |= set(places)
            signs.append([sign for _, sign in found])
        assert offsets == set(range(60))
        assert (abs(np.mean(signs, axis=0)) < 0.6).all()

    def test_the_numbers_have_variance_1(self) -> None:
        ring = np.asarray(self.bank.ring, np.float64)
        assert np.mean(ring**2) == pytest.approx(1.0, rel=1e-6)

    def test_the_weighted_mean_has_no_lasting_bias(self) -> None:
        """It is that of new numbers; whole draws that recurred had one of 0.017."""
        rows, samples, steps = 20, 256, 4000

        def mean(noise: Noise, key: jax.Array) -> jax.Array:
            values = noise.draw((rows, 1, samples), key=key)[:, 0]
            away = 0.3 * jnp.cumsum(values, axis=0) - 0.7
            cost = (away**2).sum(axis=0) + 0.5 * jnp.abs(away[-1] + 0.7)
            return values @ jax.nn.softmax(-cost / 3.0)

        @eqx.filter_jit
        def mean_of(noise: Noise, key: jax.Array) -> jax.Array:
            keys = jax.random.split(key, steps)
            means = jax.lax.map(lambda each: mean(noise, each), keys, batch_size=50)
            return means.mean(axis=0)

        bank = mean_of(NoiseBank(16 * samples, key=jax.random.key(1)), jax.random.key(2))
        fresh = mean_of(WhiteNoise(), jax.random.key(3))
        # The deviation of a step is 0.12, and of the difference of two means of 4000 steps 0.0027.
        assert float(jnp.sqrt(jnp.mean((bank - fresh) ** 2))) < 0.006

    def test_has_the_precision_of_white_noise(self) -> None:
        sequence = jnp.asarray(np.random.default_rng(0).normal(size=(3, 2)), jnp.float32)
        np.testing.assert_array_equal(self.bank.precision(sequence), sequence)

    def test_must_have_enough_numbers(self) -> None:
        for ask in (self.bank.check, lambda shape: self.bank.draw(shape, key=jax.random.key(0))):
            with pytest.raises(ValueError, match=r"holds 60 numbers; accepted: at least 61, for"):
                ask((3, 2, 61))
        with pytest.raises(
            ValueError, match=r"holds 60 numbers; accepted: at least 62, for 31 x 2"
        ):
            self.bank.check((31, 2, 4))
        self.bank.check((3, 2, 60))

    def test_checks_reach_it_through_other_noise(self) -> None:
        AntitheticNoise(self.bank).check((3, 2, 120))
        for noise in (AntitheticNoise(self.bank), ColouredNoise(1.0, self.bank)):
            with pytest.raises(ValueError, match="NoiseBank"):
                noise.check((3, 2, 122))
        with pytest.raises(ValueError, match="NoiseBank"):
            LogNormalNoise(0.1, self.bank).check((4, 2, 61))


def coloured_covariance(exponent: float, rows: int) -> np.ndarray:
    """From the spectrum by a Fourier transform, in double precision."""
    frequency = np.maximum(np.arange(rows + 1), 1).astype(float)
    autocovariance = np.fft.irfft(frequency**-exponent, 2 * rows)[:rows]
    lag = np.abs(np.subtract.outer(np.arange(rows), np.arange(rows)))
    return autocovariance[lag] / autocovariance[0]


@pytest.mark.parametrize("exponent", [0.0, 0.5, 1.0, 2.0, 4.0])
@pytest.mark.parametrize("rows", [1, 7, 64])
def test_coloured_covariance_is_that_of_the_spectrum(exponent: float, rows: int) -> None:
    covariance = covariance_of(ColouredNoise(exponent), rows)
    np.testing.assert_allclose(covariance, coloured_covariance(exponent, rows), atol=3e-5)


@pytest.mark.parametrize("exponent", [0.0, 1.0, 3.0])
def test_coloured_draws_have_their_covariance(exponent: float) -> None:
    samples = 40_000
    values = drawn(ColouredNoise(exponent), (8, 1, samples))[:, 0]
    expected = coloured_covariance(exponent, 8)
    np.testing.assert_allclose(
        values @ values.T / samples, expected, atol=5 * math.sqrt(2 / samples)
    )


def test_exponent_0_is_white() -> None:
    np.testing.assert_allclose(drawn(ColouredNoise(0.0)), drawn(WhiteNoise()), atol=1e-4)


@pytest.mark.parametrize("exponent", [0.5, 1.0, 2.0])
def test_the_power_of_coloured_noise_falls_with_its_exponent(exponent: float) -> None:
    rows = 512
    values = drawn(ColouredNoise(exponent), (rows, 1, 300))[:, 0]
    frequency, power = scipy.signal.periodogram(values, window="hann", axis=0)
    middle = slice(4, rows // 6)
    slope = np.polyfit(np.log(frequency[middle]), np.log(power.mean(axis=1)[middle]), 1)[0]
    assert slope == pytest.approx(-exponent, abs=0.1)


@pytest.mark.parametrize("exponent", [1.0, 2.0])
def test_the_last_row_does_not_know_of_the_first(exponent: float) -> None:
    """Rows out of a Fourier transform of as many values are periodic: the ends are neighbours."""
    values = drawn(ColouredNoise(exponent), (8, 1, 40_000))[:, 0]
    with_first = correlations(values[:1], values)[0]
    assert (np.diff(with_first) < 0.03).all()
    assert with_first[-1] < with_first[4] < with_first[1]
    assert with_first[-1] < with_first[1] - 0.4


@pytest.mark.parametrize("exponent", [0.0, 1.0, 2.0])
def test_the_precision_of_coloured_noise_is_the_inverse_of_its_covariance(exponent: float) -> None:
    sequence = np.random.default_rng(0).normal(size=(12, 2))
    covariance = coloured_covariance(exponent, 12) + 1e-5 * np.eye(12)
    expected = np.linalg.solve(covariance, sequence)
    for noise in (ColouredNoise(exponent), AntitheticNoise(ColouredNoise(exponent))):
        actual = precision_of(noise, jnp.asarray(sequence, jnp.float32))
        np.testing.assert_allclose(actual, expected, rtol=2e-3, atol=2e-3 * np.abs(expected).max())


@pytest.mark.parametrize(
    "noise",
    [
        ColouredNoise(1.0, LogNormalNoise(0.4)),
        ColouredNoise(1.0, ColouredNoise(1.0)),
        LogNormalNoise(0.7, ColouredNoise(1.0)),
    ],
    ids=["coloured log-normal", "twice coloured", "log-normal coloured"],
)
def test_the_precision_of_nested_noise_is_the_inverse_of_its_covariance(noise) -> None:
    values = drawn(noise, (5, 1, 60_000))[:, 0]
    covariance = values @ values.T / values.shape[-1]
    inverse = precision_of(noise, jnp.eye(5))
    np.testing.assert_allclose(covariance @ np.asarray(inverse), np.eye(5), atol=0.1)


@pytest.mark.parametrize("rows", [200, 1000])
def test_steep_spectra_are_finite(rows: int) -> None:
    assert np.isfinite(drawn(ColouredNoise(4.0), (rows, 1, 2))).all()


def test_a_change_of_numbers_does_not_retrace() -> None:
    traces = 0

    @jax.jit
    def traced(noise, key):
        nonlocal traces
        traces += 1
        return noise.draw((3, 1, 4), key=key)

    for exponent, spread in ((0.5, 0.1), (2.0, 0.9)):
        traced(ColouredNoise(exponent, LogNormalNoise(spread)), jax.random.key(0))
    assert traces == 1


def test_bad_input_is_named() -> None:
    with pytest.raises(ValueError, match=r"spread has shape \(2,\); accepted: one number"):
        LogNormalNoise(jnp.ones(2))
