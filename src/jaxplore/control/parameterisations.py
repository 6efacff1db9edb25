"""How the parameters that are sampled become a sequence of controls."""

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore._types import ControlVector, Scalar

Samples = Float[Array, "T nu K"]
Sequence = Float[Array, "T nu"]


class Parameterisation(eqx.Module):
    """Maps parameters to controls within the bounds, and moves them on in time."""

    @abc.abstractmethod
    def init(self, horizon: int, control_size: int) -> Sequence:
        """Return the nominal parameters of a robot that does nothing."""

    @abc.abstractmethod
    def perturb(
        self,
        nominal: Sequence,
        perturbations: Samples,
        control_min: ControlVector,
        control_max: ControlVector,
    ) -> tuple[Samples, Samples]:
        """Return the control sequences of perturbed parameters and the perturbations used.

        The controls are within the bounds. The perturbations come back as they took effect, in
        the parameters' own space: averaging them, not those drawn, keeps bounds from biasing.
        """

    @abc.abstractmethod
    def controls(
        self, nominal: Sequence, control_min: ControlVector, control_max: ControlVector
    ) -> Sequence:
        """Return the nominal's control sequence within the bounds."""

    @abc.abstractmethod
    def shift(self, nominal: Sequence, steps: Scalar) -> Sequence:
        """Return the nominal as seen `steps` model steps later; a fraction interpolates."""


class Direct(Parameterisation):
    """The parameters are the controls, held constant over each model step."""

    def init(self, horizon: int, control_size: int) -> Sequence:
        """Return zeros."""
        return jnp.zeros((horizon, control_size))

    def perturb(
        self,
        nominal: Sequence,
        perturbations: Samples,
        control_min: ControlVector,
        control_max: ControlVector,
    ) -> tuple[Samples, Samples]:
        """Return `clip(nominal + perturbations)` and its difference to the nominal."""
        base = nominal[:, :, None]
        controls = jnp.clip(base + perturbations, control_min[:, None], control_max[:, None])
        return controls, controls - base

    def controls(
        self, nominal: Sequence, control_min: ControlVector, control_max: ControlVector
    ) -> Sequence:
        """Return the nominal within the bounds."""
        return jnp.clip(nominal, control_min, control_max)

    def shift(self, nominal: Sequence, steps: Scalar) -> Sequence:
        """Return the controls moved on, linear between steps, 0 where nothing was planned."""
        horizon = nominal.shape[0]
        position = jnp.arange(horizon, dtype=jnp.float32) + steps
        first = jnp.floor(position)
        share = (position - first)[:, None]
        planned = jnp.concatenate([nominal, jnp.zeros_like(nominal[:1])])
        index = jnp.clip(first.astype(jnp.int32), 0, horizon)
        after = jnp.minimum(index + 1, horizon)
        return (1.0 - share) * planned[index] + share * planned[after]
