"""Sine and cosine, against double precision."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore.geometry.angles import sin_cos

both = jax.jit(sin_cos)


@pytest.mark.parametrize(("reach", "error"), [(4.0, 1.3e-7), (100.0, 1.3e-7), (1e4, 2e-7)])
def test_they_are_right_in_single_precision(reach: float, error: float) -> None:
    rng = np.random.default_rng(0)
    quarters = np.arange(-8, 9) * (np.pi / 2)
    near = np.concatenate([quarters, np.nextafter(quarters, 9), [1e-30, -0.0, 1e-4]])
    angle = np.concatenate([rng.uniform(-reach, reach, 100_000), near]).astype(np.float32)
    sine, cosine = both(angle)
    exact = angle.astype(np.float64)
    assert np.abs(sine - np.sin(exact)).max() < error
    assert np.abs(cosine - np.cos(exact)).max() < error


def test_what_is_not_finite_stays_so_and_far_angles_are_bounded() -> None:
    for angle in (np.nan, np.inf, -np.inf):
        assert np.isnan(np.asarray(both(jnp.asarray(angle, jnp.float32)))).all()
    for value in both(jnp.asarray([1e6, -3e8, 1e30, -3e38], jnp.float32)):
        assert (np.abs(value) <= 1.0).all()


def test_derivatives_are_exact_at_the_seams_too() -> None:
    angle = jnp.asarray(np.linspace(-7.0, 7.0, 1001), jnp.float32)
    slope = jax.jit(jax.vmap(jax.grad(lambda a: sin_cos(a)[0] + 2.0 * sin_cos(a)[1])))(angle)
    expected = np.cos(np.float64(angle)) - 2.0 * np.sin(np.float64(angle))
    np.testing.assert_allclose(slope, expected, atol=1e-6)
    bend = jax.jit(jax.grad(jax.grad(lambda a: sin_cos(a)[0])))(jnp.asarray(0.7))
    assert float(bend) == pytest.approx(-np.sin(0.7), rel=1e-6)


def test_in_double_precision_they_are_exact() -> None:
    with jax.enable_x64(True):
        sine, cosine = sin_cos(jnp.asarray(0.3, jnp.float64))
        assert float(sine) == pytest.approx(np.sin(0.3), rel=1e-15)
        assert float(cosine) == pytest.approx(np.cos(0.3), rel=1e-15)
