"""Where the perturbations of the nominal controls come from."""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplore._types import ControlVector, Key, Vector

Perturbations = Float[Array, "T nu K"]


class Proposal(eqx.Module):
    """A distribution of perturbations, and the price of having sampled from it."""

    @abc.abstractmethod
    def sample(self, shape: tuple[int, int, int], *, key: Key) -> Perturbations:
        """Return perturbations of shape (T, nu, K)."""

    @abc.abstractmethod
    def importance(
        self, nominal: Float[Array, "T nu"], perturbations: Perturbations
    ) -> Float[Array, " K"]:
        """Return the log-likelihood ratio of each sample (K,), up to a constant.

        That of the proposal N(nominal, Sigma) to the uncontrolled distribution N(0, Sigma).
        """


class GaussianProposal(Proposal):
    """White Gaussian noise, independent between controls and steps.

    Its importance term is `sum_t u_t^T Sigma^-1 eps_t` (Williams et al., "Information theoretic
    MPC", ICRA 2017, eq. 19; multiplied there, and in `MPPI`, by the temperature), u the nominal.

    Args:
        noise_std: (nu,) standard deviation of each control.

    Raises:
        ValueError: a standard deviation that is not positive and finite.
    """

    noise_std: ControlVector

    def __init__(self, noise_std: Vector) -> None:
        if not isinstance(noise_std, jax.core.Tracer):
            std = np.asarray(noise_std, np.float32)
            if std.ndim != 1 or not (np.isfinite(std) & (std > 0)).all():
                raise ValueError(
                    f"noise_std is {noise_std!r}; accepted: one positive number per control"
                )
            noise_std = std
        self.noise_std = jnp.asarray(noise_std, jnp.float32)

    def sample(self, shape: tuple[int, int, int], *, key: Key) -> Perturbations:
        """Return `noise_std * N(0, 1)` (T, nu, K)."""
        return self.noise_std[:, None] * jax.random.normal(key, shape)

    def importance(
        self, nominal: Float[Array, "T nu"], perturbations: Perturbations
    ) -> Float[Array, " K"]:
        """Return `sum_t u_t^T Sigma^-1 eps_t` (K,)."""
        scaled = nominal / (self.noise_std * self.noise_std)
        return jnp.einsum("tu,tuk->k", scaled, perturbations)
