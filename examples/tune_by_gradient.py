"""Tuning by gradient: a car's weights, temperature and noise go down the slope of its closed loop.

MPPI drives a small car along an S-curve past cones. What its owner wants of a drive is one number.
Its derivative by the controller's settings is taken back through every step and every rollout, and
Adam (optax) follows it from settings that are poor on purpose.

    pip install 'jaxplore[tuning]'
    python examples/tune_by_gradient.py --out runs/tune_by_gradient

A closed loop has such a derivative where everything in it has one: here the path, the distance from
the cones, the car's model and the softmax. These have none, or one that does not say where to go:

- contacts: `Dynamics.resolve_collision` holds a robot at once
- occupancy grids: a cell is free or not by a threshold, a beam ends in one cell or in the next
- choices: of frontiers and targets, of a portfolio's members, of the rollouts that are `Elite`

Bounds of controls and speeds, and costs that begin somewhere, have kinks. What only ever is beyond
one has a derivative of 0, and is not tuned from there.

And where a few rollouts take all the weight, the least change makes others win: a closed loop is
chaotic then, and its derivative, though right, is as large as it is useless. Begin with a
temperature that is too high, not too low; the table shows the slope for that.
"""

import argparse
import sys
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib
import numpy as np
import optax
from jax.flatten_util import ravel_pytree

matplotlib.use("Agg")
import matplotlib.pyplot as plt

import jaxplore as jx
from jaxplore.costs.base import WeightedCost

STEP = 0.1  # of model and plant [s]
PACE = 1.5  # [m/s]
WAYPOINTS = [(0.0, 0.0), (2.0, 0.8), (4.0, 0.8), (6.0, -0.8), (8.0, -0.8), (10.0, 0.0)]
CONES = [(2.0, 0.45), (4.0, 1.2), (6.0, -0.45), (8.0, -1.2)]  # [m]
CONE_RADIUS = 0.15  # [m]
GAP = 0.1  # wanted between car and cones [m]
CAR_RADIUS = 0.2  # [m]
NAMES = ("contouring", "lag", "change", "cones", "temperature", "noise_std")
"""What is tuned."""
TERMS = ("off", "change", "close")
"""What a drive costs: being off the pace, changing the controls, being close to cones."""
COLOURS = ("#0072b2", "#56b4e9", "#009e73", "#e69f00", "#d55e00", "#cc79a7")

Settings = dict[str, jax.Array]
"""Logarithms: all that is tuned is positive, and counts by its ratio."""


class Drive(NamedTuple):
    """A closed loop: states (N, 5), and what each step cost the owner (N,), by what for."""

    states: jax.Array
    paid: dict[str, jax.Array]


def timid_controller(path: jx.Path, horizon: int = 20, num_samples: int = 128) -> jx.MPPI:
    """Return a controller that lags behind, cuts bends and hits cones."""
    car = jx.KinematicBicycle(max_speed=3.0, radius=CAR_RADIUS)
    # The point where the car is to be runs ahead at its pace, whatever the car does.
    model = jx.Augmented(car, jx.PathParameter(PACE, path.length, min_rate=PACE))
    cost = (
        1.0 * jx.ContouringCost(path)
        + 1.0 * jx.LagCost(path)
        + 10.0 * jx.ControlRateCost()
        + 0.1 * jx.DiscObstacleCost(CONES, CONE_RADIUS, clearance=0.4, collision=1.0)
    )
    steering, running = jx.GaussianProposal([0.3, 0.05]), jx.GaussianProposal([1.0])
    return jx.MPPI(
        model,
        cost,
        horizon=horizon,
        num_samples=num_samples,
        dt=STEP,
        proposal=jx.AugmentedProposal(model, steering, running),
        parameterisation=jx.Knots(5),
        weighting=jx.Softmax(5.0, importance=0.0),
    )


def tuned(controller: jx.MPPI) -> list[Any]:
    """Return the arrays of a controller that are tuned, in the order of their names."""
    terms = jax.tree.leaves(controller.cost, is_leaf=lambda node: isinstance(node, WeightedCost))
    weights = [term.weight for term in terms]
    return [*weights, controller.weighting.temperature, controller.proposal.physical.noise_std]


