"""Sampling the controls of a physical and a virtual part from distributions of their own."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore._types import Key, Scalar
from jaxplore.control.parameterisations import ControlSpace, Samples
from jaxplore.control.proposals import Proposal, SamplingContext
from jaxplore.dynamics.augmented import Augmented


class AugmentedMemory(NamedTuple):
    """What the proposals of both parts remember."""

    physical: Any
    virtual: Any


class AugmentedProposal(Proposal):
    """Samples of an `Augmented` model's controls: each part's from a proposal of its own.

        q(v_p, v_v) = q_p(v_p) q_v(v_v)

    The parts are independent, with random streams of their own: what is drawn for one does not
    change with the other.

    Args:
        model: whose controls they are; static sizes are taken from it.
        physical: of the physical part's controls.
        virtual: of the virtual part's.

    Raises:
        ValueError: when a controller is built, a proposal that does not fit its part.
    """

    physical: Proposal
    virtual: Proposal
    physical_size: int = eqx.field(static=True)

    def __init__(self, model: Augmented, physical: Proposal, virtual: Proposal) -> None:
        self.physical = physical
        self.virtual = virtual
        self.physical_size = model.physical.control_size

    def init(self, num_parameters: int, control_size: int) -> AugmentedMemory:
        """Return what both remember."""
        return AugmentedMemory(
            self.physical.init(num_parameters, self.physical_size),
            self.virtual.init(num_parameters, control_size - self.physical_size),
        )

    def sample(
        self,
        memory: AugmentedMemory,
        around: SamplingContext,
        num_samples: int,
        *,
        key: Key,
        perturbations: Samples | None = None,
    ) -> Samples:
        """Return samples (P, nu, K), the physical part's controls first."""
        given = (None, None) if perturbations is None else self._parts(perturbations)
        keys = jax.random.split(key, 2)
        drawn = [
            proposal.sample(each, near, num_samples, key=stream, perturbations=added)
            for proposal, each, near, stream, added in zip(
                (self.physical, self.virtual),
                memory,
                self._around(around),
                keys,
                given,
                strict=True,
            )
        ]
        return jnp.concatenate(drawn, axis=1)

    def log_ratio(
        self, memory: AugmentedMemory, around: SamplingContext, samples: Samples
    ) -> Float[Array, " K"]:
        """Return the sum of the parts' log ratios (K,)."""
        near, of = self._around(around), self._parts(samples)
        return self.physical.log_ratio(memory.physical, near[0], of[0]) + self.virtual.log_ratio(
            memory.virtual, near[1], of[1]
        )

    def adapt(
        self,
        memory: AugmentedMemory,
        around: SamplingContext,
        weights: Float[Array, " K"],
        samples: Samples,
    ) -> AugmentedMemory:
        """Return what both remember after a step in which the samples had these weights."""
        near, of = self._around(around), self._parts(samples)
        return AugmentedMemory(
            self.physical.adapt(memory.physical, near[0], weights, of[0]),
            self.virtual.adapt(memory.virtual, near[1], weights, of[1]),
        )

    def shift(self, memory: AugmentedMemory, rows: Scalar) -> AugmentedMemory:
        """Return what both remember, as seen later."""
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

    def _around(self, around: SamplingContext) -> tuple[SamplingContext, SamplingContext]:
        """Return what each part samples around: controls are on the last axis of a nominal."""
        size, space = self.physical_size, around.space

        def part(of: slice) -> SamplingContext:
            bounds = (space.minimum[of], space.maximum[of], space.default[of])
            return SamplingContext(
                around.parameterisation,
                jax.tree.map(lambda leaf: leaf[..., of], around.nominal),
                ControlSpace(*bounds, space.dt, space.horizon),
            )

        return part(slice(None, size)), part(slice(size, None))
