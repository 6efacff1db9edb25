"""Proposals: the distributions that MPPI samples parameters from."""

import abc
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.scipy.linalg
import numpy as np
from jaxtyping import Array, Float

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, ControlVector, Key, Rows, Scalar, Vector
from jaxplore.control.noise import Noise, WhiteNoise
from jaxplore.control.parameterisations import (
    ControlSpace,
    Parameterisation,
    Parameters,
    Samples,
    Sequence,
    shift_sequence,
)


class CovarianceAdaptation(eqx.Module):
    """Scales the noise of each parameter to the spread of the weighted samples.

    With v the samples of a parameter, c the nominal and sigma the given standard deviation,

        s^2 <- (1 - rate) s^2 + rate * sum_k w_k ((v_k - c) / sigma)^2,   floor <= s <= ceiling

    and the noise has the standard deviation `s sigma`. The spread is taken around the nominal, not
    around the new mean, so it grows while the good samples lie to one side of the nominal. The
    floor keeps exploration from dying out. Correlations between controls do not change.

    Source: Stulp and Sigaud, "Path integral policy improvement with covariance matrix adaptation",
    ICML 2012.

    Args:
        rate: weight of the new spread in each step, 0 to 1.
        floor: lower bound of s.
        ceiling: upper bound of s.

    Raises:
        ValueError: a rate outside [0, 1], a floor that is not positive, a ceiling below the floor.
    """

    rate: Scalar
    floor: Scalar
    ceiling: Scalar

    def __init__(
        self, rate: ArrayLike = 0.2, floor: ArrayLike = 0.2, ceiling: ArrayLike = 1.0
    ) -> None:
        self.rate = _checks.scalar("rate", rate, at_least=0.0, at_most=1.0)
        self.floor = _checks.scalar("floor", floor, above=0.0)
        self.ceiling = _checks.scalar("ceiling", ceiling, above=0.0)
        if not _kinds.is_traced(floor, ceiling) and self.ceiling < self.floor:
            raise ValueError(f"ceiling is {ceiling!r}; accepted: at least the floor, {floor!r}")

    def adapt(self, scale: Parameters, weights: Float[Array, " K"], away: Samples) -> Parameters:
        """Compute the new scale (P, nu).

        Args:
            scale: (P, nu) scale before.
            weights: (K,) weights of the samples.
            away: (P, nu, K) samples minus nominal, in given standard deviations.
        """
        spread = jnp.einsum("k,puk->pu", weights, away * away)
        # If no rollout is finite, all weights are 0 and the scale must stay, not shrink.
        rate = self.rate * jnp.sum(weights)
        square = (1.0 - rate) * scale * scale + self.rate * spread
        return jnp.clip(jnp.sqrt(square), self.floor, self.ceiling)

    def shift(self, scale: Parameters, rows: Scalar) -> Parameters:
        """Move the scale on by a number of rows; new rows have the given spread, s = 1."""
        fresh = jnp.clip(jnp.ones(scale.shape[1]), self.floor, self.ceiling)
        return shift_sequence(scale, rows, fresh)


class SamplingContext(eqx.Module):
    """The nominal that a proposal samples around, with its parameterisation.

    Args:
        parameterisation: map from parameters to controls.
        nominal: last solution, as the parameterisation stores it.
        space: bounds, default control, step and horizon of the controls.
    """

    parameterisation: Parameterisation
    nominal: Any
    space: ControlSpace

    @property
    def centre(self) -> Parameters:
        """Parameters (P, nu) of the nominal."""
        return self.parameterisation.centre(self.nominal)

    @property
    def rest(self) -> ControlVector:
        """Parameters (nu,) of a robot that applies its default control."""
        return self.parameterisation.rest(self.space)

    @property
    def controls(self) -> Sequence:
        """Control sequence (T, nu) of the nominal."""
        return self.parameterisation.controls(self.nominal, self.space)

    def encode(self, controls: Sequence) -> Parameters:
        """Return the parameters (P, nu) of controls (T, nu), or the nearest ones."""
        return self.parameterisation.encode(self.nominal, controls, self.space)


