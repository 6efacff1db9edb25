"""A learned model: MPPI swings up a pendulum with friction that no formula has told it of.

A small network learns what a frictionless pendulum gets wrong, from random steps of the real one.

    python examples/learned_model.py --out runs/learned_model
"""

import argparse
import sys
from pathlib import Path
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

import jaxplore as jx

STEP = 0.05  # of model and plant [s]
MAX_TORQUE = 3.0  # [N m]
MAX_RATE = 8.0  # [rad/s]


class RustyPendulum(jx.ContinuousDynamics):
    """The real pendulum: viscous and dry friction, and another length than the formula's."""

    state_names: ClassVar[tuple[str, ...]] = ("angle", "rate")
    control_names: ClassVar[tuple[str, ...]] = ("torque",)

    control_min: jax.Array
    control_max: jax.Array
    radius: jax.Array
    integrator: jx.Integrator

    def __init__(self) -> None:
        self.control_max = jnp.asarray([MAX_TORQUE])
        self.control_min = -self.control_max
        self.radius = jnp.asarray(1.0)
        self.integrator = jx.RK4()

    def derivative(self, state: jax.Array, control: jax.Array) -> jax.Array:
        """Return dx/dt (2,)."""
        angle, rate = state
        friction = 0.3 * rate + jnp.tanh(rate / 0.1)
        return jnp.stack([rate, 12.0 * jnp.sin(angle) + 2.5 * control[0] - friction])


class LearnedPendulum(jx.Dynamics):
    """A formula, and a network for what it gets wrong."""

    state_names: ClassVar[tuple[str, ...]] = ("angle", "rate")
    control_names: ClassVar[tuple[str, ...]] = ("torque",)

    control_min: jax.Array
    control_max: jax.Array
    radius: jax.Array
    formula: jx.Pendulum
    network: eqx.nn.MLP

    def __init__(self, formula: jx.Pendulum, *, key: jax.Array) -> None:
        self.control_min, self.control_max = formula.control_min, formula.control_max
        self.radius, self.formula = formula.radius, formula
        self.network = eqx.nn.MLP(4, 2, 32, 2, jnp.tanh, key=key)

    def step(self, state: jax.Array, control: jax.Array, dt: jax.Array) -> jax.Array:
        """Return the state (2,) after a step."""
        angle, rate = state
        seen = [jnp.sin(angle), jnp.cos(angle), rate / MAX_RATE, control[0] / MAX_TORQUE]
        return self.formula.step(state, control, dt) + dt * self.network(jnp.stack(seen))


def error(model: jx.Dynamics, x: jax.Array, u: jax.Array, reached: jax.Array) -> jax.Array:
    """Return the mean squared error of the derivative over N steps."""
    predicted = jax.vmap(lambda x, u: model.step(x, u, jnp.asarray(STEP)))(x, u)
    return jnp.mean(((predicted - reached) / STEP) ** 2)


@eqx.filter_jit
def train(
    model: LearnedPendulum,
    x: jax.Array,
    u: jax.Array,
    reached: jax.Array,
    num_steps: int,
    rate: float = 0.003,
) -> tuple[LearnedPendulum, jax.Array]:
    """Fit the network with Adam; return the model and the error (num_steps,) on the way."""
    weights, rest = eqx.partition(model.network, eqx.is_inexact_array)

    def with_weights(weights: Any) -> LearnedPendulum:
        return eqx.tree_at(lambda model: model.network, model, eqx.combine(weights, rest))

    def adam(carry: Any, _: None) -> Any:
        weights, mean, square = carry
        loss, slope = jax.value_and_grad(lambda w: error(with_weights(w), x, u, reached))(weights)
        mean = jax.tree.map(lambda m, g: 0.9 * m + 0.1 * g, mean, slope)
        square = jax.tree.map(lambda s, g: 0.99 * s + 0.01 * g * g, square, slope)
        change = jax.tree.map(lambda m, s: -rate * m / (jnp.sqrt(s) + 1e-6), mean, square)
        return (eqx.apply_updates(weights, change), mean, square), loss

    zero = jax.tree.map(jnp.zeros_like, weights)
    (weights, _, _), losses = jax.lax.scan(adam, (weights, zero, zero), None, num_steps)
    return with_weights(weights), losses


