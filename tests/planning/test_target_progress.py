"""Targets to which a robot comes no nearer, against a plain loop."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore.planning.strategy.target_controller import (
    LEAST,
    MEMORY,
    PATIENCE,
    TargetProgress,
)

SHAPE, SPACING = (24, 30), 0.5
NODE = jnp.asarray([10, 12], jnp.int32)


@jax.jit
def choices(distances, is_on_the_way):
    """Return the progress after each of some choices with these distances to one target."""

    def choose(progress, given):
        distance, on_the_way = given
        field = jnp.full(SHAPE, distance)
        progress = progress.update(field, NODE, on_the_way, SPACING)
        return progress, progress

    begin = TargetProgress.begin(SHAPE).towards(jnp.asarray(10.0), jnp.asarray(True))
    return jax.lax.scan(choose, begin, (distances, is_on_the_way))[1]


@given(st.integers(0, 2**31))
def test_it_is_a_plain_loop(seed: int) -> None:
    rng = np.random.default_rng(seed)
    number = 400
    # Mostly standing, with noise below what counts; sometimes coming nearer.
    nearer = np.cumsum(rng.random(number) < 0.01) * 0.3
    distances = (10.0 - nearer + rng.uniform(0.0, 0.15, number)).astype(np.float32)
    on_the_way = rng.random(number) < 0.995
    found = jax.device_get(choices(distances, on_the_way))
    best, waiting, stalls = np.float32(10.0), 0, 0
    avoided = np.zeros(SHAPE, int)
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    gap = np.hypot(rows - 10, columns - 12) * SPACING
    for index in range(number):
        avoided = np.maximum(avoided - 1, 0)
        is_nearer = distances[index] < best - np.float32(LEAST)
        waiting = waiting + 1 if on_the_way[index] and not is_nearer else 0
        if waiting >= PATIENCE:
            avoided[gap <= min(2.0**stalls, 16.0) + 1e-6] = MEMORY
            stalls, waiting = stalls + 1, 0
        elif is_nearer:
            stalls = 0
        best = distances[index] if is_nearer else best
        assert found.waiting[index] == waiting
        assert found.stalls[index] == stalls
        assert found.best[index] == best
        np.testing.assert_array_equal(found.avoided[index], avoided)


def test_places_around_are_avoided_farther_and_farther_and_not_for_ever() -> None:
    standing = np.full(4 * PATIENCE, 5.0, np.float32)
    found = jax.device_get(choices(standing, np.ones(len(standing), bool)))
    number = [(found.avoided[n * PATIENCE] > 0).sum() for n in range(1, 4)]
    assert number[0] == 13  # Within 1 m of a node, with nodes 0.5 m apart.
    assert number[0] < number[1] < number[2]
    moving = np.concatenate([standing[: PATIENCE + 1], np.full(MEMORY, 1.0, np.float32)])
    on_the_way = np.arange(len(moving)) <= PATIENCE
    found = jax.device_get(choices(moving, on_the_way))
    assert (found.avoided[PATIENCE] > 0).any()
    assert not (found.avoided[-1] > 0).any()
    assert found.stalls[-1] == 0


def test_another_target_begins_anew() -> None:
    progress = TargetProgress.begin(SHAPE)._replace(
        best=jnp.asarray(1.0), waiting=jnp.asarray(9, jnp.int32)
    )
    same = progress.towards(jnp.asarray(7.0), jnp.asarray(False))
    assert (float(same.best), int(same.waiting)) == (1.0, 9)
    other = progress.towards(jnp.asarray(7.0), jnp.asarray(True))
    assert (float(other.best), int(other.waiting)) == (pytest.approx(7.0), 0)
