from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.interpolate
import scipy.special
import scipy.stats

from jaxplore import (
    BiasedProposal,
    ColouredNoise,
    GaussianProposal,
    InjectedProposal,
    Knots,
    Smooth,
)
from jaxplore.control import ControlSpace, CovarianceAdaptation, Direct, SamplingContext

HORIZON, SIZE, DT = 6, 2, 0.1
STD = np.array([0.6, 1.3])
MEAN = np.array([0.2, -0.7])
COVARIANCE = np.array([[0.36, 0.5], [0.5, 1.69]])
LOW, HIGH, DEFAULT = np.array([-3.0, -2.0]), np.array([3.0, 4.0]), np.array([0.5, -0.3])
SPACE = ControlSpace(
    *(jnp.asarray(value, jnp.float32) for value in (LOW, HIGH, DEFAULT, DT)), horizon=HORIZON
)
PARAMETERISATIONS = {"direct": Direct(), "smooth": Smooth(), "knots": Knots(3)}
everywhere = pytest.mark.parametrize("where", PARAMETERISATIONS)
RNG = np.random.default_rng(5)
NOMINAL = RNG.uniform(-1.5, 2.0, (HORIZON, SIZE)).astype(np.float32)
RATES = RNG.normal(size=(HORIZON, SIZE)).astype(np.float32)
REFERENCE = RNG.uniform(-1.5, 2.0, (HORIZON, SIZE)).astype(np.float32)
SEQUENCES = RNG.uniform(-1.5, 2.0, (2, HORIZON, SIZE)).astype(np.float32)


def make_context(where: str) -> SamplingContext:
    parameterisation = PARAMETERISATIONS[where]
    nominal = parameterisation.init(jnp.asarray(NOMINAL), SPACE)
    if where == "smooth":
        nominal = nominal._replace(rates=jnp.asarray(RATES))
    return SamplingContext(parameterisation, nominal, SPACE)


def cubic(horizon: int) -> np.ndarray:
    knots = np.linspace(0, horizon - 1, 3)
    spline = scipy.interpolate.CubicSpline(knots, np.eye(3), bc_type="natural")
    return spline(np.arange(horizon))


def encoded(where: str, controls: np.ndarray) -> np.ndarray:
    """The parameters whose controls are these, in double precision."""
    controls = np.asarray(controls, np.float64)
    if where == "direct":
        return controls
    if where == "smooth":
        return (controls - NOMINAL) / DT
    solved = np.linalg.lstsq(cubic(HORIZON), controls - DEFAULT, rcond=None)[0]
    return np.clip(DEFAULT + solved, LOW, HIGH)


class Drawn(NamedTuple):
    samples: jax.Array | np.ndarray
    controls: jax.Array | np.ndarray
    log_ratio: jax.Array | np.ndarray


def draw(proposal, context, count=9, perturbations=None, memory=()) -> Drawn:
    """Return what is drawn, in NumPy, whose operations are no programs."""
    return jax.tree.map(np.asarray, _draw(proposal, context, count, perturbations, memory))


@eqx.filter_jit
def _draw(proposal, context, count, perturbations, memory) -> Drawn:
    samples = proposal.sample(
        memory, context, count, key=jax.random.key(0), perturbations=perturbations
    )
    controls, _ = context.parameterisation.decode(context.nominal, samples, context.space)
    return Drawn(samples, controls, proposal.log_ratio(memory, context, samples))


@eqx.filter_jit
def log_ratio(proposal, context, samples, memory=()):
    return proposal.log_ratio(memory, context, samples)


adapt = eqx.filter_jit(lambda proposal, *given: proposal.adapt(*given))
shift = eqx.filter_jit(lambda proposal, memory, rows: proposal.shift(memory, rows))


def biased(fraction=0.5, proposal=None, **settings) -> BiasedProposal:
    proposal = GaussianProposal(STD) if proposal is None else proposal
    return BiasedProposal(proposal, REFERENCE, fraction, **settings)


def injected(samples=GaussianProposal(STD), **settings) -> InjectedProposal:  # noqa: B008
    return InjectedProposal(samples, **settings)


