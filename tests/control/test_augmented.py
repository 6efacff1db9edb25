"""Two proposals side by side are each what they are alone."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxplore as jx
from jaxplore import GaussianProposal, Knots, Smooth
from jaxplore.control.augmented import AugmentedProposal
from jaxplore.control.parameterisations import Direct, Parameterisation
from jaxplore.control.proposals import CovarianceAdaptation, SamplingContext
from jaxplore.dynamics.augmented import Augmented
from jaxplore.dynamics.path_parameter import PathParameter

MODEL = Augmented(jx.KinematicBicycle(), PathParameter(3.0, end=9.0))
PHYSICAL = GaussianProposal([0.5, 0.1], adaptation=CovarianceAdaptation())
VIRTUAL = GaussianProposal([0.7], mean=[0.2])
BOTH = AugmentedProposal(MODEL, PHYSICAL, VIRTUAL)
T, K = 12, 64


def controller(proposal, parameterisation: Parameterisation) -> jx.MPPI:
    return jx.MPPI(
        MODEL,
        jx.GoalCost([3.0, 0.0]),
        horizon=T,
        num_samples=K,
        dt=0.1,
        proposal=proposal,
        parameterisation=parameterisation,
    )


def around(mppi: jx.MPPI) -> SamplingContext:
    space = mppi._space
    controls = 0.3 * jax.random.normal(jax.random.key(9), (T, 3))
    return SamplingContext(
        mppi.parameterisation, mppi.parameterisation.init(controls, space), space
    )


@pytest.mark.parametrize("parameterisation", [Smooth(), Knots(4)], ids=["smooth", "knots"])
def test_samples_and_ratios_are_those_of_the_parts(parameterisation: Parameterisation) -> None:
    mppi = controller(BOTH, parameterisation)
    rows = parameterisation.num_parameters(T)

    @jax.jit
    def everything(key):
        near, memory = around(mppi), BOTH.init(rows, 3)
        samples = BOTH.sample(memory, near, K, key=key)
        parts = BOTH._part_contexts(near)
        keys = jax.random.split(key, 2)
        first = PHYSICAL.sample(memory.physical, parts[0], K, key=keys[0])
        second = VIRTUAL.sample(memory.virtual, parts[1], K, key=keys[1])
        ratios = (
            BOTH.log_ratio(memory, near, samples),
            PHYSICAL.log_ratio(memory.physical, parts[0], first),
            VIRTUAL.log_ratio(memory.virtual, parts[1], second),
        )
        weights, step = jax.nn.softmax(jax.random.normal(key, (K,))), jnp.asarray(1.0)
        adapted = BOTH.shift(BOTH.adapt(memory, near, weights, samples), step)
        alone = PHYSICAL.shift(PHYSICAL.adapt(memory.physical, parts[0], weights, first), step)
        added = BOTH.sample(memory, near, K, key=key, perturbations=jnp.ones((rows, 3, K)))
        return samples, first, second, ratios, adapted.physical, alone, added, near.centre

    samples, first, second, ratios, adapted, alone, added, centre = jax.tree.map(
        np.asarray, everything(jax.random.key(0))
    )
    assert samples.shape == (rows, 3, K)
    np.testing.assert_array_equal(samples, np.concatenate([first, second], axis=1))
    np.testing.assert_allclose(ratios[0], ratios[1] + ratios[2], rtol=1e-5)
    np.testing.assert_array_equal(adapted, alone)
    np.testing.assert_allclose(added, centre[:, :, None] + np.ones(K), rtol=1e-6)


def test_streams_are_independent_of_each_other() -> None:
    near, key = around(controller(BOTH, Direct())), jax.random.key(3)
    other = AugmentedProposal(MODEL, PHYSICAL, GaussianProposal([2.0]))
    draw = eqx.filter_jit(lambda each: each.sample(each.init(T, 3), near, 4096, key=key))
    samples = [np.asarray(draw(each)) for each in (BOTH, other)]
    # Another virtual noise leaves the physical samples as they were.
    np.testing.assert_array_equal(samples[0][:, :2], samples[1][:, :2])
    flat = (samples[0] - samples[0].mean(-1, keepdims=True)).reshape(3 * T, -1)
    correlation = np.corrcoef(flat)
    assert np.abs(correlation - np.diag(np.diag(correlation))).max() < 0.08


def test_alone_it_is_the_gaussian_of_all_controls() -> None:
    # With white noise and no adaptation the density is that of one Gaussian over both.
    parts = AugmentedProposal(MODEL, GaussianProposal([0.5, 0.1]), GaussianProposal([0.7]))
    whole = GaussianProposal([0.5, 0.1, 0.7])
    near = around(controller(parts, Direct()))
    samples = whole.sample((), near, K, key=jax.random.key(1))
    np.testing.assert_allclose(
        parts.log_ratio(parts.init(T, 3), near, samples),
        whole.log_ratio((), near, samples),
        rtol=1e-4,
    )


@pytest.mark.parametrize(
    ("proposal", "message"),
    [
        (
            AugmentedProposal(MODEL, GaussianProposal([1.0]), VIRTUAL),
            r"physical proposal: noise_std has shape \(1,\)",
        ),
        (
            AugmentedProposal(MODEL, PHYSICAL, PHYSICAL),
            r"virtual proposal: noise_std has shape \(2,\)",
        ),
    ],
)
def test_a_proposal_that_does_not_fit_its_part_is_named(proposal, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        controller(proposal, Direct())
