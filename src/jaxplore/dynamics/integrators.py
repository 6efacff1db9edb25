"""Integrate continuous-time models over one time step."""

import abc
from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from jaxplore._types import ControlVector, Scalar, StateVector
from jaxplore._xla import cut

Derivative = Callable[[StateVector, ControlVector], StateVector]


class Integrator(eqx.Module):
    """Method that solves `dx/dt = f(x, u)` over one step with a constant control; abstract."""

    @abc.abstractmethod
    def __call__(
        self, derivative: Derivative, state: StateVector, control: ControlVector, dt: Scalar
    ) -> StateVector:
        """Return the state after `dt` seconds of a constant control; `derivative` is f(state,
        control) = dx/dt."""


class Euler(Integrator):
    """Explicit Euler method, `x' = x + dt f(x, u)`; global error of order dt."""

    def __call__(
        self, derivative: Derivative, state: StateVector, control: ControlVector, dt: Scalar
    ) -> StateVector:
        """Return the state (nx,) after `dt` seconds."""
        return jnp.stack(_advance(tuple(state), derivative(state, control), dt))


class RK4(Integrator):
    """Classical Runge-Kutta method; global error of order dt^4.

        k1 = f(x, u),  k2 = f(x + dt/2 k1, u),  k3 = f(x + dt/2 k2, u),  k4 = f(x + dt k3, u)
        x' = x + dt/6 (k1 + 2 k2 + 2 k3 + k4)

    With s2, s3, s4 the states at which k2, k3, k4 are evaluated, this equals
    `x' = x + ((s2 - x) + 2 (s3 - x) + (s4 - x)) / 3 + dt/6 k4`. In this form only the state of each
    stage is kept, which halves the memory traffic of a rollout with many samples. The differences
    are exact in floating point if the states are within a factor of two of each other.
    """

    def __call__(
        self, derivative: Derivative, state: StateVector, control: ControlVector, dt: Scalar
    ) -> StateVector:
        """Return the state (nx,) after `dt` seconds."""
        # `cut` keeps XLA's CPU back end from recomputing all earlier stages for each component.
        half = 0.5 * dt
        first = tuple(state)
        second = cut(_advance(first, derivative(state, control), half))
        third = cut(_advance(first, derivative(jnp.stack(second), control), half))
        fourth = cut(_advance(first, derivative(jnp.stack(third), control), dt))
        last = derivative(jnp.stack(fourth), control)
        return jnp.stack(
            [
                a + ((b - a) + 2.0 * (c - a) + (d - a)) / 3.0 + (dt / 6.0) * k
                for a, b, c, d, k in zip(first, second, third, fourth, last, strict=True)
            ]
        )


def _advance(state: tuple[Array, ...], rate: Array, dt: Array) -> tuple[Array, ...]:
    # Component by component, because XLA removes a stack that is only unpacked again: rollouts of K
    # samples then compute on vectors of K without building (nx, K) arrays in between.
    return tuple(value + dt * change for value, change in zip(state, rate, strict=True))
