"""Proposals that know more than the last solution: references and given manoeuvres."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxplore import _checks
from jaxplore._types import Key, Rows, Scalar
from jaxplore.control.parameterisations import Samples
from jaxplore.control.proposals import GaussianProposal, Proposal, SamplingContext


class BiasedProposal(Proposal):
    """A mixture: a share of the samples around reference controls, the rest around the nominal.

        q(v) = (1 - a) N(v; c, Sigma) + a N(v; g, Sigma)

    with c the nominal's parameters, g those of the reference in the space of the parameterisation:
    rates for `Smooth`, knots for `Knots`. With its likelihood ratio the mixture changes how fast
    the optimum is found, not which: weights are multiplied by p / q, p the uncontrolled
    distribution. Without it the result leans towards the reference, which is what Biased-MPPI does.

    Give a new reference by `eqx.tree_at(lambda c: c.proposal.reference, controller, reference)`;
    nothing recompiles.

    Source: Trevisan and Alonso-Mora, "Biased-MPPI: Informing Sampling-Based Model Predictive
    Control by Fusing Ancillary Controllers", RA-L 2024.

    Args:
        proposal: noise around either mean.
        reference: (T, nu) controls.
        fraction: a, share of the samples around the reference.
        likelihood_ratio: whether samples are weighed by their likelihood ratio; static.

    Raises:
        ValueError: a fraction outside [0, 1]; from `check`, a reference of another shape.
    """

    proposal: GaussianProposal
    reference: Float[Array, "T nu"]
    fraction: Scalar
    likelihood_ratio: bool = eqx.field(static=True)

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
        self.likelihood_ratio = likelihood_ratio

    def init(self, num_parameters: int, control_size: int) -> Any:
        """Return the memory of the noise."""
        return self.proposal.init(num_parameters, control_size)

    def sample(
        self,
        memory: Any,
        around: SamplingContext,
        num_samples: int,
        *,
        key: Key,
        perturbations: Samples | None = None,
    ) -> Samples:
        """Return samples (P, nu, K), those around the reference first."""
        samples = self.proposal.sample(
            memory, around, num_samples, key=key, perturbations=perturbations
        )
        count = jnp.round(self.fraction * samples.shape[-1]).astype(jnp.int32)
        biased = jnp.arange(samples.shape[-1]) < count
        offset = around.encode(self.reference) - around.centre
        return samples + offset[:, :, None] * biased.astype(jnp.float32)

    def log_ratio(
        self, memory: Any, around: SamplingContext, samples: Samples
    ) -> Float[Array, " K"]:
        """Return the ratio of the mixture (K,), or 0 where it is left out."""
        if not self.likelihood_ratio:
            return jnp.zeros(samples.shape[-1])
        ratios = jnp.stack(
            [
                self.proposal.log_density_ratio(memory, around, mean, samples)
                for mean in (around.centre, around.encode(self.reference))
            ]
        )
        shares = jnp.stack([1.0 - self.fraction, self.fraction])
        return jax.nn.logsumexp(ratios, axis=0, b=shares[:, None])

    def adapt(
        self,
        memory: Any,
        around: SamplingContext,
        weights: Float[Array, " K"],
        samples: Samples,
    ) -> Any:
        """Return the memory of the noise after a step."""
        return self.proposal.adapt(memory, around, weights, samples)

    def shift(self, memory: Any, rows: Scalar) -> Any:
        """Return the memory of the noise moved on."""
        return self.proposal.shift(memory, rows)

    def check(self, num_parameters: int, horizon: int, control_size: int, num_samples: int) -> None:
        """Raise a `ValueError` if the reference or the noise does not fit."""
        self.proposal.check(num_parameters, horizon, control_size, num_samples)
        if self.reference.shape != (horizon, control_size):
            raise ValueError(
                f"reference has shape {self.reference.shape}; accepted: "
                f"{(horizon, control_size)}, horizon x controls"
            )


class InjectedProposal(Proposal):
    """A proposal some of whose samples are given: manoeuvres, the null action, the last solution.

    The given ones come first: `sequences`, then zeros, then the nominal without noise. They compete
    like all others, so that a manoeuvre that random samples would not find is taken if it is good.

    Args:
        proposal: of the other samples.
        sequences: (N, T, nu) controls to be tried in every step; none when absent.
        null_action: whether controls of 0 are tried (0 itself, not the nominal); static.
        last_solution: whether the shifted last solution is tried; static.

    Raises:
        ValueError: nothing to inject; from `check`, sequences of another shape or more of them than
            samples.
    """

    proposal: Proposal
    sequences: Float[Array, "N T nu"] | None
    null_action: bool = eqx.field(static=True)
    last_solution: bool = eqx.field(static=True)

    def __init__(
        self,
        proposal: Proposal,
        sequences: Rows | Sequence[Rows] | None = None,
        *,
        null_action: bool = False,
        last_solution: bool = False,
    ) -> None:
        if sequences is None and not (null_action or last_solution):
            raise ValueError(
                "sequences is None, null_action and last_solution are False; accepted: at least "
                "one of them to inject"
            )
        self.proposal = proposal
        self.sequences = (
            None if sequences is None else _control_sequences("sequences", sequences, 3)
        )
        self.null_action = null_action
        self.last_solution = last_solution

    @property
    def num_injected(self) -> int:
        """How many samples are given."""
        given = 0 if self.sequences is None else int(self.sequences.shape[0])
        return given + int(self.null_action) + int(self.last_solution)

    def init(self, num_parameters: int, control_size: int) -> Any:
        """Return the memory of the other samples' proposal."""
        return self.proposal.init(num_parameters, control_size)

    def sample(
        self,
        memory: Any,
        around: SamplingContext,
        num_samples: int,
        *,
        key: Key,
        perturbations: Samples | None = None,
    ) -> Samples:
        """Return samples (P, nu, K), the given ones first."""
        samples = self.proposal.sample(
            memory, around, num_samples, key=key, perturbations=perturbations
        )
        given = [] if self.sequences is None else [around.encode(each) for each in self.sequences]
        if self.null_action:
            given.append(around.encode(jnp.zeros((around.space.horizon, samples.shape[1]))))
        if self.last_solution:
            given.append(around.encode(around.controls))
        injected = jnp.stack(given, axis=-1)
        return samples.at[:, :, : injected.shape[-1]].set(injected)

    def log_ratio(
        self, memory: Any, around: SamplingContext, samples: Samples
    ) -> Float[Array, " K"]:
        """Return the ratio of the other samples' proposal (K,), for the given ones too."""
        return self.proposal.log_ratio(memory, around, samples)

    def adapt(
        self,
        memory: Any,
        around: SamplingContext,
        weights: Float[Array, " K"],
        samples: Samples,
    ) -> Any:
        """Return the memory of the other samples' proposal after a step."""
        return self.proposal.adapt(memory, around, weights, samples)

    def shift(self, memory: Any, rows: Scalar) -> Any:
        """Return the memory of the other samples' proposal moved on."""
        return self.proposal.shift(memory, rows)

    def check(self, num_parameters: int, horizon: int, control_size: int, num_samples: int) -> None:
        """Raise a `ValueError` if the sequences or the other samples' proposal do not fit."""
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
        array = np.asarray(value, np.float32)
        if array.ndim != ndim or array.size == 0 or not np.isfinite(array).all():
            shape = "(T, nu)" if ndim == 2 else "(N, T, nu)"
            raise ValueError(
                f"{name} has shape {array.shape}; accepted: finite controls of shape {shape}"
            )
        value = array
    return jnp.asarray(value, jnp.float32)