class Proposal(eqx.Module):
    """A distribution of parameters, and its likelihood ratio to the uncontrolled distribution."""

    def init(self, num_parameters: int, control_size: int) -> Any:
        """Return the initial memory; empty for a proposal that does not adapt."""
        return ()

    @abc.abstractmethod
    def sample(
        self,
        memory: Any,
        context: SamplingContext,
        num_samples: int,
        *,
        key: Key,
        perturbations: Samples | None = None,
    ) -> Samples:
        """Draw samples (P, nu, K).

        Args:
            memory: memory from `init` or `adapt`.
            context: nominal to sample around.
            num_samples: number of samples, K.
            key: random key.
            perturbations: (P, nu, K) perturbations to add to the nominal instead of noise.
        """

    @abc.abstractmethod
    def log_ratio(
        self, memory: Any, context: SamplingContext, samples: Samples
    ) -> Float[Array, " K"]:
        """Compute `log q(v) - log p(v)` of each sample v (K,), up to a constant.

        q is the density of this proposal. p is that of the uncontrolled system: the same noise
        around the default control. With the weights `exp(-J / temperature) p / q` the estimate
        converges to the same optimum for any q (Williams et al., "Information theoretic MPC for
        model-based reinforcement learning", ICRA 2017).
        """

    def adapt(
        self,
        memory: Any,
        context: SamplingContext,
        weights: Float[Array, " K"],
        samples: Samples,
    ) -> Any:
        """Update the memory with the weights (K,) of the samples (P, nu, K) of a step."""
        return memory

    def shift(self, memory: Any, rows: Scalar) -> Any:
        """Move the memory on in time by a number of rows of parameters, not necessarily whole."""
        return memory

    def check(self, num_parameters: int, horizon: int, control_size: int, num_samples: int) -> None:
        """Raise a `ValueError` if the proposal does not fit a controller of these sizes."""
        return


class GaussianProposal(Proposal):
    """`v = c + mu + eps`, with c the nominal's parameters and eps Gaussian noise.

    The covariance of eps is the product of `noise_covariance` between controls and the covariance
    of `noise` between rows, which is the identity for white noise. With r the parameters of the
    default control,

        log q - log p = sum (c - r)^T Sigma^-1 (v - c) + constant

    (Williams et al., ICRA 2017, eq. 19, where r = 0). For noise that is not Gaussian, this is the
    ratio of two Gaussians with the same covariance.

    Args:
        noise_std: (nu,) standard deviation of the noise of each control; or give
            `noise_covariance`.
        noise_covariance: (nu, nu) covariance between controls, symmetric and positive definite.
        mean: (nu,) mean of the noise, mu; 0 when absent.
        noise: source of normalised noise; `WhiteNoise` when absent.
        adaptation: rule that adapts the spread to the weights; the spread is fixed when absent.

    Raises:
        ValueError: both or neither of standard deviation and covariance, a deviation that is not
            positive, a matrix that is not a covariance, a mean of the wrong size.
    """

    noise_std: ControlVector | None
    noise_covariance: Float[Array, "nu nu"] | None
    mean: ControlVector
    noise: Noise
    adaptation: CovarianceAdaptation | None

    @_kinds.check_arguments
    def __init__(
        self,
        noise_std: Vector | None = None,
        *,
        noise_covariance: Rows | None = None,
        mean: Vector | None = None,
        noise: Noise | None = None,
        adaptation: CovarianceAdaptation | None = None,
    ) -> None:
        if (noise_std is None) == (noise_covariance is None):
            raise ValueError(
                f"noise_std is {noise_std!r} and noise_covariance is {noise_covariance!r}; "
                "accepted: one of them"
            )
        self.noise_std = None if noise_std is None else _standard_deviation(noise_std)
        self.noise_covariance = None if noise_covariance is None else _covariance(noise_covariance)
        size = self.control_size
        self.mean = _checks.vector("mean", np.zeros(size) if mean is None else mean, size)
        self.noise = WhiteNoise() if noise is None else noise
        self.adaptation = adaptation

    @property
    def control_size(self) -> int:
        """Number of controls, nu."""
        if self.noise_std is not None:
            return int(self.noise_std.shape[0])
        assert self.noise_covariance is not None
        return int(self.noise_covariance.shape[0])

    def init(self, num_parameters: int, control_size: int) -> Any:
        """Return the initial scale (P, nu) of the noise, 1, if it adapts; otherwise nothing."""
        return () if self.adaptation is None else jnp.ones((num_parameters, control_size))

    def sample(
        self,
        memory: Any,
        context: SamplingContext,
        num_samples: int,
        *,
        key: Key,
        perturbations: Samples | None = None,
    ) -> Samples:
        """Draw `c + mu + eps` (P, nu, K)."""
        centre = context.centre[:, :, None]
        if perturbations is not None:
            return centre + perturbations
        return centre + self.mean[:, None] + self.draw(memory, centre.shape, num_samples, key=key)

    def draw(self, memory: Any, shape: tuple[int, ...], num_samples: int, *, key: Key) -> Samples:
        """Draw noise (P, nu, K) of mean 0 for parameters of shape (P, nu, ...)."""
        drawn = self.noise.draw((shape[0], shape[1], num_samples), key=key)
        if self.noise_std is not None:
            drawn = self.noise_std[:, None] * drawn
        else:
            # With L L^T = Sigma, L eps has the covariance Sigma. L is not stored, so that another
            # covariance can be set without recomputing anything.
            factor = jnp.linalg.cholesky(self.noise_covariance)
            drawn = jnp.einsum("uv,pvk->puk", factor, drawn)
        return drawn if self.adaptation is None else memory[:, :, None] * drawn

    def log_ratio(
        self, memory: Any, context: SamplingContext, samples: Samples
    ) -> Float[Array, " K"]:
        """Compute the log ratio (K,) of the proposal centred on the nominal."""
        return self.log_density_ratio(memory, context, context.centre, samples)

    def log_density_ratio(
        self, memory: Any, context: SamplingContext, mean: Parameters, samples: Samples
    ) -> Float[Array, " K"]:
        """Compute `log N(v; m + mu, S Sigma S) - log N(v; r + mu, Sigma)` (K,).

        S is the adapted scale. Constants that do not depend on the mean m are left out.
        """
        if self.adaptation is None:
            # Both covariances are equal, so the terms quadratic in v cancel. Subtracting them would
            # lose digits, and the linear rest is cheaper.
            away = mean - context.rest
            pull = self.precision(away)
            # The difference is (m - r)^T Sigma^-1 (v - mu - (m + r) / 2). Its part without v is
            # equal for all samples, so it is summed once.
            constant = jnp.sum(pull * (context.rest + self.mean + 0.5 * away))
            return jnp.einsum("pu,puk->k", pull, samples) - constant
        # The scales differ between parameters, so both quadratic forms are needed.
        drawn = samples - self.mean[:, None]
        scaled = (drawn - mean[:, :, None]) / memory[:, :, None]
        return 0.5 * self._square(drawn - context.rest[:, None]) - 0.5 * self._square(scaled)

    def precision(self, sequence: Parameters) -> Parameters:
        """Compute `Sigma^-1 sequence` (P, nu), for the covariance before adaptation."""
        sequence = self.noise.precision(sequence)
        if self.noise_std is not None:
            return sequence / (self.noise_std * self.noise_std)
        factor = jnp.linalg.cholesky(self.noise_covariance)
        solved: Array = jax.scipy.linalg.cho_solve((factor, True), sequence.T)
        return solved.T

    def adapt(
        self,
        memory: Any,
        context: SamplingContext,
        weights: Float[Array, " K"],
        samples: Samples,
    ) -> Any:
        """Update the scale of the noise, if it adapts."""
        if self.adaptation is None:
            return memory
        away = (samples - context.centre[:, :, None]) / self._deviation[:, None]
        return self.adaptation.adapt(memory, weights, away)

    def shift(self, memory: Any, rows: Scalar) -> Any:
        """Move the scale on in time, if it adapts."""
        return memory if self.adaptation is None else self.adaptation.shift(memory, rows)

    def check(self, num_parameters: int, horizon: int, control_size: int, num_samples: int) -> None:
        """Raise a `ValueError` if the noise does not fit a controller of these sizes."""
        if self.control_size != control_size:
            name = "noise_std" if self.noise_std is not None else "noise_covariance"
            value = self.noise_std if self.noise_std is not None else self.noise_covariance
            assert value is not None
            wanted = (control_size,) * value.ndim
            raise ValueError(
                f"{name} has shape {value.shape}; accepted: {wanted}, one per control of the model"
            )
        self.noise.check((num_parameters, control_size, num_samples))

    @property
    def _deviation(self) -> ControlVector:
        """Standard deviation (nu,) of the noise of each control."""
        if self.noise_std is not None:
            return self.noise_std
        assert self.noise_covariance is not None
        return jnp.sqrt(jnp.diagonal(self.noise_covariance))

    def _square(self, samples: Samples) -> Float[Array, " K"]:
        """Compute `v^T Sigma^-1 v` of each sample (K,)."""
        weighted = jax.vmap(self.precision, in_axes=-1, out_axes=-1)(samples)
        return jnp.sum(samples * weighted, axis=(0, 1))