def settings_of(controller: jx.MPPI) -> Settings:
    """Return the settings of a controller."""
    return dict(zip(NAMES, map(jnp.log, tuned(controller)), strict=True))


def with_settings(controller: jx.MPPI, settings: Settings) -> jx.MPPI:
    """Return the controller with other settings: only arrays change, so nothing recompiles."""
    changed: jx.MPPI = eqx.tree_at(tuned, controller, [jnp.exp(settings[name]) for name in NAMES])
    return changed


def drive(controller: jx.MPPI, path: jx.Path, num_steps: int, key: jax.Array) -> Drive:
    """Return a closed loop whose randomness is the key's: of the start, the plant, the samples."""
    model, dt = controller.dynamics, controller.dt
    start_key, slip_key, plan_key = jax.random.split(key, 3)
    point = path.at(jnp.zeros(()))
    y = point.y + 0.1 * jax.random.normal(start_key)
    start = jnp.stack([point.x, y, point.heading, jnp.asarray(PACE), jnp.zeros(())])
    cones = jnp.asarray(CONES)
    slips = jnp.asarray([0.0, 0.0, 0.02, 0.1, 0.0]) * jax.random.normal(slip_key, (num_steps, 5))

    def advance(carry: Any, inputs: Any) -> Any:
        memory, state, before = carry
        step, slip, key = inputs
        control, memory, _ = controller.step(memory, state, key=key)
        state = model.step(state, control, dt) + slip
        off = state[:2] - path.at(PACE * dt * step).position
        change = (control - before)[:2] / jnp.asarray([1.0, 0.2])
        gaps = jnp.linalg.norm(state[:2] - cones, axis=1) - CONE_RADIUS - model.radius
        paid = {
            "off": jnp.sum((off / 0.2) ** 2),
            "change": jnp.sum(change**2),
            "close": jnp.sum((jnp.maximum(GAP - gaps, 0.0) / 0.05) ** 2),
        }
        return (memory, state, control), (state, paid)

    steps = jnp.arange(1.0, num_steps + 1.0)
    inputs = (steps, slips, jax.random.split(plan_key, num_steps))
    begin = (controller.init(), start, model.default_control)
    # On the way back each step is computed again: memory for one step's rollouts, not for all.
    _, (states, paid) = jax.lax.scan(jax.checkpoint(advance), begin, inputs)
    return Drive(states, paid)


def metric(
    settings: Settings, controller: jx.MPPI, path: jx.Path, num_steps: int, keys: jax.Array
) -> tuple[jax.Array, Drive]:
    """Return what a step costs the owner, over the seeds, and the drives (S, N, ...)."""
    controller = with_settings(controller, settings)
    drives = jax.vmap(lambda key: drive(controller, path, num_steps, key))(keys)
    return sum(map(jnp.mean, drives.paid.values()), jnp.zeros(())), drives


value = eqx.filter_jit(metric)
slope = eqx.filter_jit(lambda *arguments: jax.value_and_grad(metric, has_aux=True)(*arguments))


def row(*cells: Any) -> None:
    """Write a row of the table."""
    texts = [cell if isinstance(cell, str) else f"{float(cell):.3g}" for cell in cells]
    sys.stdout.write(" ".join(f"{text:>11}" for text in texts) + "\n")


def tune(
    start: Settings, num_iterations: int, rate: float, *problem: Any
) -> list[tuple[float, Settings]]:
    """Go downhill with Adam; return the metric and the settings on the way, until Ctrl-C."""
    # Clipped: one seed on the edge of a choice must not throw all settings away.
    descent = optax.chain(optax.clip_by_global_norm(1.0), optax.adam(rate))
    settings, memory, way = start, descent.init(start), []

    @jax.jit
    def descend(settings: Settings, memory: Any, slopes: Settings) -> Any:
        steps, memory = descent.update(slopes, memory, settings)
        return (
            optax.apply_updates(settings, steps),
            memory,
            jnp.linalg.norm(ravel_pytree(slopes)[0]),
        )

    row("iteration", "metric", *TERMS, "slope")
    try:
        for iteration in range(num_iterations):
            (found, drives), slopes = slope(settings, *problem)
            terms = [np.mean(drives.paid[name]) for name in TERMS]
            way.append((float(found), settings))
            settings, memory, steepness = descend(settings, memory, slopes)
            row(str(iteration), found, *terms, steepness)
    except KeyboardInterrupt:
        sys.stdout.write("stopped; what follows is of the iterations done\n")
    return way


