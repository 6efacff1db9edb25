"""What does not fit is said where it is built; what cannot be computed stays out of the result."""

import re
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import (
    MPPI,
    BiasedProposal,
    ColouredNoise,
    Cost,
    Dynamics,
    Elite,
    GaussianProposal,
    InjectedProposal,
    Knots,
    PointMass,
    RBFKernel,
    Smooth,
    Softmax,
    StateCost,
    StateNoise,
)
from jaxplore.control import (
    AdaptiveSoftmax,
    CovarianceAdaptation,
    CubicSpline,
    Direct,
    NoiseBank,
    SavitzkyGolay,
    SobolNoise,
)

pytestmark = pytest.mark.long

ROBOT = PointMass(2)
COST = StateCost({"x": 1.0, "y": 1.0}, {"x": 1.0})
GAUSSIAN = GaussianProposal([0.5, 0.5])


def make(robot=ROBOT, cost=COST, **changes) -> MPPI:
    settings = {"horizon": 6, "num_samples": 16, "noise_std": [0.5, 0.5], "dt": 0.1, **changes}
    if "proposal" in changes:
        del settings["noise_std"]
    return MPPI(robot, cost, **settings)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: make(temperature=np.ones(2)), "temperature has shape (2,); accepted: one number"),
        (
            lambda: make(noise_std=[0.5] * 3),
            "noise_std has shape (3,); accepted: (2,), one per control of the model",
        ),
        (lambda: make(noise_std=None), "accepted: one of them"),
        (lambda: make(disturbance=StateNoise([0.1] * 4), num_outcomes=0), "num_outcomes is 0"),
        (lambda: make(parameterisation=Knots(7)), "num_knots is 7; accepted: at most the horizon"),
        (lambda: make(parameterisation=Knots(6, RBFKernel(5.0))), "length_scale is 5.0"),
        (
            lambda: make(proposal=GaussianProposal(noise_covariance=np.eye(3))),
            "noise_covariance has shape (3, 3); accepted: (2, 2)",
        ),
        (
            lambda: make(proposal=BiasedProposal(GAUSSIAN, np.zeros((5, 2)))),
            "reference has shape (5, 2); accepted: (6, 2)",
        ),
        (
            lambda: make(proposal=InjectedProposal(GAUSSIAN, np.zeros((1, 6, 3)))),
            "sequences has shape (1, 6, 3)",
        ),
        (
            lambda: make(
                proposal=InjectedProposal(GAUSSIAN, np.zeros((16, 6, 2)), null_action=True)
            ),
            "17 sequences are to be injected; accepted: at most num_samples, 16",
        ),
        (
            lambda: make(
                proposal=GaussianProposal([0.5, 0.5], noise=NoiseBank(8, key=jax.random.key(0)))
            ),
            "NoiseBank holds 8 numbers; accepted: at least 16, for 6 x 2 parameters",
        ),
        (
            lambda: make(
                proposal=GaussianProposal([0.5, 0.5], noise=ColouredNoise(1.0, SobolNoise())),
                horizon=20000,
            ),
            "at most 21201",
        ),
        (lambda: make(smoothing=SavitzkyGolay(13, 2)), "window is 13; accepted: at most 11"),
    ],
)
def test_what_does_not_fit_is_named(build, message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        build()


class Model(Dynamics):
    state_names: ClassVar[tuple[str, ...]] = ("x", "y")
    control_names: ClassVar[tuple[str, ...]] = ("u", "v")
    control_min: jax.Array = eqx.field(default_factory=lambda: -jnp.ones(2))
    control_max: jax.Array = eqx.field(default_factory=lambda: jnp.ones(2))
    radius: jax.Array = eqx.field(default_factory=lambda: jnp.asarray(0.2))

    def step(self, state, control, dt):
        return state + dt * control


class LongerStep(Model):
    def step(self, state, control, dt):
        return jnp.append(state, 0.0)


class ScalarStep(Model):
    def step(self, state, control, dt):
        return jnp.sum(state)


@pytest.mark.parametrize(("model", "shape"), [(LongerStep, "(3,)"), (ScalarStep, "()")])
def test_a_model_of_another_shape_is_named(model, shape: str, unchecked) -> None:
    message = f"step of {model.__name__} returns shape {shape}; accepted: (2,)"
    with pytest.raises(ValueError, match=re.escape(message)):
        make(model())


def test_bounds_must_fit_and_be_in_order() -> None:
    swapped = Model(control_min=jnp.ones(2), control_max=-jnp.ones(2))
    with pytest.raises(ValueError, match=r"control_min of Model is .* at most"):
        make(swapped)
    with pytest.raises(ValueError, match=r"control_max of Model has shape \(3,\)"):
        make(Model(control_max=jnp.ones(3)))
    with pytest.raises(ValueError, match=r"control_min of Model has shape \(\)"):
        make(Model(control_min=jnp.zeros(())))
    make(Model(control_min=jnp.zeros(2), control_max=jnp.zeros(2)))


class VectorStage(Cost):
    def stage(self, state, control, t, belief):
        return state.position


class VectorTerminal(Cost):
    def stage(self, state, control, t, belief):
        return jnp.zeros(())

    def terminal(self, state, belief):
        return state.position


class VectorSequence(Cost):
    def stage(self, state, control, t, belief):
        return jnp.zeros(())

    def sequence(self, controls, applied, dt, dynamics):
        return controls[:, 0]


class ReadsBelief(Cost):
    def stage(self, state, control, t, belief):
        return state.position - belief


def build_and_step(cost: Cost) -> None:
    mppi = make(Model(), cost)
    eqx.filter_eval_shape(mppi.step, mppi.init(), jnp.zeros(2), key=jax.random.key(0))


WRONG = [
    (VectorStage, "stage", "(2,)"),
    (VectorTerminal, "terminal", "(2,)"),
    (VectorSequence, "sequence", "(6,)"),
]


@pytest.mark.parametrize(("wrong", "method", "shape"), WRONG)
def test_a_cost_of_another_shape_is_named(wrong, method: str, shape: str, unchecked) -> None:
    message = f"{method} of {wrong.__name__} returns shape {shape}; accepted: ()"
    with pytest.raises(ValueError, match=re.escape(message)):
        build_and_step(wrong())


@pytest.mark.parametrize(
    ("wrong", "weight"),
    [(VectorStage, 1.0), (VectorStage, 0.5), (VectorTerminal, 1.0), (VectorSequence, 1.0)],
)
def test_a_wrong_cost_within_a_sum_is_named(wrong, weight: float, unchecked) -> None:
    part = wrong() if weight == 1.0 else weight * wrong()
    with pytest.raises(ValueError, match=wrong.__name__):
        build_and_step(COST + (part + COST))


def test_a_cost_that_reads_the_belief_is_checked_when_first_stepped(unchecked) -> None:
    mppi = make(Model(), ReadsBelief())
    with pytest.raises(ValueError, match=re.escape("stage of ReadsBelief returns shape (2,)")):
        eqx.filter_eval_shape(
            mppi.step, mppi.init(), jnp.zeros(2), jnp.ones(2), key=jax.random.key(0)
        )


class Sometimes(Cost):
    """Not a number where the first control is positive; everywhere, if it is said so."""

    everywhere: jax.Array

    def stage(self, state, control, t, belief):
        bad = (control[0] > 0.3) | (self.everywhere > 0.0)
        return jnp.where(bad, jnp.nan, jnp.sum((state.position - 1.0) ** 2))


@eqx.filter_jit
def step(mppi, state, observation, key):
    return mppi.step(state, observation, key=key)


@eqx.filter_jit
def shifted_only(mppi, state):
    """Return the controls of a plan that was shifted and no more, and the proposal's memory."""
    way, space, shifted = mppi.parameterisation, mppi._space, mppi._shift(state)
    kept = way.update(shifted.nominal, way.centre(shifted.nominal), space)
    return way.controls(kept, space), shifted.proposal


@pytest.mark.parametrize(
    ("parameterisation", "weighting", "adaptation"),
    [
        (Direct(), AdaptiveSoftmax(4.0), CovarianceAdaptation()),
        (Smooth(), Softmax(0.5), CovarianceAdaptation()),
        (Knots(3, CubicSpline()), Elite(0.25), CovarianceAdaptation()),
        (Knots(3, RBFKernel(2.0)), Softmax(0.5, 0.0), None),
    ],
)
def test_rollouts_that_are_no_numbers_stay_out(parameterisation, weighting, adaptation) -> None:
    std = [3.0, 3.0] if isinstance(parameterisation, Smooth) else [0.3, 0.3]
    mppi = make(
        cost=Sometimes(jnp.zeros(())),
        proposal=GaussianProposal(std, adaptation=adaptation),
        parameterisation=parameterisation,
        weighting=weighting,
        num_samples=32,
    )
    rows = np.linspace(-0.4, 0.2, 6)[:, None] * [1.0, -1.0]
    state = mppi.init(jnp.asarray(rows, jnp.float32))
    control, after, info = step(mppi, state, jnp.zeros(4), jax.random.key(0))
    bad = np.isinf(info.costs)
    assert bad.any()
    assert not bad.all()
    np.testing.assert_array_equal(np.asarray(info.weights)[bad], 0.0)
    assert float(info.weights.sum()) == pytest.approx(1.0, abs=1e-5)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves((control, after)))

    worse = eqx.tree_at(lambda m: m.cost.everywhere, mppi, jnp.ones(()))
    for program, observation in ((worse, jnp.zeros(4)), (mppi, jnp.full(4, jnp.nan))):
        control, after, info = step(program, state, observation, jax.random.key(0))
        assert not bool(info.is_finite)
        assert float(info.effective_sample_size) == 0.0
        expected, memory = shifted_only(mppi, state)
        np.testing.assert_allclose(info.controls, expected, atol=1e-5)
        np.testing.assert_allclose(control, expected[0], atol=1e-5)
        for kept, was in zip(jax.tree.leaves(after.proposal), jax.tree.leaves(memory), strict=True):
            np.testing.assert_allclose(kept, was, atol=1e-5)
        # The next observation finds everything as it should be.
        _, _, again = step(mppi, after, jnp.zeros(4), jax.random.key(1))
        assert bool(again.is_finite)


def test_what_differs_in_values_only_is_traced_once() -> None:
    """A search builds a controller for each candidate."""
    traces = 0

    class Counted(Cost):
        size: int = eqx.field(static=True, default=0)

        def stage(self, state, control, t, belief):
            nonlocal traces
            traces += 1
            return jnp.zeros((self.size,) if self.size else ())

    def build(cost: Cost, horizon: int = 5) -> int:
        before = traces
        MPPI(PointMass(2), cost, horizon=horizon, num_samples=4, noise_std=[1, 1])
        return traces - before

    assert build(1.0 * Counted()) == 1
    assert build(2.0 * Counted()) == 0
    assert build(2.0 * Counted(), horizon=6) == 1
    # What was refused once is refused again.
    for _ in range(2):
        with pytest.raises(ValueError, match=r"stage of Counted returns shape \(2,\); accepted"):
            build(Counted(2))
