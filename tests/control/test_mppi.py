import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import MPPI, Cost, DifferentialDrive, GaussianProposal, Softmax

pytestmark = pytest.mark.long

HORIZON, SAMPLES, DT, TEMPERATURE = 7, 64, 0.1, 0.5
STD = np.array([0.6, 1.1])
TARGET = np.array([1.0, 0.5])


class ToPoint(Cost):
    """Quadratic, dependent on time, with a terminal cost; asks nothing of the belief."""

    target: jax.Array = eqx.field(default_factory=lambda: jnp.asarray(TARGET, jnp.float32))

    def stage(self, state, control, t, belief):
        error = state.position - self.target
        return jnp.sum(error * error) * (1.0 + t) + 0.1 * jnp.sum(control * control)

    def terminal(self, state, belief):
        return 3.0 * jnp.abs(state.speed - 0.2)


ROBOT = DifferentialDrive(max_speed=1.0, max_acceleration=0.7, max_angular_acceleration=1.0)
traces = 0


@eqx.filter_jit
def step(mppi, state, observation, belief, key, perturbations=None):
    global traces
    traces += 1
    return mppi.step(state, observation, belief, key=key, perturbations=perturbations)


def make(**changes) -> MPPI:
    settings = {
        "horizon": HORIZON,
        "num_samples": SAMPLES,
        "temperature": TEMPERATURE,
        "noise_std": STD,
        "dt": DT,
    }
    return MPPI(ROBOT, ToPoint(), **{**settings, **changes})


def driven(x0: np.ndarray, controls: np.ndarray) -> np.ndarray:
    """States that controls lead to, in double precision with a loop."""
    x, reached = np.asarray(x0, float), []
    for u in controls:
        px, py, yaw, v, w = x
        x = np.array(
            [
                px + v * math.cos(yaw) * DT,
                py + v * math.sin(yaw) * DT,
                yaw + w * DT,
                min(max(v + (u[0] - 0.1 * v) * DT, 0.0), 1.0),
                min(max(w + (u[1] - 0.1 * w) * DT, -2.0), 2.0),
            ]
        )
        reached.append(x)
    return np.array(reached)


def to_point(states: np.ndarray, controls: np.ndarray) -> float:
    """The cost of `ToPoint` in double precision."""
    times = DT * np.arange(1, len(states) + 1)
    errors = ((states[:, :2] - TARGET) ** 2).sum(axis=1)
    return errors @ (1 + times) + 0.1 * (controls**2).sum() + 3.0 * abs(states[-1, 3] - 0.2)


def reference(nominal: np.ndarray, x0: np.ndarray, noise: np.ndarray, shift: float = 1.0):
    """MPPI in double precision with loops: (nominal, costs, weights)."""
    low, high = np.array([-0.7, -1.0]), np.array([0.7, 1.0])
    padded = np.vstack([nominal, np.zeros((2, 2))])
    whole, part = int(shift), shift - int(shift)
    moved = np.array(
        [(1 - part) * padded[min(t + whole, 7)] + part * padded[min(t + whole + 1, 7)]
         for t in range(HORIZON)]
    )  # fmt: skip
    costs, effective = np.zeros(SAMPLES), np.zeros((SAMPLES, HORIZON, 2))
    importance = np.zeros(SAMPLES)
    for k in range(SAMPLES):
        controls = np.clip(moved[:HORIZON] + noise[:, :, k], low, high)
        effective[k] = controls - moved[:HORIZON]
        importance[k] = np.einsum("tu,u,tu->", moved[:HORIZON], 1 / STD**2, effective[k])
        costs[k] = to_point(driven(x0, controls), controls)
    total = costs + TEMPERATURE * importance
    weights = np.exp(-(total - total.min()) / TEMPERATURE)
    weights /= weights.sum()
    return moved + np.einsum("k,ktu->tu", weights, effective), costs, weights


@pytest.mark.parametrize("period", [DT, 0.4 * DT, 1.5 * DT])
def test_equals_the_formula_in_double_precision(period: float, empty_belief) -> None:
    rng = np.random.default_rng(0)
    mppi = make().at_period(period)
    x0 = np.array([0.1, -0.2, 0.3, 0.4, -0.5])
    state, nominal = mppi.init(), np.zeros((HORIZON, 2))
    for _ in range(5):
        noise = rng.normal(size=(HORIZON, 2, SAMPLES)) * STD[:, None]
        expected, costs, weights = reference(nominal, x0, noise, period / DT)
        control, state, info = step(
            mppi,
            state,
            jnp.asarray(x0, jnp.float32),
            empty_belief,
            jax.random.key(0),
            jnp.asarray(noise, jnp.float32),
        )
        np.testing.assert_allclose(info.costs, costs, rtol=1e-5)
        np.testing.assert_allclose(info.weights, weights, rtol=2e-4, atol=1e-6)
        np.testing.assert_allclose(state.nominal, expected, rtol=1e-4, atol=1e-5)
        np.testing.assert_array_equal(control, state.nominal[0])
        assert float(info.effective_sample_size) == pytest.approx(1 / (weights**2).sum(), rel=1e-3)
        nominal, x0 = np.asarray(state.nominal, float), x0 + 0.05