@eqx.filter_jit
def swing_up(model: jx.Dynamics, plant: jx.Dynamics, num_steps: int, key: jax.Array) -> jax.Array:
    """Return the angles (num_steps,) of the plant under MPPI with a model."""
    controller = jx.MPPI(
        model,
        jx.StateCost({"angle": 1.0, "rate": 0.1}, angles=["angle"]),
        horizon=50,
        num_samples=256,
        dt=STEP,
        proposal=jx.GaussianProposal([2.0], noise=jx.ColouredNoise(1.0)),
        weighting=jx.Softmax(2.0, importance=0.0),
    )

    def advance(carry: Any, key: jax.Array) -> Any:
        memory, x = carry
        control, memory, _ = controller.step(memory, x, key=key)
        x = plant.step(x, control, controller.dt)
        return (memory, x), x[0]

    hanging = jnp.asarray([jnp.pi, 0.0])
    keys = jax.random.split(key, num_steps)
    return jax.lax.scan(advance, (controller.init(), hanging), keys)[1]


def main() -> None:
    """Learn, swing up with and without what was learned, and draw it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("runs/learned_model"))
    parser.add_argument("--data", type=int, default=512, help="random steps to learn from")
    parser.add_argument("--training-steps", type=int, default=600)
    parser.add_argument("--steps", type=int, default=160, help="of the swing-up, 0.05 s each")
    arguments = parser.parse_args()

    keys = jax.random.split(jax.random.key(0), 4)
    plant, formula = RustyPendulum(), jx.Pendulum(max_torque=MAX_TORQUE, max_rate=MAX_RATE)
    largest = jnp.asarray([jnp.pi, MAX_RATE])
    x = largest * jax.random.uniform(keys[0], (arguments.data, 2), minval=-1.0)
    u = MAX_TORQUE * jax.random.uniform(keys[1], (arguments.data, 1), minval=-1.0)
    reached = jax.vmap(lambda x, u: plant.step(x, u, jnp.asarray(STEP)))(x, u)
    untrained = LearnedPendulum(formula, key=keys[2])
    learned, losses = train(untrained, x, u, reached, arguments.training_steps)
    before, after = float(error(formula, x, u, reached)), float(error(learned, x, u, reached))
    sys.stdout.write(f"error of a step: formula {before:.3f}, learned {after:.3f}\n")

    figure, axes = plt.subplots(2, 1, figsize=(7, 5), layout="constrained")
    axes[0].semilogy(losses, color="#0072b2")
    axes[0].axhline(before, color="#8a9099", linestyle="--", label="formula alone")
    axes[0].set(xlabel="training step", ylabel="error of a step")
    axes[0].legend(frameon=False)
    times = STEP * jnp.arange(1, arguments.steps + 1)
    for model, name, colour in (
        (formula, "formula", "#8a9099"),
        (learned, "learned", "#0072b2"),
        (plant, "the truth", "#e69f00"),
    ):
        angles = swing_up(model, plant, arguments.steps, keys[3])
        off = 1.0 - jnp.cos(angles)
        axes[1].plot(times, off, color=colour, label=name)
        sys.stdout.write(f"MPPI with {name}: mean of 1 - cos(angle) {float(off.mean()):.3f}\n")
    axes[1].set(xlabel="time [s]", ylabel="1 - cos(angle)")
    axes[1].legend(frameon=False, title="model")

    arguments.out.mkdir(parents=True, exist_ok=True)
    path = arguments.out / "learned_model.png"
    figure.savefig(path, dpi=120)
    sys.stdout.write(f"picture: {path}\n")


if __name__ == "__main__":
    main()
