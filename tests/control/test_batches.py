"""Many controllers, many robots, many devices."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import (
    MPPI,
    BiasedProposal,
    DifferentialDrive,
    FeedbackMPPI,
    GaussianProposal,
    GoalCost,
    Knots,
    PointMass,
    Smooth,
    Softmax,
)
from jaxplore.control import CubicSpline

pytestmark = pytest.mark.long


def make(temperature=0.3, std=0.5, goal=1.0, drag=0.1, reference=0.1, parameterisation=None):
    """Return a controller that differs in numbers of every part, traced or not."""
    return MPPI(
        DifferentialDrive(drag=drag),
        GoalCost(jnp.stack([jnp.asarray(goal), jnp.asarray(0.5)]), terminal_weight=2.0),
        horizon=6,
        num_samples=32,
        proposal=BiasedProposal(
            GaussianProposal(jnp.stack([jnp.asarray(std)] * 2)),
            jnp.broadcast_to(jnp.asarray(reference), (6, 2)),
            0.25,
        ),
        weighting=Softmax(temperature, 0.7),
        parameterisation=parameterisation,
        dt=0.1,
    )


NUMBERS = {
    "temperature": jnp.asarray([0.1, 0.5, 2.0]),
    "std": jnp.asarray([0.2, 0.5, 1.0]),
    "goal": jnp.asarray([-1.0, 0.5, 3.0]),
    "drag": jnp.asarray([0.0, 0.1, 0.8]),
    "reference": jnp.asarray([-0.3, 0.0, 0.6]),
}


def two_steps(mppi, start, keys):
    """Return what a controller does in two steps of a closed loop, and the state after them."""

    def advance(carry, key):
        reached, state = carry
        control, state, info = mppi.step(state, reached, key=key)
        return (mppi.dynamics.step(reached, control, mppi.dt), state), info

    (_, state), infos = jax.lax.scan(advance, (start, mppi.init()), keys)
    return infos, state


def assert_same(batch, index, single, rtol=1e-4) -> None:
    chosen = jax.tree.map(lambda leaf: leaf[index], batch)
    for a, b in zip(jax.tree.leaves(chosen), jax.tree.leaves(single), strict=True):
        np.testing.assert_allclose(a, b, rtol=rtol, atol=1e-5)


@pytest.mark.parametrize("parameterisation", [None, Smooth(), Knots(3, CubicSpline())])
def test_a_batch_of_controllers_is_the_loop_over_them(parameterisation) -> None:
    def build(numbers):
        return make(**numbers, parameterisation=parameterisation)

    start = jnp.asarray([0.0, 0.0, 0.3, 0.5, 0.1])
    keys = jax.random.split(jax.random.key(0), 6).reshape(3, 2)
    # Controllers are built under vmap, from traced numbers, or stacked: the same.
    batch = jax.jit(jax.vmap(lambda n, k: two_steps(build(n), start, k)))(NUMBERS, keys)
    singles = [build({name: value[i] for name, value in NUMBERS.items()}) for i in range(3)]
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *singles)
    again = eqx.filter_jit(eqx.filter_vmap(two_steps, in_axes=(0, None, 0)))(stacked, start, keys)
    single = eqx.filter_jit(two_steps)
    for index, mppi in enumerate(singles):
        alone = single(mppi, start, keys[index])
        assert_same(batch, index, alone)
        assert_same(again, index, alone)
    assert np.ptp(np.asarray(batch[0].controls), axis=0).max() > 0.02


def test_one_controller_for_many_robots() -> None:
    mppi = make()
    starts = jnp.asarray([[0.0, 0.0, 0.3, 0.5, 0.1], [1.0, 2.0, -2.0, 0.0, 0.0], [5.0] * 5])
    keys = jax.random.split(jax.random.key(0), 6).reshape(3, 2)
    batch = eqx.filter_jit(eqx.filter_vmap(two_steps, in_axes=(None, 0, 0)))(mppi, starts, keys)
    single = eqx.filter_jit(two_steps)
    for index in range(3):
        assert_same(batch, index, single(mppi, starts[index], keys[index]))


def test_a_batch_of_followers_plans_where_it_is_due() -> None:
    planner = MPPI(
        PointMass(1), GoalCost([1.0, 0.0]), horizon=5, num_samples=16, noise_std=[0.5], dt=0.1
    )
    controller = FeedbackMPPI(planner, commands_per_plan=2)
    starts, key = jnp.asarray([[0.0, 0.1], [2.0, -0.5]]), jax.random.key(0)

    def run(start):
        control, state, _ = controller.step(controller.init(), start, key=key)
        follow, state, info = controller.step(state, start + 0.1, key=key)
        return control, follow, info.costs, state.gains

    batch = jax.jit(jax.vmap(run))(starts)
    for index in range(2):
        assert_same(batch, index, jax.jit(run)(starts[index]))


SCRIPT = """
import json
import equinox as eqx, jax, jax.numpy as jnp, numpy as np
import jaxplore as jx
import jaxplore.control.noise as noise

