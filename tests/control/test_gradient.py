"""Derivatives of a closed loop by the settings of its controller."""

import importlib.util
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxplore as jx

pytestmark = pytest.mark.long

EXAMPLE = Path(__file__).parents[2] / "examples" / "tune_by_gradient.py"
ROBOT = jx.Unicycle(max_speed=2.0, max_turn_rate=2.0)
COST = (
    2.0 * jx.WaypointCost([1.5, 0.5], heading=1.0)
    + 3.0 * jx.DiscObstacleCost([[0.9, 0.3]], [0.2], clearance=0.8, collision=1.0)
    + 1.5 * jx.ControlRateCost()
)
H = 1e-5
NAMES = ("goal", "obstacle", "change", "temperature", "noise_std")


def controller_with(**parts) -> jx.MPPI:
    sizes = {"horizon": 5, "num_samples": 8, "dt": 0.1}
    return jx.MPPI(ROBOT, COST, temperature=5.0, noise_std=[0.4, 0.6], **sizes, **parts)


def tuned(controller: jx.MPPI) -> list:
    (goal, obstacle), change = controller.cost.costs[0].costs, controller.cost.costs[1]
    weights = [term.weight for term in (goal, obstacle, change)]
    return [*weights, controller.weighting.temperature, controller.proposal.noise_std]


def paid(settings: dict, controller: jx.MPPI, key: jax.Array) -> jax.Array:
    """Return the mean cost of a closed loop of 4 steps under settings, given by logarithms."""
    controller = eqx.tree_at(tuned, controller, [jnp.exp(settings[name]) for name in NAMES])

    def advance(carry, key):
        memory, state = carry
        control, memory, _ = controller.step(memory, state, key=key)
        state = controller.dynamics.step(state, control, controller.dt)
        return (memory, state), jnp.sum((state[:2] - 1.0) ** 2) + jnp.sum(control**2)

    start = (controller.init(), jnp.asarray([0.1, 0.2, 0.3]))
    return jnp.mean(jax.lax.scan(advance, start, jax.random.split(key, 4))[1])


def in_double_precision(tree):
    return jax.tree.map(
        lambda leaf: leaf.astype(jnp.float64) if eqx.is_inexact_array(leaf) else leaf, tree
    )


@pytest.mark.parametrize("parameterisation", [jx.control.Direct(), jx.Knots(3)])
def test_it_is_that_of_finite_differences(parameterisation) -> None:
    controller = controller_with(parameterisation=parameterisation)
    with jax.enable_x64(True):
        controller = in_double_precision(controller)
        settings = dict(zip(NAMES, map(jnp.log, tuned(controller)), strict=True))
        key = jax.random.key(1)
        value = eqx.filter_jit(paid)
        slopes = eqx.filter_jit(jax.grad(paid))(settings, controller, key)
        assert {leaf.dtype for leaf in jax.tree.leaves(slopes)} == {jnp.dtype("float64")}
        for name, logarithms in settings.items():
            for index in np.ndindex(logarithms.shape):
                after, before = (
                    float(value({**settings, name: logarithms.at[index].add(h)}, controller, key))
                    for h in (H, -H)
                )
                expected, found = (after - before) / (2.0 * H), float(slopes[name][index])
                assert abs(expected) > 1e-4, name
                assert found == pytest.approx(expected, rel=1e-7), name
        # All weights times the same are no other controller at a temperature times that.
        same = sum(float(slopes[name]) for name in NAMES[:-1])
        assert same == pytest.approx(0.0, abs=1e-12)


def test_the_example_improves_drives_it_has_not_seen(monkeypatch, capsys, tmp_path) -> None:
    spec = importlib.util.spec_from_file_location("tune_by_gradient", EXAMPLE)
    example = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(example)
    traces, metric = [], example.metric

    def counted(*arguments):
        traces.append(1)
        return metric(*arguments)

    monkeypatch.setattr(example, "metric", counted)
    sizes = ["--iterations", "6", "--steps", "20", "--samples", "16", "--seeds", "2"]
    # Adam of optax counts in whole numbers, and raises numbers to their power.
    with jax.numpy_dtype_promotion("standard"):
        example.main([*sizes, "--out", str(tmp_path)])
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    (unseen,) = (row[1:] for row in rows if row[0] == "unseen")
    before, after = map(float, unseen)
    assert 0.0 < after < 0.8 * before
    assert sum(row[0].isdigit() for row in rows) == 6
    assert traces == [1]
    assert (tmp_path / "tune_by_gradient.png").stat().st_size > 10_000
