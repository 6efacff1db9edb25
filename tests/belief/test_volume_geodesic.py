"""Costs of paths in a volume against Dijkstra's algorithm in SciPy."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

from jaxplore.belief.roadmap import geodesic
from jaxplore.belief.volume_geodesic import volume_geodesic

SHAPE = (4, 7, 9)
costs_of = jax.jit(volume_geodesic)


def plain(sources: list[int], slowness: np.ndarray, half_open: np.ndarray) -> np.ndarray:
    """Return the least costs from some nodes, by Dijkstra's algorithm."""
    shape = slowness.shape
    rows, columns, costs = [], [], []
    for node in itertools.product(*map(range, shape)):
        for step in itertools.product((-1, 0, 1), repeat=3):
            there = tuple(np.add(node, step))
            if not any(step) or any(not 0 <= t < n for t, n in zip(there, shape, strict=True)):
                continue
            half = tuple(np.add(np.multiply(node, 2), step))
            ends = [tuple(np.multiply(each, 2)) for each in (node, there)]
            if half_open[half] and all(half_open[each] for each in ends):
                rows.append(np.ravel_multi_index(node, shape))
                columns.append(np.ravel_multi_index(there, shape))
                costs.append(np.linalg.norm(step) * 0.5 * (slowness[node] + slowness[there]))
    size = slowness.size
    graph = coo_matrix((costs, (rows, columns)), (size, size)).tocsr()
    return dijkstra(graph, indices=sources).min(axis=0).reshape(shape)


@settings(max_examples=25)
@given(st.integers(0, 2**31), st.floats(0.3, 1.0))
def test_costs_are_those_of_dijkstra(seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    half_open = rng.random(tuple(2 * n - 1 for n in SHAPE)) < share
    slowness = rng.uniform(1.0, 3.0, SHAPE)
    opens = np.flatnonzero(half_open[::2, ::2, ::2])
    source = np.full(SHAPE, np.inf, np.float32)
    chosen = rng.choice(opens, min(2, len(opens)), replace=False) if len(opens) else []
    source.reshape(-1)[chosen] = 0.0
    found = costs_of(jnp.asarray(source), jnp.asarray(slowness, jnp.float32), half_open)
    wanted = plain(list(chosen), slowness, half_open) if len(chosen) else np.full(SHAPE, np.inf)
    np.testing.assert_allclose(found, wanted, rtol=1e-5)


def test_sources_with_a_cost_of_their_own_compete() -> None:
    source = np.full(SHAPE, np.inf, np.float32)
    source[0, 0, 0], source[3, 6, 8] = 5.0, 0.0
    opens = np.ones(tuple(2 * n - 1 for n in SHAPE), bool)
    found = np.asarray(costs_of(jnp.asarray(source), jnp.ones(SHAPE), opens))
    assert found[0, 0, 0] == 5.0
    assert found[0, 0, 1] == 6.0
    # A source in a closed node is none.
    opens[0, 0, 0] = False
    found = np.asarray(costs_of(jnp.asarray(source), jnp.ones(SHAPE), opens))
    assert np.isinf(found[0, 0, 0])
    assert found[0, 0, 1] > 8.0


def test_an_extruded_plane_has_the_costs_of_the_plane() -> None:
    rng = np.random.default_rng(3)
    height, width, depth = 11, 13, 5
    is_open = rng.random((height, width)) < 0.75
    corners = np.ones((height, width), bool)
    corners[:-1, :-1] = rng.random((height - 1, width - 1)) < 0.8
    slowness = rng.uniform(1.0, 3.0, (height, width)).astype(np.float32)
    initial = np.where(
        rng.random((height, width)) < 0.05, rng.uniform(0, 4, (height, width)), np.inf
    )
    half = np.ones((2 * height - 1, 2 * width - 1), bool)
    half[::2, ::2] = is_open
    half[1::2, 1::2] = corners[:-1, :-1]
    planar = geodesic(
        jnp.asarray(initial, jnp.float32),
        jnp.asarray(slowness),
        jnp.asarray(is_open),
        jnp.asarray(corners),
    )
    found = volume_geodesic(
        jnp.asarray(np.broadcast_to(initial, (depth, height, width)), jnp.float32),
        jnp.asarray(np.broadcast_to(slowness, (depth, height, width))),
        jnp.asarray(np.broadcast_to(half, (2 * depth - 1, *half.shape))),
    )
    # All levels are alike, so no path gains by leaving its own.
    np.testing.assert_allclose(found, np.broadcast_to(planar, found.shape), rtol=1e-5)
    assert np.isfinite(planar).sum() > 60
