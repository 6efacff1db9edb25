import numpy as np
import pytest

from jaxplore.report.drawing.picture import outline_at
from jaxplore.report.exploration.window import Window


def test_window_is_the_box_of_the_reachable_cells_and_a_metre(make_recording):
    reachable = np.zeros((50, 60), bool)
    reachable[20, 30:41] = True
    recording = make_recording([(3.0, 2.0)] * 2, [0.5], shape=(50, 60), reachable=reachable)
    window = Window.around_reachable(recording)
    assert (window.first, window.shape) == ((10, 20), (21, 31))
    assert window.size == pytest.approx((3.1, 2.1))
    assert window.corner == pytest.approx((2.0, 1.0))
    assert window.crop(reachable, False).sum() == 11


def test_window_beyond_the_grid_is_filled(recording):
    window = Window.around_reachable(recording)
    assert window.first == (-9, -9)
    cropped = window.crop(recording.world, 0.5)
    assert (cropped[:9] == 0.5).all()
    assert (cropped[9:-9, 9:-9] == recording.world).all()


def test_an_outline_is_turned_about_the_robots_position():
    corners = np.array([[0.4, 0.15], [-0.2, 0.15], [-0.2, -0.15], [0.4, -0.15]])
    # A quarter turn to the left: ahead is up, and the left side is to the left.
    found = outline_at(corners, np.array([5.0, 7.0]), 0.5 * np.pi)
    expected = [[4.85, 7.4], [4.85, 6.8], [5.15, 6.8], [5.15, 7.4]]
    np.testing.assert_allclose(found, expected, atol=1e-12)