def draw(path: jx.Path, way: list[tuple[float, Settings]], drives: list[Drive]) -> plt.Figure:
    """Draw unseen drives before and after, and how the metric and the settings went."""
    figure = plt.figure(figsize=(8, 6), layout="constrained")
    above, below = figure.subfigures(2, 1)
    scene = above.subplots()
    scene.plot(*path.points.T, color="#2b303a", linestyle=":", label="path")
    for cone in CONES:
        scene.add_patch(plt.Circle(cone, CONE_RADIUS, color="#e69f00"))
        near = CONE_RADIUS + CAR_RADIUS + GAP
        scene.add_patch(plt.Circle(cone, near, color="#e69f00", alpha=0.15, linewidth=0.0))
    for each, name, colour in zip(drives, ("before", "after"), ("#8a9099", "#0072b2"), strict=True):
        places = each.states[:8, :, :2]
        scene.plot(*places.T, color=colour, linewidth=0.8, alpha=0.8)
        scene.plot([], [], color=colour, label=f"{name}, {len(places)} unseen seeds")
    scene.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    scene.legend(frameon=False, loc="upper right")

    curve, settings = below.subplots(1, 2)
    curve.plot([found for found, _ in way], color="#0072b2")
    curve.set(xlabel="iteration", ylabel="metric, seeds tuned on")
    for name, colour in zip(NAMES, COLOURS, strict=True):
        first = np.asarray(way[0][1][name])
        ratios = [np.exp(np.mean(np.asarray(each[name]) - first)) for _, each in way]
        settings.plot(ratios, color=colour, label=name)
    settings.set(xlabel="iteration", ylabel="setting / its start")
    place = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0)}
    settings.legend(frameon=False, fontsize=7, ncols=3, **place)
    for axes in (curve, settings):
        axes.set_yscale("log", base=2)
        axes.yaxis.set_major_formatter("{x:g}")
    return figure


def main(arguments: list[str] | None = None) -> None:
    """Tune, say what it was worth on seeds that were not tuned on, and draw it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("runs/tune_by_gradient"))
    parser.add_argument("--iterations", type=int, default=40)
    parser.add_argument("--rate", type=float, default=0.2, help="of Adam, in logarithms")
    parser.add_argument("--steps", type=int, default=65, help="of a drive, 0.1 s each")
    parser.add_argument("--samples", type=int, default=128, help="rollouts of a step")
    parser.add_argument(
        "--seeds", type=int, default=8, help="to tune on; four times as many to judge"
    )
    given = parser.parse_args(arguments)

    path = jx.path_through(WAYPOINTS)
    controller = timid_controller(path, num_samples=given.samples)
    problem = (controller, path, given.steps)
    seen, unseen = jax.random.key(0), jax.random.key(1)
    keys = jax.random.split(seen, given.seeds)
    start = settings_of(controller)
    way = tune(start, given.iterations, given.rate, *problem, keys)
    if not way:
        return
    best = min(way, key=lambda entry: entry[0])[1]
    row("setting", "before", "after")
    for name in NAMES:
        for before, after in zip(*map(np.ravel, (start[name], best[name])), strict=True):
            row(name, np.exp(before), np.exp(after))
    checks = jax.random.split(unseen, 4 * given.seeds)
    (before, old), (after, new) = (value(each, *problem, checks) for each in (start, best))
    row("unseen", before, after)

    given.out.mkdir(parents=True, exist_ok=True)
    target = given.out / "tune_by_gradient.png"
    draw(path, way, [old, new]).savefig(target, dpi=120)
    sys.stdout.write(f"picture: {target}\n")


if __name__ == "__main__":
    main()
