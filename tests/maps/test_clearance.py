import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import distance_transform_edt

from jaxplore.maps.clearance import clearance_field, update_clearance
from jaxplore.maps.frame import GridFrame
from jaxplore.maps.window import Window

FRAME = GridFrame(0.1)
field = jax.jit(lambda blocked: clearance_field(blocked, FRAME, 0.6).values)


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.01, 0.05, 0.5]))
def test_equals_the_exact_distance_transform_up_to_its_bound(seed: int, density: float) -> None:
    blocked = np.random.default_rng(seed).random((31, 24)) < density
    centres = distance_transform_edt(np.pad(~blocked, 1))[1:-1, 1:-1]
    expected = np.clip((centres - 0.5) * 0.1, 0.0, 0.6)
    np.testing.assert_allclose(field(blocked), expected, atol=1e-6)


def test_everything_off_the_map_is_blocked() -> None:
    found = clearance_field(jnp.zeros((3, 3), bool), FRAME, 1.0)
    np.testing.assert_allclose(found.values[1], [0.05, 0.15, 0.05], atol=1e-6)
    assert float(found.outside) == 0.0


def test_does_not_recompile_for_another_map() -> None:
    field(np.zeros((31, 24), bool))
    before = field._cache_size()
    field(np.ones((31, 24), bool))
    assert field._cache_size() == before


def test_updates_inside_a_loop() -> None:
    def step(blocked, index):
        blocked = blocked.at[5, index].set(True)
        return blocked, clearance_field(blocked, FRAME, 0.6).values[5, 10]

    nothing = jnp.zeros((11, 21), bool)
    _, distances = jax.lax.scan(step, nothing, jnp.arange(10))
    assert float(distances[-1]) == pytest.approx(0.05)
    assert (np.diff(distances) <= 0).all()


@jax.jit
def updated(before, blocked, corner):
    """The clearance of a map after a change in a window of 5 x 40 cells, of which it has 24."""
    window = Window.at(corner, (5, 40), blocked.shape)
    values = clearance_field(before, FRAME, 0.6)
    now = update_clearance(values, window, lambda part: part.read(blocked), 0.6)
    return now.values, clearance_field(blocked, FRAME, 0.6).values


@given(st.integers(0, 2**32 - 1), st.integers(-3, 60), st.sampled_from([0.0, 0.002, 0.02, 0.2]))
def test_an_update_is_the_field_of_the_changed_map(seed: int, row: int, density: float) -> None:
    rng = np.random.default_rng(seed)
    before, other = (rng.random((57, 24)) < density for _ in range(2))
    first = int(np.clip(row, 0, 52))
    blocked = before.copy()
    blocked[first : first + 5] = other[first : first + 5]
    found, expected = updated(before, blocked, jnp.asarray([row, 0], jnp.int32))
    np.testing.assert_array_equal(found, expected)
