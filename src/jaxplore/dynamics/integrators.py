"""How a continuous model is taken from one time step to the next."""

import abc
from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from jaxplore._types import ControlVector, Scalar, StateVector
from jaxplore._xla import cut

Derivative = Callable[[StateVector, ControlVector], StateVector]


class Integrator(eqx.Module):
    """Solves `dx/dt = f(x, u)` over one step of `dt` seconds with u held constant."""

    @abc.abstractmethod
    def __call__(
        self, derivative: Derivative, state: StateVector, control: ControlVector, dt: Scalar
    ) -> StateVector:
        """Return the state (nx,) after `dt`."""


class Euler(Integrator):
    """`x' = x + dt f(x, u)`; error of the order dt."""

    def __call__(
        self, derivative: Derivative, state: StateVector, control: ControlVector, dt: Scalar
    ) -> StateVector:
        """Return the state (nx,) after `dt`."""
        return jnp.stack(_ahead(tuple(state), derivative(state, control), dt))


class RK4(Integrator):
    """The classical Runge-Kutta method; error of the order dt^4.

        k1 = f(x, u),  k2 = f(x + dt/2 k1, u),  k3 = f(x + dt/2 k2, u),  k4 = f(x + dt k3, u)
        x' = x + dt/6 (k1 + 2 k2 + 2 k3 + k4)

    With s2, s3, s4 the states at which k2, k3, k4 are taken, the same is
    `x' = x + ((s2 - x) + 2 (s3 - x) + (s4 - x)) / 3 + dt/6 k4`: of each stage only the state is
    kept, which halves what a rollout of many samples reads and writes. The differences are exact in
    floating point, as of any two numbers within a factor of two.
    """

    def __call__(
        self, derivative: Derivative, state: StateVector, control: ControlVector, dt: Scalar
    ) -> StateVector:
        """Return the state (nx,) after `dt`."""
        half = 0.5 * dt
        first = tuple(state)
        second = cut(_ahead(first, derivative(state, control), half))
        third = cut(_ahead(first, derivative(jnp.stack(second), control), half))
        fourth = cut(_ahead(first, derivative(jnp.stack(third), control), dt))
        last = derivative(jnp.stack(fourth), control)
        return jnp.stack(
            [
                a + ((b - a) + 2.0 * (c - a) + (d - a)) / 3.0 + (dt / 6.0) * k
                for a, b, c, d, k in zip(first, second, third, fourth, last, strict=True)
            ]
        )


def _ahead(state: tuple[Array, ...], rate: Array, dt: Array) -> tuple[Array, ...]:
    # Component by component: XLA takes a stack apart again that is only unpacked, so that rollouts
    # of K samples compute on vectors of K, and no (nx, K) array is put together in between.
    return tuple(value + dt * change for value, change in zip(state, rate, strict=True))
