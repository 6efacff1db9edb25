"""MuJoCo MJX as a model: MPPI swings up the pole of a cart that MJX simulates.

Needs MuJoCo and MJX beside jaxplore:

    pip install mujoco mujoco-mjx
    python examples/mjx_cartpole.py --out runs/mjx_cartpole
"""

import argparse
import sys
import time
from pathlib import Path
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib
import mujoco
from mujoco import mjx

matplotlib.use("Agg")
import matplotlib.pyplot as plt

import jaxplore as jx

STEP = 0.02  # of MJX [s]
CARTPOLE = f"""
<mujoco>
  <option timestep="{STEP}" integrator="implicitfast"/>
  <worldbody>
    <body name="cart">
      <joint name="slide" type="slide" axis="1 0 0" damping="0.2"/>
      <geom type="box" size="0.15 0.1 0.05" mass="1" contype="0" conaffinity="0"/>
      <body name="pole">
        <joint name="hinge" type="hinge" axis="0 1 0" damping="0.002"/>
        <geom type="capsule" fromto="0 0 0 0 0 0.8" size="0.02" mass="0.2"
              contype="0" conaffinity="0"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="slide" ctrllimited="true" ctrlrange="-15 15"/></actuator>
</mujoco>
"""


class MJXDynamics(jx.Dynamics):
    """State (qpos, qvel) of any MJX model with as many velocities as positions.

    A step takes as many steps of MJX as fit into `dt`, which must be a multiple of its own.
    """

    state_names: ClassVar[tuple[str, ...]] = ("position", "angle", "velocity", "rate")
    control_names: ClassVar[tuple[str, ...]] = ("force",)

    control_min: jax.Array
    control_max: jax.Array
    radius: jax.Array
    model: mjx.Model
    data: mjx.Data
    substeps: int = eqx.field(static=True)

    def __init__(self, xml: str, substeps: int) -> None:
        model = mujoco.MjModel.from_xml_string(xml)
        bounds = jnp.asarray(model.actuator_ctrlrange, jnp.float32)
        self.control_min, self.control_max = bounds[:, 0], bounds[:, 1]
        self.radius = jnp.asarray(0.2)
        self.model, self.data, self.substeps = mjx.put_model(model), mjx.make_data(model), substeps

    def step(self, state: jax.Array, control: jax.Array, dt: jax.Array) -> jax.Array:
        """Return (qpos, qvel) after `substeps` steps of MJX."""
        size = self.model.nq
        data = self.data.replace(qpos=state[:size], qvel=state[size:], ctrl=control)
        data = jax.lax.fori_loop(0, self.substeps, lambda _, data: mjx.step(self.model, data), data)
        return jnp.concatenate([data.qpos, data.qvel])


class Upright(jx.Cost):
    """The pole up, the cart in the middle, both at rest."""

    def stage(self, state: jx.State, control: jax.Array, t: jax.Array, belief: Any) -> jax.Array:
        """Return 0 to 2 for the angle, and a little for the rest."""
        x, v = state["position"], state["velocity"]
        rate = state["rate"]
        return 1.0 - jnp.cos(state["angle"]) + 0.2 * x * x + 0.02 * v * v + 0.01 * rate * rate


@eqx.filter_jit
def balance(controller: jx.MPPI, start: jax.Array, num_steps: int, key: jax.Array) -> Any:
    """Return the states and controls of a closed loop."""

    def advance(carry: Any, key: jax.Array) -> Any:
        memory, state = carry
        control, memory, _ = controller.step(memory, state, key=key)
        state = controller.dynamics.step(state, control, controller.control_period)
        return (memory, state), (state, control)

    keys = jax.random.split(key, num_steps)
    return jax.lax.scan(advance, (controller.init(), start), keys)[1]


def main() -> None:
    """Swing up, and draw it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("runs/mjx_cartpole"))
    parser.add_argument("--samples", type=int, default=256)
    parser.add_argument("--steps", type=int, default=150, help="of 0.04 s")
    arguments = parser.parse_args()

    substeps = 2
    dynamics = MJXDynamics(CARTPOLE, substeps)
    controller = jx.MPPI(
        dynamics,
        Upright(),
        horizon=40,
        num_samples=arguments.samples,
        proposal=jx.GaussianProposal([6.0]),
        parameterisation=jx.Knots(10),
        weighting=jx.Softmax(0.3, importance=0.0),
        dt=substeps * STEP,
    )
    hanging = jnp.array([0.0, jnp.pi, 0.0, 0.0])
    begin = time.perf_counter()
    states, controls = jax.block_until_ready(
        balance(controller, hanging, arguments.steps, jax.random.key(0))
    )
    elapsed = time.perf_counter() - begin

    arguments.out.mkdir(parents=True, exist_ok=True)
    times = substeps * STEP * jnp.arange(1, arguments.steps + 1)
    figure, axes = plt.subplots(3, 1, figsize=(7, 5), sharex=True, layout="constrained")
    for axis, values, name in (
        (axes[0], 1.0 - jnp.cos(states[:, 1]), "1 - cos(angle)"),
        (axes[1], states[:, 0], "cart [m]"),
        (axes[2], controls[:, 0], "force [N]"),
    ):
        axis.plot(times, values, color="#0072b2")
        axis.set_ylabel(name)
    axes[2].set_xlabel("time [s]")
    figure.savefig(arguments.out / "swing_up.png", dpi=120)
    off = float(jnp.max(1.0 - jnp.cos(states[-25:, 1])))
    sys.stdout.write(f"last second: 1 - cos(angle) at most {off:.3f}; 0 is upright\n")
    sys.stdout.write(f"{elapsed:.1f} s, compilation included\n")
    sys.stdout.write(f"picture: {arguments.out / 'swing_up.png'}\n")


if __name__ == "__main__":
    main()
