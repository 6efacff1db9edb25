"""Map sampled parameters to control sequences."""

import abc
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore import _checks
from jaxplore._types import ArrayLike, ControlVector, Scalar

Samples = Float[Array, "P nu K"]
ControlSamples = Float[Array, "T nu K"]
Parameters = Float[Array, "P nu"]
Sequence = Float[Array, "T nu"]


class ControlSpace(eqx.Module):
    """Space of the admissible control sequences.

    Args:
        minimum: lower bounds (nu,) of the controls.
        maximum: upper bounds (nu,) of the controls.
        default: default control (nu,) of the robot.
        dt: duration of each control of a sequence [s].
        horizon: number of controls in a sequence, T; static.
    """

    minimum: ControlVector
    maximum: ControlVector
    default: ControlVector
    dt: Scalar
    horizon: int = eqx.field(static=True)

    def clip(self, controls: Sequence) -> Sequence:
        """Return controls (T, nu), clipped to the bounds."""
        return jnp.clip(controls, self.minimum, self.maximum)

    def clip_samples(self, controls: ControlSamples) -> ControlSamples:
        """Return controls (T, nu, K), clipped to the bounds."""
        return jnp.clip(controls, self.minimum[:, None], self.maximum[:, None])


class Parameterisation(eqx.Module):
    """Map from P x nu parameters to T x nu controls within the bounds; abstract.

    Its memory between steps, the `nominal`, is a pytree of the subclass. Proposals sample around
    the `centre` of the nominal, and `update` replaces it by the weighted mean of the samples.
    """

    @abc.abstractmethod
    def num_parameters(self, horizon: int) -> int:
        """Return the number of parameters per control, P, for T = `horizon` controls.

        Raises:
            ValueError: a horizon that is too short for this parameterisation.
        """

    @abc.abstractmethod
    def init(self, controls: Sequence, space: ControlSpace) -> Any:
        """Return the nominal of a control sequence (T, nu), or of the nearest representable one."""

    @abc.abstractmethod
    def centre(self, nominal: Any) -> Parameters:
        """Return the parameters (P, nu) of the nominal, around which proposals sample."""

    @abc.abstractmethod
    def rest(self, space: ControlSpace) -> ControlVector:
        """Return the parameters (nu,), equal in every row, of the default control."""

    @abc.abstractmethod
    def decode(
        self, nominal: Any, samples: Samples, space: ControlSpace
    ) -> tuple[ControlSamples, Samples]:
        """Return the control sequences (T, nu, K) and the effective samples (P, nu, K).

        The controls are clipped to the bounds. The effective samples are the parameters of the
        clipped controls. Averaging them, instead of the samples as drawn, keeps the update unbiased
        at the bounds.
        """

    @abc.abstractmethod
    def encode(self, nominal: Any, controls: Sequence, space: ControlSpace) -> Parameters:
        """Return the sample (P, nu) of a control sequence (T, nu), or of the nearest one."""

    @abc.abstractmethod
    def update(self, nominal: Any, mean: Parameters, space: ControlSpace) -> Any:
        """Return the updated nominal, given the weighted mean (P, nu) of the effective samples."""

    @abc.abstractmethod
    def controls(self, nominal: Any, space: ControlSpace) -> Sequence:
        """Return the control sequence (T, nu) of the nominal, clipped to the bounds."""

    @abc.abstractmethod
    def shift(self, nominal: Any, steps: Scalar, space: ControlSpace) -> Any:
        """Return the nominal shifted by `steps` model steps, interpolated for fractions."""


class Direct(Parameterisation):
    """Direct parameterisation: the parameters are the controls, constant over each model step."""

    def num_parameters(self, horizon: int) -> int:
        """Return the horizon."""
        return horizon

    def init(self, controls: Sequence, space: ControlSpace) -> Sequence:
        """Return the controls, clipped to the bounds."""
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
        """Return the clipped samples, which are both the controls and the effective samples."""
        controls = space.clip_samples(samples)
        return controls, controls

    def encode(self, nominal: Sequence, controls: Sequence, space: ControlSpace) -> Parameters:
        """Return the controls."""
        return controls

    def update(self, nominal: Sequence, mean: Parameters, space: ControlSpace) -> Sequence:
        """Return the weighted mean of the samples."""
        return mean

    def controls(self, nominal: Sequence, space: ControlSpace) -> Sequence:
        """Return the nominal, clipped to the bounds."""
        return space.clip(nominal)

    def shift(self, nominal: Sequence, steps: Scalar, space: ControlSpace) -> Sequence:
        """Return the shifted controls, extended by the default control."""
        return shift_sequence(nominal, steps, space.default)


