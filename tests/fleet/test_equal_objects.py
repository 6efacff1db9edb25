"""What is done for equal things by one body is what is done for each by itself."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import _equal_objects
from jaxplore._equal_objects import Alike

THINGS = Alike([one := jnp.float32(2.0), two := jnp.float32(5.0), one, one])
ROWS = (
    [{"a": jnp.arange(3.0) + i, "none": None} for i in range(4)],
    [jnp.int32(i) for i in range(4)],
)


def scaled(thing, row, power):
    return {"found": jax.lax.cond(power > 1, lambda a: thing * a, lambda a: -a, row["a"])}


def expected(i: int) -> np.ndarray:
    """Compute the same with NumPy."""
    row = np.arange(3.0) + i
    return [2.0, 5.0, 2.0, 2.0][i] * row if i > 1 else -row


def test_things_that_are_one_object_are_stored_once() -> None:
    assert THINGS.kind_of == (0, 1, 0, 0)
    assert THINGS.all[2] is one
    assert len(jax.tree.leaves(THINGS)) == 2
    assert THINGS.at([3, 1]).kind_of == (0, 1)
    assert [float(each) for each in THINGS.map(lambda each: each + 1.0).all] == [3.0, 6.0, 3.0, 3.0]


@pytest.mark.parametrize("is_large", [False, True])
def test_each_gets_its_own_result_in_the_order_given(is_large) -> None:
    found = jax.jit(lambda *rows: THINGS.each(scaled, *rows, is_large=is_large))(*ROWS)
    for i, each in enumerate(found):
        np.testing.assert_array_equal(each["found"], expected(i))


def test_all_ways_to_compute_equal_things_agree() -> None:
    """The way of accelerators as well, which a CPU does not take by itself."""
    rows = [tuple(column[i] for column in ROWS) for i in (0, 2, 3)]
    for way in (
        _equal_objects.map_unrolled,
        _equal_objects.map_in_turn,
        _equal_objects.map_at_once,
    ):
        found = jax.jit(lambda given, way=way: way(lambda row: scaled(one, *row), given))(rows)
        for i, each in zip((0, 2, 3), found, strict=True):
            np.testing.assert_array_equal(each["found"], expected(i))


def test_one_body_is_compiled_for_equal_things() -> None:
    """On a CPU a body in a loop; large rows have a body each."""

    def bodies(is_large: bool) -> int:
        traced = jax.jit(lambda *rows: THINGS.each(scaled, *rows, is_large=is_large))
        return traced.lower(*ROWS).compile().as_text().count(" conditional(")

    assert bodies(False) == 2
    assert bodies(True) == 4
