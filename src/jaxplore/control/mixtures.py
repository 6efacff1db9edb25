"""Proposals that also use a reference or given control sequences, not only the last solution."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, Key, Rows, Scalar
from jaxplore.control.parameterisations import Samples
from jaxplore.control.proposals import GaussianProposal, Proposal, SamplingContext


class OuterProposal(Proposal):
    """A proposal that changes the samples of an inner one and keeps the memory of it; abstract."""

    proposal: eqx.AbstractVar[Proposal]

    def init(self, num_parameters: int, control_size: int) -> Any:
        """Return the initial memory of the inner proposal."""
        return self.proposal.init(num_parameters, control_size)

    def adapt(
        self,
        memory: Any,
        context: SamplingContext,
        weights: Float[Array, " K"],
        samples: Samples,
    ) -> Any:
        """Update the memory of the inner proposal."""
        return self.proposal.adapt(memory, context, weights, samples)

    def shift(self, memory: Any, rows: Scalar) -> Any:
        """Move the memory of the inner proposal on in time."""
        return self.proposal.shift(memory, rows)


class BiasedProposal(OuterProposal):
    """A mixture of two Gaussians, one around the nominal and one around reference controls.

        q(v) = (1 - a) N(v; c, Sigma) + a N(v; g, Sigma)

    with c the parameters of the nominal and g those of the reference: controls for `Direct`, rates
    for `Smooth`, knots for `Knots`. With the likelihood ratio, weights are multiplied by p / q,
    with p the uncontrolled distribution; the mixture then changes how fast the optimum is found,
    but not the optimum. Without the ratio, the result is biased towards the reference, as in
    Biased-MPPI.

    To change the reference without recompiling, use
    `eqx.tree_at(lambda c: c.proposal.reference, controller, reference)`.

    Source: Trevisan and Alonso-Mora, "Biased-MPPI: Informing Sampling-Based Model Predictive
    Control by Fusing Ancillary Controllers", RA-L 2024.

    Args:
        proposal: proposal that draws the noise around both means.
        reference: (T, nu) reference controls.
        fraction: share of the samples drawn around the reference, a.
        likelihood_ratio: whether weights include the likelihood ratio; static.

    Raises:
        ValueError: a fraction outside [0, 1]; from `check`, a reference of the wrong shape.
    """

    proposal: GaussianProposal
    reference: Float[Array, "T nu"]
    fraction: Scalar
    likelihood_ratio: bool = eqx.field(static=True)

    @_kinds.check_arguments
    def __init__(
        self,
        proposal: GaussianProposal,
        reference: Rows,
        fraction: ArrayLike = 0.5,
        *,
        likelihood_ratio: bool = True,
    ) -> None:
        self.proposal = proposal
        self.reference = _control_sequences("reference", reference, 2)
        self.fraction = _checks.scalar("fraction", fraction, at_least=0.0, at_most=1.0)
        self.likelihood_ratio = _kinds.flag("likelihood_ratio", likelihood_ratio)

    def sample(
        self,
        memory: Any,
        context: SamplingContext,
        num_samples: int,
        *,
        key: Key,
        perturbations: Samples | None = None,
    ) -> Samples:
        """Draw samples (P, nu, K), those around the reference first."""
        samples = self.proposal.sample(
            memory, context, num_samples, key=key, perturbations=perturbations
        )
        # The count may be traced, so shapes must not depend on it: the samples are drawn around the
        # nominal, and the first `count` of them are moved to the reference.
        count = jnp.round(self.fraction * samples.shape[-1]).astype(jnp.int32)
        biased = jnp.arange(samples.shape[-1]) < count
        offset = context.encode(self.reference) - context.centre
        return samples + offset[:, :, None] * biased.astype(jnp.float32)

    def log_ratio(
        self, memory: Any, context: SamplingContext, samples: Samples
    ) -> Float[Array, " K"]:
        """Compute the log ratio of the mixture (K,), or 0 if it is switched off."""
        if not self.likelihood_ratio:
            return jnp.zeros(samples.shape[-1])
        ratios = jnp.stack(
            [
                self.proposal.log_density_ratio(memory, context, mean, samples)
                for mean in (context.centre, context.encode(self.reference))
            ]
        )
        # log q - log p of a mixture: the sum over components of share times density, in logarithms
        # because the densities of long horizons underflow.
        shares = jnp.stack([1.0 - self.fraction, self.fraction])
        return jax.nn.logsumexp(ratios, axis=0, b=shares[:, None])

    def check(self, num_parameters: int, horizon: int, control_size: int, num_samples: int) -> None:
        """Raise a `ValueError` if the reference or the noise does not fit."""
        self.proposal.check(num_parameters, horizon, control_size, num_samples)
        if self.reference.shape != (horizon, control_size):
            raise ValueError(
                f"reference has shape {self.reference.shape}; accepted: "
                f"{(horizon, control_size)}, horizon x controls"
            )


class InjectedProposal(OuterProposal):
    """A proposal that replaces some samples by given control sequences.

    The first samples are `sequences`, then zeros, then the nominal without noise. They are weighted
    like all other samples, so a manoeuvre that random sampling would not find is used when it is
    good.

    Args:
        proposal: proposal of the other samples.
        sequences: (N, T, nu) control sequences to try in every step; none when absent.
        null_action: whether to try controls of 0, which need not be the default control; static.
        last_solution: whether to try the shifted last solution; static.

    Raises:
        ValueError: nothing to inject; from `check`, sequences of the wrong shape or more sequences
            than samples.
    """

    proposal: Proposal
    sequences: Float[Array, "N T nu"] | None
    null_action: bool = eqx.field(static=True)
    last_solution: bool = eqx.field(static=True)

    @_kinds.check_arguments
    def __init__(
        self,
        proposal: Proposal,
        sequences: Rows | Sequence[Rows] | None = None,
        *,
        null_action: bool = False,
        last_solution: bool = False,
    ) -> None:
        self.null_action = _kinds.flag("null_action", null_action)
        self.last_solution = _kinds.flag("last_solution", last_solution)
        if sequences is None and not (null_action or last_solution):
            raise ValueError(
                "sequences is None, null_action and last_solution are False; accepted: at least "
                "one of them to inject"
            )
        self.proposal = proposal
        self.sequences = (
            None if sequences is None else _control_sequences("sequences", sequences, 3)
        )

    @property
    def num_injected(self) -> int:
        """Number of injected samples."""
        given = 0 if self.sequences is None else int(self.sequences.shape[0])
        return given + int(self.null_action) + int(self.last_solution)

    def sample(
        self,
        memory: Any,
        context: SamplingContext,
        num_samples: int,
        *,
        key: Key,
        perturbations: Samples | None = None,
    ) -> Samples:
        """Draw samples (P, nu, K), the injected ones first."""
        samples = self.proposal.sample(
            memory, context, num_samples, key=key, perturbations=perturbations
        )
        # Injected last, so that the other samples are the same with and without injection.
        given = [] if self.sequences is None else [context.encode(each) for each in self.sequences]
        if self.null_action:
            given.append(context.encode(jnp.zeros((context.space.horizon, samples.shape[1]))))
        if self.last_solution:
            given.append(context.encode(context.controls))
        injected = jnp.stack(given, axis=-1)
        return samples.at[:, :, : injected.shape[-1]].set(injected)

    def log_ratio(
        self, memory: Any, context: SamplingContext, samples: Samples
    ) -> Float[Array, " K"]:
        """Compute the log ratio of the inner proposal (K,), also of the injected samples."""
        # An injected sequence was not drawn. It gets the ratio that it would have if it had been.
        return self.proposal.log_ratio(memory, context, samples)

    def check(self, num_parameters: int, horizon: int, control_size: int, num_samples: int) -> None:
        """Raise a `ValueError` if the sequences or the inner proposal do not fit."""
        self.proposal.check(num_parameters, horizon, control_size, num_samples)
        if self.sequences is not None and self.sequences.shape[1:] != (horizon, control_size):
            raise ValueError(
                f"sequences has shape {self.sequences.shape}; accepted: "
                f"(N, {horizon}, {control_size}), N x horizon x controls"
            )
        if self.num_injected > num_samples:
            raise ValueError(
                f"{self.num_injected} sequences are to be injected; accepted: at most num_samples, "
                f"{num_samples}"
            )


def _control_sequences(name: str, value: Rows | Sequence[Rows], ndim: int) -> Array:
    """Return controls as a finite float32 array with `ndim` axes."""
    if not isinstance(value, jax.core.Tracer):
        shape = "(T, nu)" if ndim == 2 else "(N, T, nu)"
        array = _checks.floats(name, value, f"finite controls of shape {shape}")
        is_bad = ~np.isfinite(array)
        if is_bad.any():
            raise ValueError(
                f"{name} has a value {array[is_bad][0]}; accepted: finite controls of shape {shape}"
            )
        if array.ndim != ndim or array.size == 0:
            raise ValueError(
                f"{name} has shape {array.shape}; accepted: finite controls of shape {shape}"
            )
        value = array
    return jnp.asarray(value, jnp.float32)
