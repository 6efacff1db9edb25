"""Contouring control follows paths it has never seen, and says how well."""

import equinox as eqx
import jax
import numpy as np
import pytest

import jaxplore as jx
from jaxplore.costs.path_following import CorridorCost
from jaxplore.geometry.curves import clothoid_path, line_path, path_through
from jaxplore.planning.presets.path_following import PathFollowing, mpcc

pytestmark = pytest.mark.long

CAR = jx.KinematicBicycle(2.5, 1e-3, max_speed=15.0, max_acceleration=3.0, max_steering=0.5)
# A car on a street: the defaults are a race car's.
NUMBERS = {
    "noise_std": [0.5, 0.05],
    "max_speed": 15.0,
    "contouring_weight": 100.0,
    "lag_weight": 100.0,
    "progress_weight": 600.0,
    "comfort_weight": None,
    "num_samples": 256,
    "temperature": 50.0,
    "dt": 0.1,
}
S_CURVE = path_through([(0, 0), (10, 0), (20, 5), (30, 0), (40, -5), (50, 0)])
SIDE = [(6.0, 0.0, 0.0), (2.0, 0.0, 0.15), (0.5 * np.pi / 0.15 - 2.0, 0.15, 0.15), (2.0, 0.15, 0.0)]
TRACK = clothoid_path([0, 0, 0], SIDE * 4, is_closed=True, half_widths=[1.5, 1.5])


@eqx.filter_jit
def drive(following: PathFollowing, key, num_steps: int = 130):
    """Return states (N, nx) and the effective sample sizes (N,)."""
    mppi, model = following.controller, following.model

    def advance(carry, key):
        state, memory = carry
        control, memory, info = mppi.step(memory, state, key=key)
        state = model.step(state, control, mppi.dt)
        return (state, memory), (state, info.effective_sample_size)

    start = (model.at_pose(0.0, 0.0, 0.0), mppi.init())
    return jax.lax.scan(advance, start, jax.random.split(key, num_steps))[1]


def test_it_follows_an_s_curve_to_its_end() -> None:
    following = mpcc(CAR, S_CURVE, **NUMBERS)
    for seed in range(3):
        states, sizes = drive(following, jax.random.key(seed))
        last = int(np.argmax(states[:, -1] > S_CURVE.length - 0.5))
        assert last > 0
        contouring, lag = (
            np.abs(each.errors(states[: last + 1], following.model))
            for each in (following.contouring, following.lag)
        )
        assert contouring.mean() < 0.35
        assert lag.mean() < 0.35
        assert np.isfinite(sizes).all()


def test_it_keeps_within_a_track_on_its_laps() -> None:
    following = mpcc(CAR, TRACK, **NUMBERS)
    assert "CorridorCost" in dict(following.controller.cost.terms())
    states, _ = drive(following, jax.random.key(0))
    assert states[-1, -1] > TRACK.length
    assert CorridorCost(TRACK).clearances(states, following.model).min() > 0.0


def test_another_path_noise_or_weight_does_not_recompile() -> None:
    traces = 0

    @eqx.filter_jit
    def step(mppi, key):
        nonlocal traces
        traces += 1
        return mppi.step(mppi.init(), mppi.dynamics.at_pose(0.0, 0.0, 0.0), key=key)

    for end, weight in ((10.0, 100.0), (20.0, 30.0)):
        numbers = {**NUMBERS, "contouring_weight": weight}
        following = mpcc(CAR, line_path([0, 0], [end, 1.0]), **numbers)
        step(following.controller, jax.random.key(0))
    assert traces == 1


def test_costs_of_one_s_own_are_added() -> None:
    disc = jx.DiscObstacleCost([[5.0, 0.0]], [1.0])
    following = mpcc(CAR, S_CURVE, other=disc, **NUMBERS)
    assert "DiscObstacleCost" in dict(following.controller.cost.terms())
    assert "CorridorCost" not in dict(following.controller.cost.terms())


@pytest.mark.parametrize(
    ("path", "changes", "message"),
    [
        (S_CURVE, {"corridor": True}, "path has no half_widths; accepted"),
        (line_path([0, 0], [9, 0], half_widths=[0.1, 0.3]), {}, "path is 0.4 m wide where"),
        (S_CURVE, {"noise_std": [0.5]}, r"physical proposal: noise_std has shape \(1,\)"),
    ],
)
def test_bad_input(path, changes, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        mpcc(CAR, path, **{**NUMBERS, **changes})


def test_a_robot_that_is_commanded_by_its_speed_is_bounded_by_it() -> None:
    following = mpcc(jx.Unicycle(max_speed=1.5), S_CURVE)
    high = following.model.control_max[following.model.control_names.index("phi_rate")]
    assert float(high) == 1.5


def test_a_model_that_does_not_say_needs_a_speed_and_no_comfort() -> None:
    model = jx.PathParameter.along(S_CURVE, 5.0)
    with pytest.raises(ValueError, match=r"comfort_weight is 20.0 for PathParameter, which has no"):
        mpcc(model, S_CURVE)
    with pytest.raises(ValueError, match="max_speed is None for PathParameter, which has none"):
        mpcc(model, S_CURVE, comfort_weight=None)


def test_noise_is_a_share_of_half_the_range_and_the_bound_the_robot_s() -> None:
    following = mpcc(CAR, S_CURVE, noise_share=0.4)
    np.testing.assert_allclose(
        following.controller.proposal.physical.noise_std, [0.4 * 3.0, 0.4 * 0.5], rtol=1e-6
    )
    assert float(following.model.virtual.control_max[0]) == 15.0
