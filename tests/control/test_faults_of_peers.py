"""Faults that other libraries of path-integral control have, one test each."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import (
    MPPI,
    Cost,
    GaussianProposal,
    GoalCost,
    HaltonNoise,
    InjectedProposal,
    Knots,
    PointMass,
    Quadrotor,
    RBFKernel,
    Smooth,
    StateCost,
    StateNoise,
)
from jaxplore.control import CubicSpline, Direct, WorstCase
from jaxplore.costs import QuadraticControlCost

pytestmark = pytest.mark.long

MASS = PointMass(2)
GOAL = GoalCost([1.0, 0.5])
REST = jnp.zeros(4)


@eqx.filter_jit
def step(mppi, state, observation, key, perturbations=None):
    return mppi.step(state, observation, key=key, perturbations=perturbations)


def make(robot=MASS, cost=GOAL, **changes) -> MPPI:
    settings = {"horizon": 8, "num_samples": 64, "temperature": 0.5, "dt": 0.1, **changes}
    if "proposal" not in changes:
        settings.setdefault("noise_std", [0.5, 0.5])
    return MPPI(robot, cost, **settings)


class Free(Cost):
    """Nothing costs anything."""

    def stage(self, state, control, t, belief):
        return jnp.zeros(())


def test_a_noise_term_without_temperature_and_nominal_that_leaves_one_sample_of_a_thousand() -> (
    None
):
    # The wrong term is sum eps^T Sigma^-1 eps, of the order T nu, not divided by anything.
    for temperature in (1e-3, 1.0, 1e3):
        mppi = make(cost=Free(), num_samples=1000, horizon=40, temperature=temperature)
        _, _, info = step(mppi, mppi.init(), REST, jax.random.key(0))
        assert float(info.effective_sample_size) == pytest.approx(1000.0, rel=1e-4)
        # With a nominal the term is u^T Sigma^-1 eps: its variance is |u / sigma|^2, whatever the
        # temperature is.
        some = mppi.init(jnp.full((40, 2), 0.03))
        _, _, info = step(mppi, some, REST, jax.random.key(0))
        variance = 78 * (0.03 / 0.5) ** 2
        assert float(info.effective_sample_size) == pytest.approx(
            1000.0 * np.exp(-variance), rel=0.05
        )


def test_an_update_with_noise_that_was_clipped_for_the_rollouts_only() -> None:
    mppi = make(cost=GoalCost([100.0, 0.0]), noise_std=[20.0, 20.0], temperature=100.0)
    noise = np.random.default_rng(0).normal(size=(8, 2, 64)) * 20.0
    _, state, info = step(
        mppi, mppi.init(), REST, jax.random.key(0), jnp.asarray(noise, jnp.float32)
    )
    weights = np.asarray(info.weights, float)
    np.testing.assert_allclose(state.nominal, np.clip(noise, -1, 1) @ weights, atol=1e-5)
    assert np.abs(noise @ weights).max() > 2.0
    for index in range(20):
        _, state, _ = step(mppi, state, REST, jax.random.key(index))
        assert np.abs(state.nominal).max() <= 1.0


@pytest.mark.parametrize("parameterisation", [Direct(), Smooth(), Knots(4, CubicSpline())])
def test_a_null_action_that_is_the_nominal(parameterisation) -> None:
    # Only doing nothing is good, and the noise would not find it.
    proposal = InjectedProposal(GaussianProposal([1e-3, 1e-3]), null_action=True)
    mppi = make(
        cost=QuadraticControlCost([1.0, 1.0]),
        proposal=proposal,
        parameterisation=parameterisation,
        temperature=1e-3,
    )
    state = mppi.init(jnp.full((8, 2), 0.8))
    if isinstance(parameterisation, Direct):
        # Without its shift the last row is the default already.
        state = state._replace(nominal=jnp.full((8, 2), 0.8))
    control, state, info = step(mppi, state, REST, jax.random.key(0))
    assert int(np.argmin(info.costs)) == 0
    assert float(info.costs[0]) == pytest.approx(0.0, abs=1e-6)
    assert float(np.min(info.costs[1:])) > 1.0
    np.testing.assert_allclose(control, 0.0, atol=1e-3)


def test_rollouts_of_outcomes_that_are_a_placeholder() -> None:
    still = make(disturbance=StateNoise([0.0] * 4), num_outcomes=5)
    plain = make()
    _, _, first = step(plain, plain.init(), REST, jax.random.key(0))
    _, _, same = step(still, still.init(), REST, jax.random.key(0))
    np.testing.assert_allclose(same.costs, first.costs, rtol=1e-5)
    several = make(disturbance=StateNoise([0.5] * 4), num_outcomes=5)
    worst = make(disturbance=StateNoise([0.5] * 4), num_outcomes=5, risk=WorstCase())
    _, _, mean = step(several, several.init(), REST, jax.random.key(0))
    _, _, most = step(worst, worst.init(), REST, jax.random.key(0))
    assert np.abs(mean.costs - first.costs).min() > 0.0
    assert (most.costs > mean.costs).all()


def hover(parameterisation, steps=200):
    """Return the states of a quadrotor that is to stay where it is."""
    robot = Quadrotor()
    cost = StateCost(
        {"x": 1.0, "y": 1.0, "z": 2.0, "vx": 0.2, "vy": 0.2, "vz": 0.2, "wz": 0.01}
    ) + QuadraticControlCost([0.002, 0.02, 0.02, 0.02])
    mppi = MPPI(
        robot,
        cost,
        horizon=20,
        num_samples=128,
        temperature=0.5,
        noise_std=[1.0, 0.5, 0.5, 0.2],
        dt=0.05,
        parameterisation=parameterisation,
    )
    start = robot.at_pose(0.0, 0.0, 0.0)

    @eqx.filter_jit
    def run(mppi, key):
        def advance(carry, key):
            x, state = carry
            control, state, _ = mppi.step(state, x, key=key)
            x = robot.step(x, control, mppi.dt)
            return (x, state), x

        return jax.lax.scan(advance, (start, mppi.init()), jax.random.split(key, steps))[1]

    return np.asarray(run(mppi, jax.random.key(0)))


def test_kernels_that_fall_to_no_thrust_and_a_quadrotor_that_falls_with_them() -> None:
    # Ten seconds of hovering with knots: the tail of the plan is the default control, hover.
    states = hover(Knots(5, RBFKernel(4.0)))
    assert np.abs(states[:, 2]).max() < 0.3
    assert np.hypot(states[:, 0], states[:, 1]).max() < 0.5


@pytest.mark.parametrize("interpolation", [RBFKernel(3.0), CubicSpline()])
def test_a_kernel_controller_that_answers_with_the_next_steps_control(interpolation) -> None:
    # Its first shift, by a period, comes with the next call: what is given out is row 0 of the
    # controls of the knots, and one step later it is what row 1 was.
    mppi = make(parameterisation=Knots(5, interpolation))
    none = jnp.zeros((5, 2, 64))
    control, state, info = step(mppi, mppi.init(), REST, jax.random.key(0))
    np.testing.assert_array_equal(control, info.controls[0])
    np.testing.assert_allclose(control, state.nominal[0], atol=1e-5)
    following, _, _ = step(mppi, state, REST, jax.random.key(0), none)
    np.testing.assert_allclose(following, info.controls[1], atol=1e-4)


def test_a_smooth_controller_that_repeats_the_wrong_element() -> None:
    mppi = make(parameterisation=Smooth())
    controls = jnp.linspace(-0.8, 0.8, 16).reshape(8, 2)
    state, none = mppi.init(controls), jnp.zeros((8, 2, 64))
    for index in range(1, 12):
        control, state, info = step(mppi, state, REST, jax.random.key(0), none)
        expected = np.asarray(controls)[np.minimum(np.arange(8) + index, 7)]
        np.testing.assert_allclose(info.controls, expected, atol=1e-6)
        np.testing.assert_allclose(control, expected[0], atol=1e-6)


@pytest.mark.parametrize("parameterisation", [Direct(), Smooth(), Knots(4, CubicSpline())])
def test_sampled_rollouts_that_are_all_the_same(parameterisation) -> None:
    mppi = make(parameterisation=parameterisation)
    look = eqx.filter_jit(mppi.inspect)
    seen = look(mppi.init(), REST, key=jax.random.key(0), num_trajectories=20)
    ends = np.asarray(seen.samples[:, -1])
    apart = np.abs(ends[:, None] - ends[None]).max(axis=-1) + np.eye(20)
    assert apart.min() > 1e-5
    assert ends[:, :2].std() > 1e-3


def test_random_streams_that_are_correlated() -> None:
    mppi = make(cost=Free(), num_samples=256)
    one, other = jax.random.split(jax.random.key(0))
    look = eqx.filter_jit(
        lambda key: mppi.inspect(mppi.init(), REST, key=key, num_trajectories=256).samples[:, -1]
    )
    ends = [np.asarray(look(key)).ravel() for key in (one, other, jax.random.key(0))]
    for first, second in ((0, 1), (0, 2), (1, 2)):
        assert abs(np.corrcoef(ends[first], ends[second])[0, 1]) < 4.0 / np.sqrt(1024)
    # Within one step, outcomes do not repeat the noise of the samples.
    noisy = make(cost=Free(), disturbance=StateNoise([1.0] * 4), num_outcomes=64, horizon=4)
    key = jax.random.key(3)
    sample_key, outcome_key = jax.random.split(key)
    draws = np.asarray(noisy.disturbance.draw(MASS, 4, 64, key=outcome_key))[:, :, :2]
    noise = np.asarray(GaussianProposal([1.0, 1.0]).draw((), (4, 2), 64, key=sample_key))
    assert abs(np.corrcoef(draws.transpose(0, 2, 1).ravel(), noise.ravel())[0, 1]) < 0.18


def test_a_halton_spline_that_kinks_at_its_knots() -> None:
    mppi = make(
        horizon=25,
        proposal=GaussianProposal([0.3, 0.3], noise=HaltonNoise()),
        parameterisation=Knots(5, CubicSpline()),
    )
    _, _, info = step(mppi, mppi.init(), REST, jax.random.key(0))
    second = np.abs(np.diff(np.asarray(info.controls, float), n=2, axis=0))
    third = np.abs(np.diff(np.asarray(info.controls, float), n=3, axis=0))
    assert second.max() > 1e-4
    # A kink's second difference is a slope; a smooth curve's differences from row to row little.
    assert third.max() < 0.6 * second.max()
    kinked = np.interp(np.arange(25), np.linspace(0, 24, 5), np.asarray(info.controls)[::6, 0])
    bends = np.abs(np.diff(kinked, n=2))
    assert np.abs(np.diff(kinked, n=3)).max() > 0.9 * bends.max()


class Reward(Cost):
    """Pays for control, the more the better."""

    def stage(self, state, control, t, belief):
        return -jnp.sum(control)


@pytest.mark.parametrize(
    ("parameterisation", "std"),
    [(Direct(), 30.0), (Smooth(), 300.0), (Knots(4, CubicSpline()), 30.0)],
)
def test_a_reward_on_a_control_that_the_dynamics_then_clip(parameterisation, std: float) -> None:
    mppi = make(cost=Reward(), noise_std=[std, std], parameterisation=parameterisation)
    _, _, info = step(mppi, mppi.init(), REST, jax.random.key(0))
    # The most there is to earn is the bound of both controls at every step.
    assert float(np.min(info.costs)) >= -8 * 2 * 1.0 - 1e-4
    assert np.abs(info.controls).max() <= 1.0
