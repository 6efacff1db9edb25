"""Distribute samples over several devices."""

from collections.abc import Callable
from typing import Any

import jax
from jax import Array
from jax.sharding import Mesh, NamedSharding
from jax.sharding import PartitionSpec as Spec
from jaxtyping import Float

from jaxplore.control.parameterisations import Samples


def auto_mesh(mesh: Mesh) -> Mesh:
    """Return a mesh of the same devices whose axes the compiler may shard automatically.

    The axes of a user's mesh may be of the explicit kind.
    """
    return Mesh(mesh.devices, mesh.axis_names)


def shard_samples(samples: Samples, mesh: Mesh) -> Samples:
    """Return the samples, sharded over the devices along their last axis."""
    sharding = NamedSharding(mesh, _spec(None, None, mesh.axis_names))
    shared: Samples = jax.lax.with_sharding_constraint(  # type: ignore[no-untyped-call]
        samples, sharding
    )
    return shared


def map_over_devices(
    costs: Callable[[Array, Array, Any], Array],
    mesh: Mesh,
    initial: Float[Array, "*nx_K"],
    controls: Float[Array, "T nu K"],
    arrays: Any,
) -> Float[Array, " K"]:
    """Evaluate the costs of samples, each on the device that holds it.

    The devices exchange nothing until the weights are computed. The initial state is (nx,) of all
    samples, or (nx, K) of each. The pytree `arrays`, the third argument of `costs`, is replicated
    on all devices.
    """
    samples = mesh.axis_names
    over_devices = jax.shard_map(
        costs,
        mesh=mesh,
        in_specs=(
            _spec() if initial.ndim == 1 else _spec(None, samples),
            _spec(None, None, samples),
            _spec(),
        ),
        out_specs=_spec(samples),
        # The loop over time starts with a state that is equal on all devices and then varies, which
        # the check would refuse.
        check_vma=False,
    )
    total: Array = over_devices(initial, controls, arrays)
    return total


def check_divisible(num_samples: int, mesh: Mesh) -> None:
    """Raise a `ValueError` if the samples cannot be divided evenly among the devices."""
    if num_samples % mesh.size:
        raise ValueError(
            f"num_samples is {num_samples}; accepted: a multiple of the {mesh.size} "
            "devices of the mesh"
        )


def _spec(*axes: Any) -> Spec:
    return Spec(*axes)  # type: ignore[no-untyped-call]
