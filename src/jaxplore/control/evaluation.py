"""Evaluate sampled control sequences, on one device or on several."""

from typing import Any

import equinox as eqx
from jax import Array
from jax.sharding import Mesh
from jaxtyping import Float

from jaxplore._types import Count, Scalar, StateVector
from jaxplore.control import devices
from jaxplore.control.model_checks import without_belief
from jaxplore.control.mppi_state import SampledControls
from jaxplore.control.rollout import rollout_costs
from jaxplore.costs.base import Cost
from jaxplore.dynamics.base import Dynamics


def evaluate_samples(
    dynamics: Dynamics,
    cost: Cost,
    sampled: SampledControls,
    initial: StateVector | Float[Array, "nx K"],
    dt: Scalar,
    belief: Any,
    mesh: Mesh | None,
    steps: Count | None = None,
) -> Float[Array, " K"]:
    """Roll out sampled control sequences and return their costs (K,).

    `initial` is the state (nx,) that all rollouts start from, or (nx, K) one for each. The model
    step `dt` is in s. `mesh` are the devices that share the samples; None for one device. `steps`
    is the number of steps to simulate, see `rollout_costs`; all when absent.
    """
    everything = (dynamics, cost, dt, belief, sampled.state.applied, sampled.outcomes, steps)
    # `shard_map` takes arrays only: everything else is closed over.
    arrays, static = eqx.partition(everything, eqx.is_array)

    def costs(start: Array, controls: Array, arrays: Any) -> Array:
        model, terms, step, knowledge, applied, outcomes, number = eqx.combine(arrays, static)
        return rollout_costs(
            model,
            terms,
            start,
            controls,
            step,
            knowledge,
            applied=applied,
            outcomes=outcomes,
            steps=number,
        )

    try:
        if mesh is None:
            return costs(initial, sampled.controls, arrays)
        return devices.map_over_devices(costs, mesh, initial, sampled.controls, arrays)
    except (AttributeError, TypeError) as error:
        # A cost that a user wrote asks None for what it knows.
        name = without_belief(dynamics, cost, sampled.controls.shape[0])
        if belief is not None or name is None or "NoneType" not in str(error):
            raise
        raise ValueError(
            f"belief is None, and {name} reads it ({error}); accepted: step(state, "
            "observation, belief, key=key)"
        ) from error
