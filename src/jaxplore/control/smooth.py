"""Smooth MPPI: the sampled parameters are rates of change of the controls."""

from typing import NamedTuple

import jax.numpy as jnp
from jax.typing import ArrayLike

from jaxplore import _checks
from jaxplore._types import ControlVector, Scalar
from jaxplore.control.parameterisations import (
    ControlSamples,
    ControlSpace,
    Parameterisation,
    Parameters,
    Samples,
    Sequence,
    shifted,
)


class SmoothNominal(NamedTuple):
    """What `Smooth` remembers: `rates` (T, nu) per second, and the `controls` (T, nu)."""

    rates: Sequence
    controls: Sequence


class Smooth(Parameterisation):
    """Samples rates and adds them to the controls of the last step.

        u_t,k = clip(u_t + dt * r_t,k),     r <- sum_k w_k r_k,     u_t <- u_t + dt * r_t

    with r_k the rates as they took effect after clipping. The noise's standard deviation is per
    second: a rate of s changes a control by s * dt in one command. The last control is held where
    the horizon moves on; the rates continue with 0. Add a `ControlRateCost` to weigh the
    differences of neighbouring controls, as the paper does.

    Source: Kim, Park, Lee, Kim, "Smooth Model Predictive Path Integral Control Without Smoothing",
    RA-L 2022, Algorithm 1.

    Args:
        max_rate: bound of every |rate| [1/s]; none when absent.

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
        """Return the controls within the bounds, and rates of 0."""
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
        """Return the integrated controls within the bounds, and the rates that lead to them."""
        rates = self._bounded(samples)
        base = nominal.controls[:, :, None]
        controls = space.clip_samples(base + space.dt * rates)
        return controls, (controls - base) / space.dt

    def encode(self, nominal: SmoothNominal, controls: Sequence, space: ControlSpace) -> Parameters:
        """Return the rates that lead from the nominal controls to these."""
        return (controls - nominal.controls) / space.dt

    def update(
        self, nominal: SmoothNominal, mean: Parameters, space: ControlSpace
    ) -> SmoothNominal:
        """Return the mean rates, and the controls after one step of them."""
        return SmoothNominal(mean, space.clip(nominal.controls + space.dt * mean))

    def controls(self, nominal: SmoothNominal, space: ControlSpace) -> Sequence:
        """Return the controls."""
        return space.clip(nominal.controls)

    def shift(self, nominal: SmoothNominal, steps: Scalar, space: ControlSpace) -> SmoothNominal:
        """Return rates and controls moved on; the last control is held."""
        return SmoothNominal(
            shifted(nominal.rates, steps, jnp.zeros_like(space.default)),
            shifted(nominal.controls, steps, nominal.controls[-1]),
        )

    def _bounded(self, rates: Samples) -> Samples:
        if self.max_rate is None:
            return rates
        return jnp.clip(rates, -self.max_rate, self.max_rate)
