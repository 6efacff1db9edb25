"""Clusters along the beams and hiding edges, against slow versions in NumPy."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from jaxplore.sensing.clusters import SKIPPED, cluster_points, find_hiding_edges, has_neighbour

BEAMS, GAP, WIDTH = 24, 0.3, 0.6
ANGLES = 2 * np.pi * np.arange(BEAMS) / BEAMS


@functools.cache
def compiled(is_circle: bool):
    find = functools.partial(cluster_points, number=BEAMS, is_circle=is_circle)
    edges = functools.partial(find_hiding_edges, number=BEAMS, is_circle=is_circle)
    return jax.jit(find), jax.jit(edges)


def drawn(seed: int, share: float):
    rng = np.random.default_rng(seed)
    # Long runs of one range, so that neighbours are often near.
    ranges = np.repeat(rng.uniform(0.3, 1.5, BEAMS), rng.integers(1, 5, BEAMS))[:BEAMS]
    ranges = (ranges + rng.normal(0.0, 0.02, BEAMS)).astype(np.float32)
    points = np.stack([ranges * np.cos(ANGLES), ranges * np.sin(ANGLES)], 1).astype(np.float32)
    return points, ranges, rng.random(BEAMS) < share


def joined(points, is_point, is_circle: bool) -> set[frozenset[int]]:
    """Return the clusters as sets of beams: each point joins the next one ahead of it."""
    sets = {int(i): {int(i)} for i in np.flatnonzero(is_point)}
    for i in list(sets):
        for ahead in range(1, SKIPPED + 1):
            j = (i + ahead) % BEAMS
            if not is_circle and i + ahead >= BEAMS:
                break
            if is_point[j]:
                if np.linalg.norm(points[i] - points[j]) <= GAP and sets[i] is not sets[j]:
                    sets[i] |= sets[j]
                    for k in sets[j]:
                        sets[k] = sets[i]
                break
    return {frozenset(each) for each in sets.values()}


@given(seed=st.integers(0, 2**31), share=st.sampled_from([0.2, 0.6, 1.0]), is_circle=st.booleans())
def test_clusters_are_those_of_a_union(seed: int, share: float, is_circle: bool) -> None:
    points, ranges, is_point = drawn(seed, share)
    found = compiled(is_circle)[0](points, ranges, is_point, jnp.float32(GAP))
    label = np.asarray(found.label)
    sets = {frozenset(np.flatnonzero(label == k).tolist()) for k in np.unique(label) if k < BEAMS}
    assert sets == joined(points, is_point, is_circle)
    assert int(found.num_points.sum()) == is_point.sum()
    for k in np.unique(label[label < BEAMS]):
        np.testing.assert_allclose(found.middle[k], points[label == k].mean(axis=0), atol=1e-5)
        assert found.num_points[k] == (label == k).sum()


@given(seed=st.integers(0, 2**31), share=st.sampled_from([0.3, 1.0]), is_circle=st.booleans())
def test_edges_are_where_the_range_jumps(seed: int, share: float, is_circle: bool) -> None:
    points, ranges, is_edge = drawn(seed, share)
    found = compiled(is_circle)[1](points, ranges, is_edge, jnp.float32(WIDTH))
    expected = []
    for i in np.flatnonzero(is_edge):
        beside = [i - 1, i + 1] if is_circle else [j for j in (i - 1, i + 1) if 0 <= j < BEAMS]
        if any(ranges[j % BEAMS] > ranges[i] + np.float32(WIDTH) for j in beside):
            expected.append(i)
    there = np.asarray(found.position)[np.asarray(found.is_there)]
    nearest = sorted(expected, key=lambda i: ranges[i])
    np.testing.assert_allclose(there, points[nearest].reshape(-1, 2), atol=1e-6)


def test_a_cluster_behind_something_is_cut() -> None:
    ranges = np.full(BEAMS, 3.0, np.float32)
    ranges[5:8], ranges[8] = 1.0, 0.4
    points = np.stack([ranges * np.cos(ANGLES), ranges * np.sin(ANGLES)], 1).astype(np.float32)
    is_point = np.zeros(BEAMS, bool)
    is_point[5:8] = True
    whole = ranges.copy()
    whole[8] = 3.0
    for each, is_cut in ((ranges, True), (whole, False)):
        found = compiled(True)[0](points, each, is_point, jnp.float32(GAP))
        assert int(found.num_points[0]) == 3
        assert bool(found.is_cut[0]) is is_cut


@jax.jit
def beside(points, is_point):
    return has_neighbour(points, is_point, jnp.float32(GAP))


@given(seed=st.integers(0, 2**31), share=st.sampled_from([0.02, 0.2, 0.7]))
def test_neighbours_are_those_of_a_loop(seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    # A fortieth of 120 directions are three.
    size, within = 120, 3
    angles = 2 * np.pi * np.arange(size) / size
    ranges = np.repeat(rng.uniform(0.3, 3.0, size), 5)[:size] + rng.normal(0.0, 0.02, size)
    points = np.stack([ranges * np.cos(angles), ranges * np.sin(angles)], 1).astype(np.float32)
    is_point = rng.random(size) < share
    expected = np.zeros(size, bool)
    for i in np.flatnonzero(is_point):
        for j in (i + np.arange(1, within + 1)) % size:
            if is_point[j]:
                if np.linalg.norm(points[i] - points[j]) <= GAP:
                    expected[[i, j]] = True
                break
    np.testing.assert_array_equal(beside(points, is_point), expected)