def test_clipped_noise_leaves_the_nominal_within_the_bounds(empty_belief) -> None:
    mppi = make(noise_std=[50.0, 50.0])
    state = mppi.init(jnp.full((HORIZON, 2), 0.7))
    for index in range(5):
        _, state, _ = step(
            mppi, state, ROBOT.at_pose(0.0, 0.0, 0.0), empty_belief, jax.random.key(index)
        )
        assert (jnp.abs(state.nominal) <= jnp.asarray([0.7, 1.0]) + 1e-6).all()


class LineCost(Cost):
    """Linear in the controls, so that the bounded optimum is known."""

    def stage(self, state, control, t, belief):
        return -control[0] + jnp.abs(control[1])


def test_reaches_the_bound_and_stays_unbiased_beside_it(empty_belief) -> None:
    mppi = MPPI(
        ROBOT,
        LineCost(),
        horizon=3,
        num_samples=4000,
        temperature=0.05,
        noise_std=[0.5, 0.5],
        dt=DT,
    )
    state, controls = mppi.init(), []
    for index in range(40):
        key = jax.random.key(index)
        control, state, _ = step(mppi, state, ROBOT.at_pose(0.0, 0.0, 0.0), empty_belief, key)
        controls.append(np.asarray(control))
    mean = np.mean(controls[10:], axis=0)
    assert mean[0] == pytest.approx(0.7, abs=0.05)
    assert abs(mean[1]) < 0.03


class Poisoned(Cost):
    """Not finite for rollouts that turn left, or for all."""

    everywhere: jax.Array

    def stage(self, state, control, t, belief):
        bad = (state["omega"] > 0.0) | (self.everywhere > 0.0)
        return jnp.where(bad, jnp.nan, jnp.sum(state.position**2))


def test_rollouts_that_are_not_finite_have_no_weight(empty_belief) -> None:
    mppi = make()
    mppi = eqx.tree_at(lambda m: m.cost, mppi, Poisoned(jnp.zeros(())))
    control, state, info = step(
        mppi, mppi.init(), ROBOT.at_pose(1.0, 1.0, 0.0), empty_belief, jax.random.key(0)
    )
    assert bool(info.is_finite)
    assert np.isfinite(control).all()
    assert np.isfinite(state.nominal).all()
    assert float(info.weights.sum()) == pytest.approx(1.0)
    assert (np.asarray(info.weights)[np.isinf(info.costs)] == 0).all()
    assert np.isinf(info.costs).any()


@pytest.mark.parametrize("where", ["cost", "observation"])
def test_without_a_finite_rollout_the_shifted_nominal_stays(where: str, empty_belief) -> None:
    mppi = make()
    observation = ROBOT.at_pose(0.0, 0.0, 0.0)
    if where == "cost":
        mppi = eqx.tree_at(lambda m: m.cost, mppi, Poisoned(jnp.ones(())))
    else:
        observation = observation.at[2].set(jnp.nan)
    nominal = jnp.asarray(np.random.default_rng(0).uniform(-0.5, 0.5, (HORIZON, 2)), jnp.float32)
    control, state, info = step(
        mppi, mppi.init(nominal), observation, empty_belief, jax.random.key(0)
    )
    assert not bool(info.is_finite)
    assert float(info.effective_sample_size) == 0.0
    np.testing.assert_allclose(state.nominal[:-1], nominal[1:], atol=1e-6)
    np.testing.assert_array_equal(state.nominal[-1], 0.0)
    np.testing.assert_allclose(control, nominal[1], atol=1e-6)


def test_nothing_but_sizes_recompiles(empty_belief) -> None:
    mppi = make()
    step(mppi, mppi.init(), ROBOT.at_pose(0.0, 0.0, 0.0), empty_belief, jax.random.key(0))
    before = traces
    for changed in (
        make(temperature=2.0),
        make(noise_std=[0.1, 0.2]),
        make(dt=0.03),
        make().at_period(0.02),
        eqx.tree_at(lambda m: m.cost.target, mppi, jnp.asarray([3.0, 3.0])),
        eqx.tree_at(lambda m: m.dynamics, mppi, DifferentialDrive(max_speed=0.3, drag=0.5)),
    ):
        step(changed, changed.init(), ROBOT.at_pose(1.0, 2.0, 3.0), empty_belief, jax.random.key(1))
    assert traces == before
    step(
        make(num_samples=8),
        mppi.init(),
        ROBOT.at_pose(0.0, 0.0, 0.0),
        empty_belief,
        jax.random.key(0),
    )
    assert traces == before + 1


