"""MPPI on linear-quadratic problems, whose result is known in closed form."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import (
    MPPI,
    BiasedProposal,
    ColouredNoise,
    GaussianProposal,
    InjectedProposal,
    Knots,
    PointMass,
    RBFKernel,
    Smooth,
    Softmax,
    StateCost,
)
from jaxplore.control import AntitheticNoise, CovarianceAdaptation, CubicSpline, Direct, SobolNoise
from jaxplore.costs import QuadraticControlCost

pytestmark = pytest.mark.long

HORIZON, DT, LAMBDA = 6, 0.2, 0.4
STD = 0.8
START = np.array([0.0, 0.3])


class Quadratic:
    """`J(u) = |A u + b|^2` of the double integrator in d dimensions, in double precision."""

    def __init__(self, d: int) -> None:
        self.d, self.size = d, HORIZON * d
        weights = {"x": 1.0, "vx": 0.2, "y": 0.5, "vy": 0.1}
        target = {"x": 1.0, "y": -0.7}
        names = [*("x", "y")[:d], *("vx", "vy")[:d]]
        effort = [0.05, 0.1][:d]
        self.cost = StateCost(
            {name: weights[name] for name in names},
            {name: target[name] for name in ("x", "y")[:d]},
            terminal_weight=2.0,
        ) + QuadraticControlCost(effort)
        self.robot = PointMass(d, max_acceleration=100.0)
        self.start = np.repeat(START, d)

        def residuals(u: np.ndarray) -> np.ndarray:
            x, found = self.start.copy(), []
            for t, control in enumerate(u.reshape(HORIZON, d)):
                x[:d] += DT * x[d:] + 0.5 * DT**2 * control
                x[d:] += DT * control
                times = 3.0 if t == HORIZON - 1 else 1.0
                found += [
                    np.sqrt(times * weights[name]) * (value - target.get(name, 0.0))
                    for name, value in zip(names, x, strict=True)
                ]
                found += list(np.sqrt(effort) * control)
            return np.array(found)

        self.offset = residuals(np.zeros(self.size))
        self.design = np.stack([residuals(e) - self.offset for e in np.eye(self.size)], axis=1)

    def optimum(self) -> np.ndarray:
        """Return the controls of least cost."""
        return np.linalg.lstsq(self.design, -self.offset, rcond=None)[0]

    def posterior(self, prior_mean, prior, matrix=None, base=None):
        """Return mean and log evidence of `exp(-J(base + M v) / lambda) N(v; prior)`."""
        matrix = np.eye(self.size) if matrix is None else matrix
        a = self.design @ matrix
        b = self.offset + (0.0 if base is None else self.design @ base)
        precision = np.linalg.inv(prior)
        full = 2.0 / LAMBDA * a.T @ a + precision
        right = precision @ prior_mean - 2.0 / LAMBDA * a.T @ b
        mean = np.linalg.solve(full, right)
        evidence = (
            0.5 * right @ mean
            - 0.5 * prior_mean @ precision @ prior_mean
            - 0.5 * np.linalg.slogdet(full @ prior)[1]
            - b @ b / LAMBDA
        )
        return mean, evidence


LINE, PLANE = Quadratic(1), Quadratic(2)


def estimates(problem, num_samples, seeds, *, proposal, state=None, importance=1.0, **changes):
    """Return the parameters' weighted means (seeds, P nu) of one step from each of many keys."""
    mppi = MPPI(
        problem.robot,
        problem.cost,
        horizon=HORIZON,
        num_samples=num_samples,
        dt=DT,
        control_period=1e-6,
        proposal=proposal,
        weighting=Softmax(LAMBDA, importance),
        **changes,
    )
    state = mppi.init() if state is None else state(mppi)
    observation = jnp.asarray(problem.start, jnp.float32)
    found = centres(mppi, state, observation, jax.random.split(jax.random.key(7), seeds))
    return np.asarray(found, np.float64).reshape(seeds, -1)


@eqx.filter_jit
def centres(mppi, state, observation, keys):
    """Return the parameters' weighted means after one step, for each key."""

    def one(key):
        _, after, _ = mppi.step(state, observation, key=key)
        return mppi.parameterisation.centre(after.nominal)

    return jax.lax.map(one, keys)


@eqx.filter_jit
def repeated(mppi, observation, keys):
    """Return the plans (N, T) of one step after the other from the same place."""

    def advance(state, key):
        _, state, info = mppi.step(state, observation, key=key)
        return state, info.controls[:, 0]

    return jax.lax.scan(advance, mppi.init(), keys)[1]


def nominal(mppi):
    """Return a state whose nominal is neither 0 nor the optimum."""
    controls = jnp.linspace(0.6, -0.3, HORIZON)[:, None] * jnp.asarray([1.0, -0.5])
    return mppi.init(controls[:, : mppi.dynamics.control_size])


