"""Parameterise a control sequence by rates of change of the controls: smooth MPPI."""

from typing import NamedTuple

import jax.numpy as jnp

from jaxplore import _checks
from jaxplore._types import ArrayLike, ControlVector, Scalar
from jaxplore.control.parameterisations import (
    ControlSamples,
    ControlSpace,
    Parameterisation,
    Parameters,
    Samples,
    Sequence,
    shift_sequence,
)


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
