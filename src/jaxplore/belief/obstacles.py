"""Obstacles that a robot knows of, and where they will be."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore._checks import array, covariances, one_each
from jaxplore._types import Key, Rows, Scalar, Vector
from jaxplore.geometry.outlines import Outlines


class Obstacles(eqx.Module):
    """N obstacles, and how they go on: with constant velocity and constant turn rate.

    The n-th turns with the rate w about its centre p, whose velocity v turns with it. At time t

        p(t) = p + t (s v + c J v),   s = sin(w t) / (w t),   c = (1 - cos(w t)) / (w t)

    with J a quarter turn to the left: an arc, or for w = 0 a line, and one that stands where v = 0
    as well. Where it is becomes less certain with time, to first order in the errors of p, v and w:

        C(t) = C + (growth t)^2 I + turn_growth^2 d d^T,   d = dp(t) / dw

    (The constant-turn model with known rate of Li and Jilkov, "Survey of maneuvering target
    tracking. Part I: dynamic models", IEEE TAES 2003, section V.B.1. Its errors here are constants
    that nobody knows, not white noise: they last.)

    All of it are leaves: other obstacles in the same number do not recompile.

    Args:
        outlines: where they are now.
        velocities: (N, 2) of their centres [m/s]; they stand when absent.
        turn_rates: (N,) or one number [rad/s], positive to the left.
        centres: (N, 2) about which they turn [m]; the middles of their bounding boxes when absent.
        std: of where they are now along either axis, (N,) or one number [m]; 0, exact, when absent.
        covariance: (N, 2, 2), or (2, 2) for all [m^2]; instead of `std`.
        growth: standard deviation of the velocity along either axis, (N,) or one number [m/s].
        turn_growth: standard deviation of the turn rate, (N,) or one number [rad/s].

    Raises:
        ValueError: shapes that do not fit, numbers that are not finite, a negative deviation, a
            covariance that is not symmetric and positive semidefinite, `std` beside it.
    """

    outlines: Outlines
    velocities: Float[Array, "N 2"]
    turn_rates: Float[Array, " N"]
    centres: Float[Array, "N 2"]
    covariance: Float[Array, "N 2 2"]
    growth: Float[Array, " N"]
    turn_growth: Float[Array, " N"]

    def __init__(
        self,
        outlines: Outlines,
        velocities: Rows | None = None,
        turn_rates: Vector = 0.0,
        *,
        centres: Rows | None = None,
        std: Vector | None = None,
        covariance: Rows | None = None,
        growth: Vector = 0.0,
        turn_growth: Vector = 0.0,
    ) -> None:
        number = outlines.number
        rows: dict[str, Any] = {"may_be_empty": number == 0}
        self.outlines = outlines
        self.velocities = (
            jnp.zeros((number, 2))
            if velocities is None
            else array("velocities", velocities, (number, 2), **rows)
        )
        self.turn_rates = one_each("turn_rates", turn_rates, number)
        self.centres = (
            outlines.centres if centres is None else array("centres", centres, (number, 2), **rows)
        )
        std = 0.0 if std is None and covariance is None else std
        self.covariance = covariances(std, covariance, number, may_be_zero=True)
        self.growth = one_each("growth", growth, number, at_least=0.0)
        self.turn_growth = one_each("turn_growth", turn_growth, number, at_least=0.0)

    def __add__(self, other: "Obstacles") -> "Obstacles":
        """Return the obstacles of both."""
        both = (self, other)
        merged: dict[str, Array] = {
            name: jnp.concatenate([getattr(each, name) for each in both])
            for name in ("centres", "covariance", "growth", "turn_growth")
        }
        velocities = jnp.concatenate([each.velocities for each in both])
        turn_rates = jnp.concatenate([each.turn_rates for each in both])
        return Obstacles(self.outlines + other.outlines, velocities, turn_rates, **merged)

    def predicted_centres(self, t: Scalar) -> Float[Array, "N 2"]:
        """Return where the centres are `t` seconds from now (N, 2) [m]."""
        half = 0.5 * t * self.turn_rates
        chord = t * jnp.sinc(half / jnp.pi)
        return self.centres + chord[:, None] * _turned(self.velocities, half)

    def predicted(self, t: Scalar) -> Outlines:
        """Return the outlines as they are `t` seconds from now."""
        corners = self.outlines.corners - self.centres[:, None]
        turned = jax.vmap(_turned, in_axes=(1, None), out_axes=1)(corners, t * self.turn_rates)
        return Outlines(turned + self.predicted_centres(t)[:, None], self.outlines.radii)

    def predicted_covariance(self, t: Scalar) -> Float[Array, "N 2 2"]:
        """Return the covariance of the centres `t` seconds from now (N, 2, 2) [m^2]."""
        half = 0.5 * t * self.turn_rates
        # The chord is t sinc(half) long and half a turn ahead of the velocity.
        stretch = 0.5 * t * t * _sinc_slope(half)
        swing = 0.5 * t * t * jnp.sinc(half / jnp.pi)
        ahead, beside = (
            _turned(self.velocities, half),
            _turned(self.velocities, half + 0.5 * jnp.pi),
        )
        per_turn = stretch[:, None] * ahead + swing[:, None] * beside
        drift = (self.growth * t) ** 2
        return (
            self.covariance
            + drift[:, None, None] * jnp.eye(2)
            + (self.turn_growth**2)[:, None, None] * per_turn[:, :, None] * per_turn[:, None, :]
        )

    def drawn(self, key: Key) -> "Obstacles":
        """Return one way in which they may truly be and go on, known exactly."""
        number = self.outlines.number
        first, second, third = jax.random.split(key, 3)
        shift = jax.random.normal(first, (number, 2))
        off = jnp.einsum("nij,nj->ni", _root(self.covariance), shift)
        faster = self.growth[:, None] * jax.random.normal(second, (number, 2))
        turn = self.turn_growth * jax.random.normal(third, (number,))
        outlines = Outlines(self.outlines.corners + off[:, None], self.outlines.radii)
        return Obstacles(
            outlines,
            self.velocities + faster,
            self.turn_rates + turn,
            centres=self.centres + off,
        )


def _turned(vectors: Float[Array, "N 2"], angles: Float[Array, " N"]) -> Float[Array, "N 2"]:
    cos, sin = jnp.cos(angles), jnp.sin(angles)
    x, y = vectors[:, 0], vectors[:, 1]
    return jnp.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)


def _sinc_slope(angle: Float[Array, " N"]) -> Float[Array, " N"]:
    """Return the derivative of sin(a) / a."""
    is_small = jnp.abs(angle) < 0.1
    safe = jnp.where(is_small, 1.0, angle)
    square = angle * angle
    # The terms of the difference cancel near 0: there, the series, right to 1e-10.
    series = angle * (-1.0 / 3.0 + square * (1.0 / 30.0 - square / 840.0))
    return jnp.where(is_small, series, (jnp.cos(safe) - jnp.sin(safe) / safe) / safe)


def _root(covariance: Float[Array, "N 2 2"]) -> Float[Array, "N 2 2"]:
    """Return symmetric square roots (N, 2, 2), (C + s I) / sqrt(tr C + 2 s) with s^2 = det C."""
    a, b, c = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    root = jnp.sqrt(jnp.maximum(a * c - b * b, 0.0))
    size = a + c + 2.0 * root
    scale = jnp.where(size > 0.0, 1.0 / jnp.sqrt(jnp.where(size > 0.0, size, 1.0)), 0.0)
    return scale[:, None, None] * (covariance + root[:, None, None] * jnp.eye(2))
