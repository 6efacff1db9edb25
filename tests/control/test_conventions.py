"""What a step means: when costs are taken, how plans move on in time, what is handed out."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal

from jaxplore import (
    MPPI,
    BiasedProposal,
    ControlRateCost,
    Cost,
    Dynamics,
    GaussianProposal,
    GoalCost,
    InjectedProposal,
    Knots,
    PointMass,
    Smooth,
    Softmax,
    StateCost,
)
from jaxplore.control import (
    CovarianceAdaptation,
    CubicSpline,
    SavitzkyGolay,
    ZeroOrderHold,
)
from jaxplore.costs import QuadraticControlCost

pytestmark = pytest.mark.long

DT = 0.1


class Clock(Dynamics):
    """`x' = x + dt (1 + t) u`: what a control does depends on when it is given."""

    state_names: ClassVar[tuple[str, ...]] = ("x",)
    control_names: ClassVar[tuple[str, ...]] = ("u",)
    control_min: jax.Array = eqx.field(default_factory=lambda: jnp.full(1, -10.0))
    control_max: jax.Array = eqx.field(default_factory=lambda: jnp.full(1, 10.0))
    radius: jax.Array = eqx.field(default_factory=lambda: jnp.asarray(0.1))

    def step(self, state, control, dt):
        raise AssertionError("the engine calls step_at")

    def step_at(self, state, control, t, dt):
        return state + dt * (1.0 + t) * control


class ClockCost(Cost):
    """Tells apart every argument: the state reached, its control, its time, the last state."""

    def stage(self, state, control, t, belief):
        return state["x"] * 100.0 + control[0] * 10.0 + t

    def terminal(self, state, belief):
        return 1000.0 * state["x"]

    def sequence(self, controls, applied, dt, dynamics):
        return controls[0, 0] - 7.0 * applied[0]


@eqx.filter_jit
def step(mppi, state, observation, key, perturbations=None, belief=None):
    return mppi.step(state, observation, belief, key=key, perturbations=perturbations)


def test_costs_are_paid_at_the_state_reached_and_its_time() -> None:
    mppi = MPPI(
        Clock(), ClockCost(), horizon=3, num_samples=2, temperature=1.0, noise_std=[1.0], dt=0.5
    )
    state = mppi.init()._replace(applied=jnp.asarray([2.0]))
    noise = jnp.asarray([[[1.0, 0.0]], [[2.0, 0.0]], [[-1.0, 3.0]]])
    _, _, info = step(mppi, state, jnp.asarray([4.0]), jax.random.key(0), noise)
    # By hand: x = 4, then + 0.5 (1 + 0) 1, + 0.5 (1 + 0.5) 2, + 0.5 (1 + 1) (-1).
    first = 100 * (4.5 + 6.0 + 5.0) + 10 * (1 + 2 - 1) + (0.5 + 1.0 + 1.5) + 1000 * 5.0 + 1 - 14
    second = 100 * (4.0 + 4.0 + 7.0) + 10 * 3 + 3.0 + 1000 * 7.0 + 0 - 14
    np.testing.assert_allclose(info.costs, [first, second], rtol=1e-6)


shifted = eqx.filter_jit(lambda mppi, state: mppi._shift(state))
stepped = eqx.filter_jit(lambda robot, state, control: robot.step(state, control, jnp.asarray(DT)))


def line(**changes) -> MPPI:
    settings = {"horizon": 8, "num_samples": 32, "temperature": 0.5, "noise_std": [0.5], "dt": DT}
    settings.update(changes)
    cost = settings.pop("cost", StateCost({"x": 1.0}, {"x": 1.0}))
    return MPPI(PointMass(1, max_acceleration=2.0), cost, **settings)


REST = jnp.zeros(2)
RAMP = jnp.linspace(-1.0, 1.0, 8)[:, None]
"""Controls by which positions in a plan are told apart."""
NONE = jnp.zeros((8, 1, 32))


def test_a_step_begins_with_a_shift_by_the_control_period() -> None:
    for period, steps in ((DT, 1.0), (2 * DT, 2.0), (0.25 * DT, 0.25), (1.5 * DT, 1.5)):
        mppi = line(control_period=period)
        _, state, info = step(mppi, mppi.init(RAMP), REST, jax.random.key(0), NONE)
        padded = np.append(np.asarray(RAMP[:, 0], float), 0.0)
        expected = np.interp(np.arange(8) + steps, np.arange(9), padded, right=0.0)
        np.testing.assert_allclose(state.nominal[:, 0], expected, atol=1e-6)
        np.testing.assert_array_equal(info.controls, state.nominal)


def test_several_controls_per_command() -> None:
    # n controls are taken from the plan, then the controller is called n steps later.
    mppi = line().at_period(3 * DT)
    control, state, info = step(mppi, mppi.init(), REST, jax.random.key(0))
    np.testing.assert_array_equal(control, info.controls[0])
    _, after, _ = step(mppi, state, REST, jax.random.key(1), NONE)
    np.testing.assert_allclose(after.nominal[:5], info.controls[3:], atol=1e-6)
    np.testing.assert_array_equal(after.nominal[5:], 0.0)
    # The period is a number: another one is no other program.
    assert float(mppi.at_period(2 * DT).control_period) == pytest.approx(2 * DT)
    assert float(mppi.control_period) == pytest.approx(3 * DT)


def shifts(controller: MPPI, count: int) -> list[float]:
    """Return by how many rows each of several steps has shifted, without any noise."""
    state, found = controller.init(RAMP), []
    position = 0.0
    for _ in range(count):
        state = eqx.tree_at(lambda s: s.nominal, state, RAMP)
        _, state, _ = step(controller, state, REST, jax.random.key(0), NONE)
        position = float(state.nominal[0, 0] - RAMP[0, 0]) / float(RAMP[1, 0] - RAMP[0, 0])
        found.append(position)
    return found


def test_whole_shifts_come_when_they_are_due() -> None:
    whole = line(dt=0.05, control_period=0.02, interpolate_shift=False)
    # Due after 0.02, 0.04, ... s: at 0.06 s the first step of 0.05 s has passed.
    expected = [0, 0, 1, 0, 1, 0, 0, 1, 0, 1]
    np.testing.assert_allclose(shifts(whole, 10), expected, atol=1e-5)
    smooth = line(dt=0.05, control_period=0.02)
    np.testing.assert_allclose(shifts(smooth, 3), [0.4] * 3, atol=1e-5)
    assert sum(shifts(line(dt=0.05, control_period=0.075, interpolate_shift=False), 4)) == (
        pytest.approx(6.0, abs=1e-4)
    )


def test_whole_shifts_do_not_drift() -> None:
    mppi = line(dt=1.0, control_period=0.05, interpolate_shift=False)

    @jax.jit
    def count(state):
        def advance(state, _):
            state = eqx.tree_at(lambda s: s.nominal, state, RAMP)
            _, state, _ = mppi.step(state, REST, key=jax.random.key(0), perturbations=NONE)
            return state, state.nominal[0, 0] > RAMP[0, 0] + 0.1

        return jax.lax.scan(advance, state, None, length=400)[1]

    moved = np.flatnonzero(np.asarray(count(mppi.init(RAMP))))
    np.testing.assert_array_equal(moved, np.arange(19, 400, 20))


@pytest.mark.parametrize("horizon", [4, 12])
def test_resume_goes_on_from_another_plan(horizon: int) -> None:
    mppi = line()
    _, state, info = step(mppi, mppi.init(), REST, jax.random.key(0))
    other = line(horizon=horizon, smoothing=SavitzkyGolay(5, 2), temperature=2.0)
    resumed = other.resume(state, info.controls)
    count = min(horizon, 8)
    np.testing.assert_array_equal(resumed.nominal[:count], info.controls[:count])
    np.testing.assert_array_equal(resumed.nominal[count:], 0.0)
    np.testing.assert_array_equal(resumed.applied, state.applied)
    np.testing.assert_array_equal(resumed.past, np.tile(state.applied, (2, 1)))
    control, _, found = step(other, resumed, REST, jax.random.key(1))
    assert found.controls.shape == (horizon, 1)
    assert np.isfinite(control).all()


def test_resume_into_other_parameterisations_keeps_the_controls() -> None:
    mppi = line()
    _, state, info = step(mppi, mppi.init(), REST, jax.random.key(0))
    for parameterisation in (Smooth(), Knots(8, CubicSpline())):
        other = line(parameterisation=parameterisation)
        resumed = other.resume(state, info.controls)
        controls = parameterisation.controls(resumed.nominal, other._space)
        np.testing.assert_allclose(controls, info.controls, atol=1e-4)


def test_init_takes_controls_and_is_a_reset() -> None:
    for parts in ({}, {"proposal": GaussianProposal([0.5], adaptation=CovarianceAdaptation())}):
        mppi = line(**({"noise_std": None, **parts} if parts else {}))
        fresh = mppi.init()
        _, used, _ = step(mppi, fresh, REST, jax.random.key(0))
        assert not np.array_equal(used.nominal, fresh.nominal)
        again = step(mppi, mppi.init(), REST, jax.random.key(0))
        first = step(mppi, fresh, REST, jax.random.key(0))
        for a, b in zip(jax.tree.leaves(again), jax.tree.leaves(first), strict=True):
            np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(line().init(3.0 * RAMP).nominal, np.clip(3.0 * RAMP, -2.0, 2.0))


def plane(**changes) -> MPPI:
    cost = (
        GoalCost([1.0, 0.5], terminal_weight=2.0)
        + 0.3 * GoalCost([-2.0, 1.0]).with_name("other goal")
        + (0.1 * QuadraticControlCost([1.0, 1.0])).with_name("effort")
        + 2.0 * ControlRateCost()
    )
    settings = {"horizon": 6, "num_samples": 24, "temperature": 0.5, "dt": DT}
    settings.update(changes)
    if "proposal" not in settings:
        settings["noise_std"] = [0.8, 0.8]
    return MPPI(PointMass(2), cost, **settings)


def test_inspect_shows_the_samples_of_the_step() -> None:
    mppi = plane(parameterisation=Knots(4, CubicSpline()))
    start, key = jnp.asarray([0.1, 0.2, 0.3, -0.1]), jax.random.key(3)
    _, state, _ = step(mppi, mppi.init(), start, jax.random.key(9))
    _, _, info = step(mppi, state, start, key)
    seen = eqx.filter_jit(mppi.inspect)(state, start, key=key, num_trajectories=24)
    np.testing.assert_allclose(seen.weights, info.weights, rtol=1e-5, atol=1e-7)
    np.testing.assert_array_equal(seen.nominal.controls, info.controls)

    # The best is the rollout of least cost; its terms, by name, add up to that cost.
    best = int(np.argmin(info.costs))
    assert set(seen.best.terms) == {"GoalCost", "other goal", "effort", "ControlRateCost"}
    total = sum(float(value) for value in seen.best.terms.values())
    assert total == pytest.approx(float(info.costs[best]), rel=1e-4)
    np.testing.assert_allclose(np.asarray(seen.samples)[best], seen.best.states, atol=1e-5)
    replayed, states = start, np.asarray(seen.best.states)
    for control, reached in zip(np.asarray(seen.best.controls), states[1:], strict=True):
        replayed = stepped(mppi.dynamics, replayed, control)
        np.testing.assert_allclose(reached, replayed, atol=1e-5)

    # Samples are those of the step, and no two are the same.
    ends = np.asarray(seen.samples)[:, -1]
    assert len(np.unique(ends.round(6), axis=0)) == 24
    far = np.hypot(*(ends[:, :2] - [1.0, 0.5]).T)
    assert np.corrcoef(far, info.costs)[0, 1] > 0.0


def test_few_samples_shown_are_spread_over_a_mixture() -> None:
    reference = np.tile([1.0, -1.0], (6, 1))
    proposal = BiasedProposal(GaussianProposal([0.05, 0.05]), reference, 0.5)
    mppi = plane(proposal=proposal)
    look = eqx.filter_jit(mppi.inspect)
    seen = look(mppi.init(), jnp.zeros(4), key=jax.random.key(0), num_trajectories=6)
    towards = np.asarray(seen.samples)[:, -1, 2] > 0.3
    assert towards.tolist() == [True] * 3 + [False] * 3


@pytest.mark.parametrize("smoothing", [None, SavitzkyGolay(5, 2)], ids=["plain", "smoothed"])
def test_rates_are_counted_from_the_control_really_given_out(smoothing) -> None:
    mppi = line(cost=ControlRateCost([1.0]), smoothing=smoothing)
    state = mppi.init(RAMP)
    given, rng = np.zeros(1), np.random.default_rng(0)
    for index in range(4):
        noise = rng.normal(size=(8, 1, 32)).astype(np.float32) * 0.5
        moved = shifted(mppi, state).nominal
        sampled = np.clip(np.asarray(moved)[:, :, None] + noise, -2.0, 2.0)
        control, state, info = step(mppi, state, REST, jax.random.key(index), jnp.asarray(noise))
        before = np.broadcast_to(given[None, :, None], (1, 1, 32))
        changes = np.diff(np.concatenate([before, sampled]), axis=0)
        np.testing.assert_allclose(info.costs, (changes**2).sum((0, 1)), rtol=1e-4)
        np.testing.assert_array_equal(state.applied, control)
        given = np.asarray(control)


def test_smoothing_is_that_of_scipy_on_what_was_given_out_and_is_planned() -> None:
    window, order = 5, 2
    mppi = line(smoothing=SavitzkyGolay(window, order), temperature=0.1)
    plain, state, given = line(temperature=0.1), mppi.init(), [np.zeros(1)] * 2
    x = REST
    for index in range(12):
        key = jax.random.key(index)
        control, after, info = step(mppi, state, x, key)
        # The nominal is not smoothed: it is what the plain controller makes of the same one.
        twin = plain.init()._replace(nominal=state.nominal, applied=state.applied)
        _, unsmoothed, _ = step(plain, twin, x, key)
        np.testing.assert_allclose(after.nominal, unsmoothed.nominal, atol=1e-5)
        recorded = np.concatenate([given[-2:], np.asarray(unsmoothed.nominal)])
        smooth = scipy.signal.savgol_filter(recorded, window, order, axis=0)
        expected = np.clip(smooth[2:], -2.0, 2.0)
        np.testing.assert_allclose(info.controls, expected, atol=1e-5)
        np.testing.assert_array_equal(control, info.controls[0])
        given.append(np.asarray(control))
        x, state = mppi.dynamics.step(x, control, mppi.dt), after
    assert np.ptp(given) > 0.2


def test_the_same_key_is_the_same_step_and_another_is_another() -> None:
    mppi = line()
    first, again, other = (
        step(mppi, mppi.init(), REST, jax.random.key(seed)) for seed in (5, 5, 6)
    )
    for a, b in zip(jax.tree.leaves(first), jax.tree.leaves(again), strict=True):
        np.testing.assert_array_equal(a, b)
    assert not np.array_equal(first[2].costs, other[2].costs)


def test_one_trace_for_all_numbers() -> None:
    traces = 0

    @eqx.filter_jit
    def counted(mppi, state, observation, key):
        nonlocal traces
        traces += 1
        return mppi.step(state, observation, key=key)

    def build(
        temperature=0.5, std=0.5, goal=1.0, dt=DT, reference=0.2, given=0.4, fraction=0.5, period=DT
    ):
        proposal = InjectedProposal(
            BiasedProposal(GaussianProposal([std]), np.full((8, 1), reference), fraction),
            np.full((2, 8, 1), given),
        )
        return line(
            cost=2.0 * StateCost({"x": 1.0}, {"x": goal}) + ControlRateCost([1.0]),
            proposal=proposal,
            noise_std=None,
            temperature=temperature,
            dt=dt,
            control_period=period,
        )

    base = build()
    before, _, _ = counted(base, base.init(RAMP), REST, jax.random.key(0))
    for changes in (
        {"temperature": 5.0},
        {"std": 0.1},
        {"goal": -3.0},
        {"dt": 0.05},
        {"reference": -1.0},
        {"given": -2.0},
        {"fraction": 0.1},
        {"period": 0.03},
    ):
        changed = build(**changes)
        after, _, _ = counted(changed, changed.init(RAMP), REST, jax.random.key(0))
        assert not np.array_equal(before, after), changes
    reference = jnp.full((8, 1), 1.5, jnp.float32)
    moved = eqx.tree_at(lambda c: c.proposal.proposal.reference, base, reference)
    counted(moved, moved.init(), REST, jax.random.key(0))
    heavier = eqx.tree_at(lambda c: c.weighting, base, Softmax(0.2, 0.5))
    counted(heavier, heavier.init(), REST, jax.random.key(0))
    assert traces == 1


def test_held_knots_move_on_in_periods_shorter_than_their_distance() -> None:
    mppi = line(parameterisation=Knots(4, ZeroOrderHold()))
    state = mppi.init(RAMP)
    before = np.asarray(state.nominal)
    _, after, _ = step(mppi, state, REST, jax.random.key(0), jnp.zeros((4, 1, 32)))
    assert (np.asarray(after.nominal)[:-1] > before[:-1]).all()


def test_a_belief_is_whatever_the_cost_expects() -> None:
    class ToBelief(Cost):
        def stage(self, state, control, t, belief):
            return (state["x"] - belief["goal"]) ** 2

    mppi = line(cost=ToBelief(), num_samples=256, temperature=0.01)
    for goal in (2.0, -2.0):
        control, _, _ = step(
            mppi, mppi.init(), REST, jax.random.key(0), None, {"goal": jnp.asarray(goal)}
        )
        assert float(control[0]) * goal > 0.2