def shift_sequence(sequence: Sequence, steps: Scalar, after: ControlVector) -> Sequence:
    """Return a sequence (T, nu) shifted by a number of steps, interpolated linearly.

    The number may be a fraction. The row `after` (nu,) extends the sequence.
    """
    # Rows beyond the end read the extension, which is appended as one more row.
    length = sequence.shape[0]
    position = jnp.arange(length, dtype=steps.dtype) + steps
    first = jnp.floor(position)
    share = (position - first)[:, None]
    planned = jnp.concatenate([sequence, after[None]])
    index = jnp.clip(first.astype(jnp.int32), 0, length)
    following = jnp.minimum(index + 1, length)
    return (1.0 - share) * planned[index] + share * planned[following]


class SmoothNominal(NamedTuple):
    """Nominal of `Smooth`: the `rates` (T, nu) per second, and the `controls` (T, nu)."""

    rates: Sequence
    controls: Sequence


class Smooth(Parameterisation):
    """Rates of change that are added to the nominal controls of the last step:

        u_t,k = clip(u_t + dt * r_t,k),     r <- sum_k w_k r_k,     u_t <- u_t + dt * r_t

    with r_k the effective rates after clipping. The standard deviation of the noise is per second:
    a rate s changes a control by s * dt per step. When the horizon moves on, the last control is
    held and the new rates are 0. Add a `ControlRateCost` to penalise differences of successive
    controls, as the paper does.

    Source: Kim, Park, Lee, Kim, "Smooth Model Predictive Path Integral Control Without Smoothing",
    RA-L 2022, Algorithm 1.

    Args:
        max_rate: bound of every |rate| [control unit / s]; unbounded by default.

    Raises:
        ValueError: a bound that is not positive.
    """

    max_rate: Scalar | None

    def __init__(self, max_rate: ArrayLike | None = None) -> None:
        self.max_rate = (
            None if max_rate is None else _checks.scalar("max_rate", max_rate, above=0.0)
        )

    def num_parameters(self, horizon: int) -> int:
        """Return the horizon."""
        return horizon

    def init(self, controls: Sequence, space: ControlSpace) -> SmoothNominal:
        """Return the controls clipped to the bounds, with rates of 0."""
        return SmoothNominal(jnp.zeros_like(controls), space.clip(controls))

    def centre(self, nominal: SmoothNominal) -> Parameters:
        """Return the rates."""
        return nominal.rates

    def rest(self, space: ControlSpace) -> ControlVector:
        """Return rates of 0."""
        return jnp.zeros_like(space.default)

    def decode(
        self, nominal: SmoothNominal, samples: Samples, space: ControlSpace
    ) -> tuple[ControlSamples, Samples]:
        """Return the clipped controls, and the effective rates that lead to them."""
        # Return the rates that the clipped controls correspond to, not those drawn: their average
        # is then unbiased at the bounds.
        rates = self._bound(samples)
        base = nominal.controls[:, :, None]
        controls = space.clip_samples(base + space.dt * rates)
        return controls, (controls - base) / space.dt

    def encode(self, nominal: SmoothNominal, controls: Sequence, space: ControlSpace) -> Parameters:
        """Return the rates that lead from the nominal controls to the given ones."""
        return (controls - nominal.controls) / space.dt

    def update(
        self, nominal: SmoothNominal, mean: Parameters, space: ControlSpace
    ) -> SmoothNominal:
        """Return the mean rates, and the nominal controls changed by them."""
        return SmoothNominal(mean, space.clip(nominal.controls + space.dt * mean))

    def controls(self, nominal: SmoothNominal, space: ControlSpace) -> Sequence:
        """Return the nominal controls, clipped to the bounds."""
        return space.clip(nominal.controls)

    def shift(self, nominal: SmoothNominal, steps: Scalar, space: ControlSpace) -> SmoothNominal:
        """Return rates and controls shifted in time; the last control is held."""
        return SmoothNominal(
            shift_sequence(nominal.rates, steps, jnp.zeros_like(space.default)),
            shift_sequence(nominal.controls, steps, nominal.controls[-1]),
        )

    def _bound(self, rates: Samples) -> Samples:
        if self.max_rate is None:
            return rates
        return jnp.clip(rates, -self.max_rate, self.max_rate)
