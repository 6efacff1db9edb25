"""The problems on which controllers are timed."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from benchmarks.timing import Timed, timed
from jaxplore import (
    MPPI,
    RK4,
    ControlRateCost,
    Cost,
    DifferentialDrive,
    Dynamics,
    Euler,
    GaussianProposal,
    Integrator,
    Knots,
    Quadrotor,
    RBFKernel,
    Smooth,
    Softmax,
    State,
    office,
    start_pose,
)
from jaxplore.control import Controller
from jaxplore.maps import clearance_field
from jaxplore.maps.field import ScalarField
from jaxplore.maps.frame import GridFrame

KEY = jax.random.key(0)
Problem = dict[str, Any]


class ToGoal(Cost):
    """Squared distance from a goal plus effort, in plain sums.

    `jnp.sum` over a handful of numbers is a reduction, which XLA's CPU back end does slowly.
    """

    goal: Float[Array, " n"]

    def stage(self, state: State, control: Array, t: Array, belief: Any) -> Array:
        """Return it."""
        total = 0.01 * sum((u * u for u in control), jnp.zeros(()))
        for name, wanted in zip("xyz", self.goal, strict=False):
            total = total + (state[name] - wanted) ** 2
        return total


class OnMap(Cost):
    """What a map says of the position, plus the distance from a goal."""

    field: ScalarField
    goal: Float[Array, "2"]

    def stage(self, state: State, control: Array, t: Array, belief: Any) -> Array:
        """Return it."""
        position = state.position
        x, y = position[0] - self.goal[0], position[1] - self.goal[1]
        return self.field(position) + jnp.sqrt(x * x + y * y)


def quadrotor_problem(
    num_samples: int = 1000, horizon: int = 40, is_euler: bool = False
) -> Problem:
    """A quadrotor flies to a point in the open."""
    model = Quadrotor()
    probe = np.tile([10.0, 0.3, -0.2, 0.1], (horizon, 1))
    return {
        "start": model.at_pose(0.0, 0.0, 0.0),
        "goal": [5.0, 5.0, -2.0],
        "noise_std": [2.0, 0.5, 0.5, 0.5],
        "probe": probe,
        "dt": 0.05,
        **_shared(model, num_samples, horizon, is_euler),
    }


def map_problem(
    num_samples: int, horizon: int = 100, cell: float = 0.05, is_euler: bool = False
) -> Problem:
    """A robot among the walls and the furniture of an office, 20 x 20 m."""
    world = office(seed=5, width=20.0, height=20.0, resolution=cell)
    clearance = eqx.filter_jit(lambda w: clearance_field(~w.is_free, w.frame, 1.0))(world)
    model = DifferentialDrive()
    return {
        "start": model.at_pose(*start_pose(world)),
        "goal": [15.0, 12.0],
        "noise_std": [0.5, 1.0],
        "probe": np.tile([0.8, -0.2], (horizon, 1)),
        "dt": 0.02,
        "cost_map": 10.0 * jnp.exp(-clearance.values / 0.2),
        "resolution": world.resolution,
        "origin": world.frame.origin[:2],
        **_shared(model, num_samples, horizon, is_euler),
    }


def _shared(model: Dynamics, num_samples: int, horizon: int, is_euler: bool) -> Problem:
    return {
        "is_euler": is_euler,
        "control_min": model.control_min,
        "control_max": model.control_max,
        "default_control": model.default_control,
        "num_samples": num_samples,
        "horizon": horizon,
        "temperature": 1.0,
        "smoothness_weight": 1.0,
        "num_knots": 10,
        "length_scale": 4.0,
    }


def build(
    problem: Problem,
    variant: str = "plain",
    *,
    integrator: Integrator | None = None,
    **changes: Any,
) -> MPPI:
    """Return our controller of a problem: plain, smooth or kernel, with parts changed."""
    integrator = integrator or (Euler() if problem["is_euler"] else RK4())
    model: Dynamics = Quadrotor(integrator=integrator)
    goal = jnp.asarray(problem["goal"])
    cost: Cost = ToGoal(goal)
    if "cost_map" in problem:
        model = DifferentialDrive(integrator=integrator)
        frame = GridFrame(problem["resolution"], (*map(float, problem["origin"]), 0.0))
        field = ScalarField(problem["cost_map"], frame, jnp.max(problem["cost_map"]))
        cost = OnMap(field, goal)
    std = np.asarray(problem["noise_std"])
    parts: dict[str, Any] = {}
    if variant == "smooth":
        # Rates whose effect in one command is that of the plain variant's noise.
        std = std / problem["dt"]
        rate = ControlRateCost(np.ones(std.shape), include_applied=False)
        cost = cost + problem["smoothness_weight"] * rate
        parts["parameterisation"] = Smooth()
    if variant == "kernel":
        kernel = RBFKernel(problem["length_scale"])
        parts["parameterisation"] = Knots(problem["num_knots"], kernel)
    parts |= {"weighting": Softmax(problem["temperature"]), "proposal": GaussianProposal(std)}
    parts |= {name: problem[name] for name in ("dt", "num_samples", "horizon")}
    return MPPI(model, cost, **{**parts, **changes})


def step(controller: Controller, state: Any, observation: Array, key: Array) -> Any:
    """Return the controller's next command, state and info."""
    return controller.step(state, observation, key=key)


def timed_step(controller: MPPI, start: Array, runs: int = 200) -> Timed:
    """Time one command."""
    return timed(step, controller, controller.init(), start, KEY, runs=runs)