class TestBiasedProposal:
    @everywhere
    @pytest.mark.parametrize(
        ("fraction", "wanted"), [(0.0, 0), (0.25, 2), (0.34, 3), (0.5, 4), (0.99, 9), (1.0, 9)]
    )
    def test_a_share_is_sampled_around_the_reference(self, where, fraction, wanted) -> None:
        context = make_context(where)
        shape = (*context.centre.shape, 9)
        given = np.random.default_rng(0).normal(size=shape).astype(np.float32)
        drawn = draw(biased(fraction), context, 9, jnp.asarray(given))
        means = np.asarray(drawn.samples, np.float64) - given
        reference, centre = encoded(where, REFERENCE), np.asarray(context.centre)
        scale = np.abs(reference).max()
        for index in range(9):
            expected = reference if index < wanted else centre
            np.testing.assert_allclose(means[:, :, index], expected, atol=2e-6 * scale)

    @pytest.mark.parametrize("count", [7, 10])
    def test_the_share_is_right_to_one_half_of_a_sample(self, count: int) -> None:
        context = make_context("direct")
        none = jnp.zeros((HORIZON, SIZE, count))
        for fraction in (0.1, 0.3, 0.5, 0.7):
            samples = np.asarray(draw(biased(fraction), context, count, none).samples)
            close = (np.abs(samples - REFERENCE[:, :, None]) < 1e-5).all(axis=(0, 1))
            assert abs(close.sum() - fraction * count) <= 0.5 + 1e-6

    @everywhere
    def test_without_noise_the_controls_are_the_reference(self, where: str) -> None:
        """Within the bounds, and for knots those that come nearest."""
        context = make_context(where)
        none = jnp.zeros((*context.centre.shape, 9))
        reference = REFERENCE.copy()
        reference[2] = [9.0, -9.0]
        proposal = eqx.tree_at(lambda p: p.reference, biased(1.0), jnp.asarray(reference))
        controls = draw(proposal, context, 9, none).controls
        expected = np.clip(reference, LOW, HIGH)
        if where == "knots":
            knots = encoded("knots", reference)
            expected = np.clip(DEFAULT + cubic(HORIZON) @ (knots - DEFAULT), LOW, HIGH)
        for index in range(9):
            np.testing.assert_allclose(controls[:, :, index], expected, atol=5e-6)

    def test_knots_come_nearest_to_the_reference(self) -> None:
        context = make_context("knots")
        best = encoded("knots", REFERENCE)
        error = np.sum((DEFAULT + cubic(HORIZON) @ (best - DEFAULT) - REFERENCE) ** 2)
        knots = np.asarray(context.encode(jnp.asarray(REFERENCE)), np.float64)
        rng = np.random.default_rng(0)
        for change in [np.zeros((3, SIZE)), *rng.normal(0, 0.05, (20, 3, SIZE))]:
            controls = DEFAULT + cubic(HORIZON) @ (knots + change - DEFAULT)
            assert np.sum((controls - REFERENCE) ** 2) >= error - 1e-5

    def test_fraction_0_is_the_proposal_itself(self) -> None:
        context, plain = make_context("smooth"), GaussianProposal(STD, mean=MEAN)
        drawn, expected = draw(biased(0.0, plain), context), draw(plain, context)
        np.testing.assert_allclose(drawn.samples, expected.samples, rtol=1e-5, atol=1e-6)
        np.testing.assert_allclose(drawn.log_ratio, expected.log_ratio, rtol=1e-5, atol=1e-5)

    @pytest.mark.parametrize("where", ["smooth", "knots"])
    def test_fraction_1_is_the_proposal_around_the_reference(self, where: str) -> None:
        context, plain = make_context(where), GaussianProposal(STD, mean=MEAN)
        drawn = draw(biased(1.0, plain), context)
        parameters = jnp.asarray(encoded(where, REFERENCE), jnp.float32)
        nominal = context.nominal._replace(rates=parameters) if where == "smooth" else parameters
        expected = draw(plain, SamplingContext(context.parameterisation, nominal, SPACE))
        np.testing.assert_allclose(drawn.samples, expected.samples, rtol=1e-4, atol=1e-4)
        np.testing.assert_allclose(drawn.log_ratio, expected.log_ratio, rtol=1e-4, atol=1e-3)

    @pytest.mark.parametrize("fraction", [0.0, 0.3, 1.0])
    @pytest.mark.parametrize(
        ("proposal", "where"),
        [
            (GaussianProposal(8.0 * STD, mean=MEAN), "direct"),
            (GaussianProposal(8.0 * STD, mean=MEAN), "smooth"),
            (GaussianProposal(8.0 * STD, mean=MEAN), "knots"),
            (GaussianProposal(noise_covariance=64.0 * COVARIANCE, mean=MEAN), "direct"),
            (GaussianProposal(8.0 * STD, noise=ColouredNoise(1.0)), "smooth"),
            (GaussianProposal(8.0 * STD, adaptation=CovarianceAdaptation()), "knots"),
        ],
        ids=["direct", "smooth", "knots", "covariance", "coloured", "adapted"],
    )
    def test_log_ratio_is_that_of_the_mixture(self, where: str, fraction, proposal) -> None:
        context = make_context(where)
        rows = context.centre.shape[0]
        rng = np.random.default_rng(1)
        centre, reference = np.asarray(context.centre, np.float64), encoded(where, REFERENCE)
        samples = np.concatenate(
            [
                mean[:, :, None] + 5.0 * rng.normal(size=(rows, SIZE, 8))
                for mean in (centre, reference)
            ],
            axis=-1,
        ).astype(np.float32)
        given = np.diag(64.0 * STD**2) if proposal.noise_std is not None else 64.0 * COVARIANCE
        over = np.eye(rows)
        if isinstance(proposal.noise, ColouredNoise):
            over = np.asarray(proposal.noise.covariance(rows), np.float64)
        given = np.kron(over, given)
        memory, scale = (), np.ones(rows * SIZE)
        if proposal.adaptation is not None:
            scale = rng.uniform(0.5, 1.0, rows * SIZE)
            memory = jnp.asarray(scale.reshape(rows, SIZE), jnp.float32)
        adapted = np.diag(scale) @ given @ np.diag(scale)
        shift = np.asarray(proposal.mean, np.float64)
        rest = np.zeros(SIZE) if where == "smooth" else DEFAULT
        flat = samples.reshape(-1, 16).T.astype(np.float64)

        def density(mean: np.ndarray, covariance: np.ndarray) -> np.ndarray:
            centre = (mean + shift).ravel()
            return scipy.stats.multivariate_normal(centre, covariance).logpdf(flat)

        q = scipy.special.logsumexp(
            [density(centre, adapted), density(reference, adapted)],
            axis=0,
            b=np.array([[1.0 - fraction], [fraction]]),
        )
        expected = q - density(np.tile(rest, (rows, 1)), given)
        actual = log_ratio(biased(fraction, proposal), context, jnp.asarray(samples), memory)
        actual = np.asarray(actual, np.float64)
        np.testing.assert_allclose(
            actual - actual.mean(),
            expected - expected.mean(),
            rtol=3e-3,
            atol=3e-3 * max(expected.std(), 1.0),
        )

    def test_weighted_samples_estimate_the_optimum_whatever_the_reference(self) -> None:
        """As without a reference: see test_proposals. And without the ratio they lean to it."""
        count, target, stiffness = 40_000, np.array([0.3, 0.4]), np.array([2.0, 1.0])
        space = ControlSpace(SPACE.minimum, SPACE.maximum, SPACE.default, SPACE.dt, 1)
        context = SamplingContext(Direct(), jnp.asarray([[0.2, 0.1]]), space)
        precision = 1 / STD**2
        optimum = (precision * DEFAULT + stiffness * target) / (precision + stiffness)
        reference = np.array([[1.2, 1.7]], np.float32)
        estimates = {}
        for weighs in (True, False):
            proposal = BiasedProposal(
                GaussianProposal(STD), reference, 0.4, likelihood_ratio=weighs
            )
            drawn = draw(proposal, context, count)
            ratio = np.asarray(drawn.log_ratio, np.float64)
            flat = np.asarray(drawn.samples, np.float64)[0]
            exponent = -0.5 * stiffness @ (flat - target[:, None]) ** 2 - ratio
            weights = np.exp(exponent) / np.exp(exponent).sum()
            estimates[weighs] = flat @ weights - optimum
            if weighs:
                error = 5 * np.sqrt((weights**2 * (flat - optimum[:, None]) ** 2).sum(axis=1))
                assert (error < 0.1).all()
        assert (np.abs(estimates[True]) < error).all()
        assert estimates[False][1] > 0.2

    def test_without_the_likelihood_ratio_it_is_0(self) -> None:
        proposal = biased(0.5, likelihood_ratio=False)
        np.testing.assert_array_equal(draw(proposal, make_context("knots")).log_ratio, 0.0)

    def test_a_new_reference_does_not_retrace(self) -> None:
        traces, context = 0, make_context("direct")

        @jax.jit
        def traced(proposal):
            nonlocal traces
            traces += 1
            return proposal.sample((), context, 6, key=jax.random.key(0))

        traced(biased(0.5))
        traced(eqx.tree_at(lambda p: p.reference, biased(0.1), jnp.asarray(NOMINAL)))
        assert traces == 1

    def test_adapts_as_its_noise_does(self) -> None:
        inner = GaussianProposal(STD, adaptation=CovarianceAdaptation(0.5))
        context, proposal = make_context("direct"), biased(0.5, inner)
        memory = proposal.init(HORIZON, SIZE)
        np.testing.assert_array_equal(memory, np.ones((HORIZON, SIZE)))
        samples = draw(proposal, context, memory=memory).samples
        weights = jnp.full(9, 1 / 9)
        after = adapt(proposal, memory, context, weights, samples)
        np.testing.assert_array_equal(after, adapt(inner, memory, context, weights, samples))
        rows = jnp.asarray(1.5)
        np.testing.assert_array_equal(shift(proposal, after, rows), shift(inner, after, rows))


