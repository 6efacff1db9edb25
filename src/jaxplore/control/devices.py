"""Samples spread over several devices."""

from collections.abc import Callable
from typing import Any

import jax
from jax import Array
from jax.sharding import Mesh, NamedSharding
from jax.sharding import PartitionSpec as Spec
from jaxtyping import Float

from jaxplore.control.parameterisations import Samples


def whole(mesh: Mesh) -> Mesh:
    """Return a mesh of the same devices along which the compiler spreads what follows.

    Users' meshes may have axes of the explicit kind.
    """
    return Mesh(mesh.devices, mesh.axis_names)


def spread(samples: Samples, mesh: Mesh) -> Samples:
    """Return samples with each device holding its share of the last axis."""
    sharding = NamedSharding(mesh, _spec(None, None, mesh.axis_names))
    shared: Samples = jax.lax.with_sharding_constraint(  # type: ignore[no-untyped-call]
        samples, sharding
    )
    return shared


def on_each(
    costs: Callable[[Array, Array, Any], Array],
    mesh: Mesh,
    initial: Float[Array, "*nx_K"],
    controls: Float[Array, "T nu K"],
    arrays: Any,
) -> Float[Array, " K"]:
    """Return the costs of samples, of which each device prices its own.

    Nothing is exchanged before the weights.

    Args:
        costs: of initial state, controls, and what all devices know.
        mesh: the devices.
        initial: (nx,) of all samples, or (nx, K) of each.
        controls: (T, nu, K).
        arrays: what all devices know.
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
        # The loop over time begins with the same state on all devices, which would not pass.
        check_vma=False,
    )
    total: Array = over_devices(initial, controls, arrays)
    return total


def check_share(num_samples: int, mesh: Mesh) -> None:
    """Raise a `ValueError` if samples do not divide among the devices."""
    if num_samples % mesh.size:
        raise ValueError(
            f"num_samples is {num_samples}; accepted: a multiple of the {mesh.size} "
            "devices of the mesh"
        )


def _spec(*axes: Any) -> Spec:
    return Spec(*axes)  # type: ignore[no-untyped-call]
