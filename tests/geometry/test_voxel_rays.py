"""Voxel rays against a plain traversal in float64, and against what must hold of any."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st

from jaxplore.geometry.rays import TOUCH, walk

MOST = 64


@jax.jit
def visited(start, direction, length):
    """Return the voxels (R, MOST, 3) that rays visit, with distances and masks."""
    rays = start.shape[1]
    empty = (
        jnp.zeros((), jnp.int32),
        jnp.zeros((MOST, 3, rays), jnp.int32),
        jnp.zeros((MOST, 2, rays)),
        jnp.zeros((MOST, rays), bool),
    )

    def note(carry, step):
        n, voxels, ends, crossed = carry
        ends = ends.at[n].set(jnp.stack([step.entry, step.exit]))
        voxels, crossed = voxels.at[n].set(step.voxel), crossed.at[n].set(step.is_crossed)
        return (n + 1, voxels, ends, crossed), jnp.ones(rays, bool)

    return walk(start, direction, length, note, empty)[1:]


def plain(start: np.ndarray, direction: np.ndarray, length: float) -> list[tuple[int, ...]]:
    """Return the voxels of a ray from its sorted crossings with all planes, in float64."""
    crossings = [0.0, length]
    for axis in range(3):
        if abs(direction[axis]) > 1e-9:
            ends = sorted([start[axis], start[axis] + length * direction[axis]])
            planes = np.arange(np.ceil(ends[0]), np.floor(ends[1]) + 1)
            crossings += list((planes - start[axis]) / direction[axis])
    crossings = sorted(each for each in crossings if 0.0 <= each <= length)
    found = []
    for enters, leaves in itertools.pairwise(crossings):
        if leaves - enters > 5.0 * TOUCH:
            middle = start + 0.5 * (enters + leaves) * direction
            found.append(tuple(np.floor(middle).astype(int)))
    return found


finite = st.floats(-5.0, 5.0, width=32)


@example((0.0, 0.0, 0.0), (0.0, 1.0, -8.8e-29), 1.0)
@given(
    st.tuples(finite, finite, finite),
    st.tuples(finite, finite, finite).filter(lambda way: np.linalg.norm(way) > 0.1),
    st.floats(0.0, 20.0, width=32),
)
def test_the_voxels_are_those_of_a_plain_traversal(start, way, length) -> None:
    direction = np.asarray(way, np.float64) / np.linalg.norm(way)
    # What single precision holds is what both traverse.
    direction = direction.astype(np.float32)
    origin = np.asarray(start, np.float32)
    voxels, ends, crossed = (
        np.asarray(each)
        for each in visited(
            jnp.asarray(origin)[:, None], jnp.asarray(direction)[:, None], jnp.asarray([length])
        )
    )
    kept = crossed[:, 0] & (ends[:, 1, 0] - ends[:, 0, 0] > 5.0 * TOUCH)
    kept &= np.minimum(ends[:, 1, 0], length) - ends[:, 0, 0] > 5.0 * TOUCH
    found = [tuple(each) for each in voxels[kept, :, 0]]
    wanted = plain(origin.astype(np.float64), direction.astype(np.float64), float(length))
    # A voxel that the ray is in for about the tolerance may be in one list and not in the other.
    short = {each for each in found if each not in wanted} | {e for e in wanted if e not in found}
    assert len(short) == 0 or all(_span(origin, direction, each) < 1e-3 for each in short)
    assert [each for each in found if each not in short] == [e for e in wanted if e not in short]


def _span(start: np.ndarray, direction: np.ndarray, voxel: tuple[int, ...]) -> float:
    """Return the length of the part of a line that is in a voxel; 0 along a face of it."""
    low, high = -np.inf, np.inf
    for axis in range(3):
        if abs(direction[axis]) < 1e-9:
            if not TOUCH < start[axis] - voxel[axis] < 1.0 - TOUCH:
                return 0.0
            continue
        two = sorted((np.array([0.0, 1.0]) + voxel[axis] - start[axis]) / direction[axis])
        low, high = max(low, two[0]), min(high, two[1])
    return float(high - low)


def test_each_voxel_is_entered_where_the_last_one_was_left() -> None:
    rng = np.random.default_rng(0)
    way = rng.normal(size=(3, 200))
    way /= np.linalg.norm(way, axis=0)
    start = rng.uniform(-50.0, 50.0, (3, 200))
    voxels, ends, crossed = (
        np.asarray(each)
        for each in visited(
            *(jnp.asarray(v, jnp.float32) for v in (start, way, np.full(200, 15.0)))
        )
    )
    for ray in range(200):
        # The voxel in which the ray ends is its last one.
        number = int(np.argmax(ends[:, 1, ray] > 15.0)) + 1
        np.testing.assert_array_equal(ends[1:number, 0, ray], ends[: number - 1, 1, ray])
        steps = np.abs(np.diff(voxels[:number, :, ray], axis=0)).sum(axis=1)
        np.testing.assert_array_equal(steps, 1)
        np.testing.assert_array_equal(voxels[0, :, ray], np.floor(start[:, ray].astype(np.float32)))
        spans = ends[:number, 1, ray] - ends[:number, 0, ray]
        np.testing.assert_array_equal(crossed[:number, ray], spans > np.float32(TOUCH))
        assert not crossed[number:, ray].any()


def test_a_ray_that_is_not_finite_is_not_walked() -> None:
    start, way = jnp.full((3, 2), 0.5), jnp.asarray([[0.0, jnp.nan], [0.0, 0.0], [1.0, 1.0]])
    _, _, crossed = visited(start, way, jnp.asarray([2.0, 2.0]))
    assert np.asarray(crossed).sum(axis=0).tolist() == [3, 0]
