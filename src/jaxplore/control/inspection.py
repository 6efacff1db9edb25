"""The trajectories of one step of MPPI, for drawing and debugging."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxplore._types import Scalar, StateVector
from jaxplore.control.base import Info, SampledPlan
from jaxplore.control.mppi_state import SampledControls
from jaxplore.control.trajectory import Trajectory, rollout
from jaxplore.costs.base import Cost
from jaxplore.dynamics.base import Dynamics


def roll_out_plan(
    dynamics: Dynamics,
    cost: Cost,
    sampled: SampledControls,
    info: Info,
    observation: StateVector,
    dt: Scalar,
    belief: Any,
    num_trajectories: int,
) -> SampledPlan:
    """Roll out the plan of a step, its best sample and some of the others, undisturbed.

    All start at `observation` (nx,), with the model step `dt` [s]. The others are at most
    `num_trajectories` samples.
    """
    chosen = choose_samples(sampled.controls.shape[-1], num_trajectories)

    def simulate(controls: Array) -> Trajectory:
        return rollout(
            dynamics, cost, observation, controls, dt, belief, applied=sampled.state.applied
        )

    sequences = jnp.moveaxis(sampled.controls, -1, 0)
    best = sequences[jnp.argmin(info.costs)]
    shown = jnp.concatenate([info.controls[None], best[None], sequences[chosen]])
    return SampledPlan.from_trajectories(jax.vmap(simulate)(shown), info.weights[chosen])


def choose_samples(num_samples: int, most: int) -> np.ndarray:
    """Return the numbers of the samples that are shown, at most `most`, at even distances.

    A mixture orders its samples by component, so the first few would show one component only.
    """
    return np.linspace(0, num_samples - 1, min(most, num_samples)).round().astype(int)
