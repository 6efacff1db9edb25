"""A proposal for augmented models: separate distributions for physical and virtual controls."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore import _kinds
from jaxplore._types import Key, Scalar
from jaxplore.control.parameterisations import ControlSpace, Samples
from jaxplore.control.proposals import Proposal, SamplingContext
from jaxplore.dynamics.augmented import Augmented


class AugmentedMemory(NamedTuple):
    """Memories of the proposals of both parts."""

    physical: Any
    virtual: Any


class AugmentedProposal(Proposal):
    """A proposal for an `Augmented` model, with an independent proposal for each part.

        q(v_p, v_v) = q_p(v_p) q_v(v_v)

    Each part has its own random stream, so the samples of one part do not depend on the other.

    Args:
        model: augmented model; only the sizes of its controls are used.
        physical: proposal of the physical controls.
        virtual: proposal of the virtual controls.

    Raises:
        ValueError: when a controller is built, a proposal that does not fit its part.
    """

    physical: Proposal
    virtual: Proposal
    physical_size: int = eqx.field(static=True)

    @_kinds.check_arguments
    def __init__(self, model: Augmented, physical: Proposal, virtual: Proposal) -> None:
        self.physical = physical
        self.virtual = virtual
        self.physical_size = model.physical.control_size

    def init(self, num_parameters: int, control_size: int) -> AugmentedMemory:
        """Return the initial memories of both proposals."""
        return AugmentedMemory(
            self.physical.init(num_parameters, self.physical_size),
            self.virtual.init(num_parameters, control_size - self.physical_size),
        )

    def sample(
        self,
        memory: AugmentedMemory,
        context: SamplingContext,
        num_samples: int,
        *,
        key: Key,
        perturbations: Samples | None = None,
    ) -> Samples:
        """Draw samples (P, nu, K), the physical controls first."""
        given = (None, None) if perturbations is None else self._parts(perturbations)
        keys = jax.random.split(key, 2)
        drawn = [
            proposal.sample(each, part, num_samples, key=stream, perturbations=added)
            for proposal, each, part, stream, added in zip(
                (self.physical, self.virtual),
                memory,
                self._part_contexts(context),
                keys,
                given,
                strict=True,
            )
        ]
        return jnp.concatenate(drawn, axis=1)

    def log_ratio(
        self, memory: AugmentedMemory, context: SamplingContext, samples: Samples
    ) -> Float[Array, " K"]:
        """Compute the sum of the log ratios of both parts (K,)."""
        contexts, parts = self._part_contexts(context), self._parts(samples)
        physical = self.physical.log_ratio(memory.physical, contexts[0], parts[0])
        return physical + self.virtual.log_ratio(memory.virtual, contexts[1], parts[1])

    def adapt(
        self,
        memory: AugmentedMemory,
        context: SamplingContext,
        weights: Float[Array, " K"],
        samples: Samples,
    ) -> AugmentedMemory:
        """Update the memories of both proposals."""
        contexts, parts = self._part_contexts(context), self._parts(samples)
        return AugmentedMemory(
            self.physical.adapt(memory.physical, contexts[0], weights, parts[0]),
            self.virtual.adapt(memory.virtual, contexts[1], weights, parts[1]),
        )

    def shift(self, memory: AugmentedMemory, rows: Scalar) -> AugmentedMemory:
        """Move the memories of both proposals on in time."""
        return AugmentedMemory(
            self.physical.shift(memory.physical, rows), self.virtual.shift(memory.virtual, rows)
        )

    def check(self, num_parameters: int, horizon: int, control_size: int, num_samples: int) -> None:
        """Raise a `ValueError` if a proposal does not fit its part."""
        sizes = {"physical": self.physical_size, "virtual": control_size - self.physical_size}
        for name, size in sizes.items():
            try:
                getattr(self, name).check(num_parameters, horizon, size, num_samples)
            except ValueError as error:
                raise ValueError(f"{name} proposal: {error}") from None

    def _parts(self, samples: Samples) -> tuple[Float[Array, "P np K"], Float[Array, "P nv K"]]:
        return samples[:, : self.physical_size], samples[:, self.physical_size :]

    def _part_contexts(self, context: SamplingContext) -> tuple[SamplingContext, SamplingContext]:
        """Split a context into those of the physical and of the virtual controls."""
        size, space = self.physical_size, context.space

        def part(indices: slice) -> SamplingContext:
            bounds = (space.minimum[indices], space.maximum[indices], space.default[indices])
            return SamplingContext(
                context.parameterisation,
                # Every array of a nominal has the controls on its last axis.
                jax.tree.map(lambda leaf: leaf[..., indices], context.nominal),
                ControlSpace(*bounds, space.dt, space.horizon),
            )

        return part(slice(None, size)), part(slice(size, None))
