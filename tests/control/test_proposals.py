import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

from jaxplore import ColouredNoise, GaussianProposal, Knots, RBFKernel, Smooth
from jaxplore.control import (
    AntitheticNoise,
    ControlSpace,
    CovarianceAdaptation,
    Direct,
    NoiseBank,
    SamplingContext,
)

HORIZON, SIZE = 5, 2
STD = np.array([0.6, 1.3])
COVARIANCE = np.array([[0.36, 0.5], [0.5, 1.69]])
MEAN = np.array([0.2, -0.7])
SPACE = ControlSpace(
    minimum=jnp.asarray([-3.0, -2.0]),
    maximum=jnp.asarray([3.0, 4.0]),
    default=jnp.asarray([0.5, -0.3]),
    dt=jnp.asarray(0.1),
    horizon=HORIZON,
)
PARAMETERISATIONS = {
    "direct": Direct(),
    "smooth": Smooth(),
    "knots": Knots(3),
    "kernel": Knots(3, RBFKernel(2.0)),
}


def make_context(name: str) -> SamplingContext:
    """Around controls, and for `Smooth` rates too, that are not the default."""
    rng = np.random.default_rng(5)
    parameterisation = PARAMETERISATIONS[name]
    controls = jnp.asarray(rng.uniform(-1.5, 2.0, (HORIZON, SIZE)), jnp.float32)
    nominal = parameterisation.init(controls, SPACE)
    if name == "smooth":
        nominal = nominal._replace(rates=jnp.asarray(rng.normal(size=(HORIZON, SIZE)), jnp.float32))
    return SamplingContext(parameterisation, nominal, SPACE)


def rest_of(name: str) -> np.ndarray:
    return np.zeros(SIZE) if name == "smooth" else np.array([0.5, -0.3])


@eqx.filter_jit
def sample(proposal, memory, context, count, key, perturbations=None):
    return proposal.sample(memory, context, count, key=key, perturbations=perturbations)


@eqx.filter_jit
def log_ratio(proposal, memory, context, samples):
    return proposal.log_ratio(memory, context, samples)


adapt = eqx.filter_jit(lambda proposal, *given: proposal.adapt(*given))
precision = eqx.filter_jit(lambda proposal, sequence: proposal.precision(sequence))


def scales(rows: int) -> jnp.ndarray:
    rng = np.random.default_rng(8)
    return jnp.asarray(rng.uniform(0.3, 1.0, (rows, SIZE)), jnp.float32)


PROPOSALS = {
    "std, mean": GaussianProposal(STD, mean=MEAN),
    "covariance": GaussianProposal(noise_covariance=COVARIANCE, mean=MEAN),
    "coloured": GaussianProposal(STD, mean=MEAN, noise=ColouredNoise(1.0)),
    "coloured covariance": GaussianProposal(
        noise_covariance=COVARIANCE, mean=MEAN, noise=AntitheticNoise(ColouredNoise(0.5))
    ),
    "adapted": GaussianProposal(STD, mean=MEAN, adaptation=CovarianceAdaptation()),
    "adapted coloured": GaussianProposal(
        STD, noise=ColouredNoise(1.0), adaptation=CovarianceAdaptation()
    ),
    "adapted covariance": GaussianProposal(
        noise_covariance=COVARIANCE, mean=MEAN, adaptation=CovarianceAdaptation()
    ),
}


