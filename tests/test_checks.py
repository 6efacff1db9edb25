import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import _checks


@pytest.mark.parametrize("value", [0, -3, 1.5, "2", None, True, math.nan])
def test_positive_int_refuses(value: object) -> None:
    with pytest.raises(ValueError, match=r"n is .*; accepted: a whole number >= 1"):
        _checks.positive_int("n", value)


def test_positive_int_takes_numpy() -> None:
    assert _checks.positive_int("n", np.int64(4)) == 4


@pytest.mark.parametrize(
    "value", ["a", None, math.inf, 1e300, math.nan, True, [1.0], 0.0, 1.0, 10**400]
)
def test_number_refuses(value: object) -> None:
    with pytest.raises(ValueError, match=r"x is .*; accepted: a finite number > 0.0 and < 1.0"):
        _checks.number("x", value, above=0.0, below=1.0)


def test_closed_bounds_are_accepted() -> None:
    assert _checks.number("x", 2, at_least=2.0, at_most=2.0) == 2.0
    with pytest.raises(ValueError, match=r"accepted: a finite number >= 2.0 and <= 2.0"):
        _checks.number("x", 2.1, at_least=2.0, at_most=2.0)


def test_scalar_is_a_float32_leaf_and_passes_traced_values() -> None:
    assert _checks.scalar("x", 3).dtype == jnp.float32
    assert _checks.scalar("x", np.float64(3.0)).shape == ()
    with pytest.raises(ValueError, match=r"x has shape \(2,\); accepted: one number"):
        _checks.scalar("x", np.zeros(2))
    # Nothing raises in a trace: the value is not known there.
    assert float(jax.jit(lambda x: _checks.scalar("x", x, above=0.0))(-1.0)) == -1.0


@pytest.mark.parametrize(
    "value", [(1.0, 2.0), (1.0, 2.0, math.nan), (1.0, 2.0, 1e300), "abc", None, ((1.0,), 2.0)]
)
def test_vector_refuses(value: object) -> None:
    with pytest.raises(ValueError, match=r"v is .*; accepted: 3 finite numbers"):
        _checks.vector("v", value, 3)
