import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore.geometry.footprint import Disc, Footprint, Rectangle

LENGTH = st.floats(0.0625, 4, width=32)


def uncovered(footprint: Rectangle) -> float:
    """How far the farthest of a dense grid of the rectangle's points is outside every disc."""
    ahead = np.linspace(-float(footprint.rear), float(footprint.front), 61)
    left = np.linspace(-0.5, 0.5, 21) * float(footprint.width)
    x, y = np.meshgrid(ahead, left)
    centres = np.asarray(footprint.offsets, np.float64)
    away = np.hypot(x[..., None] - centres, y[..., None])
    return float(away.min(axis=-1).max()) - float(footprint.radius)


@given(LENGTH, st.floats(0, 4, width=32), LENGTH, st.sampled_from([None, 1, 2, 5]))
def test_discs_cover_a_rectangle_and_no_smaller_ones_do(front, rear, width, num_discs) -> None:
    footprint = Rectangle(front, rear, width, num_discs)
    # The corners are on the outermost discs: they are as small as so many can be.
    assert uncovered(footprint) == pytest.approx(0.0, abs=1e-5)
    count = num_discs or max(1, math.ceil((front + rear) / width))
    assert footprint.num_discs == count
    assert footprint.offsets.shape == (count,)
    middle = 0.5 * (front - rear)
    np.testing.assert_allclose(np.mean(footprint.offsets), middle, atol=1e-5)
    np.testing.assert_allclose(
        np.diff(footprint.offsets), (front + rear) / count, rtol=1e-4, atol=1e-5
    )


def test_known_discs() -> None:
    # 3 x 4 x 5: each disc holds a part 0.6 m long and 0.8 m wide.
    footprint = Rectangle(front=1.5, rear=0.3, width=0.8, num_discs=3)
    np.testing.assert_allclose(footprint.offsets, [0.0, 0.6, 1.2], atol=1e-6)
    assert float(footprint.radius) == pytest.approx(0.5)
    assert float(footprint.length) == pytest.approx(1.8)


@pytest.mark.parametrize(
    ("front", "rear", "width", "count"),
    [
        (0.625, 0.125, 0.4, 2),
        (0.9, 0.3, 0.4, 3),  # exactly three widths, but for rounding
        (0.7, 0.2, 0.3, 3),
        (0.1, 0.0, 4.0, 1),
        (1.0, 1.0, 0.999, 3),
    ],
)
def test_as_many_discs_as_widths(front, rear, width, count: int) -> None:
    assert Rectangle(front, rear, width).num_discs == count


def test_a_disc_covers_itself() -> None:
    disc = Disc(0.3)
    assert isinstance(disc, Footprint)
    np.testing.assert_array_equal(disc.offsets, [0.0])
    assert float(disc.radius) == np.float32(0.3)


def test_lengths_are_leaves_and_another_length_does_not_recompile() -> None:
    traces = []

    @jax.jit
    def discs(footprint):
        traces.append("compiled")
        return footprint.offsets, footprint.radius

    for footprint in (Rectangle(1.0, 0.5, 0.8), Rectangle(0.75, 0.5, 0.9)):
        assert {leaf.dtype for leaf in jax.tree.leaves(footprint)} == {jnp.dtype(jnp.float32)}
        for found, expected in zip(
            discs(footprint), (footprint.offsets, footprint.radius), strict=True
        ):
            np.testing.assert_allclose(found, expected, rtol=1e-6)
    assert len(traces) == 1


def test_built_in_traced_code() -> None:
    made = jax.jit(lambda x: (Rectangle(x, 0.0, x, 2), Disc(x)))(jnp.asarray(0.5))
    np.testing.assert_allclose(made[0].offsets, [0.125, 0.375])
    assert float(made[1].radius) == 0.5
    with pytest.raises(ValueError, match=r"^num_discs is None; accepted: .* lengths are traced"):
        jax.jit(lambda x: Rectangle(x, 0.0, 1.0))(jnp.asarray(0.5))


def test_bad_input_is_named() -> None:
    with pytest.raises(ValueError, match=r"front has shape \(2,\); accepted: one number"):
        Rectangle(np.ones(2), 0.5, 0.6)


def test_a_disc_has_a_radius() -> None:
    with pytest.raises(ValueError, match=r"^radius has shape .*; accepted: "):
        Disc(np.ones(2))
