"""Generated race tracks."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely

from jaxplore import race_track


@pytest.mark.parametrize("seed", range(8))
def test_a_track_is_closed_wide_enough_and_does_not_meet_itself(seed: int) -> None:
    half_width, least = 1.1, 1.5
    track = race_track(seed, half_width=half_width, min_radius=least)
    assert track.is_closed
    assert float(track.length) == pytest.approx(60.0, rel=1e-2)
    phi = jnp.linspace(0.0, track.length, 2000)
    curvature = jax.vmap(lambda at: track.at(at).curvature)(phi)
    # Between the corners that were checked the spline may bend a little more.
    assert np.abs(curvature).max() < 1.1 / least
    sides = [
        np.asarray(jax.vmap(lambda at, side=side: track.offset(at, jnp.asarray(side)))(phi))
        for side in (half_width, -half_width)
    ]
    rings = [shapely.LinearRing(side) for side in sides]
    assert all(ring.is_valid for ring in rings)
    assert not rings[0].intersects(rings[1])
    np.testing.assert_array_equal(track.half_widths, np.full_like(track.half_widths, half_width))


def test_the_same_seed_gives_the_same_track_and_another_another() -> None:
    first, same, other = race_track(3), race_track(3), race_track(4)
    np.testing.assert_array_equal(first.points, same.points)
    assert first.points.shape != other.points.shape or np.abs(first.points - other.points).max() > 1
    bends = [
        np.abs(jax.vmap(lambda at: first.at(at).curvature)(phi)).max()
        for phi in (jnp.linspace(-0.2, 0.2, 9), jnp.linspace(0.0, first.length, 500))
    ]
    assert bends[0] < 0.2 * bends[1]


def test_what_is_no_track_is_refused() -> None:
    with pytest.raises(
        ValueError, match=r"half_width is 1\.1 m and min_radius 1\.5 m; accepted: l"
    ):
        race_track(length=10.0)