class TestInjectedProposal:
    everything = InjectedProposal(
        GaussianProposal(STD), SEQUENCES, null_action=True, last_solution=True
    )

    @everywhere
    def test_the_given_come_first_and_the_rest_are_the_proposals(self, where: str) -> None:
        context = make_context(where)
        assert self.everything.num_injected == 4
        samples = np.asarray(draw(self.everything, context).samples)
        plain = np.asarray(draw(GaussianProposal(STD), context).samples)
        assert samples.shape == plain.shape
        np.testing.assert_allclose(samples[:, :, 4:], plain[:, :, 4:], rtol=1e-5, atol=1e-6)
        nothing = np.zeros((HORIZON, SIZE))
        last = context.parameterisation.controls(context.nominal, SPACE)
        for index, controls in enumerate([*SEQUENCES, nothing, last]):
            expected = encoded(where, controls)
            tolerance = 2e-6 * max(np.abs(expected).max(), 1.0)
            np.testing.assert_allclose(samples[:, :, index], expected, atol=tolerance)

    @pytest.mark.parametrize("where", ["direct", "smooth"])
    def test_given_sequences_are_rolled_out_exactly(self, where: str) -> None:
        context = make_context(where)
        sequences = SEQUENCES.copy()
        sequences[1, 3] = [50.0, -50.0]
        proposal = eqx.tree_at(lambda p: p.sequences, self.everything, jnp.asarray(sequences))
        controls = np.asarray(draw(proposal, context).controls)
        for index in (0, 1):
            expected = np.clip(sequences[index], LOW, HIGH)
            np.testing.assert_allclose(controls[:, :, index], expected, atol=1e-6)

    @everywhere
    def test_the_null_action_is_zero_and_not_the_nominal(self, where: str) -> None:
        context = make_context(where)
        controls = np.asarray(draw(self.everything, context).controls)
        expected = np.zeros((HORIZON, SIZE))
        if where == "knots":
            expected = DEFAULT + cubic(HORIZON) @ (encoded("knots", expected) - DEFAULT)
        np.testing.assert_allclose(controls[:, :, 2], expected, atol=2e-6)
        assert np.abs(controls[:, :, 2] - NOMINAL).max() > 0.5

    @everywhere
    def test_the_last_solution_is_the_nominal(self, where: str) -> None:
        """Not what the rates of `Smooth` would make of it."""
        context = make_context(where)
        controls = draw(self.everything, context).controls
        expected = context.parameterisation.controls(context.nominal, SPACE)
        np.testing.assert_allclose(controls[:, :, 3], expected, atol=2e-6)

    def test_one_kind_goes_without_the_others(self) -> None:
        context = make_context("direct")
        null, last = injected(null_action=True), injected(last_solution=True)
        assert null.num_injected == last.num_injected == 1
        assert injected(sequences=SEQUENCES).num_injected == 2
        plain = draw(GaussianProposal(STD), context).samples
        for proposal, expected in ((null, np.zeros((HORIZON, SIZE))), (last, NOMINAL)):
            samples = draw(proposal, context).samples
            np.testing.assert_array_equal(samples[:, :, 0], expected)
            np.testing.assert_allclose(samples[:, :, 1:], plain[:, :, 1:], rtol=1e-5, atol=1e-6)

    def test_all_samples_may_be_given(self) -> None:
        self.everything.check(HORIZON, HORIZON, SIZE, 4)
        samples = np.asarray(draw(self.everything, make_context("direct"), 4).samples)
        np.testing.assert_array_equal(samples[:, :, :2], np.moveaxis(SEQUENCES, 0, -1))
        np.testing.assert_array_equal(samples[:, :, 2], 0.0)
        np.testing.assert_array_equal(samples[:, :, 3], NOMINAL)

    def test_goes_with_a_biased_proposal(self) -> None:
        context, inner = make_context("direct"), biased(0.5)
        drawn = draw(InjectedProposal(inner, SEQUENCES), context)
        expected = draw(inner, context)
        for actual, wanted in zip(drawn, expected, strict=True):
            np.testing.assert_allclose(actual[..., 2:], wanted[..., 2:], rtol=1e-5, atol=1e-5)

    def test_adapts_as_its_proposal_does(self) -> None:
        inner = GaussianProposal(STD, adaptation=CovarianceAdaptation(0.5))
        context, proposal = make_context("direct"), injected(inner, null_action=True)
        memory = proposal.init(HORIZON, SIZE)
        samples = draw(proposal, context, memory=memory).samples
        weights, rows = jnp.full(9, 1 / 9), jnp.asarray(0.5)
        after = adapt(proposal, memory, context, weights, samples)
        np.testing.assert_array_equal(after, adapt(inner, memory, context, weights, samples))
        np.testing.assert_array_equal(shift(proposal, after, rows), shift(inner, after, rows))


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (
            lambda: BiasedProposal(GaussianProposal(STD), np.zeros(3)),
            r"reference has shape \(3,\); accepted: finite controls of shape \(T, nu\)",
        ),
        (
            lambda: biased().check(HORIZON, HORIZON + 1, SIZE, 8),
            r"reference has shape \(6, 2\); accepted: \(7, 2\), horizon x controls",
        ),
        (
            lambda: biased().check(HORIZON, HORIZON, 3, 8),
            r"noise_std has shape \(2,\); accepted: \(3,\)",
        ),
        (
            lambda: injected(),
            r"sequences is None, null_action and last_solution are False; accepted: at least one",
        ),
        (
            lambda: injected(sequences=np.zeros((6, 2))),
            r"sequences has shape \(6, 2\); accepted: finite controls of shape \(N, T, nu\)",
        ),
        (
            lambda: injected(sequences=SEQUENCES).check(5, 5, 2, 8),
            r"sequences has shape \(2, 6, 2\); accepted: \(N, 5, 2\), N x horizon x controls",
        ),
        (
            lambda: TestInjectedProposal.everything.check(6, 6, 2, 3),
            r"4 sequences are to be injected; accepted: at most num_samples, 3",
        ),
        (
            lambda: injected(null_action=True).check(6, 6, 3, 8),
            r"noise_std has shape \(2,\); accepted: \(3,\)",
        ),
        (
            lambda: injected(sequences=np.zeros((0, 6, 2))),
            r"sequences has shape \(0, 6, 2\); accepted",
        ),
    ],
)
def test_bad_input_is_named(build, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        build()