def densities(proposal: GaussianProposal, rows: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The covariances (P nu, P nu) of samples, adapted and not, and the mean in double."""
    among = np.diag(STD**2) if proposal.noise_std is not None else COVARIANCE
    noise = proposal.noise.noise if isinstance(proposal.noise, AntitheticNoise) else proposal.noise
    over = np.eye(rows)
    if isinstance(noise, ColouredNoise):
        over = np.asarray(noise.covariance(rows), np.float64)
    given = np.kron(over, among)
    scale = np.ones(rows * SIZE)
    if proposal.adaptation is not None:
        scale = np.asarray(scales(rows), np.float64).ravel()
    return np.diag(scale) @ given @ np.diag(scale), given, np.asarray(proposal.mean, np.float64)


@pytest.mark.parametrize(
    "name",
    list(PROPOSALS),
)
def test_samples_have_the_mean_and_the_covariance(name: str) -> None:
    proposal, context, samples = PROPOSALS[name], make_context("knots"), 30_000
    memory = () if proposal.adaptation is None else scales(3)
    drawn = sample(proposal, memory, context, samples, jax.random.key(0))
    covariance, _, mean = densities(proposal, 3)
    flat = np.asarray(drawn, np.float64).reshape(6, samples)
    expected = (np.asarray(context.centre, np.float64) + mean).ravel()
    tolerance = 5 * math.sqrt(2 / samples)
    deviations = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose((flat.mean(axis=1) - expected) / deviations, 0.0, atol=tolerance)
    standard = np.cov(flat) / np.outer(deviations, deviations)
    wanted = covariance / np.outer(deviations, deviations)
    np.testing.assert_allclose(standard, wanted, atol=1.5 * tolerance)


@pytest.mark.parametrize(
    ("name", "where"),
    [
        *((name, "knots") for name in PROPOSALS),
        *((name, where) for name in ("covariance", "adapted") for where in ("direct", "smooth")),
    ],
)
def test_log_ratio_is_that_of_the_densities(name: str, where: str) -> None:
    proposal, context = PROPOSALS[name], make_context(where)
    rows = context.centre.shape[0]
    memory = () if proposal.adaptation is None else scales(rows)
    samples = np.random.default_rng(1).normal(size=(rows, SIZE, 16)).astype(np.float32)
    actual = np.asarray(log_ratio(proposal, memory, context, jnp.asarray(samples)), np.float64)
    adapted, given, mean = densities(proposal, rows)
    flat = samples.reshape(-1, 16).T.astype(np.float64)
    centre = (np.asarray(context.centre, np.float64) + mean).ravel()
    rest = np.tile(rest_of(where) + mean, rows)
    expected = scipy.stats.multivariate_normal(centre, adapted).logpdf(flat)
    expected = expected - scipy.stats.multivariate_normal(rest, given).logpdf(flat)
    np.testing.assert_allclose(
        actual - actual.mean(), expected - expected.mean(), rtol=2e-3, atol=2e-3 * expected.std()
    )
    if proposal.adaptation is None:
        np.testing.assert_allclose(actual, expected, rtol=2e-3, atol=2e-3 * np.abs(expected).max())


@pytest.mark.parametrize("name", ["std, mean", "adapted"])
@pytest.mark.parametrize("where", PARAMETERISATIONS)
def test_perturbations_are_added_to_the_centre_and_nothing_else(name: str, where: str) -> None:
    proposal, context = PROPOSALS[name], make_context(where)
    centre = np.asarray(context.centre)
    memory = () if proposal.adaptation is None else scales(len(centre))
    given = np.random.default_rng(2).normal(size=(*centre.shape, 4)).astype(np.float32)
    drawn = sample(proposal, memory, context, 4, jax.random.key(0), jnp.asarray(given))
    np.testing.assert_allclose(drawn, centre[:, :, None] + given, rtol=1e-6)


@pytest.mark.parametrize("where", PARAMETERISATIONS)
def test_a_robot_left_alone_has_no_ratio(where: str) -> None:
    """Around the parameters at rest, q is p, whatever they are."""
    context = make_context(where)
    nominal = context.parameterisation.init(jnp.tile(SPACE.default, (HORIZON, 1)), SPACE)
    if where == "kernel":  # Which approximates a constant only.
        nominal = jnp.tile(SPACE.default, (3, 1))
    context = SamplingContext(context.parameterisation, nominal, SPACE)
    samples = jnp.asarray(np.random.default_rng(1).normal(size=(*context.centre.shape, 6)), "f4")
    np.testing.assert_array_equal(context.rest, np.asarray(rest_of(where), np.float32))
    ratio = log_ratio(PROPOSALS["covariance"], (), context, samples)
    np.testing.assert_allclose(ratio, 0.0, atol=2e-5)


@pytest.mark.parametrize(
    "name",
    [
        "std, mean",
        "covariance",
        "adapted",
        "adapted covariance",
    ],
)
def test_weighted_samples_estimate_the_optimum_whatever_their_centre(name: str) -> None:
    """For a quadratic cost the optimum, E_p[v exp(-J)] / E_p[exp(-J)], is a product of Gaussians.

    Without the right ratio the mean of the weighted samples would depend on the centre.
    """
    proposal, count = PROPOSALS[name], 40_000
    space = eqx.tree_at(lambda s: s.default, SPACE, jnp.asarray([0.5, -0.3]))
    space = ControlSpace(space.minimum, space.maximum, space.default, space.dt, 1)
    target, stiffness = np.array([0.3, 0.4]), np.array([[2.0, 0.4], [0.4, 1.0]])
    _, given, mean = densities(proposal, 1)
    precision = np.linalg.inv(given)
    rest = np.array([0.5, -0.3]) + mean
    optimum = np.linalg.solve(precision + stiffness, precision @ rest + stiffness @ target)
    memory = () if proposal.adaptation is None else jnp.asarray(np.asarray(scales(1)) + 0.3)
    for centre in ([0.5, -0.3], [0.1, 0.9]):
        context = SamplingContext(Direct(), jnp.asarray([centre], jnp.float32), space)
        samples = sample(proposal, memory, context, count, jax.random.key(3))
        ratio = np.asarray(log_ratio(proposal, memory, context, samples), np.float64)
        flat = np.asarray(samples, np.float64)[0]
        away = flat - target[:, None]
        exponent = -0.5 * np.einsum("uk,uv,vk->k", away, stiffness, away) - ratio
        weights = np.exp(exponent - exponent.max())
        weights /= weights.sum()
        assert 1 / (weights**2).sum() > 2000
        error = 5 * np.sqrt((weights**2 * (flat - optimum[:, None]) ** 2).sum(axis=1))
        assert (np.abs(flat @ weights - optimum) < error).all()
        assert (error < 0.1).all()


def test_precision_is_the_inverse_of_the_covariance() -> None:
    sequence = np.random.default_rng(0).normal(size=(4, SIZE))
    for name, proposal in PROPOSALS.items():
        _, given, _ = densities(proposal, 4)
        expected = np.linalg.solve(given, sequence.ravel()).reshape(4, SIZE)
        actual = precision(proposal, jnp.asarray(sequence, jnp.float32))
        np.testing.assert_allclose(actual, expected, rtol=1e-3, atol=1e-3, err_msg=name)


def test_remembers_a_scale_only_if_it_adapts() -> None:
    assert GaussianProposal(STD).init(4, 2) == ()
    assert GaussianProposal(STD).shift((), jnp.asarray(1.0)) == ()
    memory = PROPOSALS["adapted"].init(4, 2)
    np.testing.assert_array_equal(memory, np.ones((4, 2)))


@pytest.mark.parametrize("name", ["adapted", "adapted covariance"])
@pytest.mark.parametrize("where", ["smooth", "knots"])
def test_adapts_to_the_spread_around_the_centre(name: str, where: str) -> None:
    context, proposal = make_context(where), PROPOSALS[name]
    rows, rng = context.centre.shape[0], np.random.default_rng(3)
    samples = rng.normal(size=(rows, SIZE, 20)).astype(np.float32)
    weights = rng.dirichlet(np.ones(20))
    away = (samples - np.asarray(context.centre, np.float64)[:, :, None]) / STD[:, None]
    square = 0.8 * np.asarray(scales(rows)) ** 2 + 0.2 * (away**2) @ weights
    actual = adapt(
        proposal, scales(rows), context, jnp.asarray(weights, jnp.float32), jnp.asarray(samples)
    )
    np.testing.assert_allclose(actual, np.clip(np.sqrt(square), 0.2, 1.0), rtol=1e-5)


def test_may_be_built_inside_a_compiled_function() -> None:
    @jax.jit
    def spread(std, matrix):
        one = GaussianProposal(std).draw((), (3, 2), 4, key=jax.random.key(0))
        other = GaussianProposal(noise_covariance=matrix).draw((), (3, 2), 4, key=jax.random.key(0))
        return one, other

    one, other = spread(jnp.asarray(STD, jnp.float32), jnp.diag(jnp.asarray(STD**2, jnp.float32)))
    np.testing.assert_allclose(one, other, rtol=1e-5)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: GaussianProposal(1.0), r"noise_std is 1.0; accepted: one positive number per"),
        (lambda: GaussianProposal(np.ones((1, 1))), r"noise_std is .*; accepted: one positive"),
        (
            lambda: GaussianProposal(noise_covariance=np.ones(2)),
            r"noise_covariance is array\(\[1., 1.\]\); accepted: a symmetric matrix",
        ),
        (
            lambda: GaussianProposal(noise_covariance=np.ones((1, 2))),
            r"noise_covariance is array\(\[\[1., 1.\]\]\); accepted: a symmetric matrix",
        ),
        (
            lambda: GaussianProposal(noise_covariance=np.array([[1.0, 0.3], [0.2, 1.0]])),
            r"(?s)noise_covariance is .*; accepted: a symmetric matrix",
        ),
        (
            lambda: GaussianProposal(noise_covariance=np.array([[1.0, math.nan], [math.nan, 1.0]])),
            r"(?s)noise_covariance is .*; accepted: a symmetric matrix",
        ),
        (
            lambda: GaussianProposal(noise_covariance=np.array([[1.0, 2.0], [2.0, 1.0]])),
            r"noise_covariance has an eigenvalue of -1; accepted: a positive definite matrix",
        ),
        (
            lambda: GaussianProposal(noise_covariance=np.array([[1.0, 1.0], [1.0, 1.0]])),
            r"noise_covariance has an eigenvalue of .*; accepted: a positive definite matrix",
        ),
        (
            lambda: GaussianProposal(noise_covariance=np.zeros((2, 2))),
            r"noise_covariance has an eigenvalue of 0; accepted: a positive definite matrix",
        ),
        (lambda: GaussianProposal([1.0, 1.0], mean=[0.0]), r"mean is \[0.0\]; accepted: 2 finite"),
        (
            lambda: GaussianProposal([1.0]).check(5, 5, 2, 8),
            r"noise_std has shape \(1,\); accepted: \(2,\), one per control of the model",
        ),
        (
            lambda: GaussianProposal(noise_covariance=np.eye(1)).check(5, 5, 2, 8),
            r"noise_covariance has shape \(1, 1\); accepted: \(2, 2\), one per control",
        ),
        (
            lambda: GaussianProposal(STD, noise=NoiseBank(9, key=jax.random.key(0))).check(
                5, 5, 2, 8
            ),
            r"NoiseBank holds 9 numbers; accepted: at least 10, for 5 x 2 parameters",
        ),
    ],
)
def test_bad_input_is_named(build, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        build()