def test_inspect_shows_what_step_does(empty_belief) -> None:
    mppi, x0, key = make(), ROBOT.at_pose(0.2, 0.1, 0.4), jax.random.key(3)
    _, after, info = step(mppi, mppi.init(), x0, empty_belief, key)
    plan = eqx.filter_jit(mppi.inspect)(mppi.init(), x0, empty_belief, key=key, num_trajectories=10)
    chosen = np.linspace(0, SAMPLES - 1, 10).round().astype(int)
    np.testing.assert_allclose(plan.weights, info.weights[chosen], rtol=1e-5)
    assert plan.samples.shape == (10, HORIZON + 1, 5)
    np.testing.assert_array_equal(plan.samples[:, 0], np.tile(x0, (10, 1)))
    state, paid = x0, 0.0
    for t, control in enumerate(after.nominal):
        state = ROBOT.step(state, control, jnp.asarray(DT))
        np.testing.assert_allclose(plan.nominal.states[t + 1], state, atol=1e-5)
        error = np.asarray(state[:2]) - TARGET
        paid += (error @ error) * (1 + (t + 1) * DT) + 0.1 * float(control @ control)
    paid += 3.0 * abs(float(state[3]) - 0.2)
    assert float(plan.nominal.terms["ToPoint"]) == pytest.approx(paid, rel=1e-4)


class Turning(Cost):
    """The square of the turn rate, whatever else there is."""

    def stage(self, state, control, t, belief):
        return jnp.square(state["omega"])


def test_each_rollout_that_is_shown_has_its_cost_by_term(empty_belief) -> None:
    mppi = make()
    mppi = eqx.tree_at(lambda c: c.cost, mppi, 2.0 * mppi.cost + 0.5 * Turning() + Turning())

    @eqx.filter_jit
    def look(mppi, x0, belief, key):
        sampled = mppi.sample(mppi.init(), key=key)
        plan = mppi.inspect(mppi.init(), x0, belief, key=key, num_trajectories=9)
        return sampled.controls, mppi.evaluate(sampled, x0, belief), plan

    x0 = ROBOT.at_pose(0.2, 0.1, 0.4)
    controls, totals, plan = look(mppi, x0, empty_belief, jax.random.key(3))
    assert set(plan.sample_terms) == set(plan.nominal.terms) == {"ToPoint", "Turning"}
    chosen = np.linspace(0, SAMPLES - 1, 9).round().astype(int)
    for i, k in enumerate(chosen):
        given = np.asarray(controls[:, :, k], float)
        states = driven(x0, given)
        np.testing.assert_allclose(plan.samples[i, 1:], states, atol=1e-5)
        # Terms of one name are added up.
        expected = {
            "ToPoint": 2.0 * to_point(states, given),
            "Turning": 1.5 * sum(states[:, 4] ** 2),
        }
        paid = {name: float(each[i]) for name, each in plan.sample_terms.items()}
        assert paid == pytest.approx(expected, rel=1e-4)
    np.testing.assert_allclose(sum(plan.sample_terms.values()), totals[chosen], rtol=1e-5)


def test_the_same_key_gives_the_same_step(empty_belief) -> None:
    mppi, x0 = make(), ROBOT.at_pose(0.0, 0.0, 0.0)
    first = step(mppi, mppi.init(), x0, empty_belief, jax.random.key(5))
    again = step(mppi, mppi.init(), x0, empty_belief, jax.random.key(5))
    other = step(mppi, mppi.init(), x0, empty_belief, jax.random.key(6))
    np.testing.assert_array_equal(first[0], again[0])
    assert not np.array_equal(first[0], other[0])


def test_drives_to_a_point(empty_belief) -> None:
    mppi = make(horizon=20, num_samples=256, temperature=0.2)

    @jax.jit
    def run(key):
        def advance(carry, key):
            x, state = carry
            control, state, _ = mppi.step(state, x, empty_belief, key=key)
            return (ROBOT.step(x, control, mppi.dt), state), x

        keys = jax.random.split(key, 120)
        return jax.lax.scan(advance, (ROBOT.at_pose(-1.0, -1.0, 2.0), mppi.init()), keys)[0][0]

    end = run(jax.random.key(0))
    assert float(jnp.linalg.norm(end[:2] - TARGET)) < 0.35


def test_softmax_is_invariant_to_a_constant_and_survives_extremes() -> None:
    costs = jnp.asarray([1.0, 2.0, jnp.inf, jnp.nan])
    none = jnp.zeros(4)
    weights = Softmax(0.5).weights(costs, none)
    expected = np.array([1.0, math.exp(-2.0), 0, 0]) / (1 + math.exp(-2.0))
    np.testing.assert_allclose(weights, expected, rtol=1e-6)
    np.testing.assert_allclose(Softmax(0.5).weights(costs + 1024.0, none), expected, rtol=1e-4)
    huge = Softmax(1e-6).weights(jnp.asarray([1e30, 2e30, 1e38, 0.0]), none)
    np.testing.assert_array_equal(huge, [0, 0, 0, 1])


@pytest.mark.parametrize(
    ("changes", "culprit"),
    [
        ({"noise_std": None}, "noise_std is None"),
        ({"proposal": GaussianProposal([1.0, 1.0])}, "accepted: one of them"),
        ({"weighting": Softmax(1.0)}, "accepted: one of them"),
    ],
)
def test_bad_input_is_named(changes, culprit: str) -> None:
    with pytest.raises(ValueError, match=culprit):
        make(**changes)
