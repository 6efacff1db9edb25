"""How the parameters that are sampled become a sequence of controls."""

import abc
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore._types import ControlVector, Scalar

Samples = Float[Array, "P nu K"]
ControlSamples = Float[Array, "T nu K"]
Parameters = Float[Array, "P nu"]
Sequence = Float[Array, "T nu"]


class ControlSpace(eqx.Module):
    """The control sequences that there are.

    Args:
        minimum: (nu,) lower bounds.
        maximum: (nu,) upper bounds.
        default: (nu,) what a robot does that is left alone.
        dt: how long each control of a sequence is held [s].
        horizon: how many there are in a sequence, T; static.
    """

    minimum: ControlVector
    maximum: ControlVector
    default: ControlVector
    dt: Scalar
    horizon: int = eqx.field(static=True)

    def clip(self, controls: Sequence) -> Sequence:
        """Return controls (T, nu) within the bounds."""
        return jnp.clip(controls, self.minimum, self.maximum)

    def clip_samples(self, controls: ControlSamples) -> ControlSamples:
        """Return controls (T, nu, K) within the bounds."""
        return jnp.clip(controls, self.minimum[:, None], self.maximum[:, None])


class Parameterisation(eqx.Module):
    """Maps P x nu parameters to T controls within the bounds, and moves them on in time.

    What it remembers between steps, the `nominal`, is a pytree of its own. Proposals sample around
    its `centre`; the weighted mean of the samples is the next one.
    """

    @abc.abstractmethod
    def num_parameters(self, horizon: int) -> int:
        """Return P, the number of rows of parameters for T = `horizon` controls.

        Raises:
            ValueError: a horizon that is too short for it.
        """

    @abc.abstractmethod
    def init(self, controls: Sequence, space: ControlSpace) -> Any:
        """Return the nominal whose controls are these (T, nu), or the nearest to them."""

    @abc.abstractmethod
    def centre(self, nominal: Any) -> Parameters:
        """Return the parameters (P, nu) of the nominal."""

    @abc.abstractmethod
    def rest(self, space: ControlSpace) -> ControlVector:
        """Return the parameters (nu,), the same in every row, of a robot that is left alone."""

    @abc.abstractmethod
    def decode(
        self, nominal: Any, samples: Samples, space: ControlSpace
    ) -> tuple[ControlSamples, Samples]:
        """Return the control sequences (T, nu, K) of samples, and the samples as they took effect.

        The controls are within the bounds. Averaging the samples that took effect, not those that
        were drawn, keeps bounds from biasing.
        """

    @abc.abstractmethod
    def encode(self, nominal: Any, controls: Sequence, space: ControlSpace) -> Parameters:
        """Return the sample (P, nu) whose controls are these (T, nu), or the nearest to them."""

    @abc.abstractmethod
    def update(self, nominal: Any, mean: Parameters, space: ControlSpace) -> Any:
        """Return the nominal after a step whose samples have this weighted mean (P, nu)."""

    @abc.abstractmethod
    def controls(self, nominal: Any, space: ControlSpace) -> Sequence:
        """Return the nominal's control sequence (T, nu) within the bounds."""

    @abc.abstractmethod
    def shift(self, nominal: Any, steps: Scalar, space: ControlSpace) -> Any:
        """Return the nominal as seen `steps` model steps later; a fraction interpolates."""


class Direct(Parameterisation):
    """The parameters are the controls, held constant over each model step."""

    def num_parameters(self, horizon: int) -> int:
        """Return the horizon."""
        return horizon

    def init(self, controls: Sequence, space: ControlSpace) -> Sequence:
        """Return the controls within the bounds."""
        return space.clip(controls)

    def centre(self, nominal: Sequence) -> Parameters:
        """Return the controls."""
        return nominal

    def rest(self, space: ControlSpace) -> ControlVector:
        """Return the default control."""
        return space.default

    def decode(
        self, nominal: Sequence, samples: Samples, space: ControlSpace
    ) -> tuple[ControlSamples, Samples]:
        """Return the samples within the bounds, twice."""
        controls = space.clip_samples(samples)
        return controls, controls

    def encode(self, nominal: Sequence, controls: Sequence, space: ControlSpace) -> Parameters:
        """Return the controls."""
        return controls

    def update(self, nominal: Sequence, mean: Parameters, space: ControlSpace) -> Sequence:
        """Return the mean."""
        return mean

    def controls(self, nominal: Sequence, space: ControlSpace) -> Sequence:
        """Return the nominal within the bounds."""
        return space.clip(nominal)

    def shift(self, nominal: Sequence, steps: Scalar, space: ControlSpace) -> Sequence:
        """Return the controls moved on, linear between steps, the default where none is planned."""
        return shifted(nominal, steps, space.default)


def shifted(sequence: Sequence, steps: Scalar, after: ControlVector) -> Sequence:
    """Return rows `t + steps` of a sequence, linear between rows and `after` (nu,) beyond it."""
    length = sequence.shape[0]
    position = jnp.arange(length, dtype=steps.dtype) + steps
    first = jnp.floor(position)
    share = (position - first)[:, None]
    planned = jnp.concatenate([sequence, after[None]])
    index = jnp.clip(first.astype(jnp.int32), 0, length)
    following = jnp.minimum(index + 1, length)
    return (1.0 - share) * planned[index] + share * planned[following]