def root_mean_square(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def test_the_weighted_mean_tends_to_the_posterior_mean_as_one_over_the_root_of_samples() -> None:
    exact, _ = LINE.posterior(np.zeros(6), STD**2 * np.eye(6))
    errors = [
        root_mean_square(
            estimates(LINE, samples, 24, proposal=GaussianProposal([STD]), state=nominal) - exact
        )
        for samples in (512, 8192)
    ]
    assert errors[1] < 0.03
    # Sixteen times the samples, a quarter of the error.
    assert 3.0 < errors[0] / errors[1] < 5.5


FULL = np.array([[0.6, 0.25], [0.25, 0.4]])
COLOUR = np.asarray(ColouredNoise(1.0).covariance(HORIZON), np.float64)


@pytest.mark.parametrize(
    ("problem", "proposal", "prior_mean", "prior"),
    [
        pytest.param(
            PLANE,
            GaussianProposal(noise_covariance=FULL),
            np.zeros(12),
            np.kron(np.eye(6), FULL),
            id="full covariance",
        ),
        pytest.param(
            LINE,
            GaussianProposal([STD], noise=ColouredNoise(1.0)),
            np.zeros(6),
            STD**2 * COLOUR,
            id="coloured",
        ),
        pytest.param(
            PLANE,
            GaussianProposal(noise_covariance=FULL, noise=ColouredNoise(1.0)),
            np.zeros(12),
            np.kron(COLOUR, FULL),
            id="coloured, full covariance",
        ),
        pytest.param(
            LINE,
            GaussianProposal([STD], noise=SobolNoise()),
            np.zeros(6),
            STD**2 * np.eye(6),
            id="Sobol",
        ),
        pytest.param(
            LINE,
            GaussianProposal([STD], noise=AntitheticNoise()),
            np.zeros(6),
            STD**2 * np.eye(6),
            id="antithetic",
        ),
        pytest.param(
            LINE,
            GaussianProposal([STD], mean=[0.2], noise=ColouredNoise(1.0, SobolNoise())),
            np.full(6, 0.2),
            STD**2 * COLOUR,
            id="Sobol, coloured, mean",
        ),
        pytest.param(
            LINE,
            BiasedProposal(GaussianProposal([STD], mean=[0.3]), np.full((6, 1), 0.8), 0.25),
            np.full(6, 0.3),
            STD**2 * np.eye(6),
            id="mixture, mean",
        ),
        pytest.param(
            LINE,
            InjectedProposal(GaussianProposal([STD]), null_action=True, last_solution=True),
            np.zeros(6),
            STD**2 * np.eye(6),
            id="injected: two of many",
        ),
    ],
)
def test_every_proposal_has_the_limit_of_its_uncontrolled_distribution(
    problem, proposal, prior_mean, prior
) -> None:
    exact, _ = problem.posterior(prior_mean, prior)
    found = estimates(problem, 8192, 24, proposal=proposal, state=nominal)
    # The mean over seeds has a fifth of the error of one seed: a bias would show.
    spread = found.std(axis=0, ddof=1) / np.sqrt(24)
    assert (np.abs(found.mean(axis=0) - exact) < 4.0 * spread + 3e-3).all()
    assert root_mean_square(found - exact) < 0.06


def test_an_adapted_spread_keeps_the_limit() -> None:
    proposal = GaussianProposal([STD], adaptation=CovarianceAdaptation())

    def narrowed(mppi):
        return nominal(mppi)._replace(proposal=jnp.linspace(0.75, 1.0, HORIZON)[:, None])

    exact, _ = LINE.posterior(np.zeros(6), STD**2 * np.eye(6))
    found = estimates(LINE, 8192, 24, proposal=proposal, state=narrowed)
    assert np.abs(found.mean(axis=0) - exact).max() < 0.03


def test_sobol_points_converge_faster_than_random_ones() -> None:
    exact, _ = LINE.posterior(np.zeros(6), STD**2 * np.eye(6))
    white, sobol = (
        root_mean_square(
            estimates(LINE, 8192, 24, proposal=GaussianProposal([STD], noise=noise), state=nominal)
            - exact
        )
        for noise in (None, SobolNoise())
    )
    assert sobol < 0.5 * white


def test_without_its_ratio_a_mixture_leans_towards_the_reference_by_as_much_as_it_should() -> None:
    proposal = BiasedProposal(
        GaussianProposal([STD]), np.full((6, 1), 0.8), 0.5, likelihood_ratio=False
    )
    prior = STD**2 * np.eye(6)
    unbiased, _ = LINE.posterior(np.zeros(6), prior)
    means, evidences = zip(
        *(LINE.posterior(np.asarray(c), prior) for c in (np.zeros(6), np.full(6, 0.8))),
        strict=True,
    )
    share = 1.0 / (1.0 + np.exp(evidences[1] - evidences[0]))
    exact = share * means[0] + (1.0 - share) * means[1]
    assert np.abs(exact - unbiased).max() > 0.2
    found = estimates(LINE, 8192, 16, proposal=proposal)
    assert np.abs(found.mean(axis=0) - exact).max() < 0.03


@pytest.mark.parametrize("interpolation", [CubicSpline(), RBFKernel(2.0)])
def test_knots_have_the_posterior_of_the_knots(interpolation) -> None:
    matrix = np.asarray(interpolation.weights(jnp.arange(6.0), 4, 5.0), np.float64)
    exact, _ = LINE.posterior(np.zeros(4), STD**2 * np.eye(4), matrix)
    found = estimates(
        LINE,
        8192,
        16,
        proposal=GaussianProposal([STD]),
        parameterisation=Knots(4, interpolation),
        state=nominal,
    )
    assert np.abs(found.mean(axis=0) - exact).max() < 0.02


def test_rates_have_the_posterior_of_the_rates() -> None:
    base = np.linspace(0.6, -0.3, HORIZON)
    exact, _ = LINE.posterior(np.zeros(6), 16.0 * np.eye(6), DT * np.eye(6), base)
    found = estimates(
        LINE,
        8192,
        16,
        proposal=GaussianProposal([4.0]),
        parameterisation=Smooth(),
        state=nominal,
    )
    assert np.abs(DT * (found.mean(axis=0) - exact)).max() < 0.02


def test_importance_between_0_and_1_keeps_that_share_of_the_pull() -> None:
    # Without the ratio the prior is the nominal's distribution; a share of it is in between.
    centre = np.linspace(0.6, -0.3, HORIZON)
    for importance in (0.0, 0.5):
        exact, _ = LINE.posterior((1.0 - importance) * centre, STD**2 * np.eye(6))
        found = estimates(
            LINE,
            8192,
            24,
            proposal=GaussianProposal([STD]),
            state=nominal,
            importance=importance,
        )
        assert np.abs(found.mean(axis=0) - exact).max() < 0.025


@pytest.mark.parametrize("parameterisation", [Direct(), Knots(6, CubicSpline())])
def test_repeated_steps_reach_the_optimum_of_the_quadratic_program(parameterisation) -> None:
    mppi = MPPI(
        LINE.robot,
        LINE.cost,
        horizon=HORIZON,
        num_samples=2048,
        dt=DT,
        control_period=1e-6,
        noise_std=[0.3],
        weighting=Softmax(0.01, 0.0),
        parameterisation=parameterisation,
    )
    keys = jax.random.split(jax.random.key(0), 150)
    plans = np.asarray(repeated(mppi, jnp.asarray(START, jnp.float32), keys), np.float64)
    optimum = LINE.optimum()
    assert np.abs(optimum).max() > 1.0
    assert np.abs(plans[50:].mean(axis=0) - optimum).max() < 0.08

    def cost(u: np.ndarray) -> float:
        return float(np.sum((LINE.design @ u + LINE.offset) ** 2))

    # Far from 0, where it began.
    assert cost(plans[50:].mean(axis=0)) < cost(optimum) + 1e-3 * cost(np.zeros(6))


@pytest.mark.parametrize("optimum", [0.5, 0.95, 1.0, 3.0, -1.0])
def test_bounds_bias_nothing(optimum: float) -> None:
    temperature, std = 2e-4, 0.5
    mppi = MPPI(
        PointMass(1, max_acceleration=1.0),
        QuadraticControlCost([1.0], [optimum]),
        horizon=2,
        num_samples=1024,
        dt=DT,
        control_period=1e-6,
        noise_std=[std],
        weighting=Softmax(temperature, 0.0),
    )

    keys = jax.random.split(jax.random.key(1), 150)
    found = np.asarray(repeated(mppi, jnp.zeros(2), keys), np.float64)[20:, 0]
    assert (np.abs(found) <= 1.0).all()
    # The limit of many samples is the fixed point of the mean over the clipped distribution.
    centre, noise = 0.0, std * np.linspace(-6.0, 6.0, 20001)
    density = np.exp(-0.5 * (noise / std) ** 2)
    for _ in range(100):
        u = np.clip(centre + noise, -1.0, 1.0)
        paid = (u - optimum) ** 2
        weights = density * np.exp(-(paid - paid.min()) / temperature)
        centre = float(weights @ u / weights.sum())
    assert abs(centre - np.clip(optimum, -1.0, 1.0)) < 0.01
    assert abs(found.mean() - centre) < 5e-3