assert jax.device_count() == 8, jax.devices()
mesh = jax.make_mesh((8,), ("samples",))
grid = jax.make_mesh((4, 2), ("a", "b"))
start = jnp.asarray([0.1, -0.2, 0.3, 0.1])
cases = {
    "direct, large": ({"num_samples": 512}, mesh),
    "smooth, two axes": ({"parameterisation": jx.Smooth()}, grid),
    "knots, outcomes": (
        {"parameterisation": jx.Knots(3, jx.control.CubicSpline()), "num_outcomes": 3,
         "disturbance": jx.StateNoise([0.1] * 4), "risk": jx.control.WorstCase()},
        mesh,
    ),
}
found = {}
for name, (changes, devices) in cases.items():
    # Numbers beyond which noise is drawn row by row: fewer here, so that the test is small.
    noise.LARGE = 2**10 if name == "direct, large" else 2**20
    results = []
    for spread in (None, devices):
        mppi = jx.MPPI(
            jx.PointMass(2),
            jx.StateCost({"x": 1.0, "y": 1.0}, {"x": 1.0}, terminal_weight=2.0)
            + jx.ControlRateCost(),
            **{"horizon": 4, "num_samples": 64, "dt": 0.1, "mesh": spread, "weighting": None,
               "noise_std": [0.5, 0.5], **changes},
        )

        def run(mppi, key):
            state = mppi.init(jnp.full((4, 2), 0.2))
            control, state, info, gains = jx.control.step_with_gains(mppi, state, start, key=key)
            return control, info.controls, info.costs, info.weights, gains

        results.append(eqx.filter_jit(run)(mppi, jax.random.key(0)))
    found[name] = [
        float(np.max(np.abs(np.asarray(a) - np.asarray(b)) / (1e-3 + np.abs(np.asarray(a)))))
        for a, b in zip(*results, strict=True)
    ]
    found[name].append(float(np.abs(np.asarray(results[0][4])).max()))
    found[name].append(float(np.std(np.asarray(results[0][2]))))
try:
    goal = jx.GoalCost([1.0, 0.0])
    jx.MPPI(jx.PointMass(2), goal, noise_std=[1.0, 1.0], num_samples=20, mesh=mesh)
except ValueError as error:
    found["indivisible"] = str(error)
print(json.dumps(found))
"""


@pytest.fixture(scope="module")
def spread() -> dict[str, Any]:
    """Return the largest relative differences between 8 devices and 1."""
    root = Path(__file__).resolve().parents[2]
    environment = {
        **os.environ,
        "XLA_FLAGS": f"{os.environ['XLA_FLAGS']} --xla_force_host_platform_device_count=8",
        "JAX_PLATFORMS": "cpu",
        "PYTHONPATH": str(root / "src"),
    }
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", SCRIPT],
        capture_output=True,
        text=True,
        env=environment,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


@pytest.mark.parametrize("case", ["direct, large", "smooth, two axes", "knots, outcomes"])
def test_eight_devices_do_what_one_does(case: str, spread) -> None:
    control, controls, costs, weights, gains, size, variety = spread[case]
    assert max(control, controls, costs) < 1e-3, spread[case]
    assert weights < 5e-3
    assert gains < 5e-3
    # There was something to compare.
    assert size > 0.01
    assert variety > 0.01


def test_samples_must_divide_among_the_devices(spread) -> None:
    assert "num_samples is 20; accepted: a multiple of the 8 devices" in spread["indivisible"]
