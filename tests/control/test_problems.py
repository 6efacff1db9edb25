"""Every way to parameterise and to weigh reaches a goal, and every kind of problem has one that
does."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import (
    MPPI,
    Ackermann,
    ControlRateCost,
    DifferentialDrive,
    Elite,
    GaussianProposal,
    KinematicBicycle,
    Knots,
    Pendulum,
    PointMass,
    Quadrotor,
    RBFKernel,
    Smooth,
    Softmax,
    StateCost,
    Unicycle,
    WaypointCost,
)
from jaxplore.control import (
    AdaptiveSoftmax,
    CovarianceAdaptation,
    CubicSpline,
    Direct,
    LinearInterpolation,
    ZeroOrderHold,
)
from jaxplore.costs import QuadraticControlCost, ReferenceCost

pytestmark = [pytest.mark.long, pytest.mark.usefixtures("unchecked")]


@eqx.filter_jit
def closed_loop(mppi, start, keys):
    """Return the states (N, nx) and controls (N, nu)."""

    def advance(carry, key):
        x, state = carry
        control, state, info = mppi.step(state, x, key=key)
        x = mppi.dynamics.step(x, control, mppi.control_period)
        return (x, state), (x, control, info.effective_sample_size)

    return jax.lax.scan(advance, (start, mppi.init()), keys)[1]


MASS = (
    PointMass(2, max_acceleration=2.0),
    StateCost({"x": 1.0, "y": 1.0, "vx": 0.3, "vy": 0.3}, {"x": 2.0, "y": -1.0}),
    jnp.zeros(4),
    [1.0, 1.0],
    {"horizon": 20, "dt": 0.1, "steps": 80},
)
PENDULUM = (
    Pendulum(max_torque=2.0),
    StateCost({"angle": 1.0, "rate": 0.1}, angles=("angle",), terminal_weight=5.0),
    jnp.asarray([np.pi, 0.0]),
    [1.5],
    {"horizon": 30, "dt": 0.05, "steps": 200},
)
POSE = WaypointCost([2.0, 1.0], heading=0.6, heading_weight=0.5, terminal_weight=4.0)
UNICYCLE = (
    Unicycle(max_speed=1.5, min_speed=-0.5),
    POSE,
    jnp.asarray([0.0, 0.0, -0.5]),
    [0.7, 1.0],
    {"horizon": 20, "dt": 0.1, "steps": 80},
)
DRIVE = (
    DifferentialDrive(),
    POSE + StateCost({"v": 0.1, "omega": 0.05}),
    jnp.asarray([0.0, 0.0, -0.5, 0.0, 0.0]),
    [0.8, 1.5],
    {"horizon": 25, "dt": 0.1, "steps": 100},
)
ACKERMANN = (
    Ackermann(0.33, max_speed=3.0, max_steering=0.42, max_steering_rate=3.0, min_speed=-1.0),
    POSE + StateCost({"v": 0.1}),
    jnp.asarray([0.0, 0.0, 0.0, 0.0, 0.0]),
    [1.5, 1.5],
    {"horizon": 25, "dt": 0.1, "steps": 100},
)
BICYCLE = (
    KinematicBicycle(min_speed=-1.0),
    POSE + StateCost({"v": 0.1}),
    jnp.asarray([0.0, 0.0, 0.0, 0.0]),
    [1.5, 0.3],
    {"horizon": 25, "dt": 0.1, "steps": 100},
)
QUADROTOR = (
    Quadrotor(max_rate=4.0),
    StateCost(
        {
            "x": 1.0,
            "y": 1.0,
            "z": 2.0,
            "vx": 0.3,
            "vy": 0.3,
            "vz": 0.3,
            "qx": 2.0,
            "qy": 2.0,
            "wz": 0.05,
        },
        {"x": 5.0, "y": 5.0, "z": -2.0},
        terminal_weight=10.0,
    )
    + QuadraticControlCost([0.005, 0.03, 0.03, 0.03]),
    Quadrotor().at_pose(0.0, 0.0, 0.0),
    [1.0, 0.4, 0.4, 0.1],
    {"horizon": 25, "dt": 0.06, "steps": 130},
)
SOFT, ADAPTIVE, ELITE = Softmax(0.5, 0.1), AdaptiveSoftmax(20.0), Elite(0.1)
RBF, CUBIC = Knots(5, RBFKernel(4.0)), Knots(5, CubicSpline())
HELD, LINES = Knots(5, ZeroOrderHold()), Knots(5, LinearInterpolation())


def arrived(name: str, end: np.ndarray) -> bool:
    """Return whether the last states (N, nx) are at the goal."""
    if name == "pendulum":
        return bool((np.cos(end[:, 0]) > 0.9).all())
    goal = {"mass": [2.0, -1.0], "quadrotor": [5.0, 5.0, -2.0]}.get(name, [2.0, 1.0])
    away = np.linalg.norm(end[:, : len(goal)] - goal, axis=1)
    if name in ("mass", "quadrotor"):
        return bool((away < 0.35).all())
    return bool((away < 0.35).all() and (np.cos(end[:, 2] - 0.6) > 0.85).all())


@pytest.mark.parametrize(
    ("name", "problem", "parameterisation", "weighting"),
    [
        ("mass", MASS, Direct(), SOFT),
        ("pendulum", PENDULUM, Direct(), ELITE),
        ("unicycle", UNICYCLE, Smooth(), SOFT),
        ("drive", DRIVE, LINES, ADAPTIVE),
        ("ackermann", ACKERMANN, CUBIC, SOFT),
        ("bicycle", BICYCLE, HELD, SOFT),
        ("quadrotor", QUADROTOR, RBF, Softmax(10.0, 0.0)),
    ],
)
def test_reaches_the_goal(name, problem, parameterisation, weighting) -> None:
    robot, cost, start, std, sizes = problem
    smooth = isinstance(parameterisation, Smooth)
    if smooth:
        # Rates: what changes a control by as much in a few steps.
        std = [3.0 * value for value in std]
        cost = cost + 0.1 * ControlRateCost()
    adaptation = CovarianceAdaptation(0.3, 0.3) if weighting is ELITE else None
    mppi = MPPI(
        robot,
        cost,
        horizon=sizes["horizon"],
        num_samples=400 if name == "quadrotor" else 200,
        dt=sizes["dt"],
        proposal=GaussianProposal(std, adaptation=adaptation),
        parameterisation=parameterisation,
        weighting=weighting,
    )
    keys = jax.random.split(jax.random.key(0), sizes["steps"])
    states, controls, sizes_seen = closed_loop(mppi, start, keys)
    assert np.isfinite(states).all()
    assert (controls >= robot.control_min - 1e-5).all()
    assert (controls <= robot.control_max + 1e-5).all()
    assert (np.asarray(sizes_seen) >= 1.0).all()
    assert arrived(name, np.asarray(states)[-15:]), np.asarray(states)[-15::7]


EIGHT_DT = 0.1


def eight(t: np.ndarray) -> np.ndarray:
    """Return a figure of eight (N, 2) at times [s]."""
    return np.stack([1.5 * np.sin(0.6 * t), 0.8 * np.sin(1.2 * t)], axis=-1)


@eqx.filter_jit
def follow(mppi, keys, windows):
    """Return tracking error and jerk per seed; `windows` (N, R, 2) move on with time."""

    def one(key):
        def advance(carry, inputs):
            x, state = carry
            window, key = inputs
            moved = eqx.tree_at(lambda m: m.cost.costs[0].reference, mppi, window)
            control, state, _ = moved.step(state, x, key=key)
            x = mppi.dynamics.step(x, control, mppi.dt)
            return (x, state), (x[:2] - window[1], control)

        start = jnp.concatenate([windows[0, 0], jnp.asarray([0.9, 0.96])])
        inputs = (windows, jax.random.split(key, windows.shape[0]))
        _, (away, controls) = jax.lax.scan(advance, (start, mppi.init()), inputs)
        jerk = jnp.mean(jnp.abs(jnp.diff(controls[20:], n=2, axis=0)))
        return jnp.sqrt(jnp.mean(jnp.sum(away[20:] ** 2, axis=1))), jerk

    return jax.lax.map(one, keys)


def test_smooth_controls_follow_an_eight_as_well_as_rough_ones() -> None:
    horizon, length = 15, 90
    times = EIGHT_DT * (np.arange(length)[:, None] + np.arange(horizon + 1))
    windows = jnp.asarray(eight(times), jnp.float32)
    keys = jax.random.split(jax.random.key(0), 1)

    def run(parameterisation, std, weight):
        mppi = MPPI(
            PointMass(2, max_acceleration=3.0),
            ReferenceCost(windows[0], EIGHT_DT) + weight * ControlRateCost([1.0, 1.0]),
            horizon=horizon,
            num_samples=512,
            dt=EIGHT_DT,
            weighting=Softmax(0.1, 0.0),
            noise_std=[std, std],
            parameterisation=parameterisation,
        )
        error, jerk = follow(mppi, keys, windows)
        return float(np.mean(error)), float(np.mean(jerk))

    direct = run(Direct(), 1.0, 0.0)
    smooth = run(Smooth(), 7.0, 0.01)
    kernel = run(Knots(8, RBFKernel(2.0)), 1.0, 0.0)
    assert direct[0] < 0.05
    for error, jerk in (smooth, kernel):
        assert jerk < 0.7 * direct[1]
        assert error < 1.05 * direct[0]
