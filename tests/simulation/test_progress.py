import jax
import numpy as np

from jaxplore.simulation.exploration.progress import MapSums

SHAPE, SCANS = (60, 70), 4000


@jax.jit
def summed(probability, reachable, corners, parts):
    """The sums of a map of which parts (N, 8, 9) have changed one after another, and the map."""

    def change(carry, given):
        sums, now = carry
        corner, part = given
        before = jax.lax.dynamic_slice(now, corner, part.shape)
        counted = jax.lax.dynamic_slice(reachable, corner, part.shape)
        now = jax.lax.dynamic_update_slice(now, part, corner)
        both = (MapSums.of(each, counted) for each in (before, part))
        return (sums.update(*both), now), None

    start = MapSums.of(probability, reachable), probability
    (sums, now), _ = jax.lax.scan(change, start, (corners, parts))
    return sums, now


def test_changes_add_up_to_the_sums_of_the_map() -> None:
    rng = np.random.default_rng(0)
    values = np.array([0.001, 0.2, 0.25, 0.5, 0.9], np.float32)
    probability = rng.choice(values, SHAPE)
    reachable = rng.random(SHAPE) < 0.7
    corners = rng.integers(0, np.array(SHAPE) - [8, 9] + 1, (SCANS, 2), dtype=np.int32)
    parts = rng.choice(values, (SCANS, 8, 9))
    sums, now = jax.device_get(summed(probability, reachable, corners, parts))
    p = np.asarray(now, float)
    entropy = -(p * np.log(p) + (1 - p) * np.log(1 - p))
    assert sums.reachable == reachable.sum()
    assert sums.free == ((p < 0.25) & reachable).sum()
    is_unknown = 4 * p * (1 - p) > 0.5
    assert sums.unknown == (is_unknown & reachable).sum()
    assert sums.unknown_map == is_unknown.sum()
    # Each change is rounded by up to 6e-5 nat; added up, that would be some thousandths.
    np.testing.assert_allclose(sums.entropy, entropy[reachable].sum(), atol=5e-4)