def _standard_deviation(value: Vector) -> ControlVector:
    """Check a vector of standard deviations; a traced one is taken as it is."""
    if not isinstance(value, jax.core.Tracer):
        std = _checks.floats("noise_std", value, "one positive number per control")
        if std.ndim != 1 or not (np.isfinite(std) & (std > 0)).all():
            raise ValueError(f"noise_std is {value!r}; accepted: one positive number per control")
        value = std
    return jnp.asarray(value, jnp.float32)


def _covariance(value: Rows) -> Float[Array, "nu nu"]:
    """Check a covariance matrix; a traced one is taken as it is."""
    if not isinstance(value, jax.core.Tracer):
        accepted = "a symmetric matrix, one row per control"
        _checks.floats("noise_covariance", value, accepted)
        matrix = np.asarray(value, np.float64)
        square = matrix.ndim == 2 and matrix.shape[0] == matrix.shape[1] > 0
        if not square or not np.isfinite(matrix).all() or not np.allclose(matrix, matrix.T):
            raise ValueError(f"noise_covariance is {value!r}; accepted: {accepted}")
        least = float(np.linalg.eigvalsh(matrix).min())
        # The Cholesky factorisation in float32 fails for matrices closer to singular than this.
        if least <= 1e-6 * float(np.abs(matrix).max()):
            raise ValueError(
                f"noise_covariance has an eigenvalue of {least:.3g}; accepted: a positive definite "
                "matrix"
            )
        value = matrix
    return jnp.asarray(value, jnp.float32)
