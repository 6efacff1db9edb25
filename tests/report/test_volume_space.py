"""Pictures of a volume in space, against what parallel projection says."""

import math

import numpy as np
import pytest

from jaxplore.report.volume.space import MOST_POINTS, SpacePicture, height_colours, surface

LOW, HIGH = np.array([1.0, 2.0, 0.0]), np.array([9.0, 8.0, 3.0])


def test_the_surface_is_what_free_space_touches() -> None:
    occupied = np.zeros((8, 9, 10), bool)
    occupied[2:5, 3:6, 4:7] = True
    found = surface(occupied, ~occupied)
    expected = occupied.copy()
    # The inside is hidden, and so is the middle of the lower side.
    expected[2:4, 4, 5] = False
    np.testing.assert_array_equal(found, np.argwhere(expected))
    np.testing.assert_array_equal(surface(occupied), np.argwhere(occupied))
    full = np.ones((40, 40, 40), bool)
    assert len(surface(full)) == MOST_POINTS
    assert surface(full)[:, 0].max() < 38
    assert surface(np.zeros((4, 4, 4), bool)).shape == (0, 3)


@pytest.mark.parametrize("azimuth", [0.0, 0.7, 2.0, -2.5])
def test_a_projection_keeps_lengths_across_the_view(azimuth: float) -> None:
    picture = SpacePicture(LOW, HIGH, 640, math.radians(40.0))
    middle = 0.5 * (LOW + HIGH)
    right = np.array([math.sin(azimuth), -math.cos(azimuth), 0.0])
    away = np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    points = middle + np.stack([np.zeros(3), right, away, up])
    pixels, near = picture.project(points, azimuth)
    scale = 0.96 * 640 / math.hypot(8.0, 6.0)
    np.testing.assert_allclose(pixels[0], np.array(picture.size) / 2.0)
    np.testing.assert_allclose(pixels[1] - pixels[0], [scale, 0.0], atol=1e-9)
    np.testing.assert_allclose(pixels[2] - pixels[0], [0.0, -scale * math.sin(math.radians(40.0))])
    np.testing.assert_allclose(pixels[3] - pixels[0], [0.0, -scale * math.cos(math.radians(40.0))])
    assert near[2] < near[0] < near[3]
    corners = np.array(np.meshgrid(*zip(LOW, HIGH, strict=True))).reshape(3, -1).T
    seen, _ = picture.project(corners, azimuth)
    assert (seen >= 0.0).all()
    assert (seen <= np.array(picture.size) + 1.0).all()


def test_nearer_voxels_hide_farther_ones() -> None:
    picture = SpacePicture(LOW, HIGH, 320, 0.0)
    middle = 0.5 * (LOW + HIGH)
    points = middle + np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])
    colours = np.array([[200, 0, 0], [0, 200, 0]], np.uint8)
    nothing = np.zeros((0, 3))
    for azimuth, first in ((0.0, 1), (math.pi, 0)):
        for order in ([0, 1], [1, 0]):
            drawn = picture.draw(points[order], colours[order], 0.5, nothing, azimuth)
            centre = tuple(each // 2 for each in drawn.size)
            assert drawn.getpixel(centre) == tuple(colours[first])
    empty = picture.draw(nothing, np.zeros((0, 3), np.uint8), 0.5, points, 0.0)
    assert empty.size == picture.size


def test_colours_rise_with_the_height() -> None:
    colours = height_colours(np.array([0.0, 1.5, 3.0, 9.0]), 0.0, 3.0)
    assert len({tuple(each) for each in colours.tolist()}) == 3
    np.testing.assert_array_equal(colours[2], colours[3])
